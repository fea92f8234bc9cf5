//! Numbers with units as people type them: `9.5 metres`, `1 1/2 in`, `150 000 N`, `7,5 t/m³`. One set of words serves flags, answers
//! and `[[rod.test]]`.

use super::written;

/// A unit: its value in SI and the words for it, without blanks and `^`, whatever their capitals; messages show the first.
type Unit = (f64, &'static [&'static str]);

/// Units of one quantity.
#[derive(Debug)]
pub struct Units {
    quantity: &'static str,
    units: &'static [Unit],
}

/// Units of length \[m\].
pub const LENGTH: Units = Units {
    quantity: "length",
    units: &[
        (
            1e-3,
            &[
                "mm",
                "millimetre",
                "millimetres",
                "millimeter",
                "millimeters",
                "millimetri",
                "milimetros",
            ],
        ),
        (
            1e-2,
            &[
                "cm",
                "centimetre",
                "centimetres",
                "centimeter",
                "centimeters",
                "centimetri",
                "centimetros",
            ],
        ),
        (
            1.0,
            &[
                "m", "metre", "metres", "meter", "meters", "metro", "metri", "metros", "mt",
            ],
        ),
        (
            0.0254,
            &[
                "in", "inch", "inches", "\"", "''", "zoll", "pollice", "pollici", "pouce", "pouces",
            ],
        ),
        (0.3048, &["ft", "foot", "feet", "'"]),
        (0.1, &["dm", "decimetre", "decimetres", "decimeter", "decimeters"]),
        (
            1e-6,
            &[
                "um",
                "micron",
                "microns",
                "micrometre",
                "micrometres",
                "micrometer",
                "micrometers",
            ],
        ),
        (0.9144, &["yd", "yard", "yards"]),
    ],
};

/// Units of force \[N\].
pub const FORCE: Units = Units {
    quantity: "force",
    units: &[
        (1.0, &["N", "newton", "newtons"]),
        (1e3, &["kN", "kilonewton", "kilonewtons"]),
        (1e6, &["MN", "meganewton", "meganewtons"]),
        (10.0, &["daN", "decanewton", "decanewtons"]),
        (9.806_65, &["kgf", "kp"]),
        (9806.65, &["tf"]),
        (4.448_221_615, &["lbf"]),
        (4_448.221_615, &["kip", "kips"]),
    ],
};

/// Units of mass \[kg\].
pub const MASS: Units = Units {
    quantity: "mass",
    units: &[
        (1.0, &["kg", "kilogram", "kilograms", "kilogramme", "kilogrammes"]),
        (1e-3, &["g", "gram", "grams"]),
        (1e3, &["t", "tonne", "tonnes"]),
        (0.453_592_37, &["lb", "lbs"]),
    ],
};

/// Units of density \[kg/m^3\].
pub const DENSITY: Units = Units {
    quantity: "density",
    units: &[
        (1.0, &["kg/m3"]),
        (1e3, &["g/cm3", "g/cc", "kg/dm3", "kg/l"]),
        (1e3, &["t/m3"]),
    ],
};

/// Units of Young's modulus \[Pa\].
pub const MODULUS: Units = Units {
    quantity: "modulus",
    units: &[
        (1e9, &["GPa", "kN/mm2"]),
        (1e6, &["MPa", "N/mm2"]),
        (1.0, &["Pa", "N/m2"]),
    ],
};

/// Units of mass per length \[kg/m\].
pub const MASS_PER_LENGTH: Units = Units {
    quantity: "mass per length",
    units: &[(1.0, &["kg/m"]), (1e-3, &["g/m"])],
};

/// Units of flexural rigidity \[N m^2\].
pub const RIGIDITY: Units = Units {
    quantity: "rigidity",
    units: &[(1.0, &["Nm2"]), (1e3, &["kNm2"])],
};

/// Units of rotational stiffness \[N m/rad\].
pub const STIFFNESS: Units = Units {
    quantity: "rotational stiffness",
    units: &[
        (1.0, &["Nm/rad", "Nm"]),
        (1e3, &["kNm/rad", "kNm"]),
        (1e6, &["MNm/rad"]),
    ],
};

/// Units of rates \[Hz\].
pub const RATE: Units = Units {
    quantity: "rate",
    units: &[(1.0, &["Hz", "hertz", "sps"]), (1e3, &["kHz"])],
};

impl Units {
    /// A value in SI. Parts of a unit are divided by their number, so that 0.9 mm are 0.0009 m to the last bit.
    ///
    /// # Errors
    /// As of [`Units::of`].
    pub fn si(&self, value: f64, unit: &str) -> Result<f64, String> {
        let factor = self.of(unit)?;
        let parts = (1.0 / factor).round();
        Ok(match factor < 1.0 && parts * factor == 1.0 {
            true => value / parts,
            false => value * factor,
        })
    }

