//! Stamps as text: decimal numbers and dates, exact to the nanosecond.

use super::{ImportError, Stamps};
use jiff::civil::DateTime;
use jiff::tz::Offset;

/// Unit of the numbers of a time column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum TimeUnit {
    /// Days; numbers of the size of a day from 2001 to 2096 are a spreadsheet's, which count from 30 December 1899.
    D,
    /// Hours.
    H,
    /// Minutes.
    Min,
    /// Seconds.
    S,
    /// Milliseconds.
    Ms,
    /// Microseconds.
    Us,
    /// Nanoseconds.
    Ns,
}

/// Order of day and month in dates such as `03/04/2026`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum DateOrder {
    /// The third of April.
    DayFirst,
    /// The fourth of March.
    MonthFirst,
}

/// A stamp as it was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Written {
    pub(super) nanos: i64,
    /// Step of its last digit \[ns\], at least 1.
    pub(super) resolution_ns: i64,
    /// True if it is a date rather than a number.
    pub(super) is_date: bool,
}

impl TimeUnit {
    /// Factor and exponent of ten from this unit to nanoseconds.
    fn factor(self) -> (i128, i32) {
        match self {
            Self::D => (864, 11),
            Self::H => (36, 11),
            Self::Min => (6, 10),
            Self::S => (1, 9),
            Self::Ms => (1, 6),
            Self::Us => (1, 3),
            Self::Ns => (1, 0),
        }
    }

    /// Nanoseconds in one unit.
    pub(super) fn nanos(self) -> f64 {
        let (factor, power) = self.factor();
        factor as f64 * 10_f64.powi(power)
    }

    /// Unit that a head names.
    pub fn of(text: &str) -> Option<Self> {
        match text.trim() {
            // "d" is the name of many a column of motion.
            "day" | "days" => Some(Self::D),
            "h" | "hr" | "hour" | "hours" => Some(Self::H),
            "min" | "minute" | "minutes" => Some(Self::Min),
            "s" | "sec" | "S" | "second" | "seconds" => Some(Self::S),
            "ms" | "msec" | "millisecond" | "milliseconds" => Some(Self::Ms),
            "us" | "µs" | "μs" | "usec" | "microsecond" | "microseconds" => Some(Self::Us),
            "ns" | "nsec" | "nanosecond" | "nanoseconds" => Some(Self::Ns),
            _ => None,
        }
    }
}

/// Parses a decimal number of `unit`, with or without exponent, rounded to the nanosecond; `None` if it is no
/// number or beyond 292 years.
pub(super) fn number(text: &str, unit: TimeUnit) -> Option<Written> {
    let (text, negative) = match text.strip_prefix('-') {
        Some(rest) => (rest, true),
        None => (text.strip_prefix('+').unwrap_or(text), false),
    };
    let (digits, exponent) = match text.split_once(['e', 'E']) {
        Some((digits, exponent)) => (digits, exponent.parse::<i32>().ok()?),
        None => (text, 0),
    };
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    let all = whole.len() + fraction.len();
    if all == 0 || all > 36 || exponent.abs() > 40 {
        return None;
    }
    let mut mantissa: i128 = 0;
    for digit in whole.bytes().chain(fraction.bytes()) {
        if !digit.is_ascii_digit() {
            return None;
        }
        mantissa = mantissa * 10 + i128::from(digit - b'0');
    }
    let (factor, power) = unit.factor();
    let power = exponent - fraction.len() as i32 + power;
    let mantissa = mantissa.checked_mul(factor)?;
    let ten = |power: i32| 10_i128.checked_pow(power.unsigned_abs());
    let nanos = if power >= 0 {
        mantissa.checked_mul(ten(power)?)?
    } else {
        match ten(power) {
            Some(by) => (mantissa + by / 2) / by,
            None => 0,
        }
    };
    let nanos = i64::try_from(nanos).ok()?;
    Some(Written {
        nanos: since_1970(if negative { -nanos } else { nanos }, unit),
        resolution_ns: ten(power.max(0))
            .and_then(|step| i64::try_from(step.checked_mul(factor)?).ok())
            .unwrap_or(1),
        is_date: false,
    })
}

