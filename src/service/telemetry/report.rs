//! The state of health as `/healthz` shows it.

use serde::{Serialize, Serializer};

/// How far the daemon has come.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Phase {
    /// It is not ready yet; the text says what it does.
    Starting(&'static str),
    /// The store is open and the sources are live.
    Serving,
    /// It drains and ends.
    Stopping,
}

impl Default for Phase {
    fn default() -> Self {
        Self::Starting("the daemon starts")
    }
}

impl Phase {
    /// Whether it is not ready yet.
    pub fn is_starting(&self) -> bool {
        matches!(self, Self::Starting(_))
    }

    /// Why requests and data should not come yet, or any more; `None` while serving.
    pub fn not_ready(&self) -> Option<&'static str> {
        match self {
            Self::Starting(doing) => Some(doing),
            Self::Serving => None,
            Self::Stopping => Some("the daemon stops"),
        }
    }
}

impl Serialize for Phase {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(match self {
            Self::Starting(_) => "starting",
            Self::Serving => "serving",
            Self::Stopping => "stopping",
        })
    }
}

/// Everything in one word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// Not ready yet.
    Starting,
    /// Nothing is wrong, and nothing was for a quarter of an hour.
    Ok,
    /// A fault lasts, or one happened lately; results are made and kept.
    Degraded,
    /// Results are not made, or not kept.
    Failing,
}

impl State {
    /// Every state.
    pub const ALL: [Self; 4] = [Self::Starting, Self::Ok, Self::Degraded, Self::Failing];

    /// The name in JSON and metrics.
    pub fn code(self) -> &'static str {
        match self {
            Self::Starting => "starting",
            Self::Ok => "ok",
            Self::Degraded => "degraded",
            Self::Failing => "failing",
        }
    }
}

/// The state of health at one moment.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// In one word.
    pub state: State,
    /// How far the daemon has come.
    pub phase: Phase,
    /// Faults that last.
    pub conditions: Vec<ConditionLine>,
    /// Every kind of fault that happened since the start.
    pub faults: Vec<FaultLine>,
}

/// A fault that lasts.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ConditionLine {
    /// Its kind.
    pub fault: &'static str,
    /// What it is about.
    pub about: String,
    /// One sentence.
    pub detail: String,
    /// How long it has lasted \[s\].
    pub for_s: u64,
}

/// A kind of fault that happened.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FaultLine {
    /// Its kind.
    pub fault: &'static str,
    /// What that means.
    pub meaning: &'static str,
    /// How often.
    pub count: u64,
    /// How long ago the latest was \[s\].
    pub last_s_ago: Option<u64>,
    /// The latest, in one sentence.
    pub last: String,
}
