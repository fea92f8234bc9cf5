//! A message between a site and the centre: the commits of one store as zstd JSON, with headers that place it.

use crate::site::hex::hex;
use crate::site::store::{Change, ChangedRow, FORMAT};
use async_nats::HeaderMap;
use rusqlite::types::Value;
use serde::{Deserialize, Serialize};
use serde_json::{Value as Json, json};
use std::io::Read;

/// Stream with what the sites send.
pub const STREAM: &str = "TIRANTE_OUT";
/// Subject of a site, without its name.
pub const OUT: &str = "tirante.v1.out";

/// Header: number of the last commit in the message.
const LAST: &str = "Tirante-N";
/// Header: number of the first.
const FIRST: &str = "Tirante-First";
/// Header: id of the store.
const EPOCH: &str = "Tirante-Epoch";
/// Header: format of the store.
const STORE_FORMAT: &str = "Tirante-Format";
/// Header: checksums of the last rows up to its last commit that never change.
const MARK: &str = "Tirante-Mark";
/// Header: condition that the server checks.
const EXPECTED: &str = "Nats-Expected-Last-Subject-Sequence";

/// Least limit on the size of a message, of server and stream \[bytes\].
pub const LEAST_MESSAGE: i32 = 1 << 20;

/// Largest content of a message without compression \[bytes\].
const LARGEST: usize = 32 << 20;
/// Level of the compression.
const LEVEL: i32 = 3;

/// Place of a message in the history of its site.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Label {
    /// Id of the store.
    pub epoch: String,
    /// Number of its first commit.
    pub first: i64,
    /// Number of its last.
    pub last: i64,
    /// Format of the store.
    pub format: i64,
    /// Checksums of the last rows up to its last commit that never change, which tell a store that was set back; empty in a message
    /// without them.
    pub mark: String,
}

/// Reason why a message is not read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MessageError {
    /// A header is missing or no value of its kind.
    #[error("its header {0} is missing or unreadable")]
    Header(&'static str),
    /// A newer program wrote it.
    #[error("it is of store format {0}, and this program knows {FORMAT}: update the hub first")]
    Newer(i64),
    /// The content is too large to be held in memory.
    #[error("its content has {0} bytes or more without compression, more than {LARGEST}")]
    Large(usize),
    /// The content cannot be read.
    #[error("its content cannot be read: {0}")]
    Content(String),
}

impl Label {
    /// Reads the headers of a message, of which `header` gives the value.
    ///
    /// # Errors
    /// One is missing, or no value of its kind.
    pub fn read<'h>(header: impl Fn(&'static str) -> Option<&'h str>) -> Result<Self, MessageError> {
        let text = |name: &'static str| header(name).ok_or(MessageError::Header(name));
        let number = |name: &'static str| {
            let number: i64 = text(name)?.parse().map_err(|_| MessageError::Header(name))?;
            (number > 0).then_some(number).ok_or(MessageError::Header(name))
        };
        let epoch = text(EPOCH)?;
        let is_id =
            !epoch.is_empty() && epoch.len() <= 64 && epoch.bytes().all(|b| b.is_ascii_alphanumeric());
        if !is_id {
            return Err(MessageError::Header(EPOCH));
        }
        let label = Self {
            epoch: epoch.to_owned(),
            first: number(FIRST)?,
            last: number(LAST)?,
            format: number(STORE_FORMAT)?,
            mark: header(MARK).unwrap_or_default().to_owned(),
        };
        if label.first > label.last {
            return Err(MessageError::Header(FIRST));
        }
        Ok(label)
    }

    /// Headers of a message that the server takes only after message `expected` of its subject. It has no `Nats-Msg-Id`: what
    /// the server takes for a repetition by its id is acknowledged without being kept.
    pub fn headers(&self, expected: u64) -> HeaderMap {
        let mut headers = HeaderMap::new();
        headers.insert(LAST, self.last.to_string().as_str());
        headers.insert(FIRST, self.first.to_string().as_str());
        headers.insert(EPOCH, self.epoch.as_str());
        headers.insert(STORE_FORMAT, self.format.to_string().as_str());
        headers.insert(MARK, self.mark.as_str());
        headers.insert(EXPECTED, expected.to_string().as_str());
        headers
    }
}

