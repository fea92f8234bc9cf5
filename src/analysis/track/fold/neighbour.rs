//! A rod's state as the other rods of its site see it.

use super::state::State;
use crate::signal::record::Timestamp;
use crate::track::alarm::{Alarm, Cause, Kind};
use crate::track::drift::companions::FORGOTTEN;
use crate::track::drift::others::{DEVIATING_SD, MOVING, Neighbour};
use crate::track::drift::period::{self, Charted, Pending, Period};
use crate::track::drift::watch::{DriftWatch, Witness};

/// Periods after an alarm within which the size of its change may be unknown: a large one is sure within three.
const DOUBT_PERIODS: i64 = 5;

/// Distances between the latest periods of which the median is usual: most of them are of the rhythm in which it is measured now.
const DISTANCES: usize = 9;

impl Neighbour for State {
    fn name(&self) -> &str {
        &self.rod.0
    }

    fn ratio_in(&self, index: i64, period_s: f64) -> Option<f64> {
        let of = |period: &Period| period.index.cmp(&index);
        if let Ok(place) = self.periods.binary_search_by(of) {
            return Some(self.periods[place].delta);
        }
        let within = |pending: &&Pending| period::index_of(pending.start, period_s) == index;
        let (mut weight, mut sum) = (0.0, 0.0);
        for pending in self.open.iter().filter(within) {
            let w = 1.0 / (pending.sd * pending.sd);
            weight += w;
            sum += w * pending.delta;
        }
        (weight > 0.0).then(|| sum / weight)
    }

    fn latest_deviations(&self, since: f64) -> [Option<(f64, f64)>; 2] {
        let compensated = |charted: &Charted| charted.evidence.compensated.is_some();
        let is_later = |time: Timestamp| time.days() > since;
        let closed = self
            .periods
            .last()
            .filter(|period| is_later(period.start))
            .and_then(|period| {
                let charted = period.charted.filter(compensated)?;
                Some((period.delta - charted.expected, charted.expected_sd))
            });
        let open = self
            .open
            .last()
            .filter(|pending| is_later(pending.start))
            .and_then(|pending| {
                let law = self.thermal_law(pending)?;
                Some((pending.delta - law.mean, law.sd))
            });
        [closed, open]
    }

    fn latest_record(&self) -> Option<(Timestamp, f64)> {
        let open = self.open.last().map(|pending| (pending.start, pending.delta));
        self.doubted
            .map(|doubted| (doubted.start, doubted.delta))
            .or(open)
    }

    fn doubted_loss(&self) -> Option<(Timestamp, f64, f64)> {
        let doubted = self.doubted?;
        let (mean, sd) = doubted.loss?;
        Some((doubted.start, mean, sd))
    }

    fn last_period(&self) -> Option<i64> {
        self.closed
    }

    fn usual_distance(&self) -> i64 {
        let latest = &self.periods[self.periods.len().saturating_sub(DISTANCES + 1)..];
        let mut distances: Vec<i64> = latest
            .windows(2)
            .map(|pair| pair[1].index - pair[0].index)
            .collect();
        distances.sort_unstable();
        distances
            .get(distances.len() / 2)
            .map_or(1, |usual| (*usual).max(1))
    }

    fn evidence(&self, since: Option<f64>) -> f64 {
        self.watch.get().map_or(0.0, |watch| watch.evidence(since))
    }

    fn evidence_alone(&self, since: Option<f64>) -> f64 {
        self.watch.get().map_or(0.0, |watch| watch.evidence_alone(since))
    }

    fn size(&self) -> f64 {
        self.watch.get().map_or(0.0, DriftWatch::size)
    }

    fn moved_alone(&self, since: f64) -> f64 {
        let Some(watch) = self.watch.get() else { return 0.0 };
        if watch.evidence_alone(Some(since)) > MOVING {
            return watch.size_alone(since).unwrap_or(0.0);
        }
        let [_, open] = self.latest_deviations(since);
        let off = open.filter(|(off, sd)| off.abs() > DEVIATING_SD * sd);
        off.map_or(0.0, |(off, _)| off)
    }

    fn slope_per_k(&self) -> Option<f64> {
        Some(self.watch.get()?.slope()?.0)
    }

    fn moved_beside_others(&self) -> f64 {
        self.watch.get().map_or(0.0, DriftWatch::moved_beside_others)
    }

    fn is_in_doubt(&self, index: i64, period_s: f64) -> bool {
        let knows_size = self.watch.get().is_some_and(DriftWatch::knows_what_moved);
        let is_doubtful = |alarm: &Alarm| {
            let periods = index.saturating_sub(period::index_of(alarm.raised, period_s));
            let most = match alarm.kind {
                Kind::Suspected => i64::MAX,
                Kind::Limit
                    if !knows_size && !self.drifts() && self.is_followed_briefly_since(alarm.raised) =>
                {
                    i64::MAX
                }
                Kind::Drift | Kind::NotAxial | Kind::Limit if !knows_size => DOUBT_PERIODS,
                _ => return false,
            };
            alarm.cleared.is_none() && (-(FORGOTTEN as i64)..=most).contains(&periods)
        };
        self.alarms.iter().any(is_doubtful)
    }

    fn drifts(&self) -> bool {
        self.holds(Kind::Drift) || self.watches.stands(Cause::Pattern)
    }

    fn drifts_in(&self, index: i64, period_s: f64) -> bool {
        let began = |alarm: &Alarm| {
            let onset = alarm.change.as_ref().map(|change| change.onset_q025);
            period::index_of(onset.unwrap_or(alarm.raised), period_s)
        };
        let is_change =
            |alarm: &&Alarm| alarm.cleared.is_none() && matches!(alarm.kind, Kind::Drift | Kind::NotAxial);
        let onset = self.alarms.iter().filter(is_change).map(began).min();
        self.drifts() && onset.is_none_or(|onset| index >= onset)
    }

    fn has_baseline(&self) -> bool {
        self.segment.baseline.is_some()
    }

    fn is_confirmed(&self) -> bool {
        let by_others = [Some(Witness::Confirmed), Some(Witness::Peers)];
        let mut standing = self.alarms.iter().filter(|alarm| alarm.cleared.is_none());
        standing.any(|alarm| by_others.contains(&alarm.witness))
    }

    fn has_moved_with_others(&self) -> bool {
        self.holds(Kind::Common)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::record::RodId;

    /// Periods before a change hold none of it: rods ask for them when others join.
    #[test]
    fn alarms_count_for_the_periods_of_their_change() {
        const DAY_S: f64 = 86_400.0;
        let rod = RodId(String::from("a"));
        let of = |kind| {
            let mut state = State::new(rod.clone(), String::new());
            let raised = Timestamp::from_nanos(50 * 86_400_000_000_000);
            let alarm = Alarm::new(&rod, kind, 1, raised, String::new());
            state.alarms.push(alarm);
            state
        };
        let doubtful =
            |state: &State| -> Vec<i64> { (0..90).filter(|day| state.is_in_doubt(*day, DAY_S)).collect() };
        let drifting =
            |state: &State| -> Vec<i64> { (0..90).filter(|day| state.drifts_in(*day, DAY_S)).collect() };
        let suspected = of(Kind::Suspected);
        assert_eq!(doubtful(&suspected), (48..90).collect::<Vec<_>>());
        assert!(drifting(&suspected).is_empty());
        let drift = of(Kind::Drift);
        assert_eq!(doubtful(&drift), (48..=55).collect::<Vec<_>>());
        assert_eq!(drifting(&drift), (50..90).collect::<Vec<_>>());
    }
}
