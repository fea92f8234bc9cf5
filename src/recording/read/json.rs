//! Reads one field of a JSON message without building the message.
//!
//! One pass over the bytes checks the whole message against RFC 8259 and picks up the numbers at the
//! path on the way; nothing is allocated for the rest. Numbers are rounded correctly.

use super::decode::{DecodeError, Decoded, PIECE, Time};
use super::path::{FieldPath, Found, Step, into_field, into_item};
use super::stamp;
use serde::Deserialize;

/// Deepest nesting accepted, so that no message can exhaust the stack.
const MAX_DEPTH: usize = 128;

/// Longest message whose content is shown in errors, and longest time made of parts \[bytes\]: both are built
/// as values, which take many times their text.
const MAX_SHOWN: usize = 64 << 10;
const MAX_TIME: usize = 1 << 10;

/// Paths of the value and its time.
#[derive(Debug, Clone)]
pub struct JsonPlan {
    value: FieldPath,
    time: Option<FieldPath>,
}

impl JsonPlan {
    /// A plan for a value and, if it is in the message, its time.
    pub fn new(value: FieldPath, time: Option<FieldPath>) -> Self {
        Self { value, time }
    }

    /// Appends a piece of the samples in `message` to `out`, which is empty; `null` is a missing sample (NaN).
    pub fn decode(&self, message: &[u8], from: usize, out: &mut Vec<f64>) -> Result<Decoded, DecodeError> {
        let text =
            std::str::from_utf8(message).map_err(|fault| malformed("not UTF-8", fault.valid_up_to()))?;
        let mut scan = Scan {
            text,
            bytes: message,
            at: 0,
            from,
            out,
            outside: 0,
            array: None,
            time: None,
        };
        let time = self.time.as_ref().map(FieldPath::steps);
        let outcome = scan
            .value(Some(self.value.steps()), time, 0)
            .and_then(|()| scan.end());
        let (array, stamp) = (scan.array, scan.time);
        let samples = scan.out.len() + scan.outside;
        match (outcome, array) {
            (Err(Fault::Malformed(what, at)), _) => Err(malformed(what, at)),
            (Err(Fault::Type(what)), _) => Err(DecodeError::Type {
                path: self.value.to_string(),
                found: what,
            }),
            (Err(Fault::Time), _) => Err(DecodeError::Time {
                path: self.time.as_ref().map(FieldPath::to_string).unwrap_or_default(),
            }),
            (Ok(()), None) => Err(missing(&self.value, text)),
            (Ok(()), Some(array)) => match (&self.time, stamp) {
                (Some(path), None) => Err(missing(path, text)),
                (_, time) => Ok(Decoded {
                    array,
                    samples,
                    time: time.map_or(Time::Outside, Time::Nanos),
                }),
            },
        }
    }
}

fn malformed(what: &'static str, at: usize) -> DecodeError {
    DecodeError::Malformed(format!("not JSON: {what} at byte {at}"))
}

/// Error with the place where a path ends and the value found there. Slow, for errors only.
fn missing(path: &FieldPath, text: &str) -> DecodeError {
    let mut has = Vec::new();
    if text.len() > MAX_SHOWN {
        has.push(format!("a message of {} bytes", text.len()));
    } else if let Ok(root) = serde_json::from_str::<serde_json::Value>(text) {
        let mut here = &root;
        for step in path.steps() {
            let next = match step {
                Step::Field(name) => here.get(name.as_str()),
                Step::Index(index) => here.get(*index),
            };
            match next {
                Some(next) => here = next,
                None => break,
            }
        }
        has = match here {
            serde_json::Value::Object(fields) => fields.keys().cloned().collect(),
            serde_json::Value::Array(items) => vec![format!("{} items", items.len())],
            _ => vec!["no fields".to_owned()],
        };
    }
    DecodeError::missing(path, has)
}

