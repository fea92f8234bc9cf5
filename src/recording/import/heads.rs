//! Heads of columns of other programs: a name, perhaps with a unit.

use super::{TimeUnit, is_time_name};

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
    // `time_ms`, `Zeit / ms`: of a time alone, names of other channels are topics.
    let time = head.rsplit_once(['_', '/', ' ']).filter(|(name, unit)| {
        is_time_name(name.trim_end_matches([' ', '/', ','])) && TimeUnit::of(unit).is_some()
    });
    match time {
        Some((name, unit)) => (name.trim_end_matches([' ', '/', ',']).to_owned(), some(unit)),
        None => (head.to_owned(), None),
    }
}

/// A unit that is not blank; `None` otherwise.
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
    fn heads_are_split_into_name_and_unit() {
        assert_eq!(split_head("Disp 1 [mm]"), ("Disp 1".into(), Some("mm".into())));
        assert_eq!(split_head("Air (°C)"), ("Air".into(), Some("°C".into())));
        assert_eq!(split_head("plain"), ("plain".into(), None));
        assert_eq!(split_head("time_ms"), ("time".into(), Some("ms".into())));
        assert_eq!(split_head("Zeit / ms"), ("Zeit".into(), Some("ms".into())));
        assert_eq!(split_head("disp_mm"), ("disp_mm".into(), None));
        assert_eq!(split_head("date time"), ("date time".into(), None));
        assert_eq!(split_head("no unit []"), ("no unit".into(), None));
    }
}
