//! Reads a text file line by line, with line numbers, odd encodings and a bound on each line.

use super::ImportError;
use std::borrow::Cow;
use std::io::{BufRead, Read};

/// Longest line read \[bytes\].
const LONGEST: u64 = 1 << 20;

/// Lines of a file, without their ends.
pub(super) struct Lines<R> {
    from: R,
    line: Vec<u8>,
    number: u32,
}

impl<R: BufRead> Lines<R> {
    pub(super) fn new(from: R) -> Self {
        Self {
            from,
            line: Vec::new(),
            number: 0,
        }
    }

    /// Number of the line that was read last, from 1.
    pub(super) fn number(&self) -> u32 {
        self.number
    }

    /// The next line as bytes; `None` at the end.
    pub(super) fn next_bytes(&mut self) -> Result<Option<&[u8]>, ImportError> {
        self.line.clear();
        let mut bounded = self.from.by_ref().take(LONGEST + 1);
        let read = bounded
            .read_until(b'\n', &mut self.line)
            .map_err(|error| ImportError::unreadable(&error))?;
        if read == 0 {
            return Ok(None);
        }
        self.number = self.number.saturating_add(1);
        if self.line.len() as u64 > LONGEST {
            return Err(ImportError::at(
                format_args!("line {}", self.number),
                format!("longer than {LONGEST} bytes: no text file of samples"),
            ));
        }
        while let Some(b'\n' | b'\r') = self.line.last() {
            self.line.pop();
        }
        Ok(Some(&self.line))
    }

    /// The next line as text; `None` at the end. Bytes that are not UTF-8 are read as Latin-1, which
    /// older recorders write (`µm`, `°C`).
    pub(super) fn next_text(&mut self) -> Result<Option<Cow<'_, str>>, ImportError> {
        let is_first = self.number == 0;
        if self.next_bytes()?.is_none() {
            return Ok(None);
        }
        let mut line = self.line.as_slice();
        if is_first {
            if line.starts_with(&[0xff, 0xfe]) || line.starts_with(&[0xfe, 0xff]) {
                return Err(ImportError::new("is UTF-16 text: save it as UTF-8"));
            }
            line = line.strip_prefix(b"\xef\xbb\xbf").unwrap_or(line);
        }
        if line.contains(&0) {
            return Err(ImportError::at(
                format_args!("line {}", self.number),
                "holds a zero byte: this is no text file",
            ));
        }
        Ok(Some(text(line)))
    }

    /// Input after the last line read, for a block that is not text.
    pub(super) fn rest(&mut self) -> &mut R {
        &mut self.from
    }
}

/// UTF-8, else Latin-1.
pub(super) fn text(bytes: &[u8]) -> Cow<'_, str> {
    match std::str::from_utf8(bytes) {
        Ok(text) => Cow::Borrowed(text),
        Err(_) => Cow::Owned(bytes.iter().map(|byte| char::from(*byte)).collect()),
    }
}

/// At most the first 40 characters of a text, for messages.
pub(super) fn shown(text: &str) -> String {
    let mut short: String = text.chars().take(40).collect();
    if short.len() < text.len() {
        short.push('…');
    }
    format!("{short:?}")
}
