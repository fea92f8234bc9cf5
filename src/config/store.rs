//! `[store]`: path and retention of results.

use super::range::{Range, toml_string};
use super::reader::{Absent, Table, key};
use crate::analysis::signal::record::time::DAY_S;
use crate::config::settings::store::StoreSettings;
use std::path::PathBuf;

/// Reads the section.
pub(super) fn read(table: &mut Table<'_>) -> StoreSettings {
    let path = table
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
        .map(PathBuf::from);
    let keep_lines_s = table
        .optional_number(
            key(
                "keep_lines_d",
                "`run` removes records' JSON lines (`history --format json`) this long before their rod's latest record; tables \
                 and charts stay [d]",
            ),
            Range::within(1.0, 100_000.0),
            "all are kept",
        )
        .map(|days| days * DAY_S);
    StoreSettings { path, keep_lines_s }
}
