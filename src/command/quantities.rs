//! Parses lengths, sections and forces: `14 m`, `d40`, `40x60 mm`, `2 in`, `20..200 kN`.

use crate::config::units::{self, FORCE, LENGTH, RATE};
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

/// Forms that are understood, for messages.
const LENGTHS: &str = "14, 9500 mm, 31 ft";
const SECTIONS: &str = "d40, s40, 40x60 mm, 2 in round";
const FORCES: &str = "150 kN, 20..200 kN";

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

/// Splits a number above 0 from the text after it; the fault names the forms that are understood.
fn number<'t>(text: &'t str, forms: &str) -> Result<(f64, &'t str), String> {
    match units::number(text) {
        Ok((value, rest)) if value > 0.0 => Ok((value, rest)),
        Ok(_) => Err("a number above 0 is expected".to_owned()),
        Err(why) if why.ends_with("does not begin with a number") => Err(format!("{why}: write {forms}")),
        Err(why) => Err(why),
    }
}

/// Converts a value in a unit of length to metres; `None` without a unit.
fn in_unit(value: f64, unit: &str) -> Result<Option<f64>, String> {
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

/// What a word says of a section.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Shape {
    Round,
    Radius,
    Square,
    Flat,
    /// Nothing.
    Bar,
}

/// Words for shapes.
const SHAPES: [(Shape, &[&str]); 5] = [
    (
        Shape::Round,
        &[
            "d",
            "dia",
            "diam",
            "diameter",
            "diametro",
            "diametre",
            "durchmesser",
            "round",
            "circle",
            "circular",
            "tondo",
            "rond",
            "rund",
            "redondo",
            "\u{f8}",
        ],
    ),
    (Shape::Radius, &["radius", "raggio", "rayon"]),
    (
        Shape::Square,
        &[
            "s", "a", "sq", "side", "square", "quadro", "quadrato", "carre", "quadrat", "cuadrado", "lato",
        ],
    ),
    (
        Shape::Flat,
        &[
            "flat",
            "rect",
            "rectangle",
            "rectangular",
            "piatto",
            "plat",
            "flach",
        ],
    ),
    (Shape::Bar, &["bar", "rod", "of", "section"]),
];

/// Takes the words of shapes, and the signs behind them, out of a text. Single letters count before the sizes alone: `40 d` may be
/// anything.
fn shape(text: &str) -> Result<(Option<Shape>, String), String> {
    let mut found = None;
    let mut sizes = String::new();
    let mut rest = text;
    while let Some(next) = rest.chars().next() {
        let end = match next.is_alphabetic() {
            true => rest.find(|c: char| !c.is_alphabetic()).unwrap_or(rest.len()),
            false => next.len_utf8(),
        };
        let (word, behind) = rest.split_at(end);
        let is_first = sizes.trim().is_empty();
        let known = SHAPES
            .iter()
            .find(|(_, words)| words.contains(&word) && (is_first || word.len() > 1));
        rest = match known {
            Some((Shape::Bar, _)) => behind,
            Some((shape, _)) if found.is_none_or(|other| other == *shape) => {
                found = Some(*shape);
                behind.trim_start_matches([' ', '=', ':', ',', '.'])
            }
            Some(_) => return Err(format!("{text:?} has two shapes: write {SECTIONS}")),
            None => {
                sizes.push_str(word);
                behind
            }
        };
    }
    Ok((found, sizes))
}

/// Parses a section: `d40`, `square 40 mm`, `40x60 mm` (width x height in the plane of vibration), or a bare
/// size. Sizes without a unit are millimetres from 1 on, metres up to 0.5.
///
/// # Errors
/// The reason why it is none.
pub fn section(text: &str) -> Result<Section, String> {
    let text = units::keyed(text)
        .to_lowercase()
        .replace(
            ['\u{2300}', '\u{2205}', '\u{3c6}', '\u{3d5}', '\u{f8}'],
            " \u{f8} ",
        )
        .replace('\u{25a1}', " square ")
        .replace(" by ", " x ");
    let (shape, sizes) = shape(&text)?;
    let (value, rest) = number(&sizes, SECTIONS)?;
    if let Some((first_unit, second)) = rest.split_once(['x', '*']) {
        let (second, second_unit) = number(second, SECTIONS)?;
        return match (
            shape,
            two_sizes(&text, (value, first_unit.trim()), (second, second_unit))?,
        ) {
            (None | Some(Shape::Flat), profile) | (Some(Shape::Square), profile @ Profile::Square(_)) => {
                Ok(Section::Known(profile))
            }
            _ => Err(format!("{text:?} has one size too many: write {SECTIONS}")),
        };
    }
    let size_m = size(value, rest)?;
    match shape {
        Some(Shape::Round) => Ok(Section::Known(Profile::Round(size_m))),
        Some(Shape::Radius) => Ok(Section::Known(Profile::Round(2.0 * size_m))),
        Some(Shape::Square) => Ok(Section::Known(Profile::Square(size_m))),
        Some(Shape::Flat) => Err("a flat has two sizes: 60x20 mm".to_owned()),
        Some(Shape::Bar) | None => Ok(Section::Size(size_m)),
    }
}

