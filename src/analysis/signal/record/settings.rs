//! Settings of cutting samples into records and of refusing records.

use serde::Serialize;

/// Rule for where a record begins and ends.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case", tag = "cut")]
pub enum Cut {
    /// One record per file and rod; a gap still splits it. The excitation is recognised.
    Auto,
    /// One ambient record per file and rod; a gap still splits it.
    File,
    /// Fixed windows, aligned to the first sample. The motion in each is recognised.
    Window {
        /// Length of a window \[s\].
        length_s: f64,
    },
    /// A record starts at each onset of a free decay (a pull and release, a blow).
    FreeDecay {
        /// Ratio of the short-term to the long-term level that makes an onset \[-\].
        ratio: f64,
        /// Longest record \[s\]; a new onset ends the one before.
        length_s: f64,
    },
}

/// Settings of cutting samples into records and of refusing records.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RecordSettings {
    /// Rule for where a record begins and ends.
    pub cut: Cut,
    /// Shortest record that is analysed \[s\].
    pub min_duration_s: f64,
    /// Longest record held in memory \[s\]; a longer stretch is cut here.
    pub max_duration_s: f64,
    /// A hole between samples longer than this ends a record \[s\]; shorter ones are filled.
    pub max_gap_s: f64,
    /// Largest tolerated share of samples that are not finite or missing, filled by interpolation.
    pub max_missing: f64,
    /// Largest tolerated share of samples at the rails (clipped).
    pub max_clipped: f64,
    /// Largest tolerated share of samples that repeat their predecessor (held).
    pub max_held: f64,
    /// Largest tolerated jitter: standard deviation of stamps about a straight line, as a share of
    /// the sample interval.
    pub max_jitter: f64,
    /// Largest tolerated relative difference of declared and measured sample rate.
    pub max_rate_error: f64,
}

/// Longest record of a live stream, with [`Cut::Auto`] \[s\].
pub const STREAM_S: f64 = 600.0;

impl RecordSettings {
    /// Settings for a stream without end, live or from its journal: with [`Cut::Auto`] a record is
    /// [`STREAM_S`] long at most, so that a result is never an hour old.
    pub fn of_stream(self) -> Self {
        match self.cut {
            Cut::Auto => Self {
                max_duration_s: self.max_duration_s.min(STREAM_S.max(self.min_duration_s)),
                ..self
            },
            _ => self,
        }
    }
}

impl Default for RecordSettings {
    fn default() -> Self {
        Self {
            cut: Cut::Auto,
            min_duration_s: 10.0,
            max_duration_s: 3600.0,
            max_gap_s: 0.1,
            max_missing: 0.02,
            max_clipped: 0.001,
            max_held: 0.2,
            max_jitter: 0.5,
            max_rate_error: 0.001,
        }
    }
}
