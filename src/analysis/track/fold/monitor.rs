//! Closes a period: moves the drift watch on, checks conditions, raises and clears alarms.

use super::change::{look_at_end, look_at_finding, static_sd};
use super::growth::look_at_growth;
use super::state::State;
use super::tracker::Tracker;
use super::wording::{not_axial_message, probable};
use crate::signal::record::Timestamp;
use crate::track::alarm::{Cause, Kind, Known, Standing};
use crate::track::drift::companions::PATIENCE;
use crate::track::drift::others::{Neighbour as _, Others};
use crate::track::drift::period::{Charted, Period};
use crate::track::drift::watch::{DriftWatch, Finding, Terms};
use statrs::distribution::{ContinuousCDF, Normal};

/// Factor on the raising probability above which the condition of `not-axial` ends.
const NOT_AXIAL_OVER: f64 = 10.0;

/// Shares of the predictive variance by uncertainty of the effect of temperature: above the first the watch
/// is nearly blind, below the second it works again.
const BLIND: (f64, f64) = (0.9, 0.7);

/// Standard deviations of the predictive law from which a change of one period is detected.
const TOLD_SD: f64 = 4.0;

/// Least credible stated error of a ratio \[-\].
const LEAST_SD: f64 = 1e-6;

/// Closes a period: updates the drift watch, raises and clears alarms. `time` is the event time at which it
/// is known to be complete.
pub(crate) fn close(tracker: &mut Tracker, mut period: Period, others: &Others, time: Timestamp) -> Period {
    watch(tracker, &mut period, others);
    look_at_misfit(tracker, &period, time);
    look_at_finding(tracker, &period, others, time);
    look_at_limit(tracker, &period, others, time);
    look_at_leverage(tracker, &period, time);
    look_at_growth(tracker, &period, others, time);
    look_at_end(tracker, &period, time);
    period
}

/// Residual of a period, in standard deviations, from which a change may be about to be reported.
const SUSPECT_SD: f64 = 3.0;
/// Evidence, as a share of its limit, from which a change may be about to be reported.
const SUSPECT_EVIDENCE: f64 = 0.05;

/// True if a period may show the beginning of a change that the next record should tell.
pub(super) fn is_suspect(charted: &Charted) -> bool {
    charted.residual.abs() > SUSPECT_SD || charted.evidence.best_informed() > SUSPECT_EVIDENCE
}

/// Reports a change with the record that shows it, as the end of the open period would, because the next record may be a day
/// away. Nothing else advances. Unusually equal readings wait for the end of the period: the thermometer may have died.
pub(crate) fn tell_ahead(tracker: &mut Tracker, others: &Others, time: Timestamp) {
    let last = tracker.state.periods.last().and_then(|period| period.charted);
    let is_suspect = last.is_some_and(|charted| is_suspect(&charted));
    let is_misled = tracker.plan.compensates() && tracker.state.thermometer.may_have_died(time);
    if !is_suspect || tracker.state.drifts() || is_misled {
        return;
    }
    // Large, and only read.
    let (shift, periods) = (tracker.shift.take(), std::mem::take(&mut tracker.state.periods));
    let mut ahead = tracker.clone();
    (ahead.shift, ahead.state.periods) = (shift, periods);
    if let Some(mut period) = ahead.take_period() {
        // One reading a day tells too little by itself.
        if !ahead.state.filters.is_sparse()
            && let Some(watch) = ahead.state.watch.get_mut()
        {
            watch.stand_in_for_late(others, period.index, tracker.plan.track.period_s);
        }
        watch(&mut ahead, &mut period, others);
        look_at_finding(&mut ahead, &period, others, time);
    }
    tracker.shift = ahead.shift.take();
    tracker.state.periods = std::mem::take(&mut ahead.state.periods);
    // What shows only relative to the others waits until they have their say on the period.
    if ahead.state.drifts() && ahead.state.watch.get().is_some_and(DriftWatch::shows_alone) {
        tracker.state.alarms = ahead.state.alarms;
        tracker.state.watches = ahead.state.watches;
        tracker.news = ahead.news;
    }
}

