//! Lists, and paths of files with secrets.

use super::range::toml_string;
use super::reader::{Absent, Key, Table};
use super::value::Value;
use crate::config::settings::credential::CredentialPath;

/// Most entries of a list.
const MOST: usize = 100;

/// Reads the path of a file with a secret.
pub(super) fn file(table: &mut Table<'_>, key: Key, without: &'static str) -> Option<CredentialPath> {
    table.take(
        key,
        "1 to 255 bytes of text",
        Absent::Nothing(without),
        |value| value.name_string().map(CredentialPath::new),
        |path| toml_string(path.as_str()),
    )
}

/// Reads the elements of a list, each by `read`.
pub(super) fn list<T>(value: &Value<'_>, read: impl Fn(&Value<'_>) -> Option<T>) -> Option<Vec<T>> {
    let elements = value.array()?;
    if elements.len() > MOST {
        value.fault(format!(
            "has {} entries, at most {MOST} are allowed",
            elements.len()
        ));
        return None;
    }
    let read: Vec<Option<T>> = elements.iter().map(read).collect();
    read.into_iter().collect()
}

/// A list of texts as TOML.
pub(super) fn strings(list: impl Iterator<Item = String>) -> String {
    let quoted: Vec<String> = list.map(|text| toml_string(&text)).collect();
    format!("[{}]", quoted.join(", "))
}
