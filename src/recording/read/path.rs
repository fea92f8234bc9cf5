//! Paths into a message: `point.z`, `data[3]`, `sensors[0].value`.

use std::fmt;
use thiserror::Error;

/// One step of a path.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Step {
    /// Into a field, by name.
    Field(String),
    /// Into an array, by index from 0.
    Index(usize),
}

/// A path into a message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FieldPath(Vec<Step>);

/// A malformed path.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("field path `{path}`: {what} (write names with dots and indices in brackets: `sensors[0].value`)")]
pub struct PathError {
    /// Path as written.
    pub path: String,
    /// Description of the fault.
    pub what: &'static str,
}

/// Deepest path accepted.
const MAX_STEPS: usize = 32;

impl FieldPath {
    /// Parses a path.
    pub fn parse(path: &str) -> Result<Self, PathError> {
        let fault = |what| PathError {
            path: path.to_owned(),
            what,
        };
        let mut steps = Vec::new();
        for (i, part) in path.split('.').enumerate() {
            let (name, mut indices) = match part.find('[') {
                Some(at) => part.split_at(at),
                None => (part, ""),
            };
            match name {
                // A message that is itself an array may be indexed at once: `[3].value`.
                "" if i == 0 && !indices.is_empty() => {}
                "" => return Err(fault("an empty name")),
                _ if name.contains(']') => return Err(fault("`]` without `[`")),
                _ => steps.push(Step::Field(name.to_owned())),
            }
            while let Some(rest) = indices.strip_prefix('[') {
                let (index, rest) = rest.split_once(']').ok_or_else(|| fault("`[` without `]`"))?;
                let index = index.parse().map_err(|_| fault("an index is a whole number"))?;
                steps.push(Step::Index(index));
                indices = rest;
            }
            if !indices.is_empty() {
                return Err(fault("a dot belongs between `]` and a name"));
            }
        }
        if steps.len() > MAX_STEPS {
            return Err(fault("too deep"));
        }
        Ok(Self(steps))
    }

    /// Steps, outermost first; never empty.
    pub fn steps(&self) -> &[Step] {
        &self.0
    }
}

/// Remainder of a path while a message is walked; `None` off the path.
pub type Found<'p> = Option<&'p [Step]>;

/// Remainder of a path behind the field `key`.
#[inline]
pub fn into_field<'p>(path: Found<'p>, key: &str) -> Found<'p> {
    match path {
        Some([Step::Field(name), rest @ ..]) if name == key => Some(rest),
        _ => None,
    }
}

/// Remainder of a path behind item `index` of a list.
#[inline]
pub fn into_item(path: Found<'_>, index: usize) -> Found<'_> {
    match path {
        Some([Step::Index(wanted), rest @ ..]) if *wanted == index => Some(rest),
        _ => None,
    }
}

impl fmt::Display for FieldPath {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, step) in self.0.iter().enumerate() {
            match step {
                Step::Field(name) if i == 0 => write!(f, "{name}")?,
                Step::Field(name) => write!(f, ".{name}")?,
                Step::Index(index) => write!(f, "[{index}]")?,
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_what_it_writes() {
        for path in [
            "z",
            "point.z",
            "data[3]",
            "sensors[0].value",
            "a[1][2].b",
            "[3].value",
        ] {
            assert_eq!(FieldPath::parse(path).unwrap().to_string(), path);
        }
    }

    #[test]
    fn refuses_what_is_no_path() {
        for path in [
            "", ".", "a..b", "a[", "a[x]", "a[-1]", "a]", "a[0]b", ".a", "a.[0]",
        ] {
            assert!(FieldPath::parse(path).is_err(), "{path}");
        }
        assert!(FieldPath::parse(&"a.".repeat(40)).is_err());
    }
}
