//! What a recording held, and what was wrong with it, in sentences.

use crate::analysis::signal::record::RodId;
use std::collections::BTreeMap;

/// What a recording held.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Summary {
    /// The file, as named.
    pub file: String,
    /// All messages, wanted or not.
    pub messages: u64,
    /// Samples of each configured rod.
    pub samples: BTreeMap<RodId, u64>,
    /// Where and why the file could not be believed any further.
    pub damage: Option<String>,
    /// What was lost between two places that can be believed, a clause each.
    pub holes: Vec<String>,
    /// Whether it ended in the middle.
    pub truncated: bool,
    /// Whether some of it has no checksum.
    pub unverified: bool,
    /// Every topic of the file.
    pub topics: BTreeMap<String, TopicSummary>,
    /// What a person should know that is no fault: what was left out of another program's file, which column was taken.
    pub notes: Vec<String>,
    /// How many topics are configured.
    pub wanted: usize,
    /// Those of them the file does not have.
    pub missing: Vec<(RodId, String)>,
}

/// What one topic held.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct TopicSummary {
    /// Its message encoding.
    pub encoding: String,
    /// Its messages.
    pub messages: u64,
    /// Those of a configured channel that gave no samples.
    pub undecodable: u64,
    /// Why the first of them did not.
    pub fault: Option<String>,
}

impl Summary {
    /// Whether any data was lost: damage, holes, or messages that could not be decoded.
    pub fn lost_data(&self) -> bool {
        self.damage.is_some()
            || !self.holes.is_empty()
            || self.topics.values().any(|topic| topic.undecodable > 0)
    }

    /// Whether the file has none of the configured topics.
    pub fn has_nothing(&self) -> bool {
        self.wanted > 0 && self.missing.len() == self.wanted
    }

    /// One clear sentence for everything a person should know, most important first.
    pub fn sentences(&self) -> Vec<String> {
        let mut sentences = self.faults();
        sentences.extend(self.absences());
        sentences
    }

    /// One sentence per configured topic that the file does not have; normal where every rod has files
    /// of its own.
    pub fn absences(&self) -> Vec<String> {
        const NAMED: usize = 40;
        let mut topics: Vec<String> = self.topics.keys().take(NAMED).cloned().collect();
        if self.topics.len() > NAMED {
            topics.push(format!("and {} more", self.topics.len() - NAMED));
        }
        let has = if topics.is_empty() {
            "no topics at all".to_owned()
        } else {
            topics.join(", ")
        };
        let sentence = |(rod, topic): &(RodId, String)| {
            format!("{}: no topic {topic} (rod {rod}); it has {has}", self.file)
        };
        self.missing.iter().map(sentence).collect()
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
