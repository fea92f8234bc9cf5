//! Measurements of a rod as people write them, in flags and in `[[rod.test]]`:
//!
//! ```text
//! load      300N@0.5L=1.1mm+-3%            force @ its place = deflection there
//!           300N@0.3L=0.9mm@0.4L+-0.02mm   read elsewhere
//! mass      20kg@0.3L                      on the rod while the frequencies with the mass were measured
//!           20kg@0.3L=0.953+-0.1%          ratio of mode 1 with it and without; mode2:20kg@0.3L=... of another mode
//! strain    mode1:0.1L/0.4L=0.0123+-2%     strain amplitude at a place over displacement amplitude at another [1/m]
//! shape     mode2:0.1L/0.4L=-0.62+-2%      modal displacements at two places, with their sign
//! measured  side=70.1,70.4,69.9mm+-0.2mm   readings of one of the rod's quantities; 70,1; 70,4mm with decimal commas
//! ```
//!
//! A place is a share of the length (`0.3L`) or a length from the left support (`4.2m`).

use super::units::{self, DENSITY, FORCE, LENGTH, MASS, MASS_PER_LENGTH, MODULUS, RIGIDITY, STIFFNESS};
use super::written;
use crate::analysis::inference::joint::Datum;
use crate::analysis::rod::beam::Quantity;
use crate::analysis::rod::beam::receptance::{PointLoad, PointMass};
use crate::analysis::rod::query::Query;

/// Relative standard error of a value given without one.
pub const ASSUMED_ERROR: f64 = 0.03;

/// Largest over smallest reading of one size, density or modulus.
const MOST_APART: f64 = 1.5;

/// Kind of a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A load and the deflection under it, at rest or just before its release.
    Load,
    /// A mass on the rod, with a frequency ratio.
    Mass,
    /// Strain over displacement.
    Strain,
    /// Modal amplitudes at two places.
    Shape,
    /// A quantity of the rod itself.
    Measured,
}

impl Kind {
    /// Every kind.
    pub const ALL: [Self; 5] = [Self::Load, Self::Mass, Self::Strain, Self::Shape, Self::Measured];

    /// Name of its key and flag.
    pub fn key(self) -> &'static str {
        match self {
            Self::Load => "load",
            Self::Mass => "mass",
            Self::Strain => "strain",
            Self::Shape => "shape",
            Self::Measured => "measured",
        }
    }

    /// An example.
    pub fn example(self) -> &'static str {
        match self {
            Self::Load => "300N@0.5L=1.1mm+-3%",
            Self::Mass => "20kg@0.3L=0.953+-0.1%",
            Self::Strain => "mode1:0.1L/0.4L=0.0123+-2%",
            Self::Shape => "mode2:0.1L/0.4L=-0.62+-2%",
            Self::Measured => "side=70.1,70.4,69.9mm+-0.2mm",
        }
    }
}

/// Parses a datum of a rod of this length.
///
/// # Errors
/// The reason why it is invalid, with an example.
pub fn datum(kind: Kind, text: &str, length_m: f64) -> Result<Datum, String> {
    let keyed = units::keyed(text);
    let text = keyed.as_str();
    let read = match kind {
        Kind::Load => load(text, length_m),
        Kind::Mass => ratio(text, length_m),
        Kind::Strain | Kind::Shape => amplitudes(kind, text, length_m),
        Kind::Measured => measured(text),
    };
    read.map_err(|why| format!("{text:?}: {why}; an example: {}", kind.example()))
}

/// Parses a mass and its place, without a value.
///
/// # Errors
/// The reason why it is invalid.
pub fn mass(text: &str, length_m: f64) -> Result<PointMass, String> {
    let text = units::keyed(text);
    let (amount, at) = cut(&text, '@', "where the mass is")?;
    let (value, unit) = units::number(amount)?;
    let mass_kg = match FORCE.of(unit) {
        Ok(_) => return Err("a weight is no mass: write kg".to_owned()),
        Err(_) => MASS.si(value, unit)?,
    };
    Ok(PointMass {
        mass_kg,
        at: place(at, length_m)?,
    })
}

