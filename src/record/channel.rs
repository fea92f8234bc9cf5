//! Where a rod's samples stand in a recording: topic, field, unit and time.

use super::RodId;
use serde::Serialize;

/// The unit of a channel's samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum Unit {
    /// Displacement in metres.
    #[serde(rename = "m")]
    Metre,
    /// Displacement in millimetres.
    #[serde(rename = "mm")]
    Millimetre,
    /// Displacement in micrometres.
    #[serde(rename = "um")]
    Micrometre,
    /// Displacement in nanometres.
    #[serde(rename = "nm")]
    Nanometre,
    /// Velocity in metres per second.
    #[serde(rename = "m/s")]
    MetrePerSecond,
    /// Velocity in millimetres per second.
    #[serde(rename = "mm/s")]
    MillimetrePerSecond,
    /// Velocity in micrometres per second.
    #[serde(rename = "um/s")]
    MicrometrePerSecond,
    /// Acceleration in metres per second squared.
    #[serde(rename = "m/s2")]
    MetrePerSecondSquared,
    /// Acceleration in standard gravity.
    #[serde(rename = "g")]
    StandardGravity,
    /// Temperature in degrees Celsius.
    #[serde(rename = "degC")]
    Celsius,
    /// Temperature in kelvin.
    #[serde(rename = "K")]
    Kelvin,
    /// Temperature in degrees Fahrenheit.
    #[serde(rename = "degF")]
    Fahrenheit,
}

impl Unit {
    /// Every unit of motion.
    pub const MOTION: [Self; 9] = [
        Self::Metre,
        Self::Millimetre,
        Self::Micrometre,
        Self::Nanometre,
        Self::MetrePerSecond,
        Self::MillimetrePerSecond,
        Self::MicrometrePerSecond,
        Self::MetrePerSecondSquared,
        Self::StandardGravity,
    ];

    /// Every unit of temperature.
    pub const TEMPERATURE: [Self; 3] = [Self::Celsius, Self::Kelvin, Self::Fahrenheit];

    /// The SI unit its values are converted to.
    pub fn si(self) -> &'static str {
        match self {
            Self::Metre | Self::Millimetre | Self::Micrometre | Self::Nanometre => "m",
            Self::MetrePerSecond | Self::MillimetrePerSecond | Self::MicrometrePerSecond => "m/s",
            Self::MetrePerSecondSquared | Self::StandardGravity => "m/s\u{b2}",
            Self::Celsius | Self::Kelvin | Self::Fahrenheit => "\u{b0}C",
        }
    }

    /// The name in configuration.
    pub fn key(self) -> &'static str {
        match self {
            Self::Metre => "m",
            Self::Millimetre => "mm",
            Self::Micrometre => "um",
            Self::Nanometre => "nm",
            Self::MetrePerSecond => "m/s",
            Self::MillimetrePerSecond => "mm/s",
            Self::MicrometrePerSecond => "um/s",
            Self::MetrePerSecondSquared => "m/s2",
            Self::StandardGravity => "g",
            Self::Celsius => "degC",
            Self::Kelvin => "K",
            Self::Fahrenheit => "degF",
        }
    }

    /// A raw value in SI (m, m/s, m/s^2), or in degrees Celsius for temperatures.
    pub fn convert(self, raw: f64) -> f64 {
        match self {
            Self::Metre | Self::MetrePerSecond | Self::MetrePerSecondSquared | Self::Celsius => raw,
            Self::Millimetre | Self::MillimetrePerSecond => raw * 1e-3,
            Self::Micrometre | Self::MicrometrePerSecond => raw * 1e-6,
            Self::Nanometre => raw * 1e-9,
            Self::StandardGravity => raw * 9.806_65,
            Self::Kelvin => raw - 273.15,
            Self::Fahrenheit => (raw - 32.0) / 1.8,
        }
    }
}

/// Which stamp of a message is the time of its (first) sample.
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

/// Where one quantity stands in a recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Channel {
    /// The topic.
    pub topic: String,
    /// The path inside the message, dots between names, indices in brackets: `point.z`, `data[3]`,
    /// `sensors[0].value`. A path that ends at an array of numbers means one sample an entry.
    pub field: String,
    /// The unit of the raw values.
    pub unit: Unit,
    /// Which stamp is the time of the (first) sample.
    pub time: TimeSource,
    /// Declared sample rate \[Hz\]; required for arrays, checked against the stamps otherwise.
    pub fs_hz: Option<f64>,
}

/// The channels of one rod.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RodChannels {
    /// The rod.
    pub rod: RodId,
    /// Its displacement, velocity or acceleration.
    pub displacement: Channel,
    /// Its temperature, if measured.
    pub temperature: Option<Channel>,
}
