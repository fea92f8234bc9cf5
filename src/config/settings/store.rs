//! Path of the store, and retention of its records.

use std::path::PathBuf;

/// Path of the store, and retention of its records.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct StoreSettings {
    /// Path of the database file, if configured.
    pub path: Option<PathBuf>,
    /// Age, before their rod's latest record, at which a daemon removes the JSON of records \[s\]; `None`
    /// keeps it.
    pub keep_lines_s: Option<f64>,
}
