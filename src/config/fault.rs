//! What is wrong with a configuration: one sentence per fault, with its key, line and column.

use std::cell::RefCell;
use std::fmt;
use std::path::PathBuf;
use thiserror::Error;

/// One thing wrong with a configuration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// The full path of the key (`rod[0].priors.density_kg_m3.cv`); empty for a fault of the text itself.
    pub key: String,
    /// Line in the text, from 1.
    pub line: usize,
    /// Column in the line, in characters, from 1.
    pub column: usize,
    /// What is wrong and what is allowed.
    pub message: String,
}

/// `14:34: rod[0].priors.density_kg_m3.cv: 3.0 is out of range, allowed: 0 < cv <= 1`
impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}: ", self.line, self.column)?;
        if !self.key.is_empty() {
            write!(f, "{}: ", self.key)?;
        }
        f.write_str(&self.message)
    }
}

/// Why there is no configuration.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// The file cannot be read at all.
    #[error("{}: {reason}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        reason: String,
    },
    /// The text has faults: all of them, in the order of the text.
    #[error("{}", listed(origin, faults))]
    Faults {
        /// The file, or what the text is called.
        origin: String,
        /// The faults, at least one.
        faults: Vec<Fault>,
    },
}

fn listed(origin: &str, faults: &[Fault]) -> String {
    let lines: Vec<String> = faults.iter().map(|fault| format!("{origin}:{fault}")).collect();
    lines.join("\n")
}

/// Faults found so far in one text.
pub(super) struct Faults<'t> {
    pub(super) text: &'t str,
    list: RefCell<Vec<(usize, Fault)>>,
}

impl<'t> Faults<'t> {
    pub(super) fn new(text: &'t str) -> Self {
        Self {
            text,
            list: RefCell::default(),
        }
    }

    /// Adds a fault of `key` at byte `at` of the text.
    pub(super) fn add(&self, key: impl Into<String>, at: usize, message: impl Into<String>) {
        let (line, column) = position(self.text, at);
        let fault = Fault {
            key: key.into(),
            line,
            column,
            message: message.into(),
        };
        self.list.borrow_mut().push((at, fault));
    }

    /// How many so far.
    pub(super) fn count(&self) -> usize {
        self.list.borrow().len()
    }

    /// The line of byte `at`, from 1.
    pub(super) fn line(&self, at: usize) -> usize {
        position(self.text, at).0
    }

    /// All faults in the order of the text.
    pub(super) fn into_sorted(self) -> Vec<Fault> {
        let mut list = self.list.into_inner();
        list.sort_by_key(|(at, _)| *at);
        list.into_iter().map(|(_, fault)| fault).collect()
    }
}

/// Line and column, both from 1, of byte `at`; a position inside a character counts as the character.
fn position(text: &str, at: usize) -> (usize, usize) {
    let mut at = at.min(text.len());
    while !text.is_char_boundary(at) {
        at -= 1;
    }
    let before = &text[..at];
    let line_start = before.rfind('\n').map_or(0, |i| i + 1);
    (
        before.matches('\n').count() + 1,
        before[line_start..].chars().count() + 1,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_count_from_one_in_characters() {
        assert_eq!(position("", 0), (1, 1));
        assert_eq!(position("a\nbc", 3), (2, 2));
        assert_eq!(position("é = x", 5), (1, 5));
        assert_eq!(position("é", 1), (1, 1), "inside a character");
        assert_eq!(position("a", 99), (1, 2));
    }
}
