//! One TOML value with its place in the text, read as the type of its key or refused with a
//! sentence.

use super::effective::Node;
use super::fault::Faults;
use super::range::Range;
use super::reader::Table;
use crate::analysis::signal::record::Timestamp;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// One value of the text.
pub(super) struct Value<'t> {
    faults: &'t Faults<'t>,
    pub(super) key: String,
    pub(super) at: usize,
    value: &'t Spanned<DeValue<'t>>,
}

impl<'t> Value<'t> {
    pub(super) fn new(faults: &'t Faults<'t>, key: String, value: &'t Spanned<DeValue<'t>>) -> Self {
        Self {
            faults,
            key,
            at: value.span().start,
            value,
        }
    }

    /// Adds a fault of this value.
    pub(super) fn fault(&self, message: impl Into<String>) {
        self.faults.add(self.key.clone(), self.at, message);
    }

    /// Last name of the key, for messages.
    fn name(&self) -> &str {
        self.key.rsplit('.').next().unwrap_or(&self.key)
    }

    /// The value as typed, shortened.
    fn typed(&self) -> String {
        let text = self.faults.text.get(self.value.span()).unwrap_or_default().trim();
        let line = text.lines().next().unwrap_or_default();
        let short: String = line.chars().take(40).collect();
        if short.len() < text.len() {
            format!("{short}…")
        } else {
            short
        }
    }

    fn wrong_type(&self, wanted: &str) {
        let found = match self.value.get_ref() {
            DeValue::String(_) => "a string",
            DeValue::Integer(_) => "an integer",
            DeValue::Float(_) => "a number",
            DeValue::Boolean(_) => "a boolean",
            DeValue::Datetime(_) => "a date",
            DeValue::Array(_) => "an array",
            DeValue::Table(_) => {
                self.fault(format!("is a table, {wanted} is wanted"));
                return;
            }
        };
        self.fault(format!("{} is {found}, {wanted} is wanted", self.typed()));
    }

    /// True if it is a table.
    pub(super) fn is_table(&self) -> bool {
        matches!(self.value.get_ref(), DeValue::Table(_))
    }

    /// True if it is an array.
    pub(super) fn is_array(&self) -> bool {
        matches!(self.value.get_ref(), DeValue::Array(_))
    }

    /// A finite number in `range`; integers are numbers too.
    pub(super) fn number(&self, range: Range) -> Option<f64> {
        let number = match self.value.get_ref() {
            DeValue::Float(float) => float.as_str().parse::<f64>().ok(),
            DeValue::Integer(integer) => i128::from_str_radix(integer.as_str(), integer.radix())
                .ok()
                .map(|value| value as f64),
            _ => {
                self.wrong_type("a number");
                return None;
            }
        };
        match number {
            Some(value) if range.holds(value) => Some(value),
            Some(value) if value.is_nan() => {
                self.fault(format!("nan is not a number, allowed: {}", range.of(self.name())));
                None
            }
            _ => {
                self.fault(format!(
                    "{} is out of range, allowed: {}",
                    self.typed(),
                    range.of(self.name())
                ));
                None
            }
        }
    }

    /// A whole number from `low` to `high`.
    pub(super) fn integer(&self, low: u64, high: u64) -> Option<u64> {
        let DeValue::Integer(integer) = self.value.get_ref() else {
            self.wrong_type("a whole number");
            return None;
        };
        match i128::from_str_radix(integer.as_str(), integer.radix()) {
            Ok(value) if (i128::from(low)..=i128::from(high)).contains(&value) => Some(value as u64),
            _ => {
                self.fault(format!(
                    "{} is out of range, allowed: {low} <= {} <= {high}",
                    self.typed(),
                    self.name()
                ));
                None
            }
        }
    }

    /// `true` or `false`.
    pub(super) fn boolean(&self) -> Option<bool> {
        if let DeValue::Boolean(value) = self.value.get_ref() {
            return Some(*value);
        }
        self.wrong_type("true or false");
        None
    }