    /// SI value of one of the unit.
    ///
    /// # Errors
    /// It is none of these, or a thousandth where a million is more likely.
    pub fn of(&self, unit: &str) -> Result<f64, String> {
        let unit = unit.trim().trim_end_matches('.');
        let bare: String = unit.chars().filter(|c| !matches!(c, ' ' | '^')).collect();
        // 'M' is a million only as a capital; nobody pulls rods with thousandths of a newton.
        if ["mN", "mPa"].iter().any(|milli| bare.starts_with(milli)) {
            return Err(format!(
                "{unit} begins with a thousandth: {} is a million",
                bare.replacen('m', "M", 1)
            ));
        }
        let is_meant = |word: &&str| word.eq_ignore_ascii_case(&bare);
        let known = self.units.iter().find(|(_, words)| words.iter().any(is_meant));
        known.map(|(factor, _)| *factor).ok_or_else(|| {
            let words: Vec<&str> = self
                .units
                .iter()
                .filter_map(|(_, words)| words.first().copied())
                .collect();
            format!(
                "{unit:?} is no unit of {} known here: {}",
                self.quantity,
                words.join(", ")
            )
        })
    }
}

/// Signs of typesetting and of other keyboards as those of one: blanks, minus, primes, micro, powers, times, plus-minus.
pub fn keyed(text: &str) -> String {
    let mut keyed = String::with_capacity(text.len());
    for c in text.trim().chars() {
        match c {
            '\u{200b}' | '\u{feff}' => {}
            c if c.is_whitespace() => keyed.push(' '),
            '\u{2010}'..='\u{2015}' | '\u{2212}' | '\u{fe63}' | '\u{ff0d}' => keyed.push('-'),
            '\u{2032}' | '\u{2018}' | '\u{2019}' | '\u{2b9}' | '\u{2bc}' | '\u{b4}' | '`' => keyed.push('\''),
            '\u{2033}' | '\u{201c}' | '\u{201d}' | '\u{2ba}' => keyed.push('"'),
            '\u{b5}' | '\u{3bc}' => keyed.push('u'),
            '\u{b2}' => keyed.push('2'),
            '\u{b3}' => keyed.push('3'),
            '\u{b7}' | '\u{22c5}' if keyed.ends_with(|c: char| c.is_alphabetic()) => {}
            '\u{d7}' | '\u{2715}' => keyed.push('x'),
            '\u{b1}' => keyed.push_str("+-"),
            '\u{2026}' => keyed.push_str(".."),
            '\u{2215}' | '\u{2044}' => keyed.push('/'),
            '\u{e8}' | '\u{e9}' | '\u{ed}' if keyed.ends_with(char::is_alphabetic) => {
                keyed.push(if c == '\u{ed}' { 'i' } else { 'e' });
            }
            // Digits, points and commas of wide fonts.
            '\u{ff0c}' | '\u{ff0e}' | '\u{ff10}'..='\u{ff19}' => {
                keyed.extend(char::from_u32(u32::from(c) - 0xfee0));
            }
            c => keyed.push(c),
        }
    }
    keyed
}

/// Splits a number from the text after it. Blanks and apostrophes may stand between thousands, and inches and feet have fractions.
///
/// # Errors
/// The text does not begin with a number, or its comma may separate thousands.
pub fn number(text: &str) -> Result<(f64, &str), String> {
    let text = text.trim();
    let bytes = text.as_bytes();
    let is_digit = |place: usize| bytes.get(place).is_some_and(u8::is_ascii_digit);
    let begin = usize::from(text.starts_with(['+', '-']));
    let mut digits = text[..begin].to_owned();
    let (mut end, mut run) = (begin, begin);
    while let Some(&byte) = bytes.get(end) {
        let is_whole = run < end && !digits.contains(['.', ',', 'e', 'E']);
        match byte {
            b'0'..=b'9' | b'.' => {}
            b',' if is_digit(end + 1) => {}
            b'e' | b'E'
                if end > begin
                    && (is_digit(end + 1)
                        || matches!(bytes.get(end + 1), Some(b'+' | b'-')) && is_digit(end + 2)) => {}
            b'+' | b'-' if digits.ends_with(['e', 'E']) => {}
            // Thousands: three digits, and no fourth.
            b' ' | b'\''
                if is_whole
                    && (end - run == 3 || run == begin && end - run < 3)
                    && (1..4).all(|next| is_digit(end + next))
                    && !is_digit(end + 4) =>
            {
                run = end + 1;
                end += 1;
                continue;
            }
            _ => break,
        }
        digits.push(char::from(byte));
        end += 1;
    }
    // A range: 20..200.
    if let Some(at) = digits.find("..") {
        end = text.find("..").unwrap_or(end);
        digits.truncate(at);
    }
    let value = match digits.contains(',') {
        true => written::decimal(&digits)?,
        false => digits
            .parse()
            .map_err(|_| format!("{text:?} does not begin with a number"))?,
    };
    let is_whole = digits.bytes().all(|byte| byte.is_ascii_digit());
    let rest = text[end..].trim_start();
    let (value, rest) = match fraction(&text[end..]) {
        Some((part, rest)) if is_whole => (value + part, rest),
        _ => match fraction(text).filter(|_| is_whole && rest.starts_with('/')) {
            Some(alone) => alone,
            None => (value, rest),
        },
    };
    match value.is_finite() {
        true => Ok((value, rest.trim())),
        false => Err(format!("{digits} is too large")),
    }
}

