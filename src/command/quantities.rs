//! Parses lengths, sections and forces: `14 m`, `d40`, `40x60 mm`, `2 in`, `20..200 kN`.

use crate::config::written;
use std::f64::consts::PI;

/// Least size without a unit that is taken in millimetres; no section is that many metres.
const LEAST_BARE_MM: f64 = 1.0;
/// Largest size without a unit that is taken in metres \[m\]; no section is that few millimetres.
const MOST_BARE_M: f64 = 0.5;
/// Largest section accepted \[m\].
const LARGEST_M: f64 = 0.5;
/// Shortest rod accepted \[m\].
const SHORTEST_M: f64 = 0.2;
/// Largest ratio of two sizes that one unit serves; the flattest common bar is 100 x 5 mm.
const FLATTEST: f64 = 25.0;
/// The same where the second size is bare behind a unit that is not millimetres.
const FLAT: f64 = 5.0;
/// Longest length without a unit that is taken in metres \[m\].
const LONGEST_BARE_M: f64 = 100.0;

/// The 97.5 % quantile of the standard normal distribution.
const QUANTILE: f64 = 1.96;
/// Limits of `log_sd` in a configuration.
const LOG_SD: (f64, f64) = (1e-3, 3.0);

/// A cross-section with its dimensions \[m\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Profile {
    /// A square by its side.
    Square(f64),
    /// A circle by its diameter.
    Round(f64),
    /// A rectangle by its width across and its height in the plane of vibration.
    Rectangle(f64, f64),
}

/// A section as typed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Section {
    /// Shape and dimensions.
    Known(Profile),
    /// A size \[m\] that may be a diameter or a side.
    Size(f64),
}

/// Expected force \[N\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Expected {
    /// About this much, give or take 30 %.
    About(f64),
    /// Between these with a probability of 95 %.
    Between(f64, f64),
}

impl Profile {
    /// The key of the section in the configuration.
    pub fn key(self) -> &'static str {
        match self {
            Self::Square(_) => "square",
            Self::Round(_) => "round",
            Self::Rectangle(..) => "rectangle",
        }
    }

    /// Keys and values of its dimensions \[m\].
    pub fn dimensions(self) -> Vec<(&'static str, f64)> {
        match self {
            Self::Square(side) => vec![("side_m", side)],
            Self::Round(diameter) => vec![("diameter_m", diameter)],
            Self::Rectangle(width, height) => vec![("width_m", width), ("height_m", height)],
        }
    }

    /// Area \[m^2\].
    pub fn area_m2(self) -> f64 {
        match self {
            Self::Square(side) => side * side,
            Self::Round(diameter) => 0.25 * PI * diameter * diameter,
            Self::Rectangle(width, height) => width * height,
        }
    }

    /// In words, with its units.
    pub fn said(self) -> String {
        match self {
            Self::Square(side) => format!("square, side {}", millimetres(side)),
            Self::Round(diameter) => format!("round, diameter {}", millimetres(diameter)),
            Self::Rectangle(width, height) => format!(
                "rectangle, {} wide and {} high in the plane of vibration",
                millimetres(width),
                millimetres(height)
            ),
        }
    }
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

/// Splits a number and the text after it; the fault if there is no number.
fn number(text: &str) -> Result<(f64, &str), String> {
    let end = text
        .char_indices()
        .find(|(i, c)| {
            // An exponent is one only before a digit or a sign: `40 e` is none.
            let next = text.as_bytes().get(i + 1);
            let is_exponent = *i > 0
                && matches!(c, 'e' | 'E')
                && next.is_some_and(|c| c.is_ascii_digit() || b"+-".contains(c));
            let is_sign = matches!(c, '+' | '-') && (*i == 0 || text[..*i].ends_with(['e', 'E']));
            !(c.is_ascii_digit() || matches!(c, '.' | ',') || is_exponent || is_sign)
        })
        .map_or(text.len(), |(i, _)| i);
    let (digits, rest) = text.split_at(end);
    let digits = digits.trim_end_matches(',');
    let value = match digits.contains(',') {
        true => written::decimal(digits)?,
        false => digits
            .parse()
            .map_err(|_| format!("{:?} does not begin with a number", text.trim()))?,
    };
    match value.is_finite() && value > 0.0 {
        true => Ok((value, rest.trim())),
        false => Err("a number above 0 is expected".to_owned()),
    }
}

/// Converts a value in a unit of length to metres; `None` without a unit.
fn in_unit(value: f64, unit: &str) -> Result<Option<f64>, String> {
    Ok(Some(match unit {
        "" => return Ok(None),
        "m" => value,
        "cm" => value / 1e2,
        "mm" => value / 1e3,
        "um" | "\u{b5}m" | "\u{3bc}m" => value / 1e6,
        "in" | "inch" | "inches" | "\"" | "\u{2033}" => value * 0.0254,
        "ft" | "foot" | "feet" | "'" | "\u{2032}" => value * 0.3048,
        other => {
            return Err(format!(
                "{other:?} is no unit of length known here: mm, cm, m, in, ft"
            ));
        }
    }))
}

