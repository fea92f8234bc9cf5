//! An event of a rod's stream: a record, a stretch that gives none, readings, or a moment of several sensors.

use super::{Envelope, Moment, Reading, Record, Rejection, RodId, Timestamp};

/// Result of a stretch of samples.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// A record.
    Record(Record),
    /// A stretch that gives no record.
    Rejected {
        /// Id of the rod.
        rod: RodId,
        /// Time of its first sample, if stamped.
        start: Option<Timestamp>,
        /// Length of the stretch \[s\].
        duration_s: f64,
        /// Sample rate \[Hz\], if it could be measured.
        fs_hz: Option<f64>,
        /// Envelope of its samples for drawing, if it has any at even times.
        waveform: Option<Envelope>,
        /// Reason why it is no record.
        rejection: Rejection,
    },
    /// Temperatures at the end of the stream that belong to no record.
    Readings {
        /// Id of the rod.
        rod: RodId,
        /// Ascending in time.
        readings: Vec<Reading>,
    },
    /// Events of one moment from several sensors of a rod.
    Moment(Moment),
}

impl Event {
    /// Id of the rod.
    pub fn rod(&self) -> &RodId {
        match self {
            Self::Record(record) => &record.rod,
            Self::Rejected { rod, .. } | Self::Readings { rod, .. } => rod,
            Self::Moment(moment) => &moment.rod,
        }
    }

    /// Its record, or the first of its moment.
    pub fn record(&self) -> Option<&Record> {
        match self {
            Self::Record(record) => Some(record),
            Self::Moment(moment) => moment.records().next().map(|(_, record)| record),
            Self::Rejected { .. } | Self::Readings { .. } => None,
        }
    }

    /// Of a moment the first record, or else the first refused stretch; any other event as it is.
    pub fn into_first(self) -> Self {
        let Self::Moment(Moment { rod, mut seen, .. }) = self else {
            return self;
        };
        let first = seen
            .iter()
            .position(|(_, event)| matches!(event, Self::Record(_)))
            .unwrap_or(0);
        match first < seen.len() {
            true => seen.swap_remove(first).1,
            false => Self::Readings {
                rod,
                readings: Vec::new(),
            },
        }
    }

    /// Number of samples of its records.
    pub fn samples(&self) -> usize {
        match self {
            Self::Record(record) => record.samples.len(),
            Self::Moment(moment) => moment.records().map(|(_, record)| record.samples.len()).sum(),
            Self::Rejected { .. } | Self::Readings { .. } => 0,
        }
    }
}
