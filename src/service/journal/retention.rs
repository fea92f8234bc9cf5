//! Selects the parts of a journal to remove.

use super::Vouch;
use crate::config::settings::journal::JournalSettings;
use crate::recording::part;
use crate::recording::read::series::modified_ns;
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
    /// Time of the last write, by the machine's clock \[ns since 1970\].
    pub modified_ns: i64,
}

/// Parts that may be removed, the oldest first: those too old, and the oldest while all together are too
/// large. `parts` ascend; `ages_s` are those of the first of them whose results are kept \[s\]: never one
/// behind.
pub fn removable(parts: &[Kept], ages_s: &[f64], settings: &JournalSettings) -> Vec<u32> {
    let mut bytes: u64 = parts.iter().map(|kept| kept.bytes).sum();
    let mut removable = Vec::new();
    for (kept, age_s) in parts.iter().zip(ages_s) {
        let is_old = settings.keep_s.is_some_and(|keep_s| *age_s > keep_s);
        let is_too_much = settings.keep_bytes.is_some_and(|keep_bytes| bytes > keep_bytes);
        // The oldest go first, so that the rest has no hole.
        if !is_old && !is_too_much {
            break;
        }
        bytes -= kept.bytes;
        removable.push(kept.part);
    }
    removable
}

/// Removes parts up to `done`, whose results are reported stored; returns the number removed. Only parts
/// confirmed by `vouch` go, by the ages that it gives, because the machine's clock may be wrong.
pub(super) fn apply(
    folder: &Path,
    done: u32,
    settings: &JournalSettings,
    vouch: &Vouch,
) -> std::io::Result<usize> {
    if settings.keep_s.is_none() && settings.keep_bytes.is_none() {
        return Ok(0);
    }
    let now = SystemTime::now();
    let (mut parts, mut ages_s) = (Vec::new(), Vec::new());
    for number in part::list(folder)? {
        let data = fs::metadata(part::path(folder, number))?;
        let modified = data.modified()?;
        parts.push(Kept {
            part: number,
            bytes: data.len(),
            modified_ns: modified_ns(modified),
        });
        if number <= done {
            // A clock that was set back makes a part young, not old.
            ages_s.push(now.duration_since(modified).unwrap_or_default().as_secs_f64());
        }
    }
    // The store is asked only if its answer matters.
    if removable(&parts, &ages_s, settings).is_empty() {
        return Ok(0);
    }
    let mut vouched = vouch(parts.get(..ages_s.len()).unwrap_or_default());
    vouched.truncate(ages_s.len());
    let removable = removable(&parts, &vouched, settings);
    for number in &removable {
        fs::remove_file(part::path(folder, *number))?;
    }
    Ok(removable.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::signal::record::time::DAY_S;

    /// Removable parts of those with these ages, if the results of so many are stored.
    fn gone(ages_d: &[f64], done: usize, settings: &JournalSettings) -> Vec<u32> {
        let kept = |part| Kept {
            part,
            bytes: 100,
            modified_ns: 0,
        };
        let parts: Vec<Kept> = (1..).take(ages_d.len()).map(kept).collect();
        let ages_s: Vec<f64> = ages_d.iter().take(done).map(|age_d| age_d * DAY_S).collect();
        removable(&parts, &ages_s, settings)
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
        let ages = [40.0, 35.0, 20.0, 1.0];
        assert_eq!(gone(&ages, 4, &settings(Some(30.0), None)), [1, 2]);
        assert_eq!(gone(&ages, 1, &settings(Some(30.0), None)), [1]);
        assert!(gone(&ages, 0, &settings(Some(30.0), Some(0))).is_empty());
        assert!(gone(&ages, 4, &settings(None, None)).is_empty());
    }

    #[test]
    fn too_much_goes_from_the_oldest_on_and_leaves_no_hole() {
        let mixed = [5.0, 4.0, 3.0, 2.0];
        assert_eq!(gone(&mixed, 4, &settings(None, Some(250))), [1, 2]);
        assert_eq!(gone(&mixed, 4, &settings(None, Some(0))), [1, 2, 3, 4]);
        // A part whose time is wrong keeps those behind it.
        let odd = [1.0, 40.0, 40.0];
        assert!(gone(&odd, 3, &settings(Some(30.0), None)).is_empty());
    }
}