/// Splits a fraction of an inch or foot from the text after it: ` 1/2 in`, `-3/16"`.
fn fraction(text: &str) -> Option<(f64, &str)> {
    let text = text.trim_start_matches([' ', '-']);
    let (over, rest) = text.split_once('/')?;
    let end = rest.find(|c: char| !c.is_ascii_digit())?;
    let (under, rest) = rest.split_at(end);
    let (over, under): (u8, u8) = (over.parse().ok()?, under.parse().ok()?);
    let rest = rest.trim_start();
    let is_imperial = ["in", "\"", "''", "ft", "foot", "feet", "'"]
        .iter()
        .any(|unit| rest.starts_with(unit));
    let is_usual = matches!(under, 2 | 4 | 8 | 16 | 32 | 64) && over < under;
    (is_imperial && is_usual).then(|| (f64::from(over) / f64::from(under), rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str, units: &Units) -> Result<f64, String> {
        let keyed = keyed(text);
        let (value, unit) = number(&keyed)?;
        units.si(value, unit)
    }

    #[test]
    fn what_people_type_is_understood() {
        for (text, units, si) in [
            ("9.5 metres", &LENGTH, 9.5),
            ("9,5 m\u{e8}tres", &LENGTH, 9.5),
            ("9\u{a0}500\u{202f}mm", &LENGTH, 9.5),
            ("9'500 mm", &LENGTH, 9.5),
            ("\u{ff19}.\u{ff15} m", &LENGTH, 9.5),
            ("31 \u{2032}", &LENGTH, 9.4488),
            ("1 1/2 in", &LENGTH, 0.0381),
            ("1-1/2\u{201d}", &LENGTH, 0.0381),
            ("3/4 in", &LENGTH, 0.01905),
            ("12 Zoll", &LENGTH, 0.3048),
            ("40 \u{b5}m", &LENGTH, 40e-6),
            ("12.5e-3 m.", &LENGTH, 0.0125),
            ("1 234 567 N", &FORCE, 1_234_567.0),
            ("150 kilonewtons", &FORCE, 150e3),
            ("2 kips", &FORCE, 8_896.443_23),
            ("7.5 t/m3", &DENSITY, 7500.0),
            ("7,5 t/m\u{b3}", &DENSITY, 7500.0),
            ("7850 kg / m^3", &DENSITY, 7850.0),
            ("210 kN/mm\u{b2}", &MODULUS, 210e9),
            ("12 kN\u{b7}m/rad", &STIFFNESS, 12e3),
            ("20 kilograms", &MASS, 20.0),
            ("1,2 kHz", &RATE, 1200.0),
        ] {
            let found = read(text, units).unwrap_or_else(|why| panic!("{text}: {why}"));
            assert!((found / si - 1.0).abs() < 1e-12, "{text}: {found}");
        }
    }

    #[test]
    fn parts_of_a_unit_are_exact() {
        for (text, metres) in [
            ("0.9 mm", 0.0009),
            ("71.5 mm", 0.0715),
            ("4.7 cm", 0.047),
            ("3 um", 3e-6),
        ] {
            assert_eq!(read(text, &LENGTH), Ok(metres), "{text}");
        }
    }

    #[test]
    fn what_is_not_known_is_refused_with_what_is() {
        for (text, units, reason) in [
            (
                "9.5 km",
                &LENGTH,
                "no unit of length known here: mm, cm, m, in, ft",
            ),
            ("40 mm2", &LENGTH, "\"mm2\" is no unit"),
            ("40/60 mm", &LENGTH, "\"/60 mm\" is no unit"),
            ("1 1/3 in", &LENGTH, "\"1/3 in\" is no unit"),
            ("9 50 m", &LENGTH, "\"50 m\" is no unit"),
            (
                "1500 000 N",
                &FORCE,
                "\"000 N\" is no unit of force known here: N, kN, MN",
            ),
            ("150 mN", &FORCE, "MN is a million"),
            ("210 mPa", &MODULUS, "MPa is a million"),
            ("1,250 m", &LENGTH, "1250 or 1.250"),
            ("nine", &LENGTH, "does not begin with a number"),
            ("", &LENGTH, "does not begin with a number"),
            ("1e999 m", &LENGTH, "too large"),
            ("1e400 m", &LENGTH, "too large"),
        ] {
            let said = read(text, units).unwrap_err();
            assert!(said.contains(reason), "{text}: {said}");
        }
    }

    #[test]
    fn words_are_written_as_they_are_compared() {
        for units in [
            &LENGTH,
            &FORCE,
            &MASS,
            &DENSITY,
            &MODULUS,
            &MASS_PER_LENGTH,
            &RIGIDITY,
            &STIFFNESS,
            &RATE,
        ] {
            let mut words: Vec<&str> = units
                .units
                .iter()
                .flat_map(|(_, words)| words.iter().copied())
                .collect();
            let count = words.len();
            assert!(words.iter().all(|word| units.of(word).is_ok()), "{units:?}");
            words.sort_unstable();
            words.dedup();
            assert_eq!(words.len(), count, "{units:?}");
        }
    }
}
