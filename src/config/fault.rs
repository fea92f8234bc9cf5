//! Faults of a configuration: one sentence per fault, with its key, line and column.

use std::cell::{Cell, RefCell};
use std::fmt;
use std::path::PathBuf;
use thiserror::Error;

/// One fault of a configuration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// The full path of the key (`rod[0].priors.density_kg_m3.cv`); empty for a fault of the text itself.
    pub key: String,
    /// Line in the text, from 1; 0 for a setting of the command line.
    pub line: usize,
    /// Column in the line, in characters, from 1; 0 for a setting of the command line.
    pub column: usize,
    /// Fault, with the values allowed.
    pub message: String,
}

/// `14:34: rod[0].priors.density_kg_m3.cv: 3.0 is out of range, allowed: 0 < cv <= 1`
impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.line > 0 {
            write!(f, "{}:{}: ", self.line, self.column)?;
        }
        if !self.key.is_empty() {
            write!(f, "{}: ", self.key)?;
        }
        f.write_str(&self.message)
    }
}

/// Reason why there is no configuration.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{}: {reason}", path.display())]
    Unreadable {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        reason: String,
    },
    /// The text has faults: all of them, in the order of the text.
    #[error("{}", listed(origin, faults))]
    Faults {
        /// Name of the file or text.
        origin: String,
        /// The faults, at least one.
        faults: Vec<Fault>,
    },
}

fn listed(origin: &str, faults: &[Fault]) -> String {
    let shown = |fault: &Fault| {
        if fault.line > 0 {
            format!("{origin}:{fault}")
        } else {
            format!("command line: {fault}")
        }
    };
    faults.iter().map(shown).collect::<Vec<_>>().join("\n")
}

/// Most faults listed; further ones are only counted.
const MOST: usize = 500;

/// Faults found so far in one text.
pub(super) struct Faults<'t> {
    pub(super) text: &'t str,
    /// End of the file's text, where the settings of the command line begin \[bytes\].
    end: usize,
    line_starts: Vec<usize>,
    list: RefCell<Vec<Found>>,
    count: Cell<usize>,
}

struct Found {
    at: usize,
    is_absence: bool,
    fault: Fault,
}

impl<'t> Faults<'t> {
    pub(super) fn new(text: &'t str, end: usize) -> Self {
        let line_starts = std::iter::once(0)
            .chain(text.match_indices('\n').map(|(i, _)| i + 1))
            .collect();
        Self {
            text,
            end,
            line_starts,
            list: RefCell::default(),
            count: Cell::new(0),
        }
    }

    /// Adds a fault of `key` at byte `at` of the text.
    pub(super) fn add(&self, key: impl Into<String>, at: usize, message: impl Into<String>) {
        self.push(key.into(), at, message.into(), false);
    }

    /// Adds the absence of `key` from the table at byte `at`.
    pub(super) fn add_absence(&self, key: impl Into<String>, at: usize, message: impl Into<String>) {
        self.push(key.into(), at, message.into(), true);
    }

    fn push(&self, key: String, at: usize, message: String, is_absence: bool) {
        self.count.set(self.count.get() + 1);
        if self.count.get() <= MOST {
            let (line, column) = self.position(at);
            let fault = Fault {
                key,
                line,
                column,
                message,
            };
            self.list.borrow_mut().push(Found {
                at,
                is_absence,
                fault,
            });
        }
    }

    /// Drops faults that only follow from a broken text: missing keys, and faults in lines with a fault
    /// of the text itself.
    pub(super) fn distrust_after_broken_text(&self) {
        let mut list = self.list.borrow_mut();
        let line = |found: &Found| self.line_starts.partition_point(|start| *start <= found.at);
        let broken: Vec<usize> = list
            .iter()
            .filter(|found| found.fault.key.is_empty())
            .map(line)
            .collect();
        list.retain(|found| {
            found.fault.key.is_empty() || !(found.is_absence || broken.contains(&line(found)))
        });
    }

    /// Number of faults so far.
    pub(super) fn count(&self) -> usize {
        self.count.get()
    }

    /// Line of byte `at`, from 1.
    pub(super) fn line(&self, at: usize) -> usize {
        self.position(at).0
    }

    /// All faults in the order of the text; the last one gives the number of faults not listed.
    pub(super) fn into_sorted(self) -> Vec<Fault> {
        let more = self.count.get().saturating_sub(MOST);
        let mut list = self.list.into_inner();
        list.sort_by_key(|found| found.at);
        let mut faults: Vec<Fault> = list.into_iter().map(|found| found.fault).collect();
        if let (Some(last), true) = (faults.last(), more > 0) {
            let message = format!("and {more} more faults");
            faults.push(Fault {
                key: String::new(),
                message,
                line: last.line,
                column: last.column,
            });
        }
        faults
    }

    /// Line and column, both from 1, of byte `at`; a position inside a character counts as the character.
    fn position(&self, at: usize) -> (usize, usize) {
        if at > self.end {
            return (0, 0);
        }
        let mut at = at.min(self.text.len());
        while !self.text.is_char_boundary(at) {
            at -= 1;
        }
        let line = self.line_starts.partition_point(|start| *start <= at);
        let start = self.line_starts[line - 1];
        (line, self.text[start..at].chars().count() + 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn faults(text: &str) -> Faults<'_> {
        Faults::new(text, text.len())
    }

    #[test]
    fn positions_count_from_one_in_characters() {
        assert_eq!(faults("").position(0), (1, 1));
        assert_eq!(faults("a\nbc").position(3), (2, 2));
        assert_eq!(faults("é = x").position(5), (1, 5));
        assert_eq!(faults("é").position(1), (1, 1), "inside a character");
        assert_eq!(faults("a").position(1), (1, 2));
        assert_eq!(
            faults("a").position(99),
            (0, 0),
            "behind the text: the command line"
        );
    }
}
