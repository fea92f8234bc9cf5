//! `[journal]`: live data on disk.

use super::reader::Table;
use crate::journal::JournalSettings;

/// The section.
pub(super) fn read(_table: &mut Table<'_>) -> JournalSettings {
    JournalSettings::default()
}
