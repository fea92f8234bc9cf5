//! Reads one field of a JSON message without building the message.
//!
//! One pass over the bytes checks the whole message against RFC 8259 and picks up the numbers at the
//! path on the way; nothing is allocated for the rest. Numbers are rounded correctly.

mod number;
mod scan;

use super::decode::{DecodeError, Decoded, Time};
use super::path::{FieldPath, Step};
use scan::{Fault, Scan};

/// Longest message whose content is shown in errors \[bytes\]: it is built as a value, which takes many times its text.
const MAX_SHOWN: usize = 64 << 10;

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
