//! The state of health as `/healthz` shows it.

use serde::{Serialize, Serializer};

/// Phase of the daemon.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Phase {
    /// Not ready yet; the text names the present step.
    Starting(&'static str),
    /// The store is open and the sources are live.
    Serving,
    /// Drains and ends.
    Stopping,
}

impl Default for Phase {
    fn default() -> Self {
        Self::Starting("the daemon starts")
    }
}

impl Phase {
    /// True if it is not ready yet.
    pub fn is_starting(&self) -> bool {
        matches!(self, Self::Starting(_))
    }

    /// Reason why requests and data should not come yet, or no more; `None` while serving.
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

/// State of health in one word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// Not ready yet.
    Starting,
    /// No fault, and none for a quarter of an hour.
    Ok,
    /// A fault lasts, or one happened lately; results are made and kept.
    Degraded,
    /// Results are not made, or not kept.
    Failing,
}

impl State {
    /// Every state.
    pub const ALL: [Self; 4] = [Self::Starting, Self::Ok, Self::Degraded, Self::Failing];

    /// Name in JSON and metrics.
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
    /// State in one word.
    pub state: State,
    /// Phase of the daemon.
    pub phase: Phase,
    /// Lasting faults.
    pub conditions: Vec<ConditionLine>,
    /// Every kind of fault that happened since the start.
    pub faults: Vec<FaultLine>,
}

/// A lasting fault.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ConditionLine {
    /// Kind of the fault.
    pub fault: &'static str,
    /// Subject: a sink, a folder, a file.
    pub about: String,
    /// Description in one sentence.
    pub detail: String,
    /// Time since its begin \[s\].
    pub for_s: u64,
}

/// A kind of fault that happened.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FaultLine {
    /// Kind of the fault.
    pub fault: &'static str,
    /// Meaning of the fault.
    pub meaning: &'static str,
    /// Number of occurrences.
    pub count: u64,
    /// Time since the latest \[s\].
    pub last_s_ago: Option<u64>,
    /// Description of the latest, in one sentence.
    pub last: String,
}
