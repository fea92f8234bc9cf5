//! Parses lengths, forces and rates: `14 m`, `31 ft 2 in`, `20..200 kN`, `1.2 kHz`.

use crate::config::units::{self, FORCE, LENGTH, RATE};
use crate::config::written;

/// Shortest rod accepted \[m\].
const SHORTEST_M: f64 = 0.2;
/// Longest length without a unit that is taken in metres \[m\].
const LONGEST_BARE_M: f64 = 100.0;

/// Forms that are understood, for messages.
const LENGTHS: &str = "14, 9500 mm, 31 ft";
const FORCES: &str = "150 kN, 20..200 kN";

/// The 97.5 % quantile of the standard normal distribution.
const QUANTILE: f64 = 1.96;
/// Limits of `log_sd` in a configuration.
const LOG_SD: (f64, f64) = (1e-3, 3.0);

/// Expected force \[N\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Expected {
    /// About this much, give or take 30 %.
    About(f64),
    /// Between these with a probability of 95 %.
    Between(f64, f64),
}

impl Expected {
    /// Standard deviation of the logarithm of a force that lies between these with 95 % probability.
    pub fn log_sd(low: f64, high: f64) -> f64 {
        (high / low).ln() / (2.0 * QUANTILE)
    }

    /// In words, with its units.
    pub fn said(self) -> String {
        let kn = |newtons: f64| number_said(1e-3 * newtons);
        match self {
            Self::About(newtons) => format!("about {} kN, give or take 30 %", kn(newtons)),
            Self::Between(low, high) => format!("{} to {} kN with 95 % probability", kn(low), kn(high)),
        }
    }
}

/// A size in millimetres, as text.
pub fn millimetres(metres: f64) -> String {
    format!("{} mm", number_said(1e3 * metres))
}

/// A length in metres, as text.
pub fn metres(metres: f64) -> String {
    format!("{} m", number_said(metres))
}

/// A number with at most six digits.
fn number_said(value: f64) -> String {
    let rounded: f64 = format!("{value:.5e}").parse().unwrap_or(value);
    rounded.to_string()
}

/// Splits a number above 0 from the text after it; the fault names the forms that are understood.
pub(super) fn number<'t>(text: &'t str, forms: &str) -> Result<(f64, &'t str), String> {
    match units::number(text) {
        Ok((value, rest)) if value > 0.0 => Ok((value, rest)),
        Ok(_) => Err("a number above 0 is expected".to_owned()),
        Err(why) if why.ends_with("does not begin with a number") => Err(format!("{why}: write {forms}")),
        Err(why) => Err(why),
    }
}

/// Converts a value in a unit of length to metres; `None` without a unit.
pub(super) fn in_unit(value: f64, unit: &str) -> Result<Option<f64>, String> {
    match unit {
        "" => Ok(None),
        unit => LENGTH.si(value, unit).map(Some),
    }
}

/// Parses a length \[m\]; without a unit in metres.
///
/// # Errors
/// The reason why it is none.
pub fn length(text: &str) -> Result<f64, String> {
    let text = units::keyed(text);
    let (value, unit) = number(&text, LENGTHS)?;
    let length_m = match in_two_units(value, unit)? {
        Some(length_m) => length_m,
        None if value > LONGEST_BARE_M => {
            return Err(format!("{text} of which unit? {text} mm, or {text} m"));
        }
        None => value,
    };
    match (SHORTEST_M..=2000.0).contains(&length_m) {
        true => Ok(length_m),
        false if has_three_decimals(&text) => Err(thousands(&text, unit)),
        false => Err(format!("{} is no length of a rod", metres(length_m))),
    }
}

/// Converts a value in one unit, or in two where the second is smaller, to metres: `31 ft 2 in`, `9 m 50 cm`; `None` without a unit.
fn in_two_units(value: f64, rest: &str) -> Result<Option<f64>, String> {
    let second = rest
        .match_indices(|c: char| c.is_ascii_digit())
        .find(|(at, _)| rest[..*at].ends_with([' ', '\'', '"']));
    let Some((at, _)) = second else {
        return in_unit(value, rest);
    };
    let (unit, less) = rest.split_at(at);
    let (less, smaller) = number(less, LENGTHS)?;
    match (in_unit(1.0, unit.trim())?, in_unit(less, smaller)?) {
        (Some(unit_m), Some(less_m)) if less_m < unit_m => Ok(Some(value * unit_m + less_m)),
        _ => Err(format!("{value} {rest} is no length: write {LENGTHS}")),
    }
}