/// Parses a length \[m\]; without a unit in metres.
///
/// # Errors
/// The reason why it is none.
pub fn length(text: &str) -> Result<f64, String> {
    let text = text.trim().to_lowercase();
    let (value, unit) = number(&text)?;
    let length_m = match in_unit(value, unit)? {
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

/// Size of a section \[m\], if its unit is given or only one unit is plausible.
fn size(value: f64, unit: &str) -> Result<f64, String> {
    let size_m = match in_unit(value, unit)? {
        Some(size_m) => size_m,
        None if value >= LEAST_BARE_MM => value / 1e3,
        None if value <= MOST_BARE_M => value,
        None => return Err(format!("{value} of which unit? {value} mm, or {value} m")),
    };
    match (1e-6..=LARGEST_M).contains(&size_m) {
        true => Ok(size_m),
        false => Err(format!(
            "{} is no size of a tie-rod's section",
            millimetres(size_m)
        )),
    }
}

/// A shape of one size.
type Shape = fn(f64) -> Profile;

/// Words for shapes, the longest first.
const SHAPES: [(&str, Shape); 14] = [
    ("diameter", Profile::Round),
    ("square", Profile::Square),
    ("round", Profile::Round),
    ("diam", Profile::Round),
    ("side", Profile::Square),
    ("dia", Profile::Round),
    ("sq", Profile::Square),
    ("\u{f8}", Profile::Round),
    ("\u{2300}", Profile::Round),
    ("\u{3c6}", Profile::Round),
    ("\u{25a1}", Profile::Square),
    ("d", Profile::Round),
    ("s", Profile::Square),
    ("a", Profile::Square),
];

/// Parses a section: `d40`, `square 40 mm`, `40x60 mm` (width x height in the plane of vibration), or a bare
/// size. Sizes without a unit are millimetres from 1 on, metres up to 0.5.
///
/// # Errors
/// The reason why it is none.
pub fn section(text: &str) -> Result<Section, String> {
    let text = text.trim().to_lowercase();
    if let Some((width, height)) = text.split_once(['x', '\u{d7}', '*']) {
        let (first, first_unit) = number(width.trim())?;
        let (second, second_unit) = number(height.trim())?;
        // Two bare sizes must be of one unit.
        let is_bare = first_unit.is_empty() && second_unit.is_empty();
        if is_bare && (first < LEAST_BARE_MM) != (second < LEAST_BARE_MM) {
            return Err(format!("{text} of which unit? {text} mm, or {text} m"));
        }
        // One unit serves both sizes, behind either of them.
        let shared = if second_unit.is_empty() {
            first_unit
        } else {
            second_unit
        };
        let first_unit_meant = if first_unit.is_empty() { shared } else { first_unit };
        let (width, height) = (size(first, first_unit_meant)?, size(second, shared)?);
        // A bare size in millimetres behind another unit, `2 cm x 30`, or in metres: `0.04 x 60 mm`.
        let flattest = match (first_unit, second_unit) {
            ("cm" | "in" | "m", "") => FLAT,
            _ => FLATTEST,
        };
        let is_shared = !is_bare && (first_unit.is_empty() || second_unit.is_empty());
        if is_shared && width.max(height) > flattest * width.min(height) {
            let bare = if first_unit.is_empty() { first } else { second };
            return Err(format!("{bare} of which unit? write one behind both sizes"));
        }
        return Ok(Section::Known(match width == height {
            true => Profile::Square(width),
            false => Profile::Rectangle(width, height),
        }));
    }
    for (word, shape) in SHAPES {
        let before = text.strip_prefix(word);
        // Behind the number whole words alone: `40 mm round`.
        let behind = text.strip_suffix(word).filter(|_| word.len() > 2);
        if let Some(rest) = before.or(behind) {
            let (value, unit) = number(rest.trim_matches([' ', '=', ':', ',']))?;
            return Ok(Section::Known(shape(size(value, unit)?)));
        }
    }
    let (value, unit) = number(&text)?;
    Ok(Section::Size(size(value, unit)?))
}

/// Parses a force, or a range: `150 kN`, `20..200 kN`, `20 to 200 kN`, `0.8-1.2 MN`.
///
/// # Errors
/// The reason why it is none.
pub fn force(text: &str) -> Result<Expected, String> {
    let text = text
        .trim()
        .to_lowercase()
        .replace("..", " to ")
        .replace('\u{2013}', " to ");
    let ends = text.split_once("to").or_else(|| text.split_once('-'));
    let newtons = |value: f64, unit: &str| match unit {
        // Nobody says thousandths of a newton.
        "n" if has_three_decimals(&text) => Err(format!(
            "{text} may be {} or {text}: write it without the point",
            text.replace('.', "")
        )),
        "n" => Ok(value),
        "kn" => Ok(value * 1e3),
        "mn" => Ok(value * 1e6),
        "" => Err(format!("{value} of which unit? {value} kN, or {value} N")),
        other => Err(format!("{other:?} is no unit of force known here: N, kN, MN")),
    };
    let Some((low, high)) = ends else {
        let (value, unit) = number(&text)?;
        return Ok(Expected::About(newtons(value, unit)?));
    };
    let (low, low_unit) = number(low.trim())?;
    let (high, unit) = number(high.trim())?;
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
            ("1 mm", "is no length"),
            ("1e400", "above 0"),
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
    fn sections_are_told_from_shape_and_size() {
        let known = |profile| Ok(Section::Known(profile));
        for (text, section_) in [
            ("d40", known(Profile::Round(0.04))),
            ("D = 40 mm", known(Profile::Round(0.04))),
            ("d 0,045", known(Profile::Round(0.045))),
            ("\u{d8}40", known(Profile::Round(0.04))),
            ("40 mm round", known(Profile::Round(0.04))),
            ("diameter 2 in", known(Profile::Round(0.0508))),
            ("square 71.5", known(Profile::Square(0.0715))),
            ("s40", known(Profile::Square(0.04))),
            ("40x40 mm", known(Profile::Square(0.04))),
            ("40x60 mm", known(Profile::Rectangle(0.04, 0.06))),
            ("40 mm x 6 cm", known(Profile::Rectangle(0.04, 0.06))),
            ("2 cm x 3", known(Profile::Rectangle(0.02, 0.03))),
            ("2 x 3 cm", known(Profile::Rectangle(0.02, 0.03))),
            ("1 in x 2", known(Profile::Rectangle(0.0254, 0.0508))),
            ("0.02 m x 0.03", known(Profile::Rectangle(0.02, 0.03))),
            ("40 mm x 60", known(Profile::Rectangle(0.04, 0.06))),
            ("0.5 mm x 4 cm", known(Profile::Rectangle(0.0005, 0.04))),
            ("0.06x0.02", known(Profile::Rectangle(0.06, 0.02))),
            ("60 \u{d7} 20", known(Profile::Rectangle(0.06, 0.02))),
            ("40 mm", Ok(Section::Size(0.04))),
            ("0.04", Ok(Section::Size(0.04))),
            ("2 in", Ok(Section::Size(0.0508))),
            ("2\"", Ok(Section::Size(0.0508))),
            ("8", Ok(Section::Size(0.008))),
            ("0.9mm", Ok(Section::Size(0.0009))),
        ] {
            assert_eq!(section(text), section_, "{text}");
        }
        for (text, reason) in [
            ("0.9", "0.9 mm, or 0.9 m"),
            ("0.5x60", "of which unit"),
            ("0.04 x 60 mm", "0.04 of which unit"),
            ("60 mm x 0.04", "0.04 of which unit"),
            ("2 cm x 30", "30 of which unit"),
            ("d", "number"),
            ("40 kg", "is no unit"),
            ("2 m", "is no size"),
            ("900", "is no size"),
            ("40x", "number"),
            ("1,200 mm", "1200 or 1.200"),
        ] {
            let said = section(text).unwrap_err();
            assert!(said.contains(reason), "{text}: {said}");
        }
    }

    #[test]
    fn forces_need_a_unit() {
        assert_eq!(force("150 kN"), Ok(Expected::About(150e3)));
        assert_eq!(force("20..200 kN"), Ok(Expected::Between(20e3, 200e3)));
        assert_eq!(force("900 N to 1,5 kN"), Ok(Expected::Between(900.0, 1500.0)));
        assert_eq!(force("0.8-1.2 MN"), Ok(Expected::Between(0.8e6, 1.2e6)));
        for (text, reason) in [
            ("150", "150 kN, or 150 N"),
            ("200..20 kN", "smaller"),
            ("5 t", "no unit of force"),
            ("150,000 N", "150000 or 150.000"),
            ("150.000 N", "150000 n or 150.000 n"),
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
    fn what_was_understood_is_said_with_its_unit() {
        assert_eq!(Profile::Round(0.0508).said(), "round, diameter 50.8 mm");
        assert_eq!(
            Profile::Rectangle(0.04, 0.06).said(),
            "rectangle, 40 mm wide and 60 mm high in the plane of vibration"
        );
        assert_eq!(metres(9.4488), "9.4488 m");
        assert_eq!(
            Expected::Between(20e3, 200e3).said(),
            "20 to 200 kN with 95 % probability"
        );
    }
}
