//! A message of the stream as it comes, whatever its site wrote into it.

use super::park::Parked;
use crate::service::forward::message::{Label, MessageError, OUT};

/// A message of the stream.
#[derive(Debug, Clone)]
pub struct Incoming {
    /// Its number in the stream.
    pub sequence: i64,
    /// Its subject.
    pub subject: String,
    /// Its headers, one a line as `Name: value`.
    pub headers: String,
    /// Its content.
    pub payload: Vec<u8>,
    /// Time at which the server took it \[ns since 1970\].
    pub time_ns: i64,
}

impl Incoming {
    /// Site of the subject; the subject itself if it is no site's.
    pub fn site(&self) -> &str {
        self.subject
            .strip_prefix(OUT)
            .and_then(|rest| rest.strip_prefix('.'))
            .unwrap_or(&self.subject)
    }

    /// Its place in the history of its site.
    ///
    /// # Errors
    /// A header is missing, or no value of its kind.
    pub fn label(&self) -> Result<Label, MessageError> {
        let lines = || self.headers.lines().filter_map(|line| line.split_once(": "));
        Label::read(|name| lines().find(|(found, _)| *found == name).map(|(_, value)| value))
    }

    /// The message with the reason why it is parked.
    pub fn parked(&self, fault: &str, detail: String) -> Parked {
        Parked {
            sequence: self.sequence,
            site: self.site().to_owned(),
            time_ns: self.time_ns,
            fault: fault.to_owned(),
            detail,
            headers: self.headers.clone(),
            payload: self.payload.clone(),
        }
    }

    /// The message that was parked.
    pub fn of_parked(parked: Parked) -> Self {
        Self {
            sequence: parked.sequence,
            subject: format!("{OUT}.{}", parked.site),
            headers: parked.headers,
            payload: parked.payload,
            time_ns: parked.time_ns,
        }
    }
}
