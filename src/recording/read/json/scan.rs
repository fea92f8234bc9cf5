//! One pass over the bytes of a JSON message, which picks up samples and time at their paths.

use super::number::{Number, digits, plain};
use crate::read::decode::PIECE;
use crate::read::path::{Found, into_field, into_item};
use crate::read::stamp;
use serde::Deserialize;

/// Deepest nesting accepted, so that no message can exhaust the stack.
const MAX_DEPTH: usize = 128;

/// Longest time made of parts \[bytes\]: it is built as a value, which takes many times its text.
const MAX_TIME: usize = 1 << 10;

/// Reason why a message is not taken.
pub(super) enum Fault {
    Malformed(&'static str, usize),
    Type(&'static str),
    Time,
}

/// A message, and what was found in it so far.
pub(super) struct Scan<'a, 'o> {
    pub text: &'a str,
    pub bytes: &'a [u8],
    pub at: usize,
    /// Number of the first sample that is wanted.
    pub from: usize,
    pub out: &'o mut Vec<f64>,
    /// Number of samples before and after the wanted ones.
    pub outside: usize,
    /// Set when the value was found: true if it is an array.
    pub array: Option<bool>,
    pub time: Option<i64>,
}

impl<'a> Scan<'a, '_> {
    fn fault<T>(&self, what: &'static str) -> Result<T, Fault> {
        Err(Fault::Malformed(what, self.at))
    }

    #[inline]
    fn peek(&self) -> u8 {
        // No JSON token contains a zero byte, so it can mark the end.
        self.bytes.get(self.at).copied().unwrap_or(0)
    }

    #[inline]
    fn space(&mut self) {
        while matches!(self.peek(), b' ' | b'\t' | b'\n' | b'\r') {
            self.at += 1;
        }
    }

    pub fn end(&mut self) -> Result<(), Fault> {
        self.space();
        if self.at == self.bytes.len() {
            Ok(())
        } else {
            self.fault("text after the message")
        }
    }

    /// Reads one value; `value` and `time` are the remainders of the two paths if they lead here.
    pub fn value(&mut self, value: Found<'_>, time: Found<'_>, depth: usize) -> Result<(), Fault> {
        if depth > MAX_DEPTH {
            return self.fault("nested too deep");
        }
        self.space();
        if value == Some(&[]) {
            return self.samples();
        }
        if time == Some(&[]) {
            return self.stamp(depth);
        }
        match self.peek() {
            b'{' => self.object(value, time, depth),
            b'[' => self.array(value, time, depth),
            b'"' => self.string().map(|_| ()),
            b'-' | b'0'..=b'9' => self.number().map(|_| ()),
            b't' => self.literal("true"),
            b'f' => self.literal("false"),
            b'n' => self.literal("null"),
            _ => self.fault("a value is missing"),
        }
    }

    fn object(&mut self, value: Found<'_>, time: Found<'_>, depth: usize) -> Result<(), Fault> {
        self.at += 1;
        let (mut value_seen, mut time_seen) = (false, false);
        self.space();
        if self.peek() == b'}' {
            self.at += 1;
            return Ok(());
        }
        loop {
            self.space();
            let key = self.string()?;
            self.space();
            if self.peek() != b':' {
                return self.fault("`:` is missing");
            }
            self.at += 1;
            let value_in = into(value, key);
            let time_in = into(time, key);
            // RFC 8259 leaves the meaning of a repeated name open, so it has none.
            if (value_in.is_some() && value_seen) || (time_in.is_some() && time_seen) {
                return self.fault("a name given twice");
            }
            value_seen |= value_in.is_some();
            time_seen |= time_in.is_some();
            self.value(value_in, time_in, depth + 1)?;
            self.space();
            match self.peek() {
                b',' => self.at += 1,
                b'}' => {
                    self.at += 1;
                    return Ok(());
                }
                _ => return self.fault("`,` or `}` is missing"),
            }
        }
    }

    fn array(&mut self, value: Found<'_>, time: Found<'_>, depth: usize) -> Result<(), Fault> {
        self.at += 1;
        self.space();
        if self.peek() == b']' {
            self.at += 1;
            return Ok(());
        }
        for index in 0.. {
            self.value(into_item(value, index), into_item(time, index), depth + 1)?;
            self.space();
            match self.peek() {
                b',' => self.at += 1,
                b']' => {
                    self.at += 1;
                    break;
                }
                _ => return self.fault("`,` or `]` is missing"),
            }
        }
        Ok(())
    }

    /// Reads the value: a number, `null`, or an array of them.
    fn samples(&mut self) -> Result<(), Fault> {
        if self.peek() != b'[' {
            self.array = Some(false);
            self.sample()?;
            if self.from > 0 {
                self.out.pop();
                self.outside += 1;
            }
            return Ok(());
        }
        self.array = Some(true);
        self.at += 1;
        self.space();
        if self.peek() == b']' {
            self.at += 1;
            return Ok(());
        }
        loop {
            self.space();
            self.sample()?;
            if self.outside < self.from || self.out.len() > PIECE {
                self.out.pop();
                self.outside += 1;
            }
            self.space();
            match self.peek() {
                b',' => self.at += 1,
                b']' => {
                    self.at += 1;
                    return Ok(());
                }
                _ => return self.fault("`,` or `]` is missing"),
            }
        }
    }

    #[inline]
    fn sample(&mut self) -> Result<(), Fault> {
        match self.peek() {
            b'-' | b'0'..=b'9' => {
                if let Some((value, end)) = plain(self.bytes, self.at) {
                    self.out.push(value);
                    self.at = end;
                    return Ok(());
                }
                let number = self.number()?;
                let value = number.value(self.text);
                self.out.push(value);
                Ok(())
            }
            b'n' => {
                self.literal("null")?;
                self.out.push(f64::NAN);
                Ok(())
            }
            b'{' => Err(Fault::Type("an object")),
            b'[' => Err(Fault::Type("an array of arrays")),
            b'"' => Err(Fault::Type("text")),
            b't' | b'f' => Err(Fault::Type("true or false")),
            _ => self.fault("a number is missing"),
        }
    }

    fn stamp(&mut self, depth: usize) -> Result<(), Fault> {
        let text = self.text;
        let time = match self.peek() {
            b'"' => stamp::from_text(self.string()?),
            b'-' | b'0'..=b'9' => {
                let number = self.number()?;
                stamp::from_number(&text[number.start..number.end])
            }
            b'{' => {
                let start = self.at;
                self.object(None, None, depth)?;
                stamp_object(&text[start..self.at])
            }
            _ => None,
        };
        self.time = Some(time.ok_or(Fault::Time)?);
        Ok(())
    }

    fn literal(&mut self, word: &'static str) -> Result<(), Fault> {
        if self.bytes[self.at..].starts_with(word.as_bytes()) {
            self.at += word.len();
            Ok(())
        } else {
            self.fault("an unknown word")
        }
    }

    /// Reads a string, without its quotes, escapes unchanged.
    #[inline]
    fn string(&mut self) -> Result<&'a str, Fault> {
        if self.peek() != b'"' {
            return self.fault("a `\"` is missing");
        }
        self.at += 1;
        let start = self.at;
        loop {
            match self.peek() {
                b'"' => break,
                b'\\' => self.escape()?,
                0..=0x1f => return self.fault("a string without end, or a control character in it"),
                _ => self.at += 1,
            }
        }
        // Both ends are at ASCII quotes, so this is a character boundary.
        let string = self.text.get(start..self.at).unwrap_or_default();
        self.at += 1;
        Ok(string)
    }

