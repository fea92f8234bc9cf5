//! `[ingest]`: where live data comes from.

use super::reader::Table;
use crate::ingest::IngestSettings;

/// The section.
pub(super) fn read(_table: &mut Table<'_>) -> IngestSettings {
    IngestSettings::default()
}
