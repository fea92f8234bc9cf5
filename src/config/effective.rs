//! The effective configuration: every key with its value in effect, as commented TOML.

use std::collections::BTreeMap;
use std::fmt::Write;

/// One table of the effective configuration.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Node {
    header: String,
    meaning: &'static str,
    is_element: bool,
    pub(super) lines: Vec<Line>,
    pub(super) children: Vec<Node>,
}

/// One key of the effective configuration.
#[derive(Debug, Clone)]
pub(super) struct Line {
    pub(super) key: &'static str,
    /// Value as TOML; `None` if there is none.
    pub(super) value: Option<String>,
    /// True if the key has an effect here.
    pub(super) shown: bool,
    /// True if the text gives the key.
    pub(super) given: bool,
    pub(super) default: String,
    pub(super) allowed: String,
    pub(super) meaning: &'static str,
    pub(super) condition: Option<&'static str>,
}

/// Equal if the values in effect are equal, given or by default.
impl PartialEq for Line {
    fn eq(&self, other: &Self) -> bool {
        self.key == other.key && self.value == other.value
    }
}

/// One key as listed in the documentation.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KeyReference {
    /// Section: `rod.channel`; `[[` … `]]` for those that may occur several times.
    pub section: String,
    /// Name of the key.
    pub key: &'static str,
    /// Default, `required`, or the behaviour without it.
    pub default: String,
    /// Allowed values.
    pub allowed: String,
    /// Meaning, with the unit.
    pub meaning: &'static str,
    /// Condition for an effect; `None`: always.
    pub condition: Option<&'static str>,
}

impl Node {
    pub(super) fn root() -> Self {
        Self::default()
    }

    pub(super) fn child(&self, name: &str, meaning: &'static str, is_element: bool) -> Self {
        let header = if self.header.is_empty() {
            name.to_owned()
        } else {
            format!("{}.{name}", self.header)
        };
        Self {
            header,
            meaning,
            is_element,
            lines: Vec::new(),
            children: Vec::new(),
        }
    }

    /// Full name of the section.
    pub(super) fn name(&self) -> &str {
        &self.header
    }

    /// Value of a key as TOML.
    pub(super) fn value_of(&self, key: &str) -> Option<&String> {
        self.lines.iter().find(|line| line.key == key)?.value.as_ref()
    }

    fn bracketed(&self) -> String {
        if self.is_element {
            format!("[[{}]]", self.header)
        } else {
            format!("[{}]", self.header)
        }
    }

    /// Adds every key that has an effect, by its full name, with its value to `settings`.
    pub(super) fn collect(&self, settings: &mut BTreeMap<String, String>) {
        for line in self.lines.iter().filter(|line| line.shown) {
            if let Some(value) = &line.value {
                settings.insert(format!("{}.{}", self.header, line.key), value.clone());
            }
        }
        for child in &self.children {
            child.collect(settings);
        }
    }

    /// Prints TOML: with the meaning of each key if `commented`, else the bare keys.
    pub(super) fn print(&self, commented: bool, out: &mut String) {
        if !self.header.is_empty() {
            if !out.is_empty() {
                out.push('\n');
            }
            if commented {
                let _ = writeln!(out, "# {}", self.meaning);
            }
            let _ = writeln!(out, "{}", self.bracketed());
        }
        for line in self.lines.iter().filter(|line| line.shown) {
            match (&line.value, commented) {
                (Some(value), true) => {
                    let default = if line.given { "" } else { " (default)" };
                    let _ = writeln!(out, "{} = {value}  # {}{default}", line.key, line.meaning);
                }
                (Some(value), false) => {
                    let _ = writeln!(out, "{} = {value}", line.key);
                }
                (None, true) => {
                    let _ = writeln!(
                        out,
                        "# {} is not set: {}  # {}",
                        line.key, line.default, line.meaning
                    );
                }
                (None, false) => {}
            }
        }
        for child in &self.children {
            child.print(commented, out);
        }
    }

    /// Every key asked for, once per section.
    pub(super) fn reference(&self, out: &mut Vec<KeyReference>) {
        for line in &self.lines {
            if out
                .iter()
                .any(|known| known.section == self.bracketed() && known.key == line.key)
            {
                continue;
            }
            out.push(KeyReference {
                section: self.bracketed(),
                key: line.key,
                default: line.default.clone(),
                allowed: line.allowed.clone(),
                meaning: line.meaning,
                condition: line.condition,
            });
        }
        for child in &self.children {
            child.reference(out);
        }
    }
}