fn load(text: &str, length_m: f64) -> Result<Datum, String> {
    let (given, found) = cut(text, '=', "the deflection")?;
    let (amount, at) = cut(given, '@', "where the load is")?;
    let (value, unit) = units::number(amount)?;
    let force_n = match unit {
        "kg" => {
            return Err(format!(
                "kg is a mass: a load of {value} kg is {value}kgf, {:.0}N",
                value * 9.806_65
            ));
        }
        "" => return Err(format!("{value} of which unit? {value}N, or {value}kgf")),
        unit => FORCE.si(value, unit)?,
    };
    let at = place(at, length_m)?;
    let (value_and_place, error) = parted(found);
    let (value, read_at) = match value_and_place.split_once('@') {
        Some((value, read_at)) => (value, place(read_at, length_m)?),
        None => (value_and_place, at),
    };
    let value = length(value)?;
    Ok(Datum {
        query: Query::Deflection {
            load: PointLoad { force_n, at },
            read_at,
        },
        value,
        sd: spread(error, value, length)?,
        gain_sd: 0.0,
    })
}

fn ratio(text: &str, length_m: f64) -> Result<Datum, String> {
    let (given, found) = cut(text, '=', "the frequency ratio")?;
    let (order, given) = mode(given)?;
    let (value, error) = parted(found);
    let value = plain(value)?;
    Ok(Datum {
        query: Query::FrequencyRatio {
            order: order.unwrap_or(1),
            mass: mass(given, length_m)?,
        },
        value,
        sd: match error {
            Some(_) => spread(error, value, plain)?,
            None => return Err("a ratio wants its error: +-0.1%, say".to_owned()),
        },
        gain_sd: 0.0,
    })
}

fn amplitudes(kind: Kind, text: &str, length_m: f64) -> Result<Datum, String> {
    let (given, found) = cut(text, '=', "the value")?;
    let (order, places) = mode(given)?;
    let order = order.ok_or("which mode? mode1: stands first")?;
    let (first, second) = cut(places, '/', "the second place")?;
    let (first, second) = (place(first, length_m)?, place(second, length_m)?);
    let (value, error) = parted(found);
    // Microstrain per millimetre is 1e-3 per metre.
    let (value, scale) = match value.trim().to_lowercase() {
        v if v.ends_with("ue/mm") => (v.trim_end_matches("ue/mm").to_owned(), 1e-3),
        v if v.ends_with("/m") => (v.trim_end_matches("/m").to_owned(), 1.0),
        v => (v, 1.0),
    };
    let value = plain(&value)? * scale;
    Ok(Datum {
        query: match kind {
            Kind::Strain => Query::StrainRatio {
                order,
                strain_at: first,
                read_at: second,
            },
            _ => Query::AmplitudeRatio {
                order,
                at: first,
                reference_at: second,
            },
        },
        value,
        sd: spread(error, value, |text| Ok(plain(text)? * scale))?,
        gain_sd: 0.0,
    })
}

/// Quantities that can be measured, by the names people use.
const QUANTITIES: [(&str, Quantity); 11] = [
    ("side", Quantity::Side),
    ("diameter", Quantity::Diameter),
    ("width", Quantity::Width),
    ("height", Quantity::Height),
    ("density", Quantity::Density),
    ("modulus", Quantity::YoungsModulus),
    ("mass_per_length", Quantity::MassPerLength),
    ("rigidity", Quantity::FlexuralRigidity),
    ("spring_left", Quantity::SpringLeft),
    ("spring_right", Quantity::SpringRight),
    ("length", Quantity::Length),
];

fn measured(text: &str) -> Result<Datum, String> {
    let (name, found) = cut(text, '=', "its value")?;
    let name = name.trim().to_lowercase();
    let known = QUANTITIES
        .iter()
        .find(|(word, quantity)| *word == name || quantity.key() == name);
    let Some(&(_, quantity)) = known else {
        let words: Vec<&str> = QUANTITIES.iter().map(|(word, _)| *word).collect();
        return Err(format!("{name:?} is nothing measured here: {}", words.join(", ")));
    };
    let (values, error) = parted(found);
    let unit_of = |text: &str| -> Result<String, String> { Ok(units::number(text)?.1.to_owned()) };
    let parts = written::list(values)?;
    // One unit at the end serves all.
    let unit = unit_of(parts.last().copied().unwrap_or_default())?;
    let read = |text: &str| -> Result<f64, String> {
        let (value, own) = units::number(text)?;
        let unit = if own.is_empty() { unit.as_str() } else { own };
        Ok(value * factor(quantity, unit)?)
    };
    let values = parts
        .into_iter()
        .map(read)
        .collect::<Result<Vec<f64>, String>>()?;
    let is_support = matches!(quantity, Quantity::SpringLeft | Quantity::SpringRight);
    let (least, most) = values
        .iter()
        .fold((f64::INFINITY, 0.0_f64), |(least, most), value| {
            (least.min(*value), most.max(*value))
        });
    if !is_support && most > MOST_APART * least {
        return Err(format!(
            "{least} and {most} in SI units are no readings of one thing: write ';' between readings, and a point as decimal sign"
        ));
    }
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let sd = match error {
        Some(_) => spread(error, mean, read)?,
        None => return Err("a measurement wants its error: +-0.2mm or +-1%, say".to_owned()),
    };
    Datum::readings(quantity, &values, sd).ok_or_else(|| "no reading".to_owned())
}