/// `Some(true)` above one level, `Some(false)` below another, `None` between.
pub(super) fn beyond(value: f64, raises: f64, clears: f64) -> Option<bool> {
    if value > raises {
        Some(true)
    } else if value < clears {
        Some(false)
    } else {
        None
    }
}

/// Moves the drift watch on by one period.
fn watch(tracker: &mut Tracker, period: &mut Period, others: &Others) {
    let plan = tracker.plan.clone();
    let state = &mut tracker.state;
    let (Some(baseline), Some(shift)) = (&state.segment.baseline, &tracker.shift) else {
        return;
    };
    if plan.compensates() && state.segment.reference_c.is_none() {
        let first_c = period.filtered_c.map(|filtered| filtered[0]);
        state.segment.reference_c = plan.track.reference_temperature_c.or(first_c);
    }
    let terms = Terms {
        commissioned_until: plan.commissioned_until(baseline),
        told_since: state.changed_since(),
        ..plan.terms(baseline, shift, state.segment.reference_c)
    };
    let noise_sd = typical_sd(state, period);
    let watch = state
        .watch
        .get_or_insert_with(|| DriftWatch::new(period.start.days(), noise_sd));
    let is_sparse = state.filters.is_sparse();
    let (history, period_s) = (&state.periods, plan.track.period_s);
    period.charted = Some(watch.step(&terms, period, history, is_sparse, others, period_s));
    period.unread_k2 = None;
}

/// Typical stated error of a period's ratio: the median over the open records, scaled to the period's number
/// of records.
fn typical_sd(state: &State, period: &Period) -> f64 {
    let mut errors: Vec<f64> = state.open.iter().map(|pending| pending.sd).collect();
    errors.sort_by(f64::total_cmp);
    let of_record = errors.get(errors.len() / 2).copied();
    let sd = of_record.map_or(period.delta_sd, |sd| sd / (period.records.max(1) as f64).sqrt());
    if sd.is_finite() {
        sd.max(LEAST_SD)
    } else {
        LEAST_SD
    }
}

/// Makes a watch from the periods of a state without one: those of an earlier version, with one temperature a
/// day.
pub(crate) fn rewatch(tracker: &mut Tracker) {
    if tracker.state.watch.get().is_some() || tracker.state.periods.is_empty() {
        return;
    }
    let mut periods = std::mem::take(&mut tracker.state.periods);
    let mut had_evidence = false;
    for period in &mut periods {
        let evidence = period.charted.and_then(|charted| charted.evidence.blind);
        // Only the first periods of a watch, and those after its restart, have none.
        if evidence == Some(0.0)
            && std::mem::take(&mut had_evidence)
            && let Some(watch) = tracker.state.watch.get_mut()
        {
            watch.restart();
        }
        had_evidence |= evidence.is_some_and(|evidence| evidence > 0.0);
        if period.filtered_c.is_none()
            && let Some(&celsius) = period.lagged_c.as_ref().and_then(|lagged| lagged.get(LAGGED))
        {
            let day = period.start.days();
            tracker.state.filters.push(day, celsius);
            period.filtered_c = tracker.state.filters.at(day);
        }
        let mut again = period.clone();
        watch(tracker, &mut again, &Others::default());
    }
    // Replayed without the other rods: what they explained then is no evidence.
    let had_others = |period: &Period| {
        period
            .charted
            .is_some_and(|charted| charted.evidence.peers.is_some())
    };
    if let Some(last) = periods
        .iter()
        .rev()
        .take(PATIENCE as usize)
        .find(|period| had_others(period))
        && let Some(watch) = tracker.state.watch.get_mut()
    {
        watch.looked_beside_others(last.time().days());
    }
    tracker.state.periods = periods;
}

/// Index of the lag of earlier versions nearest to a day's mean.
const LAGGED: usize = 4;