/// Width and height; one unit serves both sizes, behind either of them.
fn two_sizes(
    text: &str,
    (first, first_unit): (f64, &str),
    (second, second_unit): (f64, &str),
) -> Result<Profile, String> {
    // Two bare sizes must be of one unit.
    let is_bare = first_unit.is_empty() && second_unit.is_empty();
    if is_bare && (first < LEAST_BARE_MM) != (second < LEAST_BARE_MM) {
        return Err(format!("{text} of which unit? {text} mm, or {text} m"));
    }
    let or = |unit, other| if str::is_empty(unit) { other } else { unit };
    let width = size(first, or(first_unit, second_unit))?;
    let height = size(second, or(second_unit, first_unit))?;
    // A bare size in millimetres behind another unit, `2 cm x 30`, or in metres: `0.04 x 60 mm`.
    let is_in_mm = |unit| LENGTH.of(unit).is_ok_and(|factor| factor <= 1e-3);
    let flattest = match second_unit.is_empty() && !is_in_mm(first_unit) {
        true => FLAT,
        false => FLATTEST,
    };
    let is_shared = !is_bare && (first_unit.is_empty() || second_unit.is_empty());
    if is_shared && width.max(height) > flattest * width.min(height) {
        let bare = if first_unit.is_empty() { first } else { second };
        return Err(format!("{bare} of which unit? write one behind both sizes"));
    }
    Ok(match width == height {
        true => Profile::Square(width),
        false => Profile::Rectangle(width, height),
    })
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
    fn sections_are_told_from_shape_and_size() {
        let known = |profile| Ok(Section::Known(profile));
        for (text, section_) in [
            ("d40", known(Profile::Round(0.04))),
            ("D = 40 mm", known(Profile::Round(0.04))),
            ("d 0,045", known(Profile::Round(0.045))),
            ("\u{d8}40", known(Profile::Round(0.04))),
            ("40 mm round", known(Profile::Round(0.04))),
            ("40mm dia.", known(Profile::Round(0.04))),
            ("40 mm \u{d8}", known(Profile::Round(0.04))),
            ("\u{2205} 40", known(Profile::Round(0.04))),
            ("d\u{a0}40", known(Profile::Round(0.04))),
            ("round bar 40 mm", known(Profile::Round(0.04))),
            ("diameter of 40 millimetres", known(Profile::Round(0.04))),
            ("radius 20 mm", known(Profile::Round(0.04))),
            ("Tondo 40", known(Profile::Round(0.04))),
            ("1 1/2 in round", known(Profile::Round(1.5 * 0.0254))),
            ("carr\u{e9} 40 mm", known(Profile::Square(0.04))),
            ("40 mm sq.", known(Profile::Square(0.04))),
            ("square 40x40 mm", known(Profile::Square(0.04))),
            ("flat bar 40 x 60 mm", known(Profile::Rectangle(0.04, 0.06))),
            ("40 by 60 mm", known(Profile::Rectangle(0.04, 0.06))),
            ("40mm\u{d7}60mm", known(Profile::Rectangle(0.04, 0.06))),
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
            ("r20", "write d40, s40, 40x60 mm"),
            ("40 s", "is no unit"),
            ("M30", "write d40"),
            ("pipe 60x5", "write d40"),
            ("hexagonal 40", "write d40"),
            ("40 mm2", "is no unit"),
            ("d40x60", "one size too many"),
            ("square 40x60", "one size too many"),
            ("60x20x5", "is no unit"),
            ("flat 60", "two sizes"),
            ("round square 40", "two shapes"),
            ("40 mm \u{b1} 1", "is no unit"),
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