/// Parses a time of day or a duration: `06:00:00.005`, `5:07`, `125:00:00,5`. Nanoseconds since 0:00; `None`
/// if it is none.
pub(super) fn clock(text: &str) -> Option<Written> {
    let (text, half) = half_of_day(text);
    let (hours, rest) = text.split_once(':')?;
    let (minutes, seconds) = rest.split_once(':').unwrap_or((rest, "0"));
    let whole = |text: &str, below: i64| {
        let value = text.parse::<i64>().ok()?;
        let is_plain = text.len() <= 5 && text.bytes().all(|byte| byte.is_ascii_digit());
        (is_plain && value < below).then_some(value)
    };
    let (hours, minutes) = (whole(hours, 100_000)?, whole(minutes, 60)?);
    let hours = match half {
        None => hours,
        Some(begins) => (1..=12)
            .contains(&hours)
            .then_some(hours % 12 + i64::from(begins))?,
    };
    let written = number(&seconds.replace(',', "."), TimeUnit::S)?;
    let is_second = seconds.starts_with(|c: char| c.is_ascii_digit()) && written.nanos < 60_000_000_000;
    is_second.then(|| Written {
        nanos: (hours * 3600 + minutes * 60) * 1_000_000_000 + written.nanos,
        ..written
    })
}

/// Unit of a number that nobody said: seconds, but in thousandths and less of it where only so it counts from 1970 to a day from 2001 to
/// 2096, which is no guess: as seconds such numbers lie 40 000 years and more ahead.
pub(super) fn likely_unit(value: f64) -> TimeUnit {
    [TimeUnit::Ms, TimeUnit::Us, TimeUnit::Ns]
        .into_iter()
        .find(|unit| (1e18..4e18).contains(&(value * unit.nanos())))
        .unwrap_or(TimeUnit::S)
}

/// Days from 2001 to 2096, and the first of 1970, as spreadsheets count them.
const SHEET_DAYS: std::ops::Range<f64> = 36_892.0..71_954.0;
const SHEET_1970_NS: i64 = 25_569 * DAY_NS;
const DAY_NS: i64 = 86_400_000_000_000;

/// True if numbers of which nobody said the unit are days of a spreadsheet: of a day's size, and as seconds of more than 1 MHz, which is no
/// guess.
pub(super) fn are_sheet_days(first: f64, next: f64) -> bool {
    SHEET_DAYS.contains(&first) && (0.0..1e-6).contains(&(next - first))
}

/// Nanoseconds since 1970 of a spreadsheet's day; others as they are.
fn since_1970(nanos: i64, unit: TimeUnit) -> i64 {
    let is_sheets = unit == TimeUnit::D && SHEET_DAYS.contains(&(nanos as f64 / DAY_NS as f64));
    if is_sheets { nanos - SHEET_1970_NS } else { nanos }
}

/// Least number that counts from 1970: 10^9 s, in September 2001.
pub(super) const SINCE_2001: i64 = 1_000_000_000_000_000_000;

/// Stamps in a variable or channel called `name`.
pub(super) fn from_numbers(
    name: &str,
    values: &[f64],
    said: Option<TimeUnit>,
) -> Result<Stamps, ImportError> {
    let unit = said.unwrap_or_else(|| match values {
        [first, next, ..] if are_sheet_days(*first, *next) => TimeUnit::D,
        [first, ..] => likely_unit(*first),
        [] => TimeUnit::S,
    });
    let in_nanos = |value: &f64| {
        let nanos = (value * unit.nanos()).round();
        (nanos.abs() < 9.2e18).then_some(since_1970(nanos as i64, unit))
    };
    let nanos: Option<Vec<i64>> = values.iter().map(in_nanos).collect();
    let nanos =
        nanos.ok_or_else(|| ImportError::at(name, "holds a time that is not finite, or beyond 292 years"))?;
    // Doubles near 1.8e9 s are a quarter of a microsecond apart.
    let largest = values
        .iter()
        .fold(0.0, |largest: f64, value| largest.max(value.abs()));
    let largest = (largest * unit.nanos()) as u64;
    Ok(Stamps {
        absolute: nanos.first().is_some_and(|first| *first >= SINCE_2001),
        resolution_ns: (largest >> 52).max(1) as i64,
        says_unit: said.is_some() || unit != TimeUnit::S,
        nanos,
        lines: Vec::new(),
    })
}

