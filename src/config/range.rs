//! Ranges of numbers that a key accepts, and their text forms.

use std::fmt;

/// An interval of allowed numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Range {
    low: f64,
    high: f64,
    low_is_open: bool,
}

impl Range {
    /// `low <= x <= high`.
    pub(super) const fn within(low: f64, high: f64) -> Self {
        Self {
            low,
            high,
            low_is_open: false,
        }
    }

    /// `low < x <= high`.
    pub(super) const fn above(low: f64, high: f64) -> Self {
        Self {
            low,
            high,
            low_is_open: true,
        }
    }

    /// True if it contains `value`; never for a NaN.
    pub(super) fn holds(&self, value: f64) -> bool {
        let above_low = if self.low_is_open {
            value > self.low
        } else {
            value >= self.low
        };
        above_low && value <= self.high
    }

    /// Text form: `0 < cv <= 1` for the name `cv`.
    pub(super) fn of<'n>(&self, name: &'n str) -> impl fmt::Display + use<'n> {
        let sign = if self.low_is_open { "<" } else { "<=" };
        format!("{} {sign} {name} <= {}", plain(self.low), plain(self.high))
    }
}

/// A number as people write it in messages: `14`, `0.07`, `2e11`.
pub(super) fn plain(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 || (1e-3..1e6).contains(&size) {
        format!("{value}")
    } else {
        format!("{value:e}")
    }
}

/// A number as TOML that reads back to the same bits: `14.0`, `0.07`, `2e11`.
pub(super) fn toml_float(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 || (1e-3..1e7).contains(&size) {
        format!("{value:?}")
    } else {
        format!("{value:e}")
    }
}

/// A string as a TOML basic string.
pub(super) fn toml_string(value: &str) -> String {
    toml::Value::String(value.to_owned()).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nan_lies_nowhere() {
        assert!(!Range::within(f64::MIN, f64::MAX).holds(f64::NAN));
        assert!(!Range::above(0.0, 1.0).holds(0.0));
        assert!(Range::within(0.0, 1.0).holds(0.0) && Range::above(0.0, 1.0).holds(1.0));
    }

    #[test]
    fn ranges_read_like_mathematics() {
        assert_eq!(Range::above(0.0, 1.0).of("cv").to_string(), "0 < cv <= 1");
        assert_eq!(
            Range::within(1e9, 2.5e12).of("x").to_string(),
            "1e9 <= x <= 2.5e12"
        );
    }

    #[test]
    fn floats_read_back_as_the_same_bits() {
        for value in [
            0.0,
            14.0,
            0.07,
            2e11,
            1e-9,
            0.1 + 0.2,
            1e7,
            123_456.789,
            f64::MIN_POSITIVE,
            -3.5,
        ] {
            let text = toml_float(value);
            let toml::Value::Float(back) = text.parse::<toml::Value>().unwrap() else {
                panic!("{text} is no TOML float")
            };
            assert_eq!(back.to_bits(), value.to_bits());
        }
    }
}
