//! What the clock says: the time people's requests carry, never a result.

use crate::analysis::signal::record::Timestamp;
use std::time::SystemTime;

/// Now; 1970 for a clock that stands before it.
pub fn now() -> Timestamp {
    let nanos = SystemTime::now()
        .duration_since(SystemTime::UNIX_EPOCH)
        .map_or(0, |since| i64::try_from(since.as_nanos()).unwrap_or(i64::MAX));
    Timestamp::from_nanos(nanos)
}
