//! The keys most sections are made of: numbers, whole numbers, words.

use super::range::{Range, toml_float};
use super::reader::{Absent, Key, Table};
use super::value::quoted;

impl Table<'_> {
    /// Takes a number with a default.
    pub(super) fn number(&mut self, key: Key, range: Range, default: f64) -> f64 {
        self.maybe_number(key, range, Absent::Default(default))
            .unwrap_or(default)
    }

    /// Takes a number that may be absent, or must not, by `absent`.
    pub(super) fn maybe_number(&mut self, key: Key, range: Range, absent: Absent<f64>) -> Option<f64> {
        self.take(
            key,
            range.of(key.name),
            absent,
            |value| value.number(range),
            |number| toml_float(*number),
        )
    }

    /// Takes a number that may be absent; `without` describes the behaviour then.
    pub(super) fn optional_number(&mut self, key: Key, range: Range, without: &'static str) -> Option<f64> {
        self.maybe_number(key, range, Absent::Nothing(without))
    }

    /// Takes a whole number from `low` to `high` with a default.
    pub(super) fn integer(&mut self, key: Key, low: u64, high: u64, default: u64) -> u64 {
        self.take(
            key,
            format!("{low} <= {} <= {high}", key.name),
            Absent::Default(default),
            |value| value.integer(low, high),
            u64::to_string,
        )
        .unwrap_or(default)
    }

    /// Takes one of a few words with a default.
    pub(super) fn choice<T: Copy + PartialEq>(
        &mut self,
        key: Key,
        choices: &[(&'static str, T)],
        default: T,
    ) -> T {
        let words: Vec<&str> = choices.iter().map(|(word, _)| *word).collect();
        let show = |chosen: &T| {
            let word = choices
                .iter()
                .find(|(_, value)| value == chosen)
                .map_or("", |(word, _)| *word);
            format!("\"{word}\"")
        };
        self.take(
            key,
            quoted(&words),
            Absent::Default(default),
            |value| value.choice(choices),
            show,
        )
        .unwrap_or(default)
    }
}
