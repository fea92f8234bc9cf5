//! "Did you mean …?" for an unknown key.

/// Number of characters of a name that are compared, because names may come from outside.
const LONGEST: usize = 80;

/// The tail of the sentence "unknown key": the nearest known key, or all of them.
pub(super) fn hint(unknown: &str, known: &[&str]) -> String {
    match nearest(unknown, known.iter().copied()) {
        Some((distance, candidate)) if distance <= 1 + candidate.len() / 4 => {
            format!(", did you mean {candidate}?")
        }
        Some(_) => format!(", known here: {}", known.join(", ")),
        None => ", no keys are known here".to_owned(),
    }
}

/// Candidate with the fewest edits, and their number.
pub fn nearest<'c>(unknown: &str, candidates: impl Iterator<Item = &'c str>) -> Option<(usize, &'c str)> {
    candidates
        .map(|candidate| (distance(unknown, candidate), candidate))
        .min_by_key(|(distance, _)| *distance)
}

/// Number of edits (insert, delete, replace) from `a` to `b` (Levenshtein), case ignored; a key
/// that only lacks its unit (`length` for `length_m`) counts as one edit.
fn distance(a: &str, b: &str) -> usize {
    let short = |text: &str| -> String { text.to_lowercase().chars().take(LONGEST).collect() };
    let (a, b) = (short(a), short(b));
    if a.len() >= 3
        && b.strip_prefix(a.as_str())
            .is_some_and(|rest| rest.starts_with('_'))
    {
        return 1;
    }
    strsim::levenshtein(&a, &b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_key_is_suggested() {
        let known = ["length_m", "section", "discrepancy"];
        assert_eq!(hint("lenght_m", &known), ", did you mean length_m?");
        assert_eq!(hint("length", &known), ", did you mean length_m?");
        assert_eq!(hint("Section", &known), ", did you mean section?");
        assert_eq!(
            hint("colour", &known),
            ", known here: length_m, section, discrepancy"
        );
    }

    #[test]
    fn distances_are_edits() {
        assert_eq!(distance("kitten", "sitting"), 3);
        assert_eq!(distance("", "abc"), 3);
        assert_eq!(distance("same", "same"), 0);
    }
}