/// Rows of a commit: table and values.
type Rows = Vec<(String, Vec<Json>)>;

/// Content of a message.
#[derive(Debug, Serialize, Deserialize)]
struct Body {
    /// Commits in order, each with its number.
    commits: Vec<(i64, Rows)>,
}

/// Content of a message with these commits.
///
/// # Errors
/// It cannot be written as JSON, or would be too large.
pub fn encode(changes: &[Change]) -> Result<Vec<u8>, MessageError> {
    let row = |row: &ChangedRow| (row.table.clone(), row.values.iter().map(to_json).collect());
    let body = Body {
        commits: changes
            .iter()
            .map(|change| (change.number, change.rows.iter().map(row).collect()))
            .collect(),
    };
    let broken = |error: String| MessageError::Content(error);
    let text = serde_json::to_vec(&body).map_err(|error| broken(error.to_string()))?;
    if text.len() > LARGEST {
        return Err(MessageError::Large(text.len()));
    }
    zstd::encode_all(text.as_slice(), LEVEL).map_err(|error| broken(error.to_string()))
}

/// Commits of a message.
///
/// # Errors
/// It is of a newer format, too large, or no such content; its numbers are not those of the label.
pub fn decode(label: &Label, payload: &[u8]) -> Result<Vec<Change>, MessageError> {
    if label.format > FORMAT {
        return Err(MessageError::Newer(label.format));
    }
    let broken = |error: String| MessageError::Content(error);
    let mut text = Vec::new();
    zstd::Decoder::new(payload)
        .and_then(|decoder| decoder.take(LARGEST as u64 + 1).read_to_end(&mut text))
        .map_err(|error| broken(error.to_string()))?;
    if text.len() > LARGEST {
        return Err(MessageError::Large(text.len()));
    }
    let body: Body = serde_json::from_slice(&text).map_err(|error| broken(error.to_string()))?;
    let mut changes = Vec::new();
    // Up to the last one: a label may begin at the largest number there is.
    if label.last - label.first != i64::try_from(body.commits.len()).unwrap_or(i64::MAX) - 1 {
        let count = body.commits.len();
        return Err(broken(format!(
            "it holds {count} commits, not those from {} to {}",
            label.first, label.last
        )));
    }
    for (expected, (number, rows)) in (label.first..=label.last).zip(body.commits) {
        if number != expected {
            return Err(broken(format!(
                "commit {number} stands in the place of {expected}"
            )));
        }
        let rows: Result<Vec<ChangedRow>, MessageError> = rows
            .into_iter()
            .map(|(table, values)| {
                let values: Option<Vec<Value>> = values.into_iter().map(from_json).collect();
                let values = values.ok_or_else(|| broken(format!("a value of table {table}")))?;
                Ok(ChangedRow { table, values })
            })
            .collect();
        changes.push(Change { number, rows: rows? });
    }
    Ok(changes)
}

/// Bytes and infinities are objects of one key; everything else is JSON's own.
fn to_json(value: &Value) -> Json {
    match value {
        Value::Null => Json::Null,
        Value::Integer(number) => Json::from(*number),
        Value::Real(number) if number.is_finite() => Json::from(*number),
        Value::Real(number) => json!({ "real": if *number > 0.0 { "inf" } else { "-inf" } }),
        Value::Text(text) => Json::from(text.as_str()),
        Value::Blob(bytes) => json!({ "hex": hex(bytes) }),
    }
}

fn from_json(value: Json) -> Option<Value> {
    Some(match value {
        Json::Null => Value::Null,
        Json::Number(number) => match number.as_i64() {
            Some(integer) => Value::Integer(integer),
            None if number.is_f64() => Value::Real(number.as_f64()?),
            None => return None,
        },
        Json::String(text) => Value::Text(text),
        Json::Object(object) => match object.iter().next()? {
            (key, Json::String(text)) if key == "hex" => Value::Blob(from_hex(text)?),
            (key, Json::String(text)) if key == "real" && text == "inf" => Value::Real(f64::INFINITY),
            (key, Json::String(text)) if key == "real" && text == "-inf" => Value::Real(f64::NEG_INFINITY),
            _ => return None,
        },
        Json::Bool(_) | Json::Array(_) => return None,
    })
}