/// True for a number with exactly three digits behind its point, which may separate thousands.
fn has_three_decimals(text: &str) -> bool {
    let fraction = text.split_once('.').map(|(_, behind)| behind);
    let is_power = text.contains(['e', 'E']);
    fraction.is_some_and(|behind| behind.bytes().take_while(u8::is_ascii_digit).count() == 3) && !is_power
}

fn thousands(text: &str, unit: &str) -> String {
    let digits = text.trim_end_matches(unit).trim();
    format!(
        "{digits} {unit} may be {} or {digits}: write it without the point",
        digits.replace('.', "")
    )
}

/// Words that say no more than the number behind them.
const ABOUT: [&str; 6] = ["about", "around", "approx.", "circa", "ca.", "~"];

/// Signs and words between the ends of a range, the longest first.
const TO: [&str; 7] = ["...", "..", "to", "and", "bis", "-", "~"];

/// Parses a force, or a range: `150 kN`, `20..200 kN`, `20 to 200 kN`, `0.8-1.2 MN`.
///
/// # Errors
/// The reason why it is none.
pub fn force(text: &str) -> Result<Expected, String> {
    let text = units::keyed(text);
    let between = text.strip_prefix("between ");
    let about = ABOUT.iter().find_map(|word| text.strip_prefix(word));
    let (low, rest) = number(between.or(about).unwrap_or(&text), FORCES)?;
    // The first unit ends where the range goes on.
    let end = TO.iter().find_map(|to| {
        let (unit, high) = rest.split_once(to)?;
        let is_unit = unit.trim().is_empty() || FORCE.of(unit).is_ok();
        (is_unit && high.trim_start().starts_with(|c: char| c.is_ascii_digit()))
            .then_some((unit.trim(), high))
    });
    let newtons = |value: f64, unit: &str| match unit {
        "" => Err(format!("{value} of which unit? {value} kN, or {value} N")),
        "kg" => Err(format!("kg is a mass: write {value} kgf, or {FORCES}")),
        "t" | "ton" | "tons" | "tonne" | "tonnes" => {
            Err(format!("{unit} is a mass: write {value} tf, or {FORCES}"))
        }
        // Nobody says thousandths of a newton.
        "n" | "N" if has_three_decimals(&text) => Err(thousands(&text, unit)),
        unit => FORCE.si(value, unit),
    };
    let Some((low_unit, high)) = end else {
        return Ok(Expected::About(newtons(low, rest)?));
    };
    let (high, unit) = number(high, FORCES)?;
    let low_unit = if low_unit.is_empty() { unit } else { low_unit };
    let (low, high) = (newtons(low, low_unit)?, newtons(high, unit)?);
    if low >= high {
        return Err("the smaller force comes first".to_owned());
    }
    let log_sd = Expected::log_sd(low, high);
    match (LOG_SD.0..=LOG_SD.1).contains(&log_sd) {
        true => Ok(Expected::Between(low, high)),
        false => Err(format!(
            "the ends of a range may differ by factors of {:.3} to {:.0}; where nothing is known, say no force",
            (LOG_SD.0 * 2.0 * QUANTILE).exp(),
            (LOG_SD.1 * 2.0 * QUANTILE).exp()
        )),
    }
}

/// Parses a sample rate \[Hz\]; without a unit in hertz.
///
/// # Errors
/// The reason why it is none.
pub fn rate(text: &str) -> Result<f64, String> {
    let text = units::keyed(text);
    match number(&text, "200, 200 Hz, 1.2 kHz")? {
        (value, "") => Ok(value),
        (value, unit) => RATE.si(value, unit),
    }
}

