//! Parses cross-sections: `d40`, `40 mm dia.`, `square 40 mm`, `40x60 mm`, `2 in`.

use super::quantities::{in_unit, millimetres, number};
use crate::config::units::{self, LENGTH};
use std::f64::consts::PI;

/// Least size without a unit that is taken in millimetres; no section is that many metres.
const LEAST_BARE_MM: f64 = 1.0;
/// Largest size without a unit that is taken in metres \[m\]; no section is that few millimetres.
const MOST_BARE_M: f64 = 0.5;
/// Largest section accepted \[m\].
const LARGEST_M: f64 = 0.5;
/// Largest ratio of two sizes that one unit serves; the flattest common bar is 100 x 5 mm.
const FLATTEST: f64 = 25.0;
/// The same where the second size is bare behind a unit that is not millimetres.
const FLAT: f64 = 5.0;
/// Forms that are understood, for messages.
const SECTIONS: &str = "d40, s40, 40x60 mm, 2 in round";

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

/// Meaning of a word in the text of a section.
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

#[cfg(test)]
mod tests {
    use super::*;

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
    fn a_section_is_said_with_its_unit() {
        assert_eq!(Profile::Round(0.0508).said(), "round, diameter 50.8 mm");
        assert_eq!(
            Profile::Rectangle(0.04, 0.06).said(),
            "rectangle, 40 mm wide and 60 mm high in the plane of vibration"
        );
    }
}
