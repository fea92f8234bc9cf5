//! Location of a rod's samples in a recording: topic, field, unit and time.

use super::{RodId, Unit};
use serde::Serialize;

/// Source of the time of a message's (first) sample.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub enum TimeSource {
    /// The MCAP log time.
    Log,
    /// The MCAP publish time.
    Publish,
    /// A field of the message: nanoseconds (integer), seconds (float), an RFC 3339 string, or a
    /// `{sec, nanosec}` / `{seconds, nanos}` structure.
    Field(String),
}

/// Location of one quantity in a recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Channel {
    /// MCAP topic.
    pub topic: String,
    /// The path inside the message, dots between names, indices in brackets: `point.z`, `data[3]`,
    /// `sensors[0].value`. A path that ends at an array of numbers gives one sample per entry.
    pub field: String,
    /// Unit of the raw values.
    pub unit: Unit,
    /// Source of the time of the (first) sample.
    pub time: TimeSource,
    /// Declared sample rate \[Hz\]; required for arrays, checked against the stamps otherwise.
    pub fs_hz: Option<f64>,
}

/// The channels of one rod.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RodChannels {
    /// Id of the rod.
    pub rod: RodId,
    /// Its displacement, velocity or acceleration.
    pub displacement: Channel,
    /// Its temperature, if measured.
    pub temperature: Option<Channel>,
    /// Its further sensors, if it has any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub beside: Option<Beside>,
}

/// Further sensors of a rod.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Beside {
    /// Their channels.
    pub channels: Vec<Channel>,
    /// Furthest that a sensor may be behind another and is still waited for \[s\].
    pub wait_s: f64,
}

impl RodChannels {
    /// Channels of its sensors, the first one first.
    pub fn sensors(&self) -> impl Iterator<Item = &Channel> {
        let further = self.beside.iter().flat_map(|beside| &beside.channels);
        std::iter::once(&self.displacement).chain(further)
    }

    /// All of its channels: sensors, then temperature.
    pub fn all(&self) -> impl Iterator<Item = &Channel> {
        self.sensors().chain(&self.temperature)
    }

    /// All of its channels, to be changed.
    pub fn all_mut(&mut self) -> impl Iterator<Item = &mut Channel> {
        let further = self.beside.iter_mut().flat_map(|beside| &mut beside.channels);
        std::iter::once(&mut self.displacement)
            .chain(further)
            .chain(&mut self.temperature)
    }

    /// The same rod with its first sensor alone.
    #[must_use]
    pub fn alone(self) -> Self {
        Self { beside: None, ..self }
    }

    /// The rod once for each of its sensors, with that one alone.
    pub fn lanes(&self) -> impl Iterator<Item = Self> {
        self.sensors().map(|channel| Self {
            rod: self.rod.clone(),
            displacement: channel.clone(),
            temperature: self.temperature.clone(),
            beside: None,
        })
    }
}
