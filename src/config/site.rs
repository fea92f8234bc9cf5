//! `[site]`: name and seed.

use super::range::toml_string;
use super::reader::{Absent, Table, key};

/// Reads name and seed.
pub(super) fn read(table: &mut Table<'_>) -> (String, u64) {
    let name = table.take(
        key("name", "name of the site"),
        "1 to 255 bytes of text",
        Absent::Default("site".to_owned()),
        |value| value.name_string().map(str::to_owned),
        |name| toml_string(name),
    );
    let seed = table.integer(key("seed", "seed of everything random"), 0, i64::MAX as u64, 1);
    (name.unwrap_or_default(), seed)
}
