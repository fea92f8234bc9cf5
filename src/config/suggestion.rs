//! "Did you mean …?" for an unknown key.

/// The tail of the sentence "unknown key": the nearest known key, or all of them.
pub(super) fn hint(unknown: &str, known: &[&str]) -> String {
    let nearest = known
        .iter()
        .map(|candidate| (distance(unknown, candidate), *candidate))
        .min_by_key(|(distance, _)| *distance);
    match nearest {
        Some((distance, candidate)) if distance <= 1 + candidate.len() / 4 => {
            format!(", did you mean {candidate}?")
        }
        Some(_) => format!(", known here: {}", known.join(", ")),
        None => ", no keys are known here".to_owned(),
    }
}

/// Number of edits (insert, delete, replace) from `a` to `b` (Levenshtein), case ignored; a key
/// that only lacks its unit (`length` for `length_m`) counts as one edit.
fn distance(a: &str, b: &str) -> usize {
    let (a, b) = (a.to_lowercase(), b.to_lowercase());
    if a.len() >= 3
        && b.strip_prefix(a.as_str())
            .is_some_and(|rest| rest.starts_with('_'))
    {
        return 1;
    }
    let b: Vec<char> = b.chars().take(80).collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().take(80).enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(x != *y);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
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
