//! Topics of rods whose messages all give no samples, as behind a mistyped `field`: a condition each, until one gives some.

use crate::recording::read::TopicSummary;
use crate::service::telemetry::{Fault, Health};
use std::collections::BTreeSet;

/// Topics that are conditions at present.
#[derive(Debug, Default)]
pub struct Useless(BTreeSet<String>);

impl Useless {
    /// Begins and ends the conditions by what was read of some topics, each with the number of its messages.
    pub fn look<'t>(&mut self, health: &Health, read: impl Iterator<Item = (&'t str, &'t TopicSummary)>) {
        for (name, topic) in read.filter(|(_, topic)| topic.messages > 0) {
            let fault = topic
                .fault
                .as_ref()
                .filter(|_| topic.undecodable == topic.messages);
            match fault {
                Some(fault) if !self.0.contains(name) => {
                    let detail = format!(
                        "topic {name}: no message gives a sample: {fault}; mend the sender, or `field` of the rod that reads it"
                    );
                    health.hold(Fault::Topic, name, detail);
                    self.0.insert(name.to_owned());
                }
                Some(_) => {}
                None => {
                    if self.0.remove(name) {
                        health.over(Fault::Topic, name);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_topic_without_samples_is_told_until_one_message_gives_some() {
        let (health, mut useless) = (Health::default(), Useless::default());
        let mut topic = TopicSummary {
            messages: 2,
            undecodable: 2,
            fault: Some("there is no field `valuez`, it has value".to_owned()),
            ..TopicSummary::default()
        };
        useless.look(&health, [("/laser/disp", &topic)].into_iter());
        assert!(health.lasts(Fault::Topic, "/laser/disp"));
        let told = health.conditions();
        assert!(told[0].detail.contains("valuez"), "{told:?}");
        // Nothing of it in the next part so far.
        useless.look(&health, [("/laser/disp", &TopicSummary::default())].into_iter());
        assert!(health.lasts(Fault::Topic, "/laser/disp"));
        topic.messages += 1;
        useless.look(&health, [("/laser/disp", &topic)].into_iter());
        assert!(health.conditions().is_empty());
    }
}
