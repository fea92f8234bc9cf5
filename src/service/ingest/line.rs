//! One JSON line of a client: a hello, an end, or a sample.

use crate::recording::read::stamp;
use serde::Deserialize;
use serde_json::Value;

/// A JSON line of a client.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Line {
    /// Hello: the client gives its name and wants to resume.
    Hello(String),
    /// The stream ends.
    End,
    /// Data of a topic.
    Data {
        /// Topic of the data.
        topic: String,
        /// Time of measurement \[ns since 1970\]; `None` for now.
        time: Option<u64>,
    },
}

#[derive(Deserialize)]
struct Keys {
    topic: Option<String>,
    time: Option<Value>,
    hello: Option<Value>,
    end: Option<Value>,
}

/// Parses a line.
///
/// # Errors
/// The fault, as text after "line N".
pub fn parse(line: &[u8]) -> Result<Line, String> {
    let keys: Keys = serde_json::from_slice(line).map_err(|fault| {
        let what = fault.to_string().replace(" at line 1 column ", " at column ");
        format!("cannot be read: {what}")
    })?;
    match keys {
        Keys {
            topic: Some(topic),
            time,
            ..
        } => Ok(Line::Data {
            topic,
            time: nanos(time.as_ref())?,
        }),
        Keys {
            hello: Some(hello), ..
        } => sender(&hello).map(Line::Hello),
        Keys {
            end: Some(Value::Bool(true)),
            ..
        } => Ok(Line::End),
        _ => Err("has no \"topic\"".to_owned()),
    }
}

fn sender(hello: &Value) -> Result<String, String> {
    let name = hello.get("sender").and_then(Value::as_str).unwrap_or_default();
    let is_name = (1..=64).contains(&name.len())
        && name
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte));
    if is_name {
        Ok(name.to_owned())
    } else {
        Err("says hello without a good name: {\"hello\":{\"sender\":\"…\"}} with 1 to 64 letters, digits, '-', '_' and '.'".to_owned())
    }
}

fn nanos(time: Option<&Value>) -> Result<Option<u64>, String> {
    let nanos = match time {
        None | Some(Value::Null) => return Ok(None),
        Some(Value::Number(number)) => number.as_i64(),
        Some(Value::String(text)) => stamp::from_text(text),
        Some(_) => None,
    };
    match nanos.map(u64::try_from) {
        Some(Ok(nanos)) => Ok(Some(nanos)),
        _ => Err("has a \"time\" that is neither like \"2026-03-01T06:00:00.005Z\" nor whole nanoseconds since 1970 (1970 to 2262)".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_of_line() {
        let data = |topic: &str, time| {
            Ok(Line::Data {
                topic: topic.to_owned(),
                time,
            })
        };
        assert_eq!(parse(br#"{"topic":"/a","value":1}"#), data("/a", None));
        assert_eq!(
            parse(br#"{"value":1,"time":5,"topic":"/a"}"#),
            data("/a", Some(5))
        );
        assert_eq!(
            parse(br#"{"topic":"/a","time":"1970-01-01T00:00:01.5Z"}"#),
            data("/a", Some(1_500_000_000))
        );
        assert_eq!(
            parse(br#" {"topic":"/a","time":null,"hello":1,"end":2} "#),
            data("/a", None)
        );
        assert_eq!(parse(br#"{"end":true}"#), Ok(Line::End));
        assert_eq!(
            parse(br#"{"hello":{"sender":"north-laser_1.b"}}"#),
            Ok(Line::Hello("north-laser_1.b".to_owned()))
        );
    }

    #[test]
    fn what_cannot_be_meant_is_refused() {
        let nested = "[".repeat(100_000);
        for line in [
            "",
            "{",
            "[]",
            "{}",
            "nothing",
            "{\"end\":false}",
            "{\"topic\":1}",
            "{\"topic\":\"/a\",\"value\":NaN}",
            "{\"topic\":\"/a\",\"time\":-1}",
            "{\"topic\":\"/a\",\"time\":1.5}",
            "{\"topic\":\"/a\",\"time\":\"2026-03-01\"}",
            "{\"topic\":\"/a\",\"time\":[]}",
            "{\"topic\":\"/a\"} {}",
            "{\"hello\":{\"sender\":\"\"}}",
            "{\"hello\":{\"sender\":\"a b\"}}",
            "{\"hello\":1}",
            "{\"topic\":\"/a\",\"topic\":\"/b\"}",
            &format!("{{\"topic\":\"/a\",\"x\":{nested}"),
            &format!("{{\"hello\":{{\"sender\":\"{}\"}}}}", "a".repeat(65)),
        ] {
            assert!(parse(line.as_bytes()).is_err(), "{line}");
        }
        assert!(parse(b"{\"topic\":\"\xff\"}").is_err());
    }
}