/// Parses a date with its time of day: `2026-03-01T06:00:00.005Z`, `2026-03-01 06:00`,
/// `01.03.2026 06:00:00,005`, and with an `order` `01/03/2026 06:00:00`. Without an offset of its own it is
/// `offset_s` ahead of UTC.
///
/// # Errors
/// A sentence about it.
pub(super) fn date(text: &str, order: Option<DateOrder>, offset_s: i32) -> Result<Written, String> {
    let no_time =
        || "is no time: numbers, 2026-03-01T06:00:00.005Z or 01.03.2026 06:00:00,005 are read".to_owned();
    let (day, clock) = text.split_once(['T', ' ']).ok_or_else(no_time)?;
    let separator = day.chars().find(|c| !c.is_ascii_digit()).ok_or_else(no_time)?;
    let parts: Vec<&str> = day.split(separator).collect();
    let [a, b, c] = parts[..] else {
        return Err(no_time());
    };
    let (year, month, of_month) = if a.len() == 4 {
        (a, b, c)
    } else if c.len() == 4 {
        match (separator, order) {
            (_, Some(DateOrder::MonthFirst)) => (c, a, b),
            ('.', None) | (_, Some(DateOrder::DayFirst)) => (c, b, a),
            (_, None) => {
                return Err(
                    "may be day or month first: say --dates day-first or --dates month-first".to_owned(),
                );
            }
        }
    } else {
        return Err("has no year of four digits".to_owned());
    };
    let (clock, half) = half_of_day(clock.trim());
    let (clock, offset_s) = offset(clock, offset_s).ok_or_else(no_time)?;
    let mut fields = clock.splitn(3, ':');
    let (hour, minute) = (fields.next(), fields.next());
    let (second, fraction) = match fields.next() {
        Some(second) => second.split_once(['.', ',']).unwrap_or((second, "")),
        None => ("0", ""),
    };
    let whole = |text: &str| {
        text.parse::<i16>()
            .ok()
            .filter(|_| text.bytes().all(|b| b.is_ascii_digit()))
    };
    let small = |text: Option<&str>| text.and_then(whole).and_then(|number| i8::try_from(number).ok());
    if fraction.len() > 9 || !fraction.bytes().all(|b| b.is_ascii_digit()) {
        return Err("has more than nine digits behind the second".to_owned());
    }
    let nanos: i32 = format!("{fraction:0<9}").parse().map_err(|_| no_time())?;
    let (Some(year), Some(month), Some(day)) = (whole(year), small(Some(month)), small(Some(of_month)))
    else {
        return Err(no_time());
    };
    let (Some(hour), Some(minute), Some(second)) = (small(hour), small(minute), small(Some(second))) else {
        return Err(no_time());
    };
    let hour = match half {
        None => hour,
        Some(_) if !(1..=12).contains(&hour) => {
            return Err("has AM or PM with an hour beyond 1 to 12".to_owned());
        }
        Some(begins) => hour % 12 + begins,
    };
    let civil = DateTime::new(year, month, day, hour, minute, second, nanos)
        .map_err(|_| "is no day and time of the calendar (day and month mixed up? --dates)".to_owned())?;
    let time = Offset::from_seconds(offset_s)
        .and_then(|offset| offset.to_timestamp(civil))
        .map_err(|_| "lies outside the calendar".to_owned())?;
    Ok(Written {
        nanos: i64::try_from(time.as_nanosecond())
            .map_err(|_| "lies outside the years 1677 to 2262".to_owned())?,
        resolution_ns: 10_i64.pow(9 - fraction.len() as u32),
        is_date: true,
    })
}

