//! Where results are kept, and for how long what.

use std::path::PathBuf;

/// Where results are kept, and for how long what.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct StoreSettings {
    /// The database file, if one is named.
    pub path: Option<PathBuf>,
    /// A daemon removes records' JSON lines this long before their rod's latest record \[s\]; `None` keeps them.
    pub keep_lines_s: Option<f64>,
}
