//! Topics that belong to no rod, while a rod gets no data: most likely one is a misspelling of the other.

use crate::config::{RodConfig, nearest};
use crate::service::telemetry::{Fault, Health};
use std::collections::BTreeSet;

/// Topics that are conditions at present.
#[derive(Debug, Default)]
pub struct Misnamed {
    held: BTreeSet<String>,
}

impl Misnamed {
    /// Checks the topics received; `unheard`: rods without data, `is_wanted`: true if a topic is read. While
    /// every rod has data, other topics are ignored.
    pub fn look<'r>(
        &mut self,
        health: &Health,
        unheard: impl Iterator<Item = &'r RodConfig>,
        is_wanted: impl Fn(&str) -> bool,
    ) {
        let unheard: Vec<(&str, &str)> = unheard
            .map(|rod| {
                let topic = rod.channels.displacement.topic.as_str();
                (topic, rod.analysis.rod.0.as_str())
            })
            .collect();
        let mut holds = BTreeSet::new();
        if !unheard.is_empty() {
            for topic in health.strays().topics() {
                let candidates = unheard.iter().map(|(topic, _)| *topic);
                let Some((_, meant)) = nearest(&topic, candidates).filter(|_| !is_wanted(&topic)) else {
                    continue;
                };
                let rod = unheard.iter().find(|(topic, _)| *topic == meant);
                let rod = rod.map_or("", |(_, rod)| *rod);
                let detail = format!(
                    "topic {topic} comes and belongs to no rod; of the rods of which nothing comes, the nearest topic is {meant} \
                     (rod {rod}): mend `topic` in its [rod.channel], or the sender"
                );
                health.hold(Fault::Topic, &topic, detail);
                holds.insert(topic);
            }
        }
        for topic in self.held.difference(&holds) {
            health.over(Fault::Topic, topic);
        }
        self.held = holds;
    }
}
