//! Answers of the daemon to a client: one JSON object per line.

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::fmt;
use std::str::FromStr;

/// Answer of the daemon to a client.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Reply {
    /// To a hello: the sender continues with this message, counted from 0.
    Welcome {
        /// Name of the sender.
        sender: String,
        /// Number of messages that need not be sent again.
        messages: u64,
    },
    /// Number of messages of this sender's stream that are durable.
    Ack {
        /// Number of messages.
        messages: u64,
    },
    /// A stream that ended is durable as a whole, except for messages left out.
    Done {
        /// Number of messages, those left out included.
        messages: u64,
        /// Messages of this connection that were not kept.
        left_out: Vec<LeftOut>,
    },
    /// Messages are not kept, and the stream goes on; sent with the first of them.
    LeftOut(LeftOut),
    /// The connection is closed.
    Error {
        /// Reason.
        reason: String,
        /// True if the same may succeed later.
        again: bool,
    },
}

/// Messages that are not kept.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeftOut {
    /// Number of messages.
    pub messages: u64,
    /// Reason.
    pub reason: String,
}

impl fmt::Display for Reply {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let value = match self {
            Self::Welcome { sender, messages } => {
                json!({"welcome": {"sender": sender, "messages": messages}})
            }
            Self::Ack { messages } => json!({"ack": {"messages": messages}}),
            Self::Done { messages, left_out } if left_out.is_empty() => {
                json!({"done": {"messages": messages}})
            }
            Self::Done { messages, left_out } => {
                json!({"done": {"messages": messages, "left_out": left_out}})
            }
            Self::LeftOut(left_out) => json!({"left_out": left_out}),
            Self::Error { reason, again: false } => json!({"error": reason}),
            Self::Error { reason, again: true } => json!({"error": reason, "again": true}),
        };
        write!(f, "{value}")
    }
}

/// A line that is no answer of this program.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}", words(.0))]
pub struct Unknown(String);

/// First bytes of an alert of TLS, without the last byte of the version.
const TLS_ALERT: &str = "\u{15}\u{3}";

fn words(line: &str) -> String {
    if line.starts_with(TLS_ALERT) {
        return "this port speaks TLS: say --tls-ca CA.pem, with the certificate of its authority".to_owned();
    }
    format!("`{}` is no answer of `tirante run`", line.escape_debug())
}

impl FromStr for Reply {
    type Err = Unknown;

    fn from_str(line: &str) -> Result<Self, Unknown> {
        let unknown = || Unknown(line.chars().take(80).collect());
        let value: Value = serde_json::from_str(line).map_err(|_| unknown())?;
        let messages = |of: &Value| of.get("messages").and_then(Value::as_u64).ok_or_else(unknown);
        if let Some(welcome) = value.get("welcome") {
            let sender = welcome
                .get("sender")
                .and_then(Value::as_str)
                .unwrap_or_default()
                .to_owned();
            return Ok(Self::Welcome {
                sender,
                messages: messages(welcome)?,
            });
        }
        if let Some(ack) = value.get("ack") {
            return Ok(Self::Ack {
                messages: messages(ack)?,
            });
        }
        if let Some(done) = value.get("done") {
            let left_out = match done.get("left_out") {
                Some(list) => Vec::deserialize(list).map_err(|_| unknown())?,
                None => Vec::new(),
            };
            return Ok(Self::Done {
                messages: messages(done)?,
                left_out,
            });
        }
        if let Some(left_out) = value.get("left_out") {
            let left_out = LeftOut::deserialize(left_out).map_err(|_| unknown())?;
            return Ok(Self::LeftOut(left_out));
        }
        let reason = value
            .get("error")
            .and_then(Value::as_str)
            .ok_or_else(unknown)?
            .to_owned();
        let again = value.get("again").and_then(Value::as_bool).unwrap_or(false);
        Ok(Self::Error { reason, again })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_said_is_understood() {
        for (reply, text) in [
            (
                Reply::Welcome {
                    sender: "a".into(),
                    messages: 3,
                },
                r#"{"welcome":{"messages":3,"sender":"a"}}"#,
            ),
            (Reply::Ack { messages: 3 }, r#"{"ack":{"messages":3}}"#),
            (
                Reply::Done {
                    messages: 3,
                    left_out: Vec::new(),
                },
                r#"{"done":{"messages":3}}"#,
            ),
            (
                Reply::Done {
                    messages: 3,
                    left_out: vec![LeftOut {
                        messages: 1,
                        reason: "large".into(),
                    }],
                },
                r#"{"done":{"left_out":[{"messages":1,"reason":"large"}],"messages":3}}"#,
            ),
            (
                Reply::LeftOut(LeftOut {
                    messages: 2,
                    reason: "large".into(),
                }),
                r#"{"left_out":{"messages":2,"reason":"large"}}"#,
            ),
            (
                Reply::Error {
                    reason: "a \"b\"\n".into(),
                    again: false,
                },
                r#"{"error":"a \"b\"\n"}"#,
            ),
            (
                Reply::Error {
                    reason: "c".into(),
                    again: true,
                },
                r#"{"again":true,"error":"c"}"#,
            ),
        ] {
            assert_eq!(reply.to_string(), text);
            assert_eq!(text.parse(), Ok(reply));
        }
        assert!("220 smtp ready".parse::<Reply>().is_err() && "{\"ack\":{}}".parse::<Reply>().is_err());
    }
}
