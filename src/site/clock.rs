//! The wall clock: the time of people's requests, never part of a result.

use crate::analysis::signal::record::Timestamp;
use std::time::SystemTime;

/// The present time; 1970 for a clock set before it.
pub fn now() -> Timestamp {
    let nanos = SystemTime::now()
        .duration_since(SystemTime::UNIX_EPOCH)
        .map_or(0, |since| i64::try_from(since.as_nanos()).unwrap_or(i64::MAX));
    Timestamp::from_nanos(nanos)
}
