//! Explanations of an alarm: the kinds of change that explain the modes' mean shift since an onset.

use super::tracker::Tracker;
use crate::signal::record::Timestamp;
use crate::track::alarm::change::Change;
use crate::track::alternatives::{Explained, Shifted};
use crate::track::drift::period::Period;
use crate::track::observation::LogMode;

/// Weighs the kinds of change over the periods since an onset, `last` the one that is being closed. The mean change of force that
/// the drift watch found is kept (a ramp's mean is half of its final size); other effects on the force since
/// the baseline, such as temperature, are removed period by period: every mode weighs the periods by its own errors, and would make a
/// pattern of a season that only their mean takes off. `None` without a baseline or where the model has no answers for the rod.
pub(crate) fn explain(tracker: &Tracker, change: &Change, last: Option<&Period>) -> Option<Explained> {
    let (baseline, shift) = (tracker.state.segment.baseline.as_ref()?, tracker.shift.as_ref()?);
    let periods = since(tracker, change.onset, last);
    let log_ratio = |period: &Period| libm::log1p(period.delta.max(-1.0 + 1e-9));
    let share = 0.5 * (1.0 + change.step_probability);
    let found = libm::log1p((share * change.size.mean).clamp(-0.9, 10.0));
    let found_sd = share * change.size.sd / (1.0 + share * change.size.mean).max(0.1);
    let modes: Vec<Vec<LogMode>> = periods
        .iter()
        .map(|period| {
            let misfit = period.misfit.iter();
            misfit
                .filter_map(|one| {
                    Some(LogMode {
                        order: one.order,
                        log_frequency: shift.log_frequency(one.order, log_ratio(period))? + one.residual,
                        // The stated error: the baseline's overdispersion is weighed again with the scatter since.
                        log_sd: one.sd / baseline.overdispersion,
                    })
                })
                .collect()
        })
        .collect();
    let records: Vec<Shifted> = modes
        .iter()
        .zip(&periods)
        .map(|(modes, period)| Shifted {
            modes,
            expected: log_ratio(period) - found,
        })
        .collect();
    let alternatives = tracker.plan.alternatives(baseline)?;
    let mut shift = alternatives.mean_shift(baseline, &records, found_sd)?;
    shift.records = periods.iter().map(|period| period.records).sum();
    alternatives.explain(&shift)
}

/// The periods since an onset, the last one at least.
pub(crate) fn since<'a>(tracker: &'a Tracker, onset: Timestamp, last: Option<&'a Period>) -> Vec<&'a Period> {
    let periods = &tracker.state.periods;
    let first = periods.partition_point(|known| known.time() < onset);
    let first = if last.is_none() {
        first.min(periods.len().saturating_sub(1))
    } else {
        first
    };
    periods[first..].iter().chain(last).collect()
}
