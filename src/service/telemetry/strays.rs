//! Received topics that belong to no rod: a bounded list of the latest.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

/// Largest number of topics kept, because their names come from outside.
const MOST: usize = 64;
/// Longest name kept, in characters.
const LONGEST: usize = 255;

/// Topics of no rod, with the time of each one's latest message.
#[derive(Debug, Default)]
pub struct Strays(Mutex<BTreeMap<String, Instant>>);

impl Strays {
    /// Adds a topic that belongs to no rod.
    pub fn came(&self, topic: &str) {
        self.came_at(topic, Instant::now());
    }

    fn came_at(&self, topic: &str, now: Instant) {
        let name: String = topic.chars().take(LONGEST).collect();
        let mut topics = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        topics.insert(name, now);
        if topics.len() > MOST
            && let Some(oldest) = topics.iter().min_by_key(|(_, last)| **last)
        {
            let oldest = oldest.0.clone();
            topics.remove(&oldest);
        }
    }

    /// Names of the topics.
    pub fn topics(&self) -> Vec<String> {
        let topics = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        topics.keys().cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn names_from_outside_are_bounded_and_the_latest_stay() {
        let (strays, begun) = (Strays::default(), Instant::now());
        for number in 0..1000_u32 {
            strays.came_at(
                &format!("/{number:04}"),
                begun + Duration::from_secs(u64::from(number)),
            );
        }
        strays.came_at(&"x".repeat(100_000), begun + Duration::from_secs(2000));
        let topics = strays.topics();
        assert_eq!(topics.len(), MOST);
        assert!(topics.contains(&"/0999".to_owned()) && !topics.contains(&"/0900".to_owned()));
        assert!(topics.iter().all(|topic| topic.len() <= LONGEST));
    }
}