    fn escape(&mut self) -> Result<(), Fault> {
        self.at += 1;
        match self.peek() {
            b'"' | b'\\' | b'/' | b'b' | b'f' | b'n' | b'r' | b't' => self.at += 1,
            b'u' => {
                let digits = self.bytes.get(self.at + 1..self.at + 5).unwrap_or_default();
                if digits.len() < 4 || !digits.iter().all(u8::is_ascii_hexdigit) {
                    return self.fault("a broken escape");
                }
                self.at += 5;
            }
            _ => return self.fault("an unknown escape"),
        }
        Ok(())
    }

    /// Reads a JSON number: `-?(0|[1-9][0-9]*)(.[0-9]+)?([eE][+-]?[0-9]+)?`.
    #[inline]
    fn number(&mut self) -> Result<Number, Fault> {
        let start = self.at;
        let negative = self.peek() == b'-';
        self.at += usize::from(negative);
        let mut mantissa = 0u64;
        let whole = self.at;
        self.digits(&mut mantissa);
        let mut count = self.at - whole;
        if count == 0 || (count > 1 && self.bytes[whole] == b'0') {
            return self.fault("a broken number");
        }
        let mut exponent = 0i64;
        if self.peek() == b'.' {
            self.at += 1;
            let fraction = self.at;
            self.digits(&mut mantissa);
            let places = self.at - fraction;
            if places == 0 {
                return self.fault("a broken number");
            }
            exponent = -(places as i64);
            count += places;
        }
        if matches!(self.peek(), b'e' | b'E') {
            self.at += 1;
            let down = self.peek() == b'-';
            self.at += usize::from(matches!(self.peek(), b'-' | b'+'));
            let mut power = 0u64;
            let first = self.at;
            self.digits(&mut power);
            match self.at - first {
                0 => return self.fault("a broken number"),
                // Far beyond any float either way; the slow path decides.
                9.. => exponent = i64::MAX / 2,
                _ if down => exponent -= power as i64,
                _ => exponent += power as i64,
            }
        }
        Ok(Number {
            negative,
            // 19 digits always fit; with more the mantissa may have wrapped.
            exact: count <= 19 && mantissa <= 1 << 53 && exponent.unsigned_abs() <= 22,
            mantissa,
            exponent,
            start,
            end: self.at,
        })
    }

    /// Appends the next digits to a number, wrapping.
    #[inline]
    fn digits(&mut self, number: &mut u64) {
        self.at += digits(&self.bytes[self.at..], number);
    }
}

/// Remainder of a path behind a key as written in the message, escapes included.
#[inline]
fn into<'p>(path: Found<'p>, key: &str) -> Found<'p> {
    if path.is_some() && key.contains('\\') {
        let key: String = serde_json::from_str(&format!("\"{key}\"")).ok()?;
        return into_field(path, &key);
    }
    into_field(path, key)
}

/// A time of parts, by the names that messages use.
#[derive(Deserialize)]
struct Parts {
    #[serde(alias = "seconds", alias = "secs", alias = "s")]
    sec: i64,
    #[serde(alias = "nanos", alias = "nsec", alias = "ns")]
    nanosec: i64,
}

/// Nanoseconds from `{"sec": …, "nanosec": …}` or `{"seconds": …, "nanos": …}`.
fn stamp_object(text: &str) -> Option<i64> {
    if text.len() > MAX_TIME {
        return None;
    }
    let parts: Parts = serde_json::from_str(text).ok()?;
    stamp::from_parts(parts.sec, parts.nanosec)
}
