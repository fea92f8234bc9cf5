//! Growth of a drift that was told: told anew with its present size.
//!
//! The onset particles hold the sum of a step and those after it, dated by the first; a ramp after it is none of them. The change at the
//! reference temperature holds all. Without a temperature the particles beside the other rods do, which may change again.

use super::change::{change_now, pattern_message, static_sd};
use super::explain::explain;
use super::tracker::Tracker;
use super::wording::drift_message;
use crate::signal::record::Timestamp;
use crate::track::alarm::change::Change;
use crate::track::alarm::{Alarm, Kind, Known};
use crate::track::drift::others::Others;
use crate::track::drift::period::Period;
use crate::track::drift::watch::Witness;
use crate::track::relative::Interval;

/// Standard deviations from which a change is certainly another than the one told.
const CERTAIN_SD: f64 = 1.96;

/// Least growth of a change that is told again: share of the force, and of the size told.
const LEAST_GROWTH: f64 = 0.01;
const GROWTH_SHARE: f64 = 0.5;

/// Reports a change again that has grown or turned since it was told, acknowledged or not: a drift, or one that is not axial.
pub(super) fn look_at_growth(tracker: &mut Tracker, period: &Period, others: &Others, time: Timestamp) {
    let is_change =
        |alarm: &&Alarm| matches!(alarm.kind, Kind::Drift | Kind::NotAxial) && alarm.cleared.is_none();
    let Some((alarm, told)) = (tracker.state.alarms.iter())
        .filter(is_change)
        .find_map(|alarm| Some((alarm, alarm.change.clone()?)))
    else {
        return;
    };
    // Moved together, they point to the thermometer.
    let watch = tracker.state.watch.get();
    if !watch.is_some_and(|watch| watch.is_calm(others, period.index)) {
        return;
    }
    let periods = tracker.state.periods.iter().chain([period]);
    let since: Vec<&Period> = periods.filter(|period| period.time() > alarm.told).collect();
    let Some(size) = grown(tracker, &told.size, &since) else {
        return;
    };
    let (kind, witness) = (alarm.kind, alarm.witness);
    let change = Change { size, ..told.clone() };
    let alternatives = explain(tracker, &change, Some(period));
    let now = if kind == Kind::Drift {
        drift_message(&change, witness.unwrap_or(Witness::Alone), alternatives.as_ref())
    } else {
        let pattern = pattern_message(tracker, period, &change, alternatives.as_ref());
        format!(
            "{pattern}; taken for one of force, the change is {:+.2} %",
            100.0 * size.mean
        )
    };
    let message = format!(
        "{now}; it was {:+.2} % when it was told before",
        100.0 * told.size.mean
    );
    let known = Known {
        change: Some(change),
        witness,
        alternatives,
    };
    tracker.on_board(|board| board.tell_anew(kind, time, message, known));
}

/// Change at the reference temperature by the last of some periods, if the last ones all show another than `told`; without a temperature,
/// the change beside the other rods, if that is another.
fn grown(tracker: &Tracker, told: &Interval, periods: &[&Period]) -> Option<Interval> {
    let count = tracker.plan.alarm.confirm.max(1);
    let last = periods.len().checked_sub(count).map(|first| &periods[first..])?;
    if tracker.change_without_temperature().is_some() {
        let now = change_now(tracker)?.size;
        return grew(told, now.mean, now.sd).then_some(now);
    }
    let now = |period: &&Period| at_reference(tracker, period).filter(|size| grew(told, size.mean, size.sd));
    let all: Option<Vec<Interval>> = last.iter().map(now).collect();
    all?.last().copied()
}

/// Present change for the repetition of a drift that was told as `told`. Where the onset particles date a later change alone, the one
/// told goes on to hold both. Where the last periods all show another change at the reference temperature, that is the whole, since the
/// onset told.
pub(super) fn change_since_told(tracker: &Tracker, told: Option<&Change>) -> Option<Change> {
    let now = change_now(tracker)?;
    let dates_a_later_one = |told: &&Change| now.onset_q025 > told.onset_q975;
    let change = told.filter(dates_a_later_one).unwrap_or(&now);
    let periods = &tracker.state.periods;
    let last = periods.len().saturating_sub(tracker.plan.alarm.confirm.max(1));
    // The static parameters make all sizes wrong alike: the other errors decide.
    let by_parameters = static_sd(tracker.shift.as_ref(), 0.0, change.size.mean);
    let own_variance = (change.size.sd.powi(2) - by_parameters.powi(2)).max(0.0);
    let differs = |period: &Period| {
        let charted = period.charted.as_ref();
        charted
            .and_then(|charted| charted.at_reference.zip(charted.at_reference_sd))
            .is_some_and(|(size, sd)| {
                (size - change.size.mean).abs() > CERTAIN_SD * sd.hypot(own_variance.sqrt())
            })
    };
    let latest = periods.last().filter(|_| periods[last..].iter().all(differs));
    Some(match latest.and_then(|period| at_reference(tracker, period)) {
        None => change.clone(),
        Some(size) => Change {
            size,
            ..told.unwrap_or(change).clone()
        },
    })
}

/// Change at the reference temperature by a period.
fn at_reference(tracker: &Tracker, period: &Period) -> Option<Interval> {
    let charted = period.charted?;
    let (change, sd) = (charted.at_reference?, charted.at_reference_sd?);
    let by_parameters = static_sd(tracker.shift.as_ref(), period.delta - change, period.delta);
    Some(Interval::normal(change, sd.hypot(by_parameters)))
}

/// True if a change differs from the one told by more than half of it and a hundredth of the force.
pub(super) fn is_further(told: f64, differs: f64) -> bool {
    differs > LEAST_GROWTH.max(GROWTH_SHARE * told)
}

/// True if a change of this size and standard deviation is certainly not the one told: larger by half of it and a hundredth of the
/// force, or in the other direction.
fn grew(told: &Interval, change: f64, sd: f64) -> bool {
    let differs = (change - told.mean).abs();
    let is_certain = differs > CERTAIN_SD * sd.hypot(told.sd);
    let is_larger = change.abs() > told.mean.abs() && is_further(told.mean.abs(), differs);
    let has_turned = change * told.mean < 0.0 && change.abs() > LEAST_GROWTH.max(CERTAIN_SD * sd);
    is_certain && (is_larger || has_turned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_that_grows_by_half_or_turns_is_another() {
        let told = Interval::normal(-0.01, 0.002);
        assert!(!grew(&told, -0.018, 0.001), "less than a hundredth more");
        assert!(grew(&told, -0.045, 0.002));
        assert!(!grew(&told, -0.045, 0.03), "uncertain");
        assert!(grew(&told, 0.02, 0.002), "turned");
        assert!(!grew(&told, 0.004, 0.001), "back");
        let large = Interval::normal(-0.1, 0.002);
        assert!(!grew(&large, -0.14, 0.002) && grew(&large, -0.16, 0.002));
        assert!(!grew(&large, -0.04, 0.002), "smaller");
    }
}
