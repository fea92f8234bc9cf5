//! Scales from data to drawing, and ticks at round numbers and dates in UTC.

use crate::analysis::signal::record::time::DAY_S;
use jiff::civil::Date;
use jiff::tz::TimeZone;

const MINUTE_S: f64 = 60.0;
const HOUR_S: f64 = 3600.0;

/// A linear map from data to drawing units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scale {
    /// Data values at both ends, the first below the second.
    pub data: (f64, f64),
    /// Drawing positions of both ends.
    pub drawn: (f64, f64),
}

impl Scale {
    /// Maps `low` and `high` to the two positions; an empty or unordered span is widened.
    pub fn new((low, high): (f64, f64), drawn: (f64, f64)) -> Self {
        let data = match (low.is_finite() && high.is_finite(), high - low) {
            (true, span) if span > 1e-12 * low.abs().max(high.abs()).max(1e-300) => (low, high),
            (true, _) => {
                let half = (0.01 * low.abs()).max(1e-6);
                (low - half, high.max(low) + half)
            }
            (false, _) => (0.0, 1.0),
        };
        Self { data, drawn }
    }

    /// Drawing position of a value.
    pub fn place(&self, value: f64) -> f64 {
        let share = (value - self.data.0) / (self.data.1 - self.data.0);
        self.drawn.0 + share * (self.drawn.1 - self.drawn.0)
    }

    /// True if a value lies within.
    pub fn holds(&self, value: f64) -> bool {
        (self.data.0..=self.data.1).contains(&value)
    }
}

/// A tick of an axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Tick {
    /// Data value of the tick.
    pub at: f64,
    /// Label of the tick.
    pub label: String,
}

/// Smallest and largest of the finite values, with `margin` of the span added at either end.
pub fn span(values: impl Iterator<Item = f64>, margin: f64) -> Option<(f64, f64)> {
    let (low, high) = values
        .filter(|value| value.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
            (low.min(value), high.max(value))
        });
    let extra = margin * (high - low);
    (low <= high).then_some((low - extra, high + extra))
}

/// At most about `count` round numbers within a span.
pub fn numbers((low, high): (f64, f64), count: usize) -> Vec<Tick> {
    let raw = (high - low) / count.max(1) as f64;
    if !(raw.is_finite() && raw > 0.0) {
        return Vec::new();
    }
    let decade = 10f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .into_iter()
        .map(|factor| factor * decade)
        .find(|step| *step >= raw * (1.0 - 1e-9))
        .unwrap_or(10.0 * decade);
    let decimals = (-(step.log10() + 1e-9).floor()).clamp(0.0, 12.0) as usize;
    let (first, last) = (
        (low / step - 1e-9).ceil() as i64,
        (high / step + 1e-9).floor() as i64,
    );
    (first..=last.min(first.saturating_add(100)))
        .map(|i| {
            let at = i as f64 * step;
            Tick {
                at,
                label: minus(&format!("{at:.decimals$}")),
            }
        })
        .collect()
}

/// A number's text with a true minus sign, and no sign before zero.
pub fn minus(text: &str) -> String {
    match text.strip_prefix('-') {
        Some(rest) if rest.chars().all(|c| matches!(c, '0' | '.')) => rest.to_owned(),
        Some(rest) => format!("\u{2212}{rest}"),
        None => text.to_owned(),
    }
}

/// Powers of ten within a span of decibels (ten times the decimal logarithm), at most about `count`.
pub fn powers((low_db, high_db): (f64, f64), count: usize) -> Vec<Tick> {
    let (first, last) = ((low_db / 10.0).ceil() as i64, (high_db / 10.0).floor() as i64);
    let step = ((last - first) as usize).div_ceil(count.max(1)).max(1);
    (first..=last)
        .filter(|power| power.rem_euclid(step as i64) == 0)
        .map(|power| Tick {
            at: 10.0 * power as f64,
            label: ten_to(power),
        })
        .collect()
}

/// A power of ten: `10⁻⁶`.
pub fn ten_to(power: i64) -> String {
    format!("10{}", superscript(power))
}

fn superscript(power: i64) -> String {
    power
        .to_string()
        .chars()
        .map(|c| match c {
            '-' => '\u{207b}',
            '1' => '\u{b9}',
            '2' => '\u{b2}',
            '3' => '\u{b3}',
            digit => char::from_u32(0x2070 + digit.to_digit(10).unwrap_or(0)).unwrap_or(digit),
        })
        .collect()
}