/// SI of one unit of a quantity.
fn factor(quantity: Quantity, unit: &str) -> Result<f64, String> {
    use Quantity::*;
    let units = match quantity {
        Side | Diameter | Width | Height | Length => &LENGTH,
        Density => &DENSITY,
        YoungsModulus => &MODULUS,
        MassPerLength => &MASS_PER_LENGTH,
        FlexuralRigidity => &RIGIDITY,
        SpringLeft | SpringRight => &STIFFNESS,
        AxialForce => &FORCE,
    };
    units.of(unit)
}

/// `mode2:rest`.
fn mode(text: &str) -> Result<(Option<usize>, &str), String> {
    match text.split_once(':') {
        None => Ok((None, text)),
        Some((word, rest)) => {
            let word = word.trim().to_lowercase();
            let order = word
                .strip_prefix("mode")
                .map(str::trim)
                .and_then(|n| n.parse().ok());
            let order = order.ok_or_else(|| format!("{word:?} is no mode: mode1, mode2 ..."))?;
            Ok((Some(order), rest))
        }
    }
}

fn cut<'t>(text: &'t str, at: char, missing: &str) -> Result<(&'t str, &'t str), String> {
    text.split_once(at)
        .ok_or_else(|| format!("{missing} is missing behind '{at}'"))
}

/// Splits a value from its error, which follows `+-`.
fn parted(text: &str) -> (&str, Option<&str>) {
    match text.split_once("+-") {
        Some((value, error)) => (value.trim(), Some(error.trim())),
        None => (text.trim(), None),
    }
}

/// The standard error: a share in per cent, or in the unit of the value; [`ASSUMED_ERROR`] where none is given.
fn spread(
    error: Option<&str>,
    value: f64,
    read: impl Fn(&str) -> Result<f64, String>,
) -> Result<f64, String> {
    let sd = match error {
        None => ASSUMED_ERROR * value.abs(),
        Some(text) => match text.strip_suffix('%') {
            Some(share) => plain(share)? / 100.0 * value.abs(),
            None => read(text)?,
        },
    };
    match sd > 0.0 && sd.is_finite() {
        true => Ok(sd),
        false => Err("the error behind +- must be above 0".to_owned()),
    }
}

/// A place along the rod as a share of its length.
fn place(text: &str, length_m: f64) -> Result<f64, String> {
    let (value, unit) = units::number(text)?;
    match unit {
        "l" | "L" => Ok(value),
        "" => Err(format!(
            "{value} of what? {value}L is a share of the length, {value}m a length"
        )),
        _ => Ok(length(text)? / length_m),
    }
}

/// A length \[m\].
fn length(text: &str) -> Result<f64, String> {
    match units::number(text)? {
        (value, "") => Err(format!("{value} of which unit? {value}mm, or {value}m")),
        (value, unit) => LENGTH.si(value, unit),
    }
}

