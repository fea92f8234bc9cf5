//! Force and relative force of a record at the reference temperature, by the regression over the closed
//! periods.

use super::state::State;
use super::tracker::Tracker;
use super::verdict::AtReference;
use crate::signal::record::Timestamp;
use crate::track::drift::Filters;
use crate::track::observation::Observation;
use crate::track::relative::{Interval, Relative};

/// Standard deviations between a normal law's mean and its 97.5 % quantile.
const TAIL_SD: f64 = 1.959_964;

/// Low passes up to a time, those of the last closed period, updated with the readings since.
pub(crate) fn filters_until(state: &State, time: Timestamp) -> Filters {
    state.filters.advanced(&state.readings, time)
}

/// Force and relative force of one record at the reference temperature; `None` while it is unknown.
pub(crate) fn of_record(
    tracker: &Tracker,
    observation: &Observation,
    relative: &Relative,
) -> Option<AtReference> {
    let state = &tracker.state;
    let watch = state.watch.get()?;
    let reference_c = state.segment.reference_c?;
    let end = observation.start.plus_seconds(observation.duration_s);
    let filters = filters_until(state, end);
    let filtered = filters.at(end.days())?;
    // The effect of temperature is learned from periods, which carry the estimates: the posterior mean weighs the particles anew by
    // every record's noise, and differs from them the more the temperature moved the force.
    let measured = libm::expm1(relative.estimate);
    let own_sd = relative.record_sd * (1.0 + measured);
    // Where it is known, the scatter within a period is added to the law of a period, at least what the record states.
    let scatter = state.scatter.sd();
    let (change, change_sd) = watch.change_of(
        end.days(),
        measured,
        scatter.map_or(own_sd, |_| own_sd.min(watch.noise_sd())),
        Some(&filtered),
        filters.unread_k2(end.days()).as_ref(),
        state.changed_since().is_some_and(|since| end.days() > since),
    )?;
    let change_sd = change_sd.hypot(scatter.map_or(0.0, |scatter| scatter.max(own_sd)));
    let static_sd = tracker.shift.as_ref()?.static_sd(measured - change, measured);
    let force = &relative.force_n;
    let factor = (1.0 + change) / relative.ratio.mean.max(f64::MIN_POSITIVE);
    Some(AtReference {
        temperature_c: reference_c,
        ratio: Interval::normal(1.0 + change, change_sd.hypot(static_sd)),
        force_n: moved(force, factor, (factor * force.sd).hypot(change_sd * force.mean)),
    })
}

/// Adds an independent change of `share` of the force to the errors.
pub(super) fn widen(at_reference: &mut AtReference, share: f64) {
    let wider = |interval: &Interval, sd: f64| moved(interval, 1.0, interval.sd.hypot(sd));
    at_reference.ratio = wider(&at_reference.ratio, share);
    at_reference.force_n = wider(&at_reference.force_n, share * at_reference.force_n.mean);
}

/// `interval` times `factor`, with a normal error more that makes its standard deviation `sd`: the shape is the interval's own as far
/// as its error is.
fn moved(interval: &Interval, factor: f64, sd: f64) -> Interval {
    let mean = interval.mean * factor;
    let own = interval.sd * factor;
    let narrower = if own > sd { sd / own } else { 1.0 };
    let added = (sd * sd - own * own).max(0.0).sqrt();
    let half = |tail: f64| (narrower * factor * tail).hypot(TAIL_SD * added);
    Interval {
        mean,
        sd,
        q025: mean - half(interval.mean - interval.q025),
        q975: mean + half(interval.q975 - interval.mean),
    }
}