fn from_hex(text: &str) -> Option<Vec<u8>> {
    let digits: Option<Vec<u32>> = text.chars().map(|digit| digit.to_digit(16)).collect();
    let digits = digits.filter(|digits| digits.len().is_multiple_of(2))?;
    digits
        .chunks_exact(2)
        .map(|pair| u8::try_from(16 * pair[0] + pair[1]).ok())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn label(first: i64, last: i64) -> Label {
        Label {
            epoch: "00ff".to_owned(),
            first,
            last,
            format: FORMAT,
            mark: "1.22".to_owned(),
        }
    }

    fn changes() -> Vec<Change> {
        let values = vec![
            Value::Null,
            Value::Integer(i64::MIN),
            Value::Integer(1),
            Value::Real(1.0),
            Value::Real(0.1 + 0.2),
            Value::Real(f64::INFINITY),
            Value::Real(f64::NEG_INFINITY),
            Value::Real(f64::MIN_POSITIVE / 3.0),
            Value::Text("\"\u{0}ä".to_owned()),
            Value::Blob(vec![0, 255]),
        ];
        let row = |table: &str| ChangedRow {
            table: table.to_owned(),
            values: values.clone(),
        };
        (7..9)
            .map(|number| Change {
                number,
                rows: vec![row("record"), row("line")],
            })
            .collect()
    }

    #[test]
    fn commits_read_back_equal() {
        let sent = encode(&changes()).unwrap();
        assert_eq!(decode(&label(7, 8), &sent).unwrap(), changes());
    }

    #[test]
    fn what_is_not_as_labelled_is_refused() {
        let sent = encode(&changes()).unwrap();
        for wrong in [label(6, 8), label(7, 9), label(7, 7), label(8, 9)] {
            assert!(decode(&wrong, &sent).is_err(), "{wrong:?}");
        }
        let one = |number: i64| {
            let rows = Vec::new();
            [Change { number, rows }]
        };
        let most = i64::MAX;
        assert_eq!(
            decode(&label(most, most), &encode(&one(most)).unwrap()).unwrap(),
            one(most)
        );
        let none = encode(&[]).unwrap();
        for wrong in [label(most, most), label(1, most), label(7, 8)] {
            assert!(decode(&wrong, &none).is_err(), "{wrong:?}");
        }
        let newer = Label {
            format: FORMAT + 1,
            ..label(7, 8)
        };
        assert_eq!(decode(&newer, &sent), Err(MessageError::Newer(FORMAT + 1)));
        for broken in [&b""[..], b"nothing", &sent[..sent.len() - 5]] {
            assert!(matches!(
                decode(&label(7, 8), broken),
                Err(MessageError::Content(_))
            ));
        }
        let bomb = zstd::encode_all(vec![b' '; 80 << 20].as_slice(), 1).unwrap();
        assert!(decode(&label(7, 8), &bomb).is_err());
    }

    fn read(headers: &HeaderMap) -> Result<Label, MessageError> {
        Label::read(|name| headers.get(name).map(async_nats::HeaderValue::as_str))
    }

    #[test]
    fn a_label_reads_back_and_a_broken_one_is_named() {
        let headers = label(7, 8).headers(3);
        assert_eq!(read(&headers), Ok(label(7, 8)));
        assert_eq!(headers.get(EXPECTED).unwrap().as_str(), "3");
        for (name, wrong) in [
            (LAST, "6"),
            (LAST, "x"),
            (FIRST, "0"),
            (EPOCH, "../x"),
            (STORE_FORMAT, ""),
        ] {
            let mut headers = label(7, 8).headers(3);
            headers.insert(name, wrong);
            assert!(read(&headers).is_err(), "{name} {wrong}");
        }
        assert!(read(&HeaderMap::new()).is_err());
    }
}