/// A number without a unit.
fn plain(text: &str) -> Result<f64, String> {
    match units::number(text)? {
        (value, "") => Ok(value),
        (_, unit) => Err(format!("{unit:?} stands behind a number without a unit")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_example_is_read() {
        for kind in Kind::ALL {
            assert!(datum(kind, kind.example(), 14.0).is_ok(), "{kind:?}");
        }
        let load = datum(Kind::Load, "300 N @ 4.2 m = 0.9 mm @ 0.4 L +- 0.02 mm", 14.0).unwrap();
        let Query::Deflection {
            load: PointLoad { force_n, at },
            read_at,
        } = load.query
        else {
            panic!("a deflection");
        };
        assert!(force_n == 300.0 && (at - 0.3).abs() < 1e-12 && read_at == 0.4);
        assert!((load.value - 0.9e-3).abs() < 1e-12 && (load.sd - 2e-5).abs() < 1e-12);
        let bare = datum(Kind::Load, "30kgf@0.5L=1.1mm", 14.0).unwrap();
        assert!((bare.sd - 0.03 * 1.1e-3).abs() < 1e-12);
        assert!(
            matches!(bare.query, Query::Deflection { load, .. } if (load.force_n - 294.1995).abs() < 1e-9)
        );
        let shape = datum(Kind::Shape, "mode2:0.1L/0.4L=-0.62\u{b1}2%", 14.0).unwrap();
        assert!(shape.value == -0.62 && (shape.sd - 0.0124).abs() < 1e-12);
        let side = datum(Kind::Measured, "side=70.1,70.4,69.9mm+-0.2mm", 14.0).unwrap();
        assert!((side.value - 0.070_133_333).abs() < 1e-8 && side.sd > 0.2e-3 && side.sd < 0.3e-3);
        for commas in [
            "side=70,1; 70,4; 69,9mm+-0,2mm",
            "side=70,1, 70,4, 69,9 mm +- 0,2 mm",
        ] {
            let read = datum(Kind::Measured, commas, 14.0).unwrap();
            assert_eq!((read.value, read.sd), (side.value, side.sd), "{commas}");
        }
        let comma = datum(Kind::Load, "300N@0,5L=1,1mm+-3%", 14.0).unwrap();
        let point = datum(Kind::Load, "300N@0.5L=1.1mm+-3%", 14.0).unwrap();
        assert_eq!(comma, point);
        for (text, si) in [
            ("density=7.5 t/m\u{b3}+-1%", 7500.0),
            ("density = 7500\u{a0}kg / m^3 \u{b1} 1 %", 7500.0),
            ("modulus=190 kN/mm2+-5%", 190e9),
            ("diameter=1 1/2 in+-1%", 0.0381),
            ("spring_left=12 kN\u{b7}m/rad+-20%", 12e3),
        ] {
            let read = datum(Kind::Measured, text, 14.0).unwrap();
            assert!((read.value / si - 1.0).abs() < 1e-12, "{text}: {}", read.value);
        }
        assert_eq!(
            mass("0,02 tonnes @ 4200 mm", 14.0).map(|mass| mass.mass_kg),
            Ok(20.0)
        );
        let strain = datum(Kind::Strain, "mode1:0.1L/0.4L=12.3ue/mm+-2%", 14.0).unwrap();
        assert!((strain.value - 0.0123).abs() < 1e-9 && (strain.sd - 0.000_246).abs() < 1e-9);
        assert_eq!(
            mass("20kg@0.3L", 14.0),
            Ok(PointMass {
                mass_kg: 20.0,
                at: 0.3
            })
        );
    }

    #[test]
    fn what_is_meant_is_asked_where_it_is_not_said() {
        for (kind, text, reason) in [
            (Kind::Load, "300@0.5L=1.1mm", "300N, or 300kgf"),
            (Kind::Load, "30kg@0.5L=1.1mm", "a load of 30 kg is 30kgf, 294N"),
            (Kind::Load, "300N@0.5=1.1mm", "0.5L is a share"),
            (Kind::Load, "300N@0.5L=1.1", "1.1mm, or 1.1m"),
            (Kind::Load, "300N@0.5L", "the deflection is missing"),
            (Kind::Load, "300N=1.1mm", "where the load is"),
            (Kind::Load, "300N@0.5L=1.1mm+-", "does not begin with a number"),
            (Kind::Load, "300N@0.5L=1.1mm+-0%", "above 0"),
            (Kind::Load, "300 stone@0.5L=1.1mm", "no unit of force known"),
            (Kind::Load, "300 mN@0.5L=1.1mm", "MN is a million"),
            (Kind::Load, "1e400N@0.5L=1.1mm", "too large"),
            (Kind::Mass, "200N@0.3L=0.95+-1%", "no mass"),
            (Kind::Mass, "20kg@0.3L=0.95", "wants its error"),
            (Kind::Shape, "0.1L/0.4L=-0.6", "which mode"),
            (Kind::Shape, "mode2:0.1L=-0.6", "second place"),
            (Kind::Measured, "colour=3mm+-1%", "nothing measured"),
            (
                Kind::Measured,
                "density=7.8mm+-1%",
                "no unit of density known here: kg/m3",
            ),
            (Kind::Measured, "side=70mm", "wants its error"),
            (Kind::Measured, "side=70,1mm+-0.2mm", "may be a decimal comma"),
            (Kind::Measured, "density=7,85g/cm3+-1%", "may be a decimal comma"),
            (
                Kind::Measured,
                "side=70,1,70,4,69mm+-0.2mm",
                "no readings of one thing",
            ),
            (
                Kind::Measured,
                "side=7; 70.4mm+-0.2mm",
                "no readings of one thing",
            ),
            (Kind::Measured, "side=70.1mm+-1,200mm", "1200 or 1.200"),
            (Kind::Load, "1,200N@0.5L=1.1mm", "1200 or 1.200"),
        ] {
            let said = datum(kind, text, 14.0).unwrap_err();
            assert!(
                said.contains(reason) && said.contains(kind.example()),
                "{text}: {said}"
            );
        }
    }
}
