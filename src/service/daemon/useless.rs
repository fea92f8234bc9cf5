//! Topics of rods whose messages all give no samples, as behind a mistyped `field`: a condition each, until one gives some.

use crate::config::Config;
use crate::recording::read::TopicSummary;
use crate::service::telemetry::{Fault, Health};

/// Begins and ends the conditions by what was read of some topics, each with the number of its messages. Those of topics that no rod
/// reads are not its own.
pub fn look<'t>(health: &Health, config: &Config, read: impl Iterator<Item = (&'t str, &'t TopicSummary)>) {
    for (name, topic) in read.filter(|(name, topic)| topic.messages > 0 && config.reads(name)) {
        let fault = topic
            .fault
            .as_ref()
            .filter(|_| topic.undecodable == topic.messages);
        match fault {
            Some(fault) if !health.lasts(Fault::Topic, name) => {
                let detail = format!(
                    "topic {name}: no message gives a sample: {fault}; mend the sender, or `field` of the rod that reads it"
                );
                health.hold(Fault::Topic, name, detail);
            }
            Some(_) => {}
            None => health.over(Fault::Topic, name),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_topic_without_samples_is_told_until_one_message_gives_some() {
        let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/config/todi.toml")).unwrap();
        let config = Config::parse(&text, "todi.toml").unwrap();
        let name = config.rods[0].channels.all().next().unwrap().topic.as_str();
        let health = Health::default();
        let look = |topic: &TopicSummary| look(&health, &config, [(name, topic)].into_iter());
        let mut topic = TopicSummary {
            messages: 2,
            undecodable: 2,
            fault: Some("there is no field `valuez`, it has value".to_owned()),
            ..TopicSummary::default()
        };
        look(&topic);
        assert!(health.lasts(Fault::Topic, name));
        let told = health.conditions();
        assert!(told[0].detail.contains("valuez"), "{told:?}");
        // Nothing of it in the next part so far.
        look(&TopicSummary::default());
        assert!(health.lasts(Fault::Topic, name));
        topic.messages += 1;
        look(&topic);
        assert!(health.conditions().is_empty());
    }
}
