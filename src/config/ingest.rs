//! `[ingest]`: where live data comes from.

use super::range::toml_string;
use super::reader::{Absent, Table, key};
use crate::ingest::IngestSettings;
use std::path::PathBuf;

/// The section; only the folder, until the sockets are there.
pub(super) fn read(table: &mut Table<'_>) -> IngestSettings {
    let folder = table
        .take(
            key(
                "folder",
                "folder that is watched for recordings; relative to the working folder",
            ),
            "1 to 255 bytes of text",
            Absent::Nothing("no folder is watched"),
            |value| value.name_string().map(str::to_owned),
            |path| toml_string(path),
        )
        .map(PathBuf::from);
    IngestSettings {
        folder,
        ..IngestSettings::default()
    }
}
