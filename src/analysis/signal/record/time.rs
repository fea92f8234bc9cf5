//! Points in time, as recordings stamp them.

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use std::fmt;

/// A day \[s\].
pub const DAY_S: f64 = 86_400.0;

/// A Julian year \[d\].
pub const YEAR_D: f64 = 365.25;

/// A Julian year \[s\].
pub const YEAR_S: f64 = YEAR_D * DAY_S;

/// Nanoseconds since 1970-01-01T00:00:00 UTC, leap seconds ignored (Unix time).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Timestamp(i64);

impl Timestamp {
    /// Latest point in time.
    pub const MAX: Self = Self(i64::MAX);

    /// From nanoseconds since the Unix epoch.
    pub const fn from_nanos(nanos: i64) -> Self {
        Self(nanos)
    }

    /// Nanoseconds since the Unix epoch.
    pub const fn as_nanos(self) -> i64 {
        self.0
    }

    /// Seconds from `earlier` to `self`, negative if `self` comes first; exact to the nanosecond up
    /// to about a hundred days and to 2^-53 of the difference beyond.
    pub fn seconds_since(self, earlier: Self) -> f64 {
        (i128::from(self.0) - i128::from(earlier.0)) as f64 * 1e-9
    }

    /// Days since 1970, to a microsecond.
    pub fn days(self) -> f64 {
        self.0 as f64 / 86_400e9
    }

    /// Point in time `days` after 1970; saturates at the ends of the range.
    pub fn from_days(days: f64) -> Self {
        Self((days * 86_400e9).round() as i64)
    }

    /// The point in time `seconds` later; saturates at the ends of the range (years 1677 and 2262).
    pub fn plus_seconds(self, seconds: f64) -> Self {
        Self(self.0.saturating_add((seconds * 1e9).round() as i64))
    }

    /// Parses a person's input: a day (`2026-03-01`, from its midnight in UTC) or a time
    /// (`2026-03-01T06:00:00Z`; UTC if no zone is given).
    ///
    /// # Errors
    /// It is neither; the text names the expected forms.
    pub fn as_written(text: &str) -> Result<Self, String> {
        let whole = if text.contains('T') || text.contains(' ') {
            text.to_owned()
        } else {
            format!("{text}T00:00:00Z")
        };
        let zoned: Result<jiff::Timestamp, _> = whole.parse().or_else(|_| format!("{whole}Z").parse());
        zoned
            .ok()
            .and_then(|time| i64::try_from(time.as_nanosecond()).ok())
            .map(Self)
            .ok_or_else(|| {
                "a day such as 2026-03-01 or a time such as 2026-03-01T06:00:00Z is expected".to_owned()
            })
    }
}

/// RFC 3339 in UTC, as short as exactness allows: `2026-03-01T06:00:00Z`.
impl fmt::Display for Timestamp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match jiff::Timestamp::from_nanosecond(i128::from(self.0)) {
            Ok(time) => time.fmt(f),
            Err(_) => write!(f, "{} ns since 1970", self.0),
        }
    }
}

impl Serialize for Timestamp {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// From RFC 3339 with any offset.
impl<'de> Deserialize<'de> for Timestamp {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = <std::borrow::Cow<'de, str>>::deserialize(deserializer)?;
        let time: jiff::Timestamp = text.parse().map_err(de::Error::custom)?;
        i64::try_from(time.as_nanosecond())
            .map(Self)
            .map_err(|_| de::Error::custom(format!("{text} lies outside the years 1677 to 2262")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shown_as_rfc_3339() {
        assert_eq!(Timestamp::from_nanos(0).to_string(), "1970-01-01T00:00:00Z");
        assert_eq!(
            Timestamp::from_nanos(1_500_000_000).to_string(),
            "1970-01-01T00:00:01.5Z"
        );
    }

    #[test]
    fn people_write_days_and_times() {
        let six = Timestamp::from_nanos(1_772_344_800_000_000_000);
        for text in [
            "2026-03-01T06:00:00Z",
            "2026-03-01T06:00:00",
            "2026-03-01 06:00:00Z",
            "2026-03-01T08:00:00+02:00",
        ] {
            assert_eq!(Timestamp::as_written(text), Ok(six), "{text}");
        }
        let midnight = Timestamp::as_written("2026-03-01").unwrap();
        assert_eq!(six.seconds_since(midnight), 6.0 * 3600.0);
        for text in [
            "",
            "1970",
            "now",
            "1970-02-30",
            "1970-01-01T25:00:00Z",
            "2026-03-01T",
            "1500-01-01",
        ] {
            assert!(Timestamp::as_written(text).is_err(), "{text}");
        }
    }

    #[test]
    fn differences_do_not_overflow() {
        let (low, high) = (Timestamp::from_nanos(i64::MIN), Timestamp::from_nanos(i64::MAX));
        assert!(high.seconds_since(low) > 1.8e10);
        assert_eq!(high.plus_seconds(1.0), high);
    }
}
