//! The place in a recording at which an event was complete.

use crate::analysis::signal::record::Timestamp;
use crate::analysis::track::ordered::Reached;
use std::sync::Arc;

/// Where in its recording a record ended.
#[derive(Debug, Clone)]
pub struct Place {
    /// The recording's name.
    pub file: Arc<str>,
    /// Bytes read.
    pub bytes: u64,
    /// Records found.
    pub records: u64,
    /// When the event was complete, by the rod's own stamps.
    pub at: Timestamp,
    /// Times up to which the rods had been followed then.
    pub reached: Reached,
}
