//! Folder, part size and retention of the journal.

use crate::analysis::signal::record::time::DAY_S;
use std::path::PathBuf;

/// Folder, part size and retention of the journal.
#[derive(Debug, Clone, PartialEq)]
pub struct JournalSettings {
    /// Folder; by default `journal` next to the store.
    pub folder: Option<PathBuf>,
    /// Size at which a part is closed \[bytes\].
    pub part_bytes: u64,
    /// Age at which a part is closed \[s\].
    pub part_s: f64,
    /// Age at which parts whose results are in the store are removed \[s\]; `None` keeps them.
    pub keep_s: Option<f64>,
    /// Total size beyond which the oldest parts whose results are in the store are removed \[bytes\]; `None`
    /// keeps them.
    pub keep_bytes: Option<u64>,
    /// File that every backup of the journal renews: parts written after its time of change stay.
    pub backup_stamp: Option<PathBuf>,
}

impl Default for JournalSettings {
    fn default() -> Self {
        Self {
            folder: None,
            part_bytes: 64 << 20,
            part_s: 3600.0,
            keep_s: Some(30.0 * DAY_S),
            keep_bytes: Some(20_000_000_000),
            backup_stamp: None,
        }
    }
}
