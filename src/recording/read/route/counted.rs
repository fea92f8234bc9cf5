//! Contents of a file as counted: messages and samples by topic and rod, and what is missing.

use super::{Rod, Router};
use crate::read::summary::{Summary, TopicSummary};
use tirante_analysis::signal::record::Channel;

impl Router {
    /// Topics so far.
    pub fn topics(&self) -> impl Iterator<Item = (&str, &TopicSummary)> {
        let topics = self.topics.iter();
        topics.map(|topic| (topic.name.as_str(), &topic.summary))
    }

    /// Number of messages of all topics.
    pub fn messages(&self) -> u64 {
        self.topics.iter().map(|topic| topic.summary.messages).sum()
    }

    /// Adds the counts of messages to a summary.
    pub fn summarise(&self, summary: &mut Summary) {
        summary.unverified = self.unverified;
        let topics = self.topics.iter();
        summary.topics = topics
            .map(|topic| (topic.name.clone(), topic.summary.clone()))
            .collect();
        summary.holes = self.holes.clone();
        for (what, counts) in [
            ("records end early", &self.cuts),
            ("moments did not wait for every sensor", &self.released),
        ] {
            for (at, times) in counts {
                let Some(Rod { config, .. }) = self.rods.get(*at) else {
                    continue;
                };
                summary.notes.push(format!(
                    "{}: rod {}: {times} {what}: the samples of all rods together took too much memory",
                    summary.file, config.rod
                ));
            }
        }
        summary.missing.clear();
        summary.wanted = 0;
        summary.samples.clear();
        for (Rod { config, sensor, .. }, count) in self.rods.iter().zip(&self.counts) {
            *summary.samples.entry(config.rod.clone()).or_default() += count.samples;
            let temperature = config.temperature.as_ref().filter(|_| *sensor == 0);
            let wanted = [Some(&config.displacement), temperature];
            for Channel { topic, .. } in wanted.into_iter().flatten() {
                summary.wanted += 1;
                if !summary.topics.contains_key(topic) {
                    summary.missing.push((config.rod.clone(), topic.clone()));
                }
            }
        }
    }
}
