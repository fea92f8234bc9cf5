//! Where the journal is and how long it is kept.

use crate::analysis::signal::record::time::DAY_S;
use std::path::PathBuf;

/// Where the journal is and how long it is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct JournalSettings {
    /// The folder; by default `journal` beside the store.
    pub folder: Option<PathBuf>,
    /// A part is closed when it has this many bytes.
    pub part_bytes: u64,
    /// A part is closed when it is this old \[s\].
    pub part_s: f64,
    /// Parts whose results are in the store are removed when they are this old \[s\]; `None` keeps them.
    pub keep_s: Option<f64>,
    /// The oldest parts whose results are in the store are removed beyond this many bytes; `None` keeps them.
    pub keep_bytes: Option<u64>,
}

impl Default for JournalSettings {
    fn default() -> Self {
        Self {
            folder: None,
            part_bytes: 64 << 20,
            part_s: 3600.0,
            keep_s: Some(30.0 * DAY_S),
            keep_bytes: Some(20_000_000_000),
        }
    }
}