/// Checks the misfit of each period.
fn look_at_misfit(tracker: &mut Tracker, period: &Period, time: Timestamp) {
    let least = tracker.plan.alarm.not_axial_p;
    let holds = beyond(-period.not_axial_p, -least, -NOT_AXIAL_OVER * least);
    match tracker.find(Cause::Misfit, holds) {
        Standing::Holds => {
            let message = not_axial_message(period.not_axial_p);
            tracker.on_board(|board| board.raise(Kind::NotAxial, time, message, Known::default()));
        }
        Standing::Over => tracker.on_board(|board| board.clear(Kind::NotAxial, time)),
        Standing::Undecided => {}
    }
}

/// Checks the limit by a period. Its error holds what rods that move together are uncertain by, before the notice of the site, too,
/// and what the static parameters leave open.
fn look_at_limit(tracker: &mut Tracker, period: &Period, others: &Others, time: Timestamp) {
    // Without a temperature a limit would react to the weather; a certain loss is still reported (`loss`).
    let Some((change, charted_sd)) = period
        .charted
        .and_then(|charted| Some((charted.at_reference?, charted.at_reference_sd?)))
    else {
        tracker.look_at_loss_beside_others(period, others, time);
        return;
    };
    if !tracker.state.has_learned(tracker.plan.track.learning_periods) {
        return;
    }
    let alarm = &tracker.plan.alarm;
    let (limit, certain) = (alarm.limit_loss, alarm.limit_probability);
    let watch = tracker.state.watch.get();
    let found = |watch: &&DriftWatch| watch.finding(others, period.index, false);
    let seems_common = |watch: &&DriftWatch| matches!(found(watch), Finding::Common | Finding::Waiting);
    // What was told of this rod, and a loss that the frequencies themselves show, is no thermometer's.
    let is_its_own = tracker.state.drifts() || tracker.state.watches.stands(Cause::Loss);
    let common = watch
        .filter(|watch| !is_its_own && seems_common(watch))
        .map_or(0.0, |watch| watch.size().abs());
    let common = common.max(tracker.state.common_size());
    let sd = charted_sd.hypot(common).hypot(static_sd(
        tracker.shift.as_ref(),
        period.delta - change,
        period.delta,
    ));
    let probability = Normal::standard().cdf((-limit - change) / sd);
    let proviso = if common > 0.0 {
        "; the rods of the site moved together: a wrong thermometer looks the same"
    } else if watch.is_some_and(DriftWatch::has_witnesses) || !tracker.plan.compensates() {
        ""
    } else {
        "; no other rods bear witness: a thermometer that drifts looks the same"
    };
    tracker.look(Cause::Limit, beyond(probability, certain, 0.5), time, || {
        format!(
            "the loss of axial force at the reference temperature is {:.1} ± {:.1} %, above the limit of {:.1} % ({}){proviso}",
            -100.0 * change,
            100.0 * sd,
            100.0 * limit,
            probable(probability)
        )
    });
}

fn look_at_leverage(tracker: &mut Tracker, period: &Period, time: Timestamp) {
    let Some(charted) = period.charted.filter(|charted| charted.at_reference.is_some()) else {
        return;
    };
    if !tracker.state.has_learned(tracker.plan.track.learning_periods) {
        return;
    }
    // After a change the law of none is wide by the change.
    if tracker.state.drifts() && !tracker.state.watches.stands(Cause::Unlearned) {
        return;
    }
    let (blind, sees) = BLIND;
    // An effect not yet learned matters only where it hides a loss as large as the limit.
    let hides = TOLD_SD * charted.expected_sd > tracker.plan.alarm.limit_loss;
    let unlearned = if hides { charted.leverage } else { 0.0 };
    tracker.look(Cause::Unlearned, beyond(unlearned, blind, sees), time, || {
        "the temperature is far from all learned so far: until more is learned, only large changes are seen".to_owned()
    });
}
