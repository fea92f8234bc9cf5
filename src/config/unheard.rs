//! Configured topics of which nothing comes, and the topics of no rod that most likely are misspellings of them.

use super::{Config, RodConfig, nearest};

/// A configured topic of which nothing comes.
#[derive(Debug, Clone, Copy)]
pub struct Unheard<'c> {
    /// The topic.
    pub topic: &'c str,
    /// Id of its rod.
    pub rod: &'c str,
    /// Table of the configuration that names it.
    table: &'static str,
    /// True for one sensor of a rod that has data, and for a thermometer: it may as well be dead, so only a topic much like it counts.
    is_one_of_several: bool,
}

impl<'c> Unheard<'c> {
    /// The topics of a rod's sensors, in their order; `has_data`: other sensors of the rod are heard.
    pub fn sensors(rod: &'c RodConfig, has_data: bool) -> impl Iterator<Item = Self> {
        let channels = rod.channels.sensors().enumerate();
        channels.map(move |(number, channel)| Self {
            topic: &channel.topic,
            rod: &rod.analysis.rod.0,
            table: match number {
                0 => "[rod.channel]",
                _ => "[[rod.sensor]]",
            },
            is_one_of_several: has_data,
        })
    }

    /// The topic of a rod's thermometer, if it has one.
    pub fn thermometer(rod: &'c RodConfig) -> Option<Self> {
        rod.channels.temperature.as_ref().map(|channel| Self {
            topic: &channel.topic,
            rod: &rod.analysis.rod.0,
            table: "[rod.temperature]",
            is_one_of_several: true,
        })
    }

    /// One clause with the next step, where another topic is the nearest.
    pub fn remedy(&self) -> String {
        let Self {
            topic, rod, table, ..
        } = self;
        format!("the nearest is {topic} (rod {rod}): mend `topic` in its {table}, or the sender")
    }
}

/// The one of `unheard` that a topic which came most likely is; `None` if a rod reads it, or it is much like none.
pub fn meant<'u, 'c>(config: &Config, unheard: &'u [Unheard<'c>], came: &str) -> Option<&'u Unheard<'c>> {
    let candidates = unheard.iter().map(|unheard| unheard.topic);
    let (edits, meant) = nearest(came, candidates).filter(|_| !config.reads(came))?;
    let is_alike = 3 * edits <= meant.chars().count();
    let mut of_it = unheard.iter().filter(|unheard| unheard.topic == meant);
    of_it.find(|unheard| is_alike || !unheard.is_one_of_several)
}