/// Round times (Unix seconds, UTC) within a span, at most about `count`: `2025-03-01`, or `03-01 06:00`
/// if they are closer than a day.
pub fn dates((low, high): (f64, f64), count: usize) -> Vec<Tick> {
    let raw = (high - low) / count.max(1) as f64;
    let within_a_day = [
        MINUTE_S,
        5.0 * MINUTE_S,
        15.0 * MINUTE_S,
        HOUR_S,
        3.0 * HOUR_S,
        6.0 * HOUR_S,
        12.0 * HOUR_S,
    ];
    let days = [1.0, 2.0, 5.0, 7.0, 14.0];
    let months = [1, 2, 3, 6, 12, 24, 60, 120];
    if let Some(step) = within_a_day.into_iter().find(|step| *step >= raw) {
        return evenly((low, high), step, "%m-%d %H:%M");
    }
    if let Some(step) = days.into_iter().find(|step| step * DAY_S >= raw) {
        return evenly((low, high), step * DAY_S, "%Y-%m-%d");
    }
    let step = months
        .into_iter()
        .find(|step| f64::from(*step) * 30.4 * DAY_S >= raw)
        .unwrap_or(240);
    monthly((low, high), step)
}

fn evenly((low, high): (f64, f64), step: f64, format: &str) -> Vec<Tick> {
    let (first, last) = ((low / step).ceil() as i64, (high / step).floor() as i64);
    (first..=last)
        .map(|i| i as f64 * step)
        .map(|at| Tick {
            at,
            label: shown(at, format),
        })
        .collect()
}

/// A time (Unix seconds) in UTC; empty beyond the years that have names.
pub fn shown(at: f64, format: &str) -> String {
    jiff::Timestamp::from_second(at as i64)
        .map(|time| time.to_zoned(TimeZone::UTC).strftime(format).to_string())
        .unwrap_or_default()
}

fn monthly((low, high): (f64, f64), step: i32) -> Vec<Tick> {
    let Ok(first) = jiff::Timestamp::from_second(low as i64) else {
        return Vec::new();
    };
    let first = first.to_zoned(TimeZone::UTC).date();
    let month = i32::from(first.year()) * 12 + i32::from(first.month()) - 1;
    let month = month - month.rem_euclid(step);
    (0..)
        .map_while(|i| {
            let month = month + i * step;
            let (year, month) = (month.div_euclid(12), month.rem_euclid(12) + 1);
            let date = Date::new(i16::try_from(year).ok()?, i8::try_from(month).ok()?, 1).ok()?;
            let time = date.to_zoned(TimeZone::UTC).ok()?.timestamp().as_second() as f64;
            (time <= high).then(|| Tick {
                at: time,
                label: date.to_string(),
            })
        })
        .filter(|tick| tick.at >= low)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(ticks: &[Tick]) -> Vec<&str> {
        ticks.iter().map(|tick| tick.label.as_str()).collect()
    }

    fn unix(text: &str) -> f64 {
        text.parse::<jiff::Timestamp>().unwrap().as_second() as f64
    }

    #[test]
    fn numbers_are_round() {
        assert_eq!(labels(&numbers((-3.2, 4.1), 4)), ["\u{2212}2", "0", "2", "4"]);
        assert_eq!(labels(&numbers((0.9, 1.0), 4)), ["0.90", "0.95", "1.00"]);
        assert!(numbers((1.0, 1.0), 4).is_empty());
        assert!(numbers((f64::NAN, 1.0), 4).is_empty());
    }

    #[test]
    fn dates_are_the_first_of_months_and_whole_hours() {
        let year = (unix("2025-01-15T00:00:00Z"), unix("2025-12-20T00:00:00Z"));
        assert_eq!(
            labels(&dates(year, 6)),
            [
                "2025-03-01",
                "2025-05-01",
                "2025-07-01",
                "2025-09-01",
                "2025-11-01"
            ]
        );
        let day = (unix("2025-03-01T05:00:00Z"), unix("2025-03-02T01:00:00Z"));
        assert_eq!(
            labels(&dates(day, 5)),
            ["03-01 06:00", "03-01 12:00", "03-01 18:00", "03-02 00:00"]
        );
        let decades = (unix("1990-01-01T00:00:00Z"), unix("2030-01-01T00:00:00Z"));
        assert_eq!(labels(&dates(decades, 5)).len(), 5);
    }

    #[test]
    fn powers_of_ten_from_decibels() {
        assert_eq!(
            labels(&powers((-125.0, -85.0), 5)),
            ["10⁻¹²", "10⁻¹¹", "10⁻¹⁰", "10⁻⁹"]
        );
    }

    #[test]
    fn a_scale_of_nothing_is_still_a_scale() {
        for data in [
            (1.0, 1.0),
            (f64::NAN, 1.0),
            (f64::INFINITY, f64::NEG_INFINITY),
            (0.0, 0.0),
        ] {
            let scale = Scale::new(data, (0.0, 100.0));
            assert!(scale.place(0.5).is_finite() && scale.data.0 < scale.data.1);
        }
    }
}
