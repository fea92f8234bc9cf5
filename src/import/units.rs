//! Units as other programs write them.

use crate::record::Unit;

/// The unit that a file or a person means; none if it is none of ours.
pub fn unit_of(text: &str) -> Option<Unit> {
    // Two characters look like a micro sign.
    let text: String = text
        .trim()
        .replace(['µ', 'μ'], "u")
        .replace('²', "2")
        .replace("^2", "2")
        .replace("**2", "2")
        .replace("°", "deg")
        .replace(' ', "");
    let every = Unit::MOTION.into_iter().chain(Unit::TEMPERATURE);
    if let Some(unit) = every.into_iter().find(|unit| unit.key() == text) {
        return Some(unit);
    }
    // Only what nobody uses for anything else: "c", "f" and "M" are left alone.
    match text.as_str() {
        "meter" | "metre" | "meters" | "metres" => Some(Unit::Metre),
        "millimeter" | "millimetre" | "MM" | "Mm" => Some(Unit::Millimetre),
        "micron" | "microns" | "micrometer" | "micrometre" => Some(Unit::Micrometre),
        "m/sec" | "ms-1" | "m.s-1" => Some(Unit::MetrePerSecond),
        "mm/sec" | "mms-1" | "mm.s-1" => Some(Unit::MillimetrePerSecond),
        "um/sec" => Some(Unit::MicrometrePerSecond),
        "m/sec2" | "m/s/s" | "ms-2" | "m.s-2" => Some(Unit::MetrePerSecondSquared),
        "gn" | "g0" => Some(Unit::StandardGravity),
        "C" | "Celsius" | "celsius" => Some(Unit::Celsius),
        "kelvin" | "Kelvin" => Some(Unit::Kelvin),
        "F" | "Fahrenheit" | "fahrenheit" => Some(Unit::Fahrenheit),
        _ => None,
    }
}

/// `disp [mm]` or `disp (mm)` as name and unit; a head without one is a name alone.
pub(super) fn split_head(head: &str) -> (String, Option<String>) {
    let head = head.trim();
    for (open, close) in [('[', ']'), ('(', ')')] {
        if let Some(inner) = head.strip_suffix(close)
            && let Some((name, unit)) = inner.rsplit_once(open)
        {
            return (name.trim().to_owned(), some(unit));
        }
    }
    (head.to_owned(), None)
}

/// A unit that is written at all.
pub(super) fn some(unit: &str) -> Option<String> {
    let unit = unit
        .trim()
        .trim_start_matches(['[', '('])
        .trim_end_matches([']', ')'])
        .trim();
    (!unit.is_empty() && !matches!(unit, "-" | "NONE" | "none")).then(|| unit.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spellings_are_known_and_strangers_are_not() {
        for (text, unit) in [
            ("mm", Unit::Millimetre),
            ("µm", Unit::Micrometre),
            ("μm/s", Unit::MicrometrePerSecond),
            ("m/s²", Unit::MetrePerSecondSquared),
            ("m/s^2", Unit::MetrePerSecondSquared),
            ("°C", Unit::Celsius),
            ("deg C", Unit::Celsius),
            (" g ", Unit::StandardGravity),
        ] {
            assert_eq!(unit_of(text), Some(unit), "{text}");
        }
        for text in ["", "V", "M", "s", "mV", "inch", "c"] {
            assert_eq!(unit_of(text), None, "{text}");
        }
        assert_eq!(split_head("Disp 1 [mm]"), ("Disp 1".into(), Some("mm".into())));
        assert_eq!(split_head("Air (°C)"), ("Air".into(), Some("°C".into())));
        assert_eq!(split_head("plain"), ("plain".into(), None));
        assert_eq!(split_head("no unit []"), ("no unit".into(), None));
    }
}
