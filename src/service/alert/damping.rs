//! Alarms about the measurement that come and go: the more often one was raised within a day, the longer its messages wait to be sent
//! together.

use crate::analysis::signal::record::Timestamp;
use crate::analysis::track::alarm::{Alarm, Kind, What};
use crate::site::store::{Filter, News, Reader, StoreError};
use std::time::Duration;

/// Time over which alarms of a rod and kind are counted \[s\].
const DAY_S: f64 = 86_400.0;
/// Alarms within a day whose messages are not delayed.
const PROMPT: usize = 2;
/// Longest delay.
const LONGEST: Duration = Duration::from_secs(4 * 3600);

/// Number of times that an alarm's rod and kind were raised within the day up to it; 1 where it is not damped: a word about the
/// force, and what a person did, never waits.
///
/// # Errors
/// The store cannot be read.
pub(super) fn raises(reader: &Reader, news: &News) -> Result<usize, StoreError> {
    let Alarm {
        rod, kind, raised, ..
    } = &news.event.alarm;
    let is_of_measurement = matches!(kind, Kind::NoData | Kind::Sensor | Kind::OutsideTraining);
    if !is_of_measurement || !matches!(news.event.what, What::Raised | What::Cleared) {
        return Ok(1);
    }
    let of_the_day = Filter {
        rod: Some(rod.clone()),
        from: Some(raised.plus_seconds(-DAY_S)),
        to: Some(Timestamp::from_nanos(raised.as_nanos().saturating_add(1))),
    };
    let alarms = reader.alarms(&of_the_day)?;
    Ok(alarms.iter().filter(|alarm| alarm.kind == *kind).count())
}

/// Time for which a message waits: `group`, and four times as long with each alarm after the second.
pub(super) fn wait(group: Duration, raises: usize) -> Duration {
    let more = u32::try_from(raises.saturating_sub(PROMPT)).map_or(15, |more| more.min(15));
    group.max(group.saturating_mul(4_u32.pow(more)).min(LONGEST))
}

/// Remark in the message of an alarm that was raised so often that it waited.
pub(super) fn remark(raises: usize) -> Option<String> {
    (raises > PROMPT)
        .then(|| format!(" (number {raises} within a day: its messages wait to be sent together)"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_comes_and_goes_waits_ever_longer_and_never_for_more_than_four_hours() {
        let group = Duration::from_secs(60);
        let waits: Vec<u64> = [0, 1, 2, 3, 4, 5, 6, 1000]
            .map(|raises| wait(group, raises).as_secs())
            .to_vec();
        assert_eq!(waits, [60, 60, 60, 240, 960, 3840, 14_400, 14_400]);
        let long = Duration::from_secs(86_400);
        assert_eq!(wait(long, 1000), long, "never less than asked for");
        assert_eq!(remark(PROMPT), None);
        assert!(remark(3).is_some_and(|remark| remark.contains("number 3")));
    }
}
