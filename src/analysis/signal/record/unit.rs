//! Units of samples: names in configuration and in other programs, and conversion to SI.

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
    /// Strain.
    #[serde(rename = "strain")]
    Strain,
    /// Strain in millionths.
    #[serde(rename = "ue")]
    Microstrain,
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

    /// Every unit of a sensor on a rod: motion and strain.
    pub const SENSOR: [Self; 11] = [
        Self::Metre,
        Self::Millimetre,
        Self::Micrometre,
        Self::Nanometre,
        Self::MetrePerSecond,
        Self::MillimetrePerSecond,
        Self::MicrometrePerSecond,
        Self::MetrePerSecondSquared,
        Self::StandardGravity,
        Self::Strain,
        Self::Microstrain,
    ];

    /// Every unit of temperature.
    pub const TEMPERATURE: [Self; 3] = [Self::Celsius, Self::Kelvin, Self::Fahrenheit];

    /// The SI unit its values are converted to.
    pub fn si(self) -> &'static str {
        match self {
            Self::Metre | Self::Millimetre | Self::Micrometre | Self::Nanometre => "m",
            Self::MetrePerSecond | Self::MillimetrePerSecond | Self::MicrometrePerSecond => "m/s",
            Self::MetrePerSecondSquared | Self::StandardGravity => "m/s\u{b2}",
            Self::Strain | Self::Microstrain => "m/m",
            Self::Celsius | Self::Kelvin | Self::Fahrenheit => "\u{b0}C",
        }
    }

    /// True for strain.
    pub fn is_strain(self) -> bool {
        matches!(self, Self::Strain | Self::Microstrain)
    }

    /// Derivatives by time of a displacement that it measures; a strain follows the displacement.
    pub fn derivative(self) -> i32 {
        match self.si() {
            "m/s" => 1,
            "m/s\u{b2}" => 2,
            _ => 0,
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
            Self::Strain => "strain",
            Self::Microstrain => "ue",
            Self::Celsius => "degC",
            Self::Kelvin => "K",
            Self::Fahrenheit => "degF",
        }
    }

    /// Converts a raw value to SI (m, m/s, m/s^2), or a temperature to degrees Celsius.
    pub fn convert(self, raw: f64) -> f64 {
        match self {
            Self::Metre
            | Self::MetrePerSecond
            | Self::MetrePerSecondSquared
            | Self::Strain
            | Self::Celsius => raw,
            Self::Millimetre | Self::MillimetrePerSecond => raw * 1e-3,
            Self::Micrometre | Self::MicrometrePerSecond | Self::Microstrain => raw * 1e-6,
            Self::Nanometre => raw * 1e-9,
            Self::StandardGravity => raw * 9.806_65,
            Self::Kelvin => raw - 273.15,
            Self::Fahrenheit => (raw - 32.0) / 1.8,
        }
    }

    /// Parses a unit as written by a file or a person; `None` if it is not supported.
    pub fn as_written(text: &str) -> Option<Self> {
        // Two characters look like a micro sign.
        let text: String = text
            .trim()
            .replace(['µ', 'μ'], "u")
            .replace('²', "2")
            .replace("^2", "2")
            .replace("**2", "2")
            .replace("°", "deg")
            .replace(' ', "");
        let every = Self::SENSOR.into_iter().chain(Self::TEMPERATURE);
        if let Some(unit) = every.into_iter().find(|unit| unit.key() == text) {
            return Some(unit);
        }
        // Only unambiguous spellings: "c", "f" and "M" are left alone.
        match text.as_str() {
            "meter" | "metre" | "meters" | "metres" => Some(Self::Metre),
            "millimeter" | "millimetre" | "MM" | "Mm" => Some(Self::Millimetre),
            "micron" | "microns" | "micrometer" | "micrometre" => Some(Self::Micrometre),
            "m/sec" | "ms-1" | "m.s-1" => Some(Self::MetrePerSecond),
            "mm/sec" | "mms-1" | "mm.s-1" => Some(Self::MillimetrePerSecond),
            "um/sec" => Some(Self::MicrometrePerSecond),
            "m/sec2" | "m/s/s" | "ms-2" | "m.s-2" => Some(Self::MetrePerSecondSquared),
            "gn" | "g0" => Some(Self::StandardGravity),
            // The second is written by programs that lack the sign.
            "C" | "\u{fffd}C" | "Celsius" | "celsius" => Some(Self::Celsius),
            "kelvin" | "Kelvin" => Some(Self::Kelvin),
            "F" | "Fahrenheit" | "fahrenheit" => Some(Self::Fahrenheit),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spellings_are_known_and_strangers_are_not() {
        for (text, unit) in [
            ("mm", Unit::Millimetre),
            ("µm", Unit::Micrometre),
            ("μm/s", Unit::MicrometrePerSecond),
            ("m/s²", Unit::MetrePerSecondSquared),
            ("m/s^2", Unit::MetrePerSecondSquared),
            ("°C", Unit::Celsius),
            ("deg C", Unit::Celsius),
            ("\u{fffd}C", Unit::Celsius),
            (" g ", Unit::StandardGravity),
        ] {
            assert_eq!(Unit::as_written(text), Some(unit), "{text}");
        }
        for text in ["", "V", "M", "s", "mV", "inch", "c"] {
            assert_eq!(Unit::as_written(text), None, "{text}");
        }
    }
}
