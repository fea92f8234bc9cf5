//! Topics of the files of a campaign beside those of the configuration: a rod that no file speaks of must not pass for one that was read.

use crate::config::Config;
use crate::config::unheard::{self, Unheard};
use crate::recording::read::Summary;
use std::collections::BTreeSet;

/// Topics that came in the files so far.
#[derive(Debug, Default)]
pub struct Topics(BTreeSet<String>);

/// Differences between the topics of the files and those of the configuration.
#[derive(Debug, Default)]
pub struct Differences {
    /// One sentence per topic that belongs to no rod and most likely is a misspelling of one that no file has.
    pub misspelt: Vec<String>,
    /// Rods of which no file has a topic.
    pub absent: Vec<String>,
    /// True if these are all rods.
    pub is_all: bool,
}

impl Topics {
    /// Takes the topics of a file.
    pub fn take(&mut self, summary: &Summary) {
        let came = summary.topics.iter().filter(|(_, topic)| topic.messages > 0);
        self.0.extend(came.map(|(name, _)| name.clone()));
    }

    /// Compares them with the configuration's; none came where no recording was read.
    pub fn compare(&self, config: &Config) -> Differences {
        let mut differences = Differences::default();
        if self.0.is_empty() {
            return differences;
        }
        let mut unheard: Vec<Unheard<'_>> = Vec::new();
        for rod in &config.rods {
            let has_data = rod
                .channels
                .sensors()
                .any(|channel| self.0.contains(&channel.topic));
            if !has_data {
                differences.absent.push(rod.analysis.rod.0.clone());
            }
            // A file of one rod may have topics of other purposes: only one much like a rod's counts.
            let of_rod = Unheard::sensors(rod, true).chain(Unheard::thermometer(rod));
            unheard.extend(of_rod.filter(|one| !self.0.contains(one.topic)));
        }
        differences.is_all = differences.absent.len() == config.rods.len();
        for came in &self.0 {
            if let Some(meant) = unheard::meant(config, &unheard, came) {
                differences.misspelt.push(format!(
                    "topic {came} is in the files and belongs to no rod; of the configured topics that no file has, {}",
                    meant.remedy()
                ));
            }
        }
        differences
    }
}
