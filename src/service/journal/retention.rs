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

/// What became of parts that may go.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Applied {
    /// Number of parts removed.
    pub removed: usize,
    /// Number of parts that wait for a backup.
    pub waiting: usize,
}

/// Removes parts up to `done`, whose results are reported stored. Only parts confirmed by `vouch` go, by the
/// ages that it gives, because the machine's clock may be wrong; and none that was written after the last
/// backup, if backups are waited for, or that is not `copied` yet, where parts are.
pub(super) fn apply(
    folder: &Path,
    done: u32,
    settings: &JournalSettings,
    vouch: &Vouch,
    copied: Option<u32>,
) -> std::io::Result<Applied> {
    if settings.keep_s.is_none() && settings.keep_bytes.is_none() {
        return Ok(Applied::default());
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
        return Ok(Applied::default());
    }
    let mut vouched = vouch(parts.get(..ages_s.len()).unwrap_or_default());
    vouched.truncate(ages_s.len());
    let all = removable(&parts, &vouched, settings);
    let saved_ns = match &settings.backup_stamp {
        None => i64::MAX,
        // Without the file nothing was backed up yet; a time to come says nothing of what was.
        Some(stamp) => fs::metadata(stamp)
            .and_then(|data| data.modified())
            .ok()
            .filter(|modified| *modified <= now)
            .map_or(i64::MIN, modified_ns),
    };
    let is_saved = |number: &&u32| {
        let kept = parts.iter().find(|kept| kept.part == **number);
        kept.is_some_and(|kept| kept.modified_ns < saved_ns) && copied.is_none_or(|copied| **number <= copied)
    };
    let mut applied = Applied::default();
    for number in all.iter().take_while(is_saved) {
        fs::remove_file(part::path(folder, *number))?;
        applied.removed += 1;
    }
    applied.waiting = all.len() - applied.removed;
    Ok(applied)
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
    fn a_part_written_after_the_last_backup_stays() {
        let folder = tempfile::tempdir().unwrap();
        let stamp = folder.path().join("backed-up");
        let settings = JournalSettings {
            backup_stamp: Some(stamp.clone()),
            ..settings(Some(1.0), None)
        };
        let second = |s: u64| SystemTime::UNIX_EPOCH + std::time::Duration::from_secs(1_700_000_000 + s);
        let write = |path: &Path, s: u64| {
            let file = fs::File::create(path).unwrap();
            file.set_modified(second(s)).unwrap();
        };
        for number in 1..=4 {
            let path = part::path(folder.path(), number);
            write(&path, 10 * u64::from(number));
        }
        let vouch: Vouch = Box::new(|parts| vec![1e9; parts.len()]);
        let apply = || apply(folder.path(), 3, &settings, &vouch, None).unwrap();
        assert_eq!(
            apply(),
            Applied {
                removed: 0,
                waiting: 3
            }
        );
        write(&stamp, 25);
        assert_eq!(
            apply(),
            Applied {
                removed: 2,
                waiting: 1
            }
        );
        write(&stamp, 31);
        assert_eq!(
            apply(),
            Applied {
                removed: 1,
                waiting: 0
            }
        );
        assert_eq!(part::list(folder.path()).unwrap(), [4]);
    }

    #[test]
    fn a_part_that_object_storage_does_not_have_stays() {
        let folder = tempfile::tempdir().unwrap();
        for number in 1..=4 {
            fs::write(part::path(folder.path(), number), "").unwrap();
        }
        let vouch: Vouch = Box::new(|parts| vec![1e9; parts.len()]);
        let apply = |copied| apply(folder.path(), 3, &settings(Some(-1.0), None), &vouch, copied).unwrap();
        let of = |removed, waiting| Applied { removed, waiting };
        assert_eq!(apply(Some(0)), of(0, 3));
        assert_eq!(apply(Some(2)), of(2, 1));
        assert_eq!(apply(Some(9)), of(1, 0));
        // What the bucket has is no reason to remove what the journal's own rules keep.
        assert_eq!(part::list(folder.path()).unwrap(), [4]);
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
