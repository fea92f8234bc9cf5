//! Alarms of a change that the drift watch found: raised, confirmed by other rods, ended.

use super::explain::{explain, since};
use super::monitor::beyond;
use super::state::State;
use super::tracker::Tracker;
use super::wording::{common_message, drift_message, not_axial_message};
use crate::signal::record::Timestamp;
use crate::track::alarm::change::Change;
use crate::track::alarm::{Alarm, Cause, Kind, Known, Standing};
use crate::track::alternatives::Explained;
use crate::track::drift;
use crate::track::drift::others::{Neighbour as _, Others};
use crate::track::drift::period::{self, Evidence, Period, combined_misfit};
use crate::track::drift::watch::{DriftWatch, Finding, Witness};
use crate::track::relative::Shift;

/// Least probability of the misfit since its onset, by a change of axial force, for a drift.
pub(super) const SIGNAL_NOT_AXIAL_P: f64 = 0.01;

/// A drift is over if the change at the reference temperature lies within one standard deviation of zero, or
/// within this share of the reported size.
const OVER_SHARE: f64 = 0.25;

/// Share of its limit below which the evidence also ends a change.
const FAINT_EVIDENCE: f64 = 0.01;

/// Standard deviations from zero beyond which a change stands, by the detector that told it.
const STANDS_SD: f64 = 2.0;

/// Number of periods in a row above the limit before rods are reported to move together.
const COMMON_PERIODS: usize = 3;

/// Raises `drift`, `not-axial` or `common` by the finding of the drift watch, unless one of them holds.
pub(super) fn look_at_finding(tracker: &mut Tracker, period: &Period, others: &Others, time: Timestamp) {
    let (drifts, has_lasted) = (tracker.state.drifts(), has_lasted(&tracker.state));
    let Some(watch) = tracker.state.watch.get_mut() else {
        return;
    };
    let finding = watch.finding(others, period.index, !has_lasted);
    let moves = matches!(finding, Finding::Common | Finding::Waiting);
    if watch.joins(others, period.index, moves) && !drifts {
        watch.restart();
        return;
    }
    let state = &tracker.state;
    // A change that was told while the baseline was learned is known by its provisional one only.
    let end = period::start_of(period.index.saturating_add(1), tracker.plan.track.period_s);
    let is_early = |alarm: &Alarm| alarm.kind == Kind::Drift && alarm.cleared.is_none() && alarm.told > end;
    let is_taken_over = state.watches.stands(Cause::Change) || state.watches.stands(Cause::Pattern);
    let drifts = drifts && (is_taken_over || !state.alarms.iter().any(is_early));
    // While a rod moves with others the thermometer is in doubt: what it alone shows is no change of one rod.
    let moves_with_others = state.moves_with_others() && others.known(period.index) > 0;
    let is_known = match finding {
        Finding::Quiet | Finding::Waiting => true,
        Finding::Drift(Witness::Unconfirmed | Witness::Alone) if moves_with_others => true,
        Finding::Drift(witness) => {
            drifts && !(witness == Witness::Confirmed && state.alarms.iter().any(is_unconfirmed))
        }
        // A rod that was reported by itself stays so; one that moves alone is confirmed before others seem to move with it.
        Finding::Common => {
            drifts || state.holds(Kind::Common) || others.has_told_common(period.index) || !has_lasted
        }
    };
    if is_known {
        return;
    }
    let Some(change) = change_now(tracker) else { return };
    match finding {
        Finding::Quiet | Finding::Waiting => {}
        Finding::Drift(_) if drifts => confirm(tracker, &change, period, time),
        Finding::Drift(witness) => {
            let alternatives = explain(tracker, &change, Some(period));
            let p = axial_p(tracker, period, change.onset);
            // The pattern alone does not decide: where temperature moves the force by much, wrong static parameters look like one.
            let (kind, message) = if p >= SIGNAL_NOT_AXIAL_P {
                let message = drift_message(&change, witness, alternatives.as_ref());
                (Kind::Drift, message)
            } else {
                (Kind::NotAxial, not_axial_or(p, alternatives.as_ref()))
            };
            let known = Known {
                change: Some(change),
                witness: Some(witness),
                alternatives,
            };
            let cause = if kind == Kind::Drift {
                Cause::Change
            } else {
                Cause::Pattern
            };
            let is_active = |alarm: &Alarm| alarm.kind == kind && alarm.cleared.is_none();
            if state.alarms.iter().any(is_active) {
                // Period after period the misfit raised it; now its size and onset are known.
                tracker.on_board(|board| board.tell_again(time, &message, &known, is_active));
            } else {
                tracker.on_board(|board| board.raise(kind, time, message, known));
            }
            tracker.state.watches.begin(cause);
        }
        Finding::Common => {
            let moving = state
                .watch
                .get()
                .map_or(0, |watch| watch.moving(others, period.index));
            let is_loss = state.watches.stands(Cause::Loss);
            let message = common_message(&change, moving, others.count(), is_loss);
            let known = Known {
                change: Some(change),
                ..Known::default()
            };
            tracker.on_board(|board| board.raise(Kind::Common, time, message, known));
            tracker.state.watches.begin(Cause::Change);
        }
    }
}