/// Parses a force in newtons, without a unit.
///
/// # Errors
/// The reason why it is none.
pub fn newtons(text: &str) -> Result<f64, String> {
    let force_n = written::positive(text)?;
    match has_three_decimals(text) {
        true => Err(thousands(text.trim(), "N")),
        false => Ok(force_n),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_metres_unless_a_unit_says_otherwise() {
        for (text, metres) in [
            ("14", 14.0),
            ("9,5", 9.5),
            ("14 m", 14.0),
            ("14500 mm", 14.5),
            ("950cm", 9.5),
            ("31 ft", 9.4488),
            ("1.2e1m", 12.0),
            ("0,950 m", 0.95),
            ("9.5 metres", 9.5),
            ("9,5\u{a0}m\u{e8}tres", 9.5),
            ("9\u{202f}500 mm", 9.5),
            ("9 m 50 cm", 9.5),
            ("31'2\"", 9.4996),
            ("31\u{2032} 2\u{2033}", 9.4996),
            ("31 ft 1 1/2 in", 9.4869),
        ] {
            assert!((length(text).unwrap() - metres).abs() < 1e-12, "{text}");
        }
        for (text, reason) in [
            ("14500", "14500 mm, or 14500 m"),
            ("long", "does not begin with a number"),
            ("", "does not begin with a number"),
            ("-3", "above 0"),
            ("0", "above 0"),
            ("3 km", "is no unit of length"),
            ("9 m 50", "is no length: write 14, 9500 mm, 31 ft"),
            ("31 ft 14 in", "is no length"),
            ("ca. 9.5 m", "write 14, 9500 mm, 31 ft"),
            ("9.5 m +- 0.01", "is no unit of length"),
            ("\u{2212}9.5 m", "above 0"),
            ("1 mm", "is no length"),
            ("1e400", "too large"),
            ("1,250", "1250 or 1.250"),
            ("1.250,5", "a point and a comma"),
            ("14.500mm", "14.500 mm may be 14500 or 14.500"),
            ("14.500 cm", "14.500 cm may be 14500 or 14.500"),
            ("0.19", "is no length"),
        ] {
            let said = length(text).unwrap_err();
            assert!(said.contains(reason), "{text}: {said}");
        }
    }

    #[test]
    fn forces_need_a_unit() {
        assert_eq!(force("150 kN"), Ok(Expected::About(150e3)));
        assert_eq!(force("20..200 kN"), Ok(Expected::Between(20e3, 200e3)));
        assert_eq!(force("900 N to 1,5 kN"), Ok(Expected::Between(900.0, 1500.0)));
        assert_eq!(force("0.8-1.2 MN"), Ok(Expected::Between(0.8e6, 1.2e6)));
        for text in [
            "100\u{2212}200 kN",
            "100 \u{2013} 200 kN",
            "100\u{2026}200 kN",
            "100...200 kN",
            "between 100 and 200 kN",
            "100 kN to 200 kilonewtons",
            "100 000 to 200 000 N",
        ] {
            assert_eq!(force(text), Ok(Expected::Between(100e3, 200e3)), "{text}");
        }
        for text in [
            "~150 kN",
            "about 150 kN",
            "150\u{a0}000 N",
            "15000 daN",
            "150 kilonewton",
        ] {
            assert_eq!(force(text), Ok(Expected::About(150e3)), "{text}");
        }
        for (text, reason) in [
            ("150", "150 kN, or 150 N"),
            ("200..20 kN", "smaller"),
            ("5 t", "write 5 tf"),
            ("15 tonnes", "write 15 tf"),
            ("150 stone", "no unit of force"),
            ("150 mN", "MN is a million"),
            ("150 +- 20 kN", "no unit of force"),
            ("<200 kN", "write 150 kN, 20..200 kN"),
            ("150,000 N", "150000 or 150.000"),
            ("150.000 N", "150000 or 150.000"),
            ("1N..1000MN", "factors of 1.004 to 128"),
            ("100..100.3 kN", "factors of 1.004 to 128"),
            ("-5 kN", "number"),
            ("", "number"),
        ] {
            let said = force(text).unwrap_err();
            assert!(said.contains(reason), "{text}: {said}");
        }
    }

    #[test]
    fn rates_are_hertz_unless_a_unit_says_otherwise() {
        for text in ["1200", "1200 Hz", "1,2 kHz", "1\u{a0}200 hertz"] {
            assert_eq!(rate(text), Ok(1200.0), "{text}");
        }
        for (text, reason) in [
            ("5 ms", "no unit of rate"),
            ("fast", "write 200, 200 Hz"),
            ("-200", "above 0"),
            ("1,200", "1200 or 1.200"),
        ] {
            let said = rate(text).unwrap_err();
            assert!(said.contains(reason), "{text}: {said}");
        }
    }

    #[test]
    fn what_was_understood_is_said_with_its_unit() {
        assert_eq!(metres(9.4488), "9.4488 m");
        assert_eq!(
            Expected::Between(20e3, 200e3).said(),
            "20 to 200 kN with 95 % probability"
        );
    }
}
