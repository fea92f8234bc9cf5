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
}