    /// A string.
    pub(super) fn string(&self) -> Option<&'t str> {
        if let DeValue::String(value) = self.value.get_ref() {
            return Some(value);
        }
        self.wrong_type("a string");
        None
    }

    /// A string that is not empty, has at most 255 bytes and no control characters.
    pub(super) fn name_string(&self) -> Option<&'t str> {
        let text = self.string()?;
        if text.trim().is_empty() {
            self.fault("is empty");
        } else if text.len() > 255 {
            self.fault(format!("has {} bytes, at most 255 are allowed", text.len()));
        } else if text.chars().any(char::is_control) {
            self.fault(format!("{} holds a control character", self.typed()));
        } else {
            return Some(text);
        }
        None
    }

    /// One of a few words.
    pub(super) fn choice<T: Copy>(&self, choices: &[(&'static str, T)]) -> Option<T> {
        let DeValue::String(text) = self.value.get_ref() else {
            self.wrong_type("a string");
            return None;
        };
        let found = choices.iter().find(|(word, _)| word == text);
        if found.is_none() {
            let words: Vec<&'static str> = choices.iter().map(|(word, _)| *word).collect();
            self.fault(format!(
                "{} is not known, allowed: {}",
                self.typed(),
                quoted(&words)
            ));
        }
        found.map(|(_, value)| *value)
    }

    /// A point in time: an RFC 3339 string or a TOML date with an offset.
    pub(super) fn time(&self) -> Option<Timestamp> {
        let text = match self.value.get_ref() {
            DeValue::String(text) => text.to_string(),
            DeValue::Datetime(time) => time.to_string(),
            _ => {
                self.wrong_type("a time like 2026-03-01T06:00:00Z");
                return None;
            }
        };
        let parsed = text.parse::<jiff::Timestamp>().ok();
        let time = parsed
            .and_then(|time| i64::try_from(time.as_nanosecond()).ok())
            .map(Timestamp::from_nanos);
        if time.is_none() {
            self.fault(format!(
                "{} is no time with an offset, write it like 2026-03-01T06:00:00Z",
                self.typed()
            ));
        }
        time
    }

    /// The entries of a table.
    pub(super) fn table(&self) -> Option<&'t DeTable<'t>> {
        if let DeValue::Table(entries) = self.value.get_ref() {
            return Some(entries);
        }
        self.wrong_type("a table");
        None
    }

    /// Reads a table used as a value, such as `{ mean = 8e5, cv = 0.2 }`.
    pub(super) fn inline<T>(&self, read: impl FnOnce(&mut Table<'t>) -> Option<T>) -> Option<T> {
        let entries = self.table()?;
        let mut table = Table::new(
            self.faults,
            self.key.clone(),
            self.at,
            Some(entries),
            Node::root(),
        );
        let result = read(&mut table);
        table.finish();
        result
    }

    /// The elements of an array.
    pub(super) fn array(&self) -> Option<Vec<Value<'t>>> {
        if let DeValue::Array(elements) = self.value.get_ref() {
            let elements = elements.iter().enumerate();
            return Some(
                elements
                    .map(|(i, value)| Value::new(self.faults, format!("{}[{i}]", self.key), value))
                    .collect(),
            );
        }
        self.wrong_type("an array");
        None
    }

    /// Numbers, `shortest` to `longest` of them, each in `range`.
    pub(super) fn numbers(&self, range: Range, shortest: usize, longest: usize) -> Option<Vec<f64>> {
        let elements = self.array()?;
        if !(shortest..=longest).contains(&elements.len()) {
            self.fault(format!(
                "has {} entries, allowed: {}",
                elements.len(),
                if shortest == longest {
                    shortest.to_string()
                } else {
                    format!("{shortest} to {longest}")
                }
            ));
            return None;
        }
        let numbers: Vec<Option<f64>> = elements.iter().map(|value| value.number(range)).collect();
        numbers.into_iter().collect()
    }

    /// The elements of an array of tables called `name`.
    pub(super) fn array_of_tables(&self, name: &str) -> Vec<Value<'t>> {
        match self.value.get_ref() {
            DeValue::Array(_) => self.array().unwrap_or_default(),
            DeValue::Table(_) => {
                self.fault(format!(
                    "there may be several of these: write [[{name}]], not [{name}]"
                ));
                Vec::new()
            }
            _ => {
                self.wrong_type(&format!("one or more [[{name}]]"));
                Vec::new()
            }
        }
    }
}

/// `"a", "b" or "c"`.
pub(super) fn quoted(words: &[&str]) -> String {
    let quoted: Vec<String> = words.iter().map(|word| format!("\"{word}\"")).collect();
    match quoted.split_last() {
        Some((last, rest)) if !rest.is_empty() => format!("{} or {last}", rest.join(", ")),
        _ => quoted.join(""),
    }
}

/// `[0.1, 0.2]`, each number as TOML.
pub(super) fn toml_floats(numbers: &[f64]) -> String {
    let numbers: Vec<String> = numbers
        .iter()
        .map(|number| super::range::toml_float(*number))
        .collect();
    format!("[{}]", numbers.join(", "))
}
