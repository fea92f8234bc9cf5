//! `[http]`: the daemon's HTTP server.

use super::reader::Table;
use crate::http::HttpSettings;

/// The section.
pub(super) fn read(_table: &mut Table<'_>) -> HttpSettings {
    HttpSettings::default()
}