/// One sentence about a pattern of this probability if it were axial: by the kinds of change that remain, if none of them is axial.
fn not_axial_or(p: f64, alternatives: Option<&Explained>) -> String {
    let other = alternatives.filter(|known| known.is_axial() == Some(false));
    other.map_or_else(|| not_axial_message(p), Explained::sentence)
}

/// One sentence about a change that is not axial.
pub(super) fn pattern_message(
    tracker: &Tracker,
    period: &Period,
    change: &Change,
    alternatives: Option<&Explained>,
) -> String {
    not_axial_or(axial_p(tracker, period, change.onset), alternatives)
}

/// True if the periods before the present one were above the limit as well.
fn has_lasted(state: &State) -> bool {
    let before = state.periods.iter().rev().take(COMMON_PERIODS - 1);
    let is_above = |period: &&Period| {
        let evidence = period.charted.map(|charted| charted.evidence);
        evidence.is_some_and(|evidence| evidence.best_informed() > 1.0)
    };
    before.filter(is_above).count() == COMMON_PERIODS - 1
}

/// True for an alarm that the other rods have not confirmed yet.
fn is_unconfirmed(alarm: &Alarm) -> bool {
    alarm.cleared.is_none() && alarm.witness == Some(Witness::Unconfirmed)
}

/// Reports a change again that the other rods confirm now.
fn confirm(tracker: &mut Tracker, change: &Change, period: &Period, time: Timestamp) {
    let Some(alarm) = tracker.state.alarms.iter().find(|alarm| is_unconfirmed(alarm)) else {
        return;
    };
    let alternatives = explain(tracker, change, Some(period));
    let message = if alarm.kind == Kind::Drift {
        drift_message(change, Witness::Confirmed, alternatives.as_ref())
    } else {
        alarm.message.clone()
    };
    let known = Known {
        change: Some(change.clone()),
        witness: Some(Witness::Confirmed),
        alternatives,
    };
    tracker.on_board(|board| board.tell_again(time, &message, &known, is_unconfirmed));
}

/// Ends the alarms raised by evidence once the change is gone; the watch restarts with its knowledge of
/// temperature.
pub(super) fn look_at_end(tracker: &mut Tracker, period: &Period, time: Timestamp) {
    let is_pattern = tracker.state.watches.stands(Cause::Pattern);
    let by_evidence = |alarm: &&Alarm| match alarm.kind {
        Kind::Drift | Kind::Common => alarm.cleared.is_none(),
        Kind::NotAxial => alarm.cleared.is_none() && is_pattern,
        _ => false,
    };
    let sizes = tracker.state.alarms.iter().filter(by_evidence);
    // Periods of a baseline in which the change was told come after it.
    let is_still_to_come = |alarm: &Alarm| {
        let onset = alarm.change.as_ref().map(|change| change.onset_q975);
        onset.is_some_and(|onset| period.time() < onset)
    };
    if sizes.clone().any(is_still_to_come) {
        return;
    }
    let first = (sizes.clone().map(Alarm::latest_onset)).fold(f64::INFINITY, f64::min);
    let witnesses: Vec<_> = sizes.clone().map(|alarm| alarm.witness).collect();
    let size_of = |alarm: &Alarm| alarm.change.as_ref().map_or(0.0, |change| change.size.mean.abs());
    let (Some(size), Some(charted)) = (sizes.map(size_of).reduce(f64::max), period.charted) else {
        return;
    };
    let Some(watch) = tracker.state.watch.get() else {
        return;
    };
    let is_settled = watch.is_settled();
    let (known, change) = watch.testimony(first);
    let evidence = known.best_informed();
    // A change that came back has evidence for good: what it came to decides.
    let is_back = |change: drift::Change| change.size.abs() < STANDS_SD * change.size_sd;
    let (is_told, has_come_back) = (evidence >= 1.0, evidence > 1.0 && change.is_some_and(is_back));
    let by_level = charted
        .at_reference
        .zip(charted.at_reference_sd)
        .and_then(|(change, sd)| {
            let over = sd.max(OVER_SHARE * size);
            // A small change ends nothing as long as it is evident.
            beyond(change.abs(), 2.0 * over, over).filter(|holds| *holds || !is_told || has_come_back)
        });
    // Without a temperature, a lasting change is learned as normal: only the evidence ends the alarm, that of a detector which knew
    // the rod before and saw the change.
    let saw = |witness: &Option<Witness>| saw_change(*witness, &known);
    let is_faint = is_settled && (evidence < FAINT_EVIDENCE || has_come_back) && witnesses.iter().all(saw);
    let holds = by_level.or(is_faint.then_some(false));
    if tracker.find(Cause::Change, holds) != Standing::Over {
        return;
    }
    tracker.state.watches.end(Cause::Pattern);
    let misfit_holds = tracker.state.watches.stands(Cause::Misfit);
    tracker.on_board(|board| {
        board.clear(Kind::Drift, time);
        board.clear(Kind::Common, time);
        if is_pattern && !misfit_holds {
            board.clear(Kind::NotAxial, time);
        }
    });
    if let Some(watch) = tracker.state.watch.get_mut() {
        watch.restart();
    }
}

