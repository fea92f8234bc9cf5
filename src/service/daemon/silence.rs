//! Time without data of each rod, by a monotonic clock.

use crate::analysis::signal::record::time::DAY_S;
use crate::analysis::signal::record::{RodId, Timestamp};
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Longest silence before the start that can be a sensor's \[s\]; a longer one is that of an old campaign.
const OLD_S: f64 = 90.0 * DAY_S;

/// Time without data of each rod.
///
/// While the daemon runs, the monotonic clock counts from the rod's last commit, so that a wall clock set forward or
/// back raises nothing. Only for the time before the start the wall clock is used.
#[derive(Debug, Default)]
pub struct Silence {
    rods: BTreeMap<RodId, Since>,
}

#[derive(Debug, Clone, Copy)]
struct Since {
    /// Silence reached at `instant` \[s\].
    before_s: f64,
    instant: Instant,
}

impl Silence {
    /// Begins to count for a rod, unless it does already; `latest` is its last record, `wall` the time of
    /// day.
    pub fn begin(&mut self, rod: &RodId, latest: Option<Timestamp>, wall: Timestamp, now: Instant) {
        let before_s = latest
            .map(|latest| wall.seconds_since(latest))
            .filter(|before_s| (0.0..=OLD_S).contains(before_s));
        self.rods.entry(rod.clone()).or_insert(Since {
            before_s: before_s.unwrap_or(0.0),
            instant: now,
        });
    }

    /// Ends the silence of a rod of which a record was taken.
    pub fn end(&mut self, rod: &RodId, now: Instant) {
        if let Some(since) = self.rods.get_mut(rod) {
            *since = Since {
                before_s: 0.0,
                instant: now,
            };
        }
    }

    /// Subtracts a time during which no data could be taken.
    pub fn forgive(&mut self, deaf: Duration) {
        for since in self.rods.values_mut() {
            since.instant += deaf;
        }
    }

    /// Rods with the length of their silence \[s\].
    pub fn lasts(&self, now: Instant) -> impl Iterator<Item = (&RodId, f64)> {
        self.rods.iter().map(move |(rod, since)| {
            let lasts = now.saturating_duration_since(since.instant);
            (rod, since.before_s + lasts.as_secs_f64())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn first(silence: &Silence, now: Instant) -> f64 {
        silence.lasts(now).next().unwrap().1
    }

    #[test]
    fn silence_before_the_start_counts_unless_the_campaign_is_old_or_the_clock_wrong() {
        let (rod, now) = (RodId("north".into()), Instant::now());
        let wall = Timestamp::from_nanos(1_800_000_000_000_000_000);
        let began = |latest: Option<f64>| {
            let mut silence = Silence::default();
            let latest = latest.map(|ago_s| wall.plus_seconds(-ago_s));
            silence.begin(&rod, latest, wall, now);
            first(&silence, now + Duration::from_secs(5))
        };
        assert_eq!(began(Some(3600.0)), 3605.0);
        assert_eq!(began(Some(100.0 * DAY_S)), 5.0);
        assert_eq!(began(Some(-3600.0)), 5.0);
        assert_eq!(began(None), 5.0);
    }

    #[test]
    fn a_record_ends_it_and_a_reload_does_not() {
        let (rod, now) = (RodId("north".into()), Instant::now());
        let wall = Timestamp::from_nanos(1_800_000_000_000_000_000);
        let mut silence = Silence::default();
        silence.begin(&rod, Some(wall.plus_seconds(-60.0)), wall, now);
        silence.end(&rod, now + Duration::from_secs(10));
        assert_eq!(first(&silence, now + Duration::from_secs(12)), 2.0);
        silence.begin(
            &rod,
            Some(wall),
            wall.plus_seconds(1e6),
            now + Duration::from_secs(20),
        );
        assert_eq!(first(&silence, now + Duration::from_secs(30)), 20.0);
        silence.forgive(Duration::from_secs(15));
        assert_eq!(first(&silence, now + Duration::from_secs(30)), 5.0);
        assert_eq!(first(&silence, now + Duration::from_secs(20)), 0.0);
    }
}
