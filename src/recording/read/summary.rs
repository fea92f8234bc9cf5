//! Content of a recording and its faults, in sentences.

use std::collections::BTreeMap;
use tirante_analysis::signal::record::RodId;

/// Content of a recording.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Summary {
    /// File name as given.
    pub file: String,
    /// Number of messages, of all topics.
    pub messages: u64,
    /// Number of samples of each configured rod.
    pub samples: BTreeMap<RodId, u64>,
    /// Damage that ended the reading: place and kind.
    pub damage: Option<String>,
    /// Data lost between two intact places, one clause each.
    pub holes: Vec<String>,
    /// True if it is cut short.
    pub truncated: bool,
    /// True if some of it has no checksum.
    pub unverified: bool,
    /// Every topic of the file.
    pub topics: BTreeMap<String, TopicSummary>,
    /// Notes that are no faults: items left out of another program's file, the column taken.
    pub notes: Vec<String>,
    /// Number of configured topics.
    pub wanted: usize,
    /// Configured topics that the file does not have.
    pub missing: Vec<(RodId, String)>,
}

/// Content of one topic.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct TopicSummary {
    /// Message encoding of the topic.
    pub encoding: String,
    /// Number of its messages.
    pub messages: u64,
    /// Number of messages of a configured channel that gave no samples.
    pub undecodable: u64,
    /// Error of the first of them.
    pub fault: Option<String>,
    /// Unit that the file states where the configuration reads another one: both, as written.
    pub other_unit: Option<[&'static str; 2]>,
}

impl Summary {
    /// True if any data was lost: damage, holes, or messages that could not be decoded.
    pub fn lost_data(&self) -> bool {
        self.damage.is_some()
            || !self.holes.is_empty()
            || self.topics.values().any(|topic| topic.undecodable > 0)
    }

    /// True if the file has none of the configured topics.
    pub fn has_nothing(&self) -> bool {
        self.wanted > 0 && self.missing.len() == self.wanted
    }

    /// One sentence per item that a person should know, most important first.
    pub fn sentences(&self) -> Vec<String> {
        let mut sentences = self.faults();
        sentences.extend(self.absence());
        sentences
    }

    /// One sentence on the configured topics that the file does not have, if there are any; this is normal where every rod
    /// has its own files.
    pub fn absence(&self) -> Option<String> {
        const NAMED: usize = 40;
        let listed = |names: &mut dyn Iterator<Item = String>, count: usize| {
            let mut named: Vec<String> = names.take(NAMED).collect();
            if count > NAMED {
                named.push(format!("and {} more", count - NAMED));
            }
            named.join(", ")
        };
        let mut missing = self
            .missing
            .iter()
            .map(|(rod, topic)| format!("{topic} (rod {rod})"));
        let has = if self.topics.is_empty() {
            "no topics at all".to_owned()
        } else {
            listed(&mut self.topics.keys().cloned(), self.topics.len())
        };
        let missing = match self.missing.len() {
            0 => return None,
            count => listed(&mut missing, count),
        };
        Some(format!("{}: no topic {missing}; it has {has}", self.file))
    }

    /// One sentence per fault of the file and of its messages.
    pub fn faults(&self) -> Vec<String> {
        let file = &self.file;
        let mut sentences = Vec::new();
        if let Some(damage) = &self.damage {
            sentences.push(damage.clone());
        }
        for hole in &self.holes {
            sentences.push(format!(
                "{file}: {hole}; what follows was used; copy the file again from the recorder"
            ));
        }
        for (name, topic) in &self.topics {
            if let Some(fault) = &topic.fault {
                sentences.push(format!(
                    "{file}: topic {name}: {} of {} messages give no samples: {fault}",
                    topic.undecodable, topic.messages
                ));
            }
            if let Some([said, read]) = topic.other_unit {
                sentences.push(format!(
                    "{file}: topic {name}: the file says {said}, and the configuration reads {read}: mend `unit` of the rod that reads it, or \
                     the recorder"
                ));
            }
        }
        if self.truncated {
            sentences.push(format!(
                "{file}: ends in the middle (cut short, or still being written); what is complete was used"
            ));
        }
        if self.unverified {
            sentences.push(format!(
                "{file}: some of it has no checksum, damage would go unseen; records from there on are marked unverified"
            ));
        }
        sentences
    }
}