/// Splits AM or PM off a time of day; returns the hour at which that half begins.
fn half_of_day(clock: &str) -> (&str, Option<i8>) {
    let halves = [("am", 0), ("pm", 12), ("a.m.", 0), ("p.m.", 12)];
    for (word, begins) in halves {
        let at = clock.len().saturating_sub(word.len());
        if let Some((rest, end)) = clock.split_at_checked(at)
            && end.eq_ignore_ascii_case(word)
        {
            return (rest.trim_end(), Some(begins));
        }
    }
    (clock, None)
}

/// Splits `Z` or `+02:00` off a time of day.
fn offset(clock: &str, default_s: i32) -> Option<(&str, i32)> {
    if let Some(clock) = clock.strip_suffix(['Z', 'z']) {
        return Some((clock, 0));
    }
    match clock.rfind(['+', '-']) {
        None => Some((clock, default_s)),
        Some(at) => Some((clock.get(..at)?.trim_end(), utc_offset(clock.get(at..)?).ok()?)),
    }
}

/// Parses `+01:00`, `-0530` or `+1` to seconds ahead of UTC.
///
/// # Errors
/// It is none of these.
pub fn utc_offset(text: &str) -> Result<i32, String> {
    let fault = || format!("{text:?} is no offset from UTC: +01:00 is expected");
    let (sign, digits) = match text.split_at_checked(1) {
        Some(("+", digits)) => (1, digits),
        Some(("-", digits)) => (-1, digits),
        _ => return Err(fault()),
    };
    let (hours, minutes) = match digits.split_once(':') {
        Some(parts) => parts,
        None if digits.len() == 4 => digits.split_at_checked(2).ok_or_else(fault)?,
        None => (digits, "0"),
    };
    let number = |text: &str, most: i32| {
        let value: i32 = text.parse().ok()?;
        (text.len() <= 2 && text.bytes().all(|b| b.is_ascii_digit()) && value <= most).then_some(value)
    };
    let (hours, minutes) = (
        number(hours, 14).ok_or_else(fault)?,
        number(minutes, 59).ok_or_else(fault)?,
    );
    Ok(sign * (hours * 3600 + minutes * 60))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_exact_to_the_nanosecond() {
        let nanos =
            |text: &str, unit| number(text, unit).map(|written| (written.nanos, written.resolution_ns));
        assert_eq!(nanos("0.005", TimeUnit::S), Some((5_000_000, 1_000_000)));
        assert_eq!(
            nanos("1772344800.123456789", TimeUnit::S),
            Some((1_772_344_800_123_456_789, 1))
        );
        assert_eq!(
            nanos("5.000000000000000000e-03", TimeUnit::S),
            Some((5_000_000, 1))
        );
        assert_eq!(nanos("-12", TimeUnit::Ms), Some((-12_000_000, 1_000_000)));
        assert_eq!(nanos("0.15000000000000002", TimeUnit::S), Some((150_000_000, 1)));
        assert_eq!(nanos("+.5", TimeUnit::Us), Some((500, 100)));
        assert_eq!(nanos("1.5", TimeUnit::Min), Some((90_000_000_000, 6_000_000_000)));
        assert_eq!(
            nanos("0.25", TimeUnit::H),
            Some((900_000_000_000, 36_000_000_000))
        );
        for bad in [
            "",
            ".",
            "-",
            "1e",
            "1.2.3",
            "1,5",
            "e5",
            "1e999",
            "99999999999999999999",
        ] {
            assert_eq!(nanos(bad, TimeUnit::S), None, "{bad}");
        }
    }

    #[test]
    fn days_of_a_spreadsheet_are_dates() {
        let six = 1_772_344_800_000_000_000;
        let sheet = number("46082.25", TimeUnit::D).unwrap();
        assert_eq!((sheet.nanos, sheet.resolution_ns), (six, DAY_NS / 100));
        assert_eq!(number("0.5", TimeUnit::D).unwrap().nanos, DAY_NS / 2);
        let days = [
            46_082.25,
            46_082.25 + 0.004 / 86_400.0,
            46_082.25 + 0.008 / 86_400.0,
        ];
        let stamps = from_numbers("t", &days, None).unwrap();
        assert!(stamps.absolute && stamps.says_unit && stamps.nanos[0] == six);
        assert!((stamps.nanos[1] - six - 4_000_000).abs() < 1000);
        // Half a day of seconds at 1 kHz.
        assert!(
            !from_numbers("t", &[46_082.25, 46_082.251], None)
                .unwrap()
                .absolute
        );
    }

    #[test]
    fn times_of_day_count_from_midnight() {
        let nanos = |text: &str| clock(text).map(|written| (written.nanos, written.resolution_ns));
        assert_eq!(nanos("00:00:00,005"), Some((5_000_000, 1_000_000)));
        assert_eq!(nanos("1:02:03"), Some((3_723_000_000_000, 1_000_000_000)));
        assert_eq!(nanos("30:01").map(|found| found.0), Some(108_060_000_000_000));
        assert_eq!(nanos("12:00:01 AM").map(|found| found.0), Some(1_000_000_000));
        assert_eq!(
            nanos("1:00:00.5 pm").map(|found| found.0),
            Some(46_800_500_000_000)
        );
        for bad in [
            "",
            "1",
            "1:60",
            "1:00:60",
            "a:b:c",
            "1:00:00:00",
            "1:2:-3",
            "-1:00",
            "13:00:00 PM",
        ] {
            assert_eq!(clock(bad), None, "{bad}");
        }
    }

    #[test]
    fn dates_are_read_as_meant_or_refused() {
        let nanos = |text: &str, order| date(text, order, 3600).map(|written| written.nanos);
        let six = 1_772_344_800_000_000_000;
        assert_eq!(nanos("2026-03-01T06:00:00Z", None), Ok(six));
        assert_eq!(nanos("2026-03-01 07:00:00", None), Ok(six));
        let american = Some(DateOrder::MonthFirst);
        assert_eq!(nanos("03/01/2026 07:00:00.000 AM", american), Ok(six));
        assert_eq!(
            nanos("03/01/2026 12:00:00 AM", american),
            Ok(six - 7 * 3_600_000_000_000)
        );
        assert_eq!(
            nanos("03/01/2026 1:00:00 PM", american),
            Ok(six + 6 * 3_600_000_000_000)
        );
        assert!(nanos("03/01/2026 13:00:00 PM", american).is_err());
        assert_eq!(
            nanos("2026-03-01 08:00:00,250+02:00", None),
            Ok(six + 250_000_000)
        );
        assert_eq!(nanos("01.03.2026 07:00", None), Ok(six));
        assert_eq!(nanos("01/03/2026 07:00:00", Some(DateOrder::DayFirst)), Ok(six));
        assert_eq!(nanos("03/01/2026 07:00:00", Some(DateOrder::MonthFirst)), Ok(six));
        assert!(
            nanos("01/03/2026 07:00:00", None)
                .unwrap_err()
                .contains("--dates")
        );
        for bad in [
            "",
            "2026-03-01",
            "2026-02-30 06:00",
            "2026-03-01 25:00",
            "01.03.26 06:00",
            "a b",
            "2026-03-01 06:00:00.1234567890",
            "é é",
        ] {
            assert!(nanos(bad, None).is_err(), "{bad}");
        }
        assert_eq!(utc_offset("-05:30"), Ok(-19800));
        assert!(utc_offset("5").is_err() && utc_offset("+é1").is_err());
    }
}
