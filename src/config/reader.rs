//! A cursor over one TOML table: takes typed keys, collects every fault, records the values in
//! effect.
//!
//! A section's reader takes its keys one by one and always gets a value back, so that one fault never hides
//! the next; the configuration is built only if there was none. Each key is recorded when taken ([`Node`]),
//! which gives the effective configuration, the reference table of the documentation, and the unknown keys.

use super::effective::{Line, Node};
use super::fault::Faults;
use super::value::Value;
use std::fmt::Display;
use toml::de::DeTable;

/// Most elements of an array of tables without a bound of its own.
const MOST_ELEMENTS: usize = 1000;

/// A key: name, meaning, and condition for an effect.
#[derive(Clone, Copy)]
pub(super) struct Key {
    pub(super) name: &'static str,
    pub(super) meaning: &'static str,
    only: Option<(bool, &'static str)>,
}

/// A key that always has an effect; `meaning` ends with the unit in brackets.
pub(super) const fn key(name: &'static str, meaning: &'static str) -> Key {
    Key {
        name,
        meaning,
        only: None,
    }
}

impl Key {
    /// A key that has an effect only if `holds`; `condition` gives the condition in words.
    pub(super) const fn only(mut self, holds: bool, condition: &'static str) -> Self {
        self.only = Some((holds, condition));
        self
    }
}

/// Behaviour when a key is not given.
pub(super) enum Absent<T> {
    /// This value is used.
    Default(T),
    /// No value is needed; the text describes the behaviour then.
    Nothing(&'static str),
    /// The absence is a fault.
    Required,
}

/// One table of the text, or an absent one in which every key has its default.
pub(super) struct Table<'t> {
    faults: &'t Faults<'t>,
    path: String,
    at: usize,
    entries: Option<&'t DeTable<'t>>,
    asked: Vec<&'static str>,
    node: Node,
}

impl<'t> Table<'t> {
    /// Cursor over the whole text.
    pub(super) fn root(faults: &'t Faults<'t>, entries: &'t DeTable<'t>) -> Self {
        Self::new(faults, String::new(), 0, Some(entries), Node::root())
    }

    pub(super) fn new(
        faults: &'t Faults<'t>,
        path: String,
        at: usize,
        entries: Option<&'t DeTable<'t>>,
        node: Node,
    ) -> Self {
        Self {
            faults,
            path,
            at,
            entries,
            asked: Vec::new(),
            node,
        }
    }

