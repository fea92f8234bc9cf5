//! Messages of topics that no rod reads: counted by topic, and each topic told with its first one.

use super::reply::LeftOut;
use super::server::TopicSet;
use crate::config::nearest;
use crate::recording::note;
use std::collections::{BTreeMap, VecDeque};
use std::mem;

/// Largest number of topics kept by name, because their names come from outside.
const MOST: usize = 16;
/// Longest name kept, in characters.
const LONGEST: usize = 255;

/// Messages that are not kept because no rod reads their topics.
#[derive(Default)]
pub(super) struct Foreign {
    /// Number of messages of each topic kept by name.
    topics: BTreeMap<String, u64>,
    /// Number of messages of further topics.
    further: u64,
    /// Number of messages since the last call of [`Foreign::take_fresh`].
    fresh: u64,
    /// Topics that came for the first time.
    news: VecDeque<LeftOut>,
}

impl Foreign {
    /// Counts a message, of a channel that is unknown without a topic. Topics that are `read` by rods are always kept by name.
    pub fn came(&mut self, topic: Option<&str>, read: &TopicSet) {
        self.fresh += 1;
        let Some(topic) = topic.filter(|topic| *topic != note::TOPIC) else {
            return;
        };
        let name = shortened(topic);
        if let Some(messages) = self.topics.get_mut(name) {
            *messages += 1;
        } else if self.topics.len() < MOST || read.contains(topic) {
            self.topics.insert(name.to_owned(), 1);
            // A topic that a rod reads is another sender's, which is answered otherwise.
            if !read.contains(topic) {
                self.news.push_back(left_out(1, name, read));
            }
        } else {
            self.further += 1;
        }
    }

    /// Number of messages since the last call.
    pub fn take_fresh(&mut self) -> u64 {
        mem::take(&mut self.fresh)
    }

    /// The next topic that came for the first time.
    pub fn take_news(&mut self) -> Option<LeftOut> {
        self.news.pop_front()
    }

    /// Topics kept by name.
    pub fn topics(&self) -> impl Iterator<Item = &str> {
        self.topics.keys().map(String::as_str)
    }

    /// Messages that were not kept, by topic.
    pub fn left_out(&self, read: &TopicSet) -> Vec<LeftOut> {
        let named = self.topics.iter().filter(|(_, messages)| **messages > 0);
        let mut all: Vec<LeftOut> = named
            .map(|(topic, messages)| left_out(*messages, topic, read))
            .collect();
        if self.further > 0 {
            all.push(LeftOut {
                messages: self.further,
                reason: "no rod reads their topics".to_owned(),
            });
        }
        all
    }

    /// State for the next stream of the same client: what was not reported yet, and names that were told.
    pub fn carried(&mut self) -> Self {
        Self {
            topics: self.topics.keys().map(|topic| (topic.clone(), 0)).collect(),
            further: 0,
            fresh: mem::take(&mut self.fresh),
            news: mem::take(&mut self.news),
        }
    }
}

fn left_out(messages: u64, topic: &str, read: &TopicSet) -> LeftOut {
    let near = nearest(topic, read.iter().map(String::as_str));
    let reason = match near {
        // Another one is no help.
        Some((edits, near)) if edits > 0 && 3 * edits <= near.chars().count() => {
            format!("no rod reads the topic {topic}; the nearest that one reads is {near}")
        }
        _ => format!("no rod reads the topic {topic}"),
    };
    LeftOut { messages, reason }
}

fn shortened(topic: &str) -> &str {
    let end = topic.char_indices().nth(LONGEST).map(|(end, _)| end);
    end.and_then(|end| topic.get(..end)).unwrap_or(topic)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_topic_is_told_once_and_all_of_its_messages_in_the_end() {
        let read = TopicSet::from(["/rod-b".to_owned()]);
        let mut foreign = Foreign::default();
        for topic in [
            Some("/rod-bb"),
            Some("/rod-bb"),
            Some("/imu"),
            None,
            Some(note::TOPIC),
        ] {
            foreign.came(topic, &read);
        }
        let news: Vec<_> = std::iter::from_fn(|| foreign.take_news()).collect();
        assert_eq!(news.len(), 2, "{news:?}");
        assert_eq!(
            news[0],
            LeftOut {
                messages: 1,
                reason: "no rod reads the topic /rod-bb; the nearest that one reads is /rod-b".to_owned()
            }
        );
        let counts = |foreign: &Foreign| -> Vec<u64> {
            let all = foreign.left_out(&read);
            all.iter().map(|left_out| left_out.messages).collect()
        };
        assert_eq!(counts(&foreign), [1, 2]);
        let mut next = foreign.carried();
        assert!(next.take_fresh() == 5 && counts(&next).is_empty());
        next.came(Some("/imu"), &read);
        assert!(next.take_news().is_none() && counts(&next) == [1]);
    }

    #[test]
    fn names_from_outside_are_bounded_and_every_message_is_counted() {
        let read = TopicSet::from(["/last".to_owned()]);
        let mut foreign = Foreign::default();
        for number in 0..1000 {
            foreign.came(Some(&format!("/{number:04}{}", "x".repeat(1000))), &read);
        }
        foreign.came(Some("/last"), &read);
        assert_eq!(foreign.topics().count(), MOST + 1);
        assert_eq!(std::iter::from_fn(|| foreign.take_news()).count(), MOST);
        assert!(foreign.topics().all(|topic| topic.len() <= LONGEST));
        let told: u64 = foreign.left_out(&read).iter().map(|all| all.messages).sum();
        assert_eq!(told, 1001);
    }
}
