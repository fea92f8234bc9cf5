//! `[journal]`: live data on disk.

use super::range::{Range, toml_string};
use super::reader::{Absent, Table, key};
use crate::analysis::signal::record::time::DAY_S;
use crate::config::settings::journal::JournalSettings;
use std::path::PathBuf;

const MB: f64 = (1u64 << 20) as f64;
const GB: f64 = 1e9;

/// Reads the section.
pub(super) fn read(table: &mut Table<'_>) -> JournalSettings {
    let default = JournalSettings::default();
    let folder = table
        .take(
            key(
                "path",
                "the folder of the journal, which holds what came through the sockets; relative to the working folder",
            ),
            "1 to 255 bytes of text",
            Absent::Nothing("`journal` beside the store"),
            |value| value.name_string().map(str::to_owned),
            |path| toml_string(path),
        )
        .map(PathBuf::from);
    let part_mb = table.number(
        key(
            "part_mb",
            "a part is closed, and the next one begun, when it has this size [MiB]",
        ),
        Range::within(1.0, 4096.0),
        default.part_bytes as f64 / MB,
    );
    let part_h = table.number(
        key("part_h", "a part is closed when it is this old [h]"),
        Range::within(0.01, 168.0),
        default.part_s / 3600.0,
    );
    let keep_d = table.number(
        key(
            "keep_d",
            "parts whose results are in the store are removed when they are this old [d]; 0 keeps them",
        ),
        Range::within(0.0, 36_500.0),
        default.keep_s.unwrap_or(0.0) / DAY_S,
    );
    let keep_gb = table.number(
        key(
            "keep_gb",
            "the oldest parts whose results are in the store are removed while all together exceed this [GB]; 0 keeps them",
        ),
        Range::within(0.0, 1e6),
        default.keep_bytes.unwrap_or(0) as f64 / GB,
    );
    let backup_stamp = table
        .take(
            key(
                "backup_stamp",
                "a file that every backup of the journal renews when it begins: no part written later is removed",
            ),
            "1 to 255 bytes of text",
            Absent::Nothing("no backup is waited for"),
            |value| value.name_string().map(str::to_owned),
            |path| toml_string(path),
        )
        .map(PathBuf::from);
    JournalSettings {
        folder,
        part_bytes: (part_mb * MB) as u64,
        part_s: part_h * 3600.0,
        keep_s: Some(keep_d * DAY_S).filter(|keep_s| *keep_s > 0.0),
        keep_bytes: Some((keep_gb * GB) as u64).filter(|bytes| *bytes > 0),
        backup_stamp,
    }
}
