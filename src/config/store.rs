//! `[store]`: where results are kept.

use super::range::toml_string;
use super::reader::{Absent, Table, key};
use std::path::PathBuf;

/// The database file, if one is named.
pub(super) fn read(table: &mut Table<'_>) -> Option<PathBuf> {
    table
        .take(
            key(
                "path",
                "the database file (SQLite); relative to the working folder",
            ),
            "1 to 255 bytes of text",
            Absent::Nothing("`replay` remembers nothing; `--store` names one"),
            |value| value.name_string().map(str::to_owned),
            |path| toml_string(path),
        )
        .map(PathBuf::from)
}
