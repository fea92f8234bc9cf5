//! Holes of a recording: damage between two intact places.

use std::collections::BTreeSet;
use tirante_analysis::signal::record::Timestamp;

/// Most topics named in a sentence.
const NAMED: usize = 8;

/// Damage in the middle of a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Hole {
    /// Begin in the file \[bytes\].
    pub offset: u64,
    /// Description of the fault.
    pub what: String,
    /// Log times of the first and the last message lost, if known.
    pub span: Option<(Timestamp, Timestamp)>,
    /// Channels that lost messages; empty: unknown.
    pub channels: BTreeSet<u16>,
    /// True if messages are lost, or may be.
    pub is_loss: bool,
}

impl Hole {
    /// A hole of messages logged from the first of `span` to the second \[ns since 1970\].
    pub fn new(offset: u64, what: String, span: Option<(u64, u64)>) -> Self {
        let time = |nanos: u64| i64::try_from(nanos).ok().map(Timestamp::from_nanos);
        let span = span
            .filter(|(from, to)| from <= to && *to > 0)
            .and_then(|(from, to)| time(from).zip(time(to)));
        Self {
            offset,
            what,
            span,
            channels: BTreeSet::new(),
            is_loss: true,
        }
    }

    /// Damage that cost no message.
    pub fn without_loss(offset: u64, what: String) -> Self {
        Self {
            is_loss: false,
            ..Self::new(offset, what, None)
        }
    }

    /// Time of the first message lost.
    pub fn start(&self) -> Option<Timestamp> {
        self.span.map(|(from, _)| from)
    }

    /// Time from the first lost message to the last \[s\]; 0 if unknown.
    pub fn duration_s(&self) -> f64 {
        self.span.map_or(0.0, |(from, to)| to.seconds_since(from))
    }

    /// One clause with place, fault, time and topics.
    pub fn sentence<'a>(&self, topics: impl ExactSizeIterator<Item = &'a str>) -> String {
        let Self { offset, what, .. } = self;
        if !self.is_loss {
            return format!("at byte {offset}: {what}; no message is lost by it");
        }
        let when = match &self.span {
            Some((from, to)) => format!("from {from} to {to}"),
            None => "there".to_owned(),
        };
        let more = topics.len().saturating_sub(NAMED);
        let mut named: Vec<String> = topics.take(NAMED).map(str::to_owned).collect();
        if more > 0 {
            named.push(format!("{more} more"));
        }
        let whose = match named.is_empty() {
            true => String::new(),
            false => format!(" on {}", named.join(", ")),
        };
        format!("at byte {offset}: {what}; what was logged {when}{whose} is lost")
    }
}
