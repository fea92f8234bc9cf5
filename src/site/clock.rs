//! The machine's clock: for times of requests, messages and journal entries, never for results.

use crate::analysis::signal::record::Timestamp;
use std::time::SystemTime;

/// The present time; 1970 for a clock set before it.
pub fn now() -> Timestamp {
    Timestamp::from_nanos(i64::try_from(now_ns()).unwrap_or(i64::MAX))
}

/// Seconds since 1970; 0 for a clock set before that.
pub fn now_s() -> i64 {
    i64::try_from(now_ns() / 1_000_000_000).unwrap_or(i64::MAX)
}

/// Nanoseconds since 1970; 0 for a clock set before that.
pub fn now_ns() -> u64 {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    since.map_or(0, |since| u64::try_from(since.as_nanos()).unwrap_or(u64::MAX))
}

/// Lead over the present beyond which a record was dated by a wrong clock \[s\].
const AHEAD_S: f64 = 86_400.0;

/// Latest time that a record taken by `now` can have.
pub fn latest_past(now: Timestamp) -> Timestamp {
    now.plus_seconds(AHEAD_S)
}
