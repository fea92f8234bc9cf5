//! Selects the parts of a journal to remove.

use crate::config::settings::journal::JournalSettings;
use crate::recording::part;
use std::fs;
use std::path::Path;
use std::time::SystemTime;

/// A part on disk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Kept {
    /// Number of the part.
    pub part: u32,
    /// Size \[bytes\].
    pub bytes: u64,
    /// Time since the last write \[s\].
    pub age_s: f64,
}

/// Parts to remove, the oldest first: those too old, and the oldest while all together are too large. Never
/// one after `done`, whose results are not all in the store. `parts` ascend.
pub fn removable(parts: &[Kept], done: u32, settings: &JournalSettings) -> Vec<u32> {
    let mut bytes: u64 = parts.iter().map(|kept| kept.bytes).sum();
    let mut removable = Vec::new();
    for kept in parts.iter().take_while(|kept| kept.part <= done) {
        let is_old = settings.keep_s.is_some_and(|keep_s| kept.age_s > keep_s);
        let is_too_much = settings.keep_bytes.is_some_and(|keep_bytes| bytes > keep_bytes);
        // The oldest go first: what stays has no hole.
        if !is_old && !is_too_much {
            break;
        }
        bytes -= kept.bytes;
        removable.push(kept.part);
    }
    removable
}

/// Removes the parts to remove; returns their number.
pub(super) fn apply(folder: &Path, done: u32, settings: &JournalSettings) -> std::io::Result<usize> {
    if settings.keep_s.is_none() && settings.keep_bytes.is_none() {
        return Ok(0);
    }
    let now = SystemTime::now();
    let mut parts = Vec::new();
    for number in part::list(folder)? {
        let data = fs::metadata(part::path(folder, number))?;
        // A clock that was set back makes a part young, not old.
        let age = now.duration_since(data.modified()?).unwrap_or_default();
        parts.push(Kept {
            part: number,
            bytes: data.len(),
            age_s: age.as_secs_f64(),
        });
    }
    let removable = removable(&parts, done, settings);
    for number in &removable {
        fs::remove_file(part::path(folder, *number))?;
    }
    Ok(removable.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::signal::record::time::DAY_S;

    fn parts(ages_d: &[f64]) -> Vec<Kept> {
        let kept = |(at, age_d): (usize, &f64)| Kept {
            part: at as u32 + 1,
            bytes: 100,
            age_s: age_d * DAY_S,
        };
        ages_d.iter().enumerate().map(kept).collect()
    }

    fn settings(keep_d: Option<f64>, keep_bytes: Option<u64>) -> JournalSettings {
        JournalSettings {
            keep_s: keep_d.map(|days| days * DAY_S),
            keep_bytes,
            ..JournalSettings::default()
        }
    }

    #[test]
    fn old_parts_go_once_their_results_are_kept() {
        let parts = parts(&[40.0, 35.0, 20.0, 1.0]);
        assert_eq!(removable(&parts, 4, &settings(Some(30.0), None)), [1, 2]);
        assert_eq!(removable(&parts, 1, &settings(Some(30.0), None)), [1]);
        assert!(removable(&parts, 0, &settings(Some(30.0), Some(0))).is_empty());
        assert!(removable(&parts, 4, &settings(None, None)).is_empty());
    }

    #[test]
    fn too_much_goes_from_the_oldest_on_and_leaves_no_hole() {
        let mixed = parts(&[5.0, 4.0, 3.0, 2.0]);
        assert_eq!(removable(&mixed, 4, &settings(None, Some(250))), [1, 2]);
        assert_eq!(removable(&mixed, 4, &settings(None, Some(0))), [1, 2, 3, 4]);
        // A part whose time is wrong keeps those behind it.
        let odd = parts(&[1.0, 40.0, 40.0]);
        assert!(removable(&odd, 3, &settings(Some(30.0), None)).is_empty());
    }
}
