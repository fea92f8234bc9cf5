//! A folder that holds everything of a daemon, in place of what its configuration says: that of a site without a computer.

use super::Config;
use std::path::{Path, PathBuf};

/// Least time after which a recording without an end counts as cut short: every file there is whole when it has its name \[s\].
const SETTLE_S: f64 = 1.0;

/// Store in the folder.
pub fn store(folder: &Path) -> PathBuf {
    folder.join("site.db")
}

/// Folder in it whose recordings are read.
pub fn recordings(folder: &Path) -> PathBuf {
    folder.join("in")
}

impl Config {
    /// The configuration for a daemon within a folder, without a page. Its text and hash stay those of the site's, wherever the folder
    /// is.
    #[must_use]
    pub fn within(mut self, folder: &Path) -> Self {
        self.store.path = Some(store(folder));
        self.journal.folder = Some(folder.join("journal"));
        self.ingest.folder = Some(recordings(folder));
        self.ingest.subfolders = false;
        self.ingest.settle_s = SETTLE_S;
        // A file is read before the next one comes.
        self.ingest.readings_s = 0.0;
        self.http.listen = None;
        self
    }
}