    /// Takes one key: reads it if present, else applies `absent`.
    pub(super) fn take<T>(
        &mut self,
        key: Key,
        allowed: impl Display,
        absent: Absent<T>,
        read: impl FnOnce(&Value<'t>) -> Option<T>,
        show: impl Fn(&T) -> String,
    ) -> Option<T> {
        let (holds, condition) = match key.only {
            Some((holds, condition)) => (holds, Some(condition)),
            None => (true, None),
        };
        let given = self.value(key.name);
        let default = match &absent {
            Absent::Default(value) => show(value),
            Absent::Nothing(text) => (*text).to_owned(),
            Absent::Required => "required".to_owned(),
        };
        let result = match (&given, holds) {
            (Some(value), true) => read(value).or(match absent {
                Absent::Default(value) => Some(value),
                _ => None,
            }),
            (Some(value), false) => {
                value.fault(format!(
                    "has no effect here, only with {}; remove it",
                    condition.unwrap_or_default()
                ));
                None
            }
            (None, _) => match absent {
                Absent::Default(value) => Some(value),
                Absent::Nothing(_) => None,
                Absent::Required => {
                    if holds {
                        self.absence_of(key.name, format!("{}, allowed: {allowed}", key.meaning));
                    }
                    None
                }
            },
        };
        self.node.lines.push(Line {
            key: key.name,
            value: if holds { result.as_ref().map(&show) } else { None },
            shown: holds,
            given: given.is_some(),
            default,
            allowed: allowed.to_string(),
            meaning: key.meaning,
            condition,
        });
        result
    }

    /// Reads the sub-table `name`; if it is absent, its keys have their defaults.
    pub(super) fn section<T>(
        &mut self,
        name: &'static str,
        meaning: &'static str,
        read: impl FnOnce(&mut Table<'t>) -> T,
    ) -> T {
        let given = self
            .value(name)
            .and_then(|value| value.table().map(|entries| (value.at, entries)));
        let node = self.node.child(name, meaning, false);
        let (at, entries) = given.map_or((self.at, None), |(at, entries)| (at, Some(entries)));
        let mut table = Table::new(self.faults, self.path_of(name), at, entries, node);
        let result = read(&mut table);
        self.node.children.push(table.finish());
        result
    }

    /// Reads the sub-table `name` if it is present.
    pub(super) fn optional_section<T>(
        &mut self,
        name: &'static str,
        meaning: &'static str,
        read: impl FnOnce(&mut Table<'t>) -> T,
    ) -> Option<T> {
        if self.entries.is_some_and(|entries| entries.contains_key(name)) {
            Some(self.section(name, meaning, read))
        } else {
            self.asked.push(name);
            None
        }
    }

    /// Reads every `[[name]]`.
    pub(super) fn list<T>(
        &mut self,
        name: &'static str,
        meaning: &'static str,
        read: impl FnMut(&mut Table<'t>) -> T,
    ) -> Vec<T> {
        self.list_of(MOST_ELEMENTS, name, meaning, read)
    }

    /// Reads every `[[name]]`, `most` of them.
    pub(super) fn list_of<T>(
        &mut self,
        most: usize,
        name: &'static str,
        meaning: &'static str,
        mut read: impl FnMut(&mut Table<'t>) -> T,
    ) -> Vec<T> {
        let Some(value) = self.value(name) else {
            return Vec::new();
        };
        let mut results = Vec::new();
        let elements = value.array_of_tables(name);
        if elements.len() > most {
            value.fault(format!(
                "stands {} times, at most {most} are allowed",
                elements.len()
            ));
        }
        for element in elements.into_iter().take(most) {
            let Some(entries) = element.table() else { continue };
            let node = self.node.child(name, meaning, true);
            let mut table = Table::new(self.faults, element.key.clone(), element.at, Some(entries), node);
            results.push(read(&mut table));
            self.node.children.push(table.finish());
        }
        results
    }

    /// True if the text has this key, without taking it.
    pub(super) fn has(&self, name: &str) -> bool {
        self.entries.is_some_and(|entries| entries.contains_key(name))
    }

    /// Marks keys as known that are not read because of another fault.
    pub(super) fn ignore(&mut self, names: &[&'static str]) {
        self.asked.extend(names);
    }

    /// Adds a fault of one key of this table, at the key if present, else at the table.
    pub(super) fn fault_of(&self, name: &str, message: impl Into<String>) {
        let at = self
            .entries
            .and_then(|entries| entries.get(name))
            .map_or(self.at, |value| value.span().start);
        self.faults.add(self.path_of(name), at, message);
    }

    /// Adds the fault that a key is missing; `what` describes the key.
    pub(super) fn absence_of(&self, name: &str, what: impl Display) {
        self.faults
            .add_absence(self.path_of(name), self.at, format!("is missing: {what}"));
    }

    /// Adds a fault of the table itself.
    pub(super) fn fault(&self, message: impl Into<String>) {
        self.faults.add(self.path.clone(), self.at, message);
    }

    /// Line of one key, from 1.
    pub(super) fn line_of(&self, name: &str) -> usize {
        let value = self.entries.and_then(|entries| entries.get(name));
        self.faults
            .line(value.map_or(self.at, |value| value.span().start))
    }

    /// Reports unknown keys and returns the values recorded.
    pub(super) fn finish(self) -> Node {
        for (name, _) in self.entries.into_iter().flatten() {
            let text: &str = name.get_ref();
            if !self.asked.contains(&text) {
                let hint = super::suggestion::hint(text, &self.asked);
                self.faults.add(
                    self.path_of(text),
                    name.span().start,
                    format!("unknown key{hint}"),
                );
            }
        }
        self.node
    }

    fn value(&mut self, name: &'static str) -> Option<Value<'t>> {
        if !self.asked.contains(&name) {
            self.asked.push(name);
        }
        let value = self.entries?.get(name)?;
        Some(Value::new(self.faults, self.path_of(name), value))
    }

    fn path_of(&self, name: &str) -> String {
        if self.path.is_empty() {
            name.to_owned()
        } else {
            format!("{}.{name}", self.path)
        }
    }
}