enum Fault {
    Malformed(&'static str, usize),
    Type(&'static str),
    Time,
}

struct Scan<'a, 'o> {
    text: &'a str,
    bytes: &'a [u8],
    at: usize,
    /// Number of the first sample that is wanted.
    from: usize,
    out: &'o mut Vec<f64>,
    /// Number of samples before and after the wanted ones.
    outside: usize,
    /// Set when the value was found: true if it is an array.
    array: Option<bool>,
    time: Option<i64>,
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

    fn end(&mut self) -> Result<(), Fault> {
        self.space();
        if self.at == self.bytes.len() {
            Ok(())
        } else {
            self.fault("text after the message")
        }
    }

    /// Reads one value; `value` and `time` are the remainders of the two paths if they lead here.
    fn value(&mut self, value: Found<'_>, time: Found<'_>, depth: usize) -> Result<(), Fault> {
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
        loop {
            let digit = self.peek().wrapping_sub(b'0');
            if digit > 9 {
                return;
            }
            *number = number.wrapping_mul(10).wrapping_add(u64::from(digit));
            self.at += 1;
        }
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

/// Reads a number of the common form `-?digits.digits` with at most 15 digits, and its end; `None` for any
/// other text.
#[inline(always)]
fn plain(bytes: &[u8], start: usize) -> Option<(f64, usize)> {
    let rest = bytes.get(start..)?;
    let (negative, rest) = match rest {
        [b'-', rest @ ..] => (true, rest),
        _ => (false, rest),
    };
    let mut mantissa = 0u64;
    let whole = digits(rest, &mut mantissa);
    let fraction = match rest.get(whole) {
        Some(b'.') => digits(&rest[whole + 1..], &mut mantissa),
        _ => return None,
    };
    let length = whole + 1 + fraction;
    let sound = fraction > 0 && (whole == 1 || (whole > 1 && rest[0] != b'0'));
    if !sound || whole + fraction > 15 || matches!(rest.get(length), Some(b'e' | b'E')) {
        return None;
    }
    let value = mantissa as f64 / POWERS[fraction];
    Some((
        if negative { -value } else { value },
        start + usize::from(negative) + length,
    ))
}

/// Appends the digits at the start to a number, wrapping; returns their number.
#[inline(always)]
fn digits(bytes: &[u8], number: &mut u64) -> usize {
    let mut count = 0;
    for byte in bytes {
        let digit = byte.wrapping_sub(b'0');
        if digit > 9 {
            break;
        }
        *number = number.wrapping_mul(10).wrapping_add(u64::from(digit));
        count += 1;
    }
    count
}

struct Number {
    negative: bool,
    exact: bool,
    mantissa: u64,
    exponent: i64,
    start: usize,
    end: usize,
}

impl Number {
    /// The nearest float. Mantissa and power of ten are exact floats in the common case, so that one
    /// operation rounds once (Clinger 1990); the standard library does the rest.
    #[inline]
    fn value(&self, text: &str) -> f64 {
        if !self.exact {
            let digits = text.get(self.start..self.end).unwrap_or_default();
            return digits.parse().unwrap_or(f64::NAN);
        }
        let mantissa = self.mantissa as f64;
        let power = POWERS[self.exponent.unsigned_abs() as usize];
        let value = if self.exponent < 0 {
            mantissa / power
        } else {
            mantissa * power
        };
        if self.negative { -value } else { value }
    }
}

/// The powers of ten that are exact floats.
const POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18,
    1e19, 1e20, 1e21, 1e22,
];

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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn decode(message: &str, value: &str, time: Option<&str>) -> Result<(Vec<f64>, Decoded), DecodeError> {
        let plan = JsonPlan::new(
            FieldPath::parse(value).unwrap(),
            time.map(|path| FieldPath::parse(path).unwrap()),
        );
        let mut out = Vec::new();
        let decoded = plan.decode(message.as_bytes(), 0, &mut out)?;
        Ok((out, decoded))
    }

    #[test]
    fn finds_fields_where_they_are() {
        let message = r#" {"header":{"stamp":{"sec":3,"nanosec":5}},"a":[1,{"b":[-2.5e-3, 4]}],"c":null} "#;
        assert_eq!(decode(message, "a[0]", None).unwrap().0, [1.0]);
        let (out, decoded) = decode(message, "a[1].b", Some("header.stamp")).unwrap();
        assert_eq!(out, [-2.5e-3, 4.0]);
        assert_eq!(decoded.time, Time::Nanos(3_000_000_005));
        assert!(decoded.array);
        assert!(decode(message, "c", None).unwrap().0[0].is_nan());
        assert_eq!(decode(r#"{"\u0061b":1}"#, "ab", None).unwrap().0, [1.0]);
    }

    #[test]
    fn says_what_is_there_instead() {
        let message = r#"{"header":{},"point":{"x":1,"y":[1,2]},"t":"2026-03-01T06:00:00Z"}"#;
        let told = |path| decode(message, path, None).unwrap_err().to_string();
        assert_eq!(told("z"), "no field `z`; there is: header, point, t");
        assert_eq!(told("point.z"), "no field `point.z`; there is: x, y");
        assert_eq!(told("point.y[5]"), "no field `point.y[5]`; there is: 2 items");
        assert_eq!(
            told("point"),
            "field `point` is an object, not a number or an array of numbers"
        );
        assert!(decode(message, "point.x", Some("t")).is_ok());
        assert!(decode(message, "point.x", Some("point.y")).is_err());
    }

    #[test]
    fn refuses_what_json_refuses() {
        for bad in [
            "",
            "{",
            "{\"v\":}",
            "{\"v\":1,}",
            "{\"v\":01}",
            "{\"v\":1.}",
            "{\"v\":.5}",
            "{\"v\":+1}",
            "{\"v\":1e}",
            "{\"v\":NaN}",
            "{\"v\":1}x",
            "{\"v\":1 \"w\":2}",
            "{\"v\":1,\"w\":\"\n\"}",
            "{\"v\":1,\"w\":\"\\x\"}",
            "{\"v\":1,\"w\":tru}",
            "{\"v\":[1,]}",
            "{\"v\":[1 2]}",
            "{\"v\":1,\"v\":2}",
            "{\"v\":1,\"w\":\"\\u12\"}",
        ] {
            assert!(decode(bad, "v", None).is_err(), "{bad}");
        }
        assert!(decode(&("[".repeat(1000) + &"]".repeat(1000)), "v", None).is_err());
        assert!(
            JsonPlan::new(FieldPath::parse("v").unwrap(), None)
                .decode(b"{\"v\":1,\"w\":\"\xff\"}", 0, &mut Vec::new())
                .is_err()
        );
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, cases: 2000, ..Default::default() })]

        /// The standard library reads every number to the same bits.
        #[test]
        fn numbers_are_rounded_correctly(text in "-?(0|[1-9][0-9]{0,20})(\\.[0-9]{1,22})?([eE][+-]?[0-9]{1,3})?") {
            let out = decode(&format!("{{\"v\":{text}}}"), "v", None).unwrap().0;
            prop_assert_eq!(out[0].to_bits(), text.parse::<f64>().unwrap().to_bits());
        }

        /// serde_json accepts the same texts, for any damage to a message.
        #[test]
        fn agrees_with_serde_json(at in 0usize..60, byte in 0u8..128, cut in 0usize..80) {
            let mut message = br#"{"v":[1.5,-2e3,null],"w":{"x":"a\n\u00e9","y":[true,false]},"z":0}"#.to_vec();
            message.truncate(cut.max(20));
            let at = at % message.len();
            message[at] = byte;
            let ours = JsonPlan::new(FieldPath::parse("v").unwrap(), None).decode(&message, 0, &mut Vec::new());
            let theirs = serde_json::from_slice::<serde_json::Value>(&message);
            // A field of the wrong type is reported before the rest is read.
            if matches!(ours, Ok(_) | Err(DecodeError::Missing { .. })) {
                prop_assert!(theirs.is_ok());
            }
            // A field that occurs twice is refused here; serde_json takes the last.
            let is_twice = message.windows(3).filter(|key| key == b"\"v\"").count() > 1;
            if theirs.is_ok() && !is_twice {
                prop_assert!(!matches!(ours, Err(DecodeError::Malformed(_))));
            }
        }
    }
}
