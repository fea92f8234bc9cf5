//! The place in a recording at which an event was complete.

use std::sync::Arc;
use tirante_analysis::signal::record::Timestamp;
use tirante_analysis::track::ordered::Reached;

/// Place of a record's end in its recording.
#[derive(Debug, Clone)]
pub struct Place {
    /// Name of the recording that was read when it was complete.
    pub file: Arc<str>,
    /// Name of the recording that holds its last sample: the one before, where the next one's first samples complete it.
    pub origin: Arc<str>,
    /// Number of bytes read.
    pub bytes: u64,
    /// Number of records found.
    pub records: u64,
    /// Completion time of the event, by the rod's own stamps.
    pub at: Timestamp,
    /// Times up to which each rod had been read by then.
    pub reached: Reached,
}