/// True if a detector took the period that is as well informed as the one that told a change, or better.
fn saw_change(witness: Option<Witness>, evidence: &Evidence) -> bool {
    match witness {
        Some(Witness::Blind) => true,
        Some(Witness::Peers | Witness::Confirmed) => evidence.compensated.or(evidence.peers).is_some(),
        Some(Witness::Unconfirmed | Witness::Alone) | None => evidence.compensated.is_some(),
    }
}

/// Present estimate of the change of force by the drift watch.
pub(crate) fn change_now(tracker: &Tracker) -> Option<Change> {
    change_told(tracker.state.watch.get()?, tracker.shift.as_ref())
}

/// Estimate of the change of force by a watch, in reported form.
pub(crate) fn change_told(watch: &DriftWatch, shift: Option<&Shift>) -> Option<Change> {
    let change = watch.change()?;
    // The ratio of a change of force to one of frequencies stays uncertain with any number of periods.
    let share = if change.size == 0.0 {
        0.0
    } else {
        static_sd(shift, 0.0, change.size) / change.size.abs()
    };
    Some(Change::told(&change, share))
}

/// Standard deviation of a change of N_t / N_0 - 1 by the uncertainty of the static parameters.
pub(super) fn static_sd(shift: Option<&Shift>, before: f64, now: f64) -> f64 {
    shift.map_or(0.0, |shift| shift.static_sd(before, now))
}

/// P(misfit at least this large | axial) of the change since an onset. A recent change is diluted over a long
/// time: the last periods are tested too, and the smallest probability counts, times the number of tests.
fn axial_p(tracker: &Tracker, period: &Period, onset: Timestamp) -> f64 {
    let Some(shift) = &tracker.shift else { return 1.0 };
    let since = since(tracker, onset, Some(period));
    let windows = [since.len(), tracker.plan.alarm.confirm.min(since.len()), 1];
    let smallest = windows.iter().map(|&count| {
        let (log_ratio, misfit) = combined_misfit(since[since.len() - count..].iter().copied());
        shift.not_axial_p(log_ratio, &misfit)
    });
    (smallest.fold(1.0, f64::min) * windows.len() as f64).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_is_not_ended_by_a_detector_that_knows_less_than_its_witness() {
        let blind = Evidence {
            blind: Some(1e-3),
            ..Evidence::default()
        };
        let peers = Evidence {
            peers: Some(1e-3),
            ..blind
        };
        let all = Evidence {
            compensated: Some(1e-3),
            ..peers
        };
        let saw = |evidence: &Evidence| {
            let witnesses = [
                Some(Witness::Blind),
                Some(Witness::Peers),
                Some(Witness::Confirmed),
                Some(Witness::Unconfirmed),
                Some(Witness::Alone),
                None,
            ];
            witnesses.map(|witness| saw_change(witness, evidence))
        };
        assert_eq!(saw(&blind), [true, false, false, false, false, false]);
        assert_eq!(saw(&peers), [true, true, true, false, false, false]);
        assert_eq!(saw(&all), [true; 6]);
    }
}
