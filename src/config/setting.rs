//! Settings of the command line, which override those of the file: `abc.draws=1000000`.

use std::fmt;
use std::str::FromStr;
use toml::de::{DeTable, DeValue};

/// One key of a section with its value, as TOML; a bare word counts as a string.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Setting {
    key: String,
    value: String,
}

impl Setting {
    /// A setting; `key` is the full path of a key outside `[[rod]]` (`abc.draws`), `value` is TOML.
    pub fn new(key: &str, value: impl fmt::Display) -> Self {
        let value = value.to_string();
        let is_word = value.starts_with(|c: char| c.is_ascii_alphabetic())
            && value
                .chars()
                .all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_')
            && !["true", "false", "nan", "inf"].contains(&value.as_str());
        Self {
            key: key.trim().to_owned(),
            value: if is_word { format!("\"{value}\"") } else { value },
        }
    }
}

/// Parses `KEY=VALUE`.
impl FromStr for Setting {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (key, value) = text
            .split_once('=')
            .ok_or("write it as KEY=VALUE, like abc.draws=1000000")?;
        let is_key = !key.trim().is_empty()
            && key
                .trim()
                .chars()
                .all(|c| c.is_ascii_alphanumeric() || "._-".contains(c));
        if !is_key || value.trim().is_empty() || value.contains(['\n', '\r']) {
            return Err("write it as KEY=VALUE, like abc.draws=1000000".to_owned());
        }
        Ok(Self::new(key, value.trim()))
    }
}

impl Setting {
    /// Number of nested tables that the key goes through.
    pub(super) fn levels(&self) -> usize {
        self.key.matches('.').count()
    }
}

/// Printed as a line of TOML.
impl fmt::Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} = {}", self.key, self.value)
    }
}

/// Overrides `entries` with `over`, one setting whose key names `levels` nested tables: these are
/// merged, the value itself is replaced.
pub(super) fn merge<'t>(entries: &mut DeTable<'t>, over: DeTable<'t>, levels: usize) {
    for (key, value) in over {
        let name: &str = key.get_ref();
        match (entries.get_mut(name).map(toml::Spanned::get_mut), value.get_ref()) {
            (Some(DeValue::Table(below)), DeValue::Table(_)) if levels > 0 => {
                if let DeValue::Table(above) = value.into_inner() {
                    merge(below, above, levels - 1);
                }
            }
            _ => {
                entries.insert(key, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_strings_and_the_rest_is_toml() {
        let line = |text: &str| text.parse::<Setting>().map(|setting| setting.to_string());
        assert_eq!(line("abc.draws=10"), Ok("abc.draws = 10".to_owned()));
        assert_eq!(
            line("record.cut = free-decay"),
            Ok("record.cut = \"free-decay\"".to_owned())
        );
        assert_eq!(
            line("abc.accept={ quantile = 0.05 }"),
            Ok("abc.accept = { quantile = 0.05 }".to_owned())
        );
        assert!(
            line("abc.draws").is_err()
                && line("=1").is_err()
                && line("a=").is_err()
                && line("[a]\nb=1").is_err()
        );
    }
}
