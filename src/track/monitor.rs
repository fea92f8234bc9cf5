//! What a closed period says: temperature taken out, charts moved on, conditions looked at.

use super::Tracker;
use super::alarm::{Cause, Finding, Kind};
use super::change::{self, Change, Sample};
use super::chart::{CLAMP, Charts, Signal};
use super::period::{Charted, Period, combined_misfit};
use super::reference::{Level, temperature_c};
use super::regression::{Prediction, Regression};
use super::relative::Interval;
use super::state::State;
use super::whiteness::{Whiteness, whiteness};
use crate::record::Timestamp;
use statrs::distribution::{ContinuousCDF, Normal};

/// The latest charted residuals asked whether they are white.
const GUARDED: usize = 100;

/// A chart's alarm is no drift if a change of axial force explains the misfit since its onset with less than this
/// probability.
const SIGNAL_NOT_AXIAL_P: f64 = 0.01;

/// A change beyond this many standard deviations is one; within one standard deviation it is none.
const BEYOND: f64 = 2.0;

/// The condition of `not-axial` ends above this many times the probability that raised it.
const NOT_AXIAL_OVER: f64 = 10.0;

/// Share of the predictive variance that is uncertainty of the regression: above the first the charts are nearly blind,
/// below the second they see again.
const BLIND: (f64, f64) = (0.9, 0.7);

/// Takes a period that no record can come into any more: its place on the charts, and the news it makes. `time` is the
/// event time at which this is known.
pub(super) fn close(tracker: &mut Tracker, mut period: Period, time: Timestamp) -> Period {
    begin_regression(tracker, &period);
    let signal = chart(tracker, &mut period);
    look_at_misfit(tracker, &mut period, time);
    if let Some(signal) = signal {
        take_signal(tracker, &mut period, signal, time);
    }
    look_at_limit(tracker, &period, time);
    look_at_leverage(tracker, &period, time);
    if signal.is_none() && tracker.state.charts.as_ref().is_none_or(Charts::is_calm) {
        tracker.on_board(|board| board.clear(Kind::Drift, time));
    }
    look_at_change(tracker, &period, time);
    thaw(tracker, period.index);
    tracker.state.whiteness = whiteness_of(&tracker.state, &period);
    period
}

/// `Some(true)` above one level, `Some(false)` below another, `None` between.
fn beyond(value: f64, raises: f64, clears: f64) -> Option<bool> {
    if value > raises {
        Some(true)
    } else if value < clears {
        Some(false)
    } else {
        None
    }
}

/// The misfit of period after period.
fn look_at_misfit(tracker: &mut Tracker, period: &mut Period, time: Timestamp) {
    let least = tracker.plan.alarm.not_axial_p;
    let holds = beyond(-period.not_axial_p, -least, -NOT_AXIAL_OVER * least);
    match tracker.find(Cause::Misfit, holds) {
        Finding::Holds => {
            let message = not_axial_message(period.not_axial_p);
            tracker.on_board(|board| board.raise(Kind::NotAxial, time, message, None));
            if !tracker.state.is_frozen() {
                let periods = &tracker.state.periods;
                let first = periods
                    .len()
                    .saturating_sub(tracker.plan.alarm.confirm.saturating_sub(1));
                let since = periods.get(first).map_or(period.index, |known| known.index);
                forget_since(tracker, since, period);
                freeze(tracker, since);
            }
        }
        Finding::Over if tracker.state.charts.as_ref().is_none_or(Charts::is_calm) => {
            tracker.on_board(|board| board.clear(Kind::NotAxial, time));
        }
        _ => {}
    }
}

/// A signal of the charts raises `drift` or `not-axial`, unless one of them holds.
fn take_signal(tracker: &mut Tracker, period: &mut Period, signal: Signal, time: Timestamp) {
    if tracker.on_board(|board| board.holds(Kind::Drift) || board.holds(Kind::NotAxial)) {
        return;
    }
    let p = axial_p(tracker, period, signal);
    forget_since(tracker, signal.since, period);
    freeze(tracker, signal.since);
    if p < SIGNAL_NOT_AXIAL_P {
        tracker.on_board(|board| board.raise(Kind::NotAxial, time, not_axial_message(p), None));
        return;
    }
    let change = estimate(tracker, Some(period));
    let message = change
        .as_ref()
        .map_or_else(|| "the axial force changed".to_owned(), drift_message);
    tracker.on_board(|board| board.raise(Kind::Drift, time, message, change));
    tracker.find(Cause::Change, Some(true));
}

fn look_at_limit(tracker: &mut Tracker, period: &Period, time: Timestamp) {
    // Uncompensated, a limit would be a thermometer.
    let Some(charted) = period.charted else { return };
    if !tracker.state.has_learned(tracker.plan.track.learning_periods) {
        return;
    }
    let alarm = &tracker.plan.alarm;
    let (limit, certain) = (alarm.limit_loss, alarm.limit_probability);
    let (change, sd) = (charted.at_reference, charted.at_reference_sd);
    let probability = Normal::standard().cdf((-limit - change) / sd);
    tracker.look(Cause::Limit, beyond(probability, certain, 0.5), time, || {
        format!(
            "the loss of axial force at the reference temperature is {:.1} ± {:.1} %, more than {:.1} % with probability {probability:.3}",
            -100.0 * change,
            100.0 * sd,
            100.0 * limit
        )
    });
}

fn look_at_leverage(tracker: &mut Tracker, period: &Period, time: Timestamp) {
    let Some(charted) = period.charted else { return };
    if !tracker.state.has_learned(tracker.plan.track.learning_periods) {
        return;
    }
    let (blind, sees) = BLIND;
    tracker.look(Cause::Unlearned, beyond(charted.leverage, blind, sees), time, || {
        "the temperature is far from all learned so far: until more is learned, the charts see only large changes".to_owned()
    });
}

/// From a period on the regression learns nothing.
fn freeze(tracker: &mut Tracker, from: i64) {
    tracker.state.frozen.push((from, None));
}

/// A drift that is none when all periods are looked at together ends. The regression was left where it stood, perhaps with
/// too little learned to say what a new season does: the charts need not come down by themselves. It learns what it left out.
fn look_at_change(tracker: &mut Tracker, period: &Period, time: Timestamp) {
    if !tracker.on_board(|board| board.holds(Kind::Drift)) {
        return;
    }
    let Some(change) = estimate(tracker, Some(period)) else {
        return;
    };
    let size = change.size.mean.abs();
    let holds = beyond(size, BEYOND * change.size.sd, change.size.sd);
    if tracker.find(Cause::Change, holds) == Finding::Over {
        tracker.on_board(|board| board.clear(Kind::Drift, time));
        if !tracker.on_board(|board| board.holds(Kind::NotAxial)) {
            tracker.state.frozen.pop();
            learn_anew(tracker, i64::MAX);
            if let Some(charts) = &mut tracker.state.charts {
                charts.reset();
            }
        }
    }
}

/// The regression learns again, and the charts begin anew, once nothing is warned of any more.
fn thaw(tracker: &mut Tracker, index: i64) {
    if tracker.on_board(|board| board.holds(Kind::Drift) || board.holds(Kind::NotAxial)) {
        return;
    }
    let state = &mut tracker.state;
    if let Some((_, to @ None)) = state.frozen.last_mut() {
        *to = Some(index);
        if let Some(charts) = &mut state.charts {
            charts.reset();
        }
    }
}

/// Whether the latest charted residuals are white; those of a time an alarm warned of are not asked.
fn whiteness_of(state: &State, last: &Period) -> Option<Whiteness> {
    let mut residuals: Vec<f64> = std::iter::once(last)
        .chain(state.periods.iter().rev())
        .filter(|period| !state.was_frozen(period.index))
        .filter_map(|period| period.charted.filter(|charted| charted.cusum.is_some()))
        .map(|charted| charted.residual)
        .take(GUARDED)
        .collect();
    residuals.reverse();
    whiteness(&residuals)
}

/// What the tracker knows about a change of force now, for a standing alarm that is told again.
pub(super) fn change_now(tracker: &Tracker) -> Option<Change> {
    estimate(tracker, None)
}

/// One sentence about a drift.
pub(super) fn drift_message(change: &Change) -> String {
    let size = &change.size;
    let verb = if size.mean < 0.0 { "fell" } else { "rose" };
    // Counted in the direction it went; below zero it may have gone the other way.
    let toward = |fraction: f64| 100.0 * fraction * size.mean.signum();
    let (one, other) = (toward(size.q025), toward(size.q975));
    format!(
        "the axial force at the reference temperature {verb} by {:.2} % (95 %: {:.2} to {:.2} %) since about {}",
        toward(size.mean),
        one.min(other),
        one.max(other),
        date(change.onset)
    )
}

fn date(time: Timestamp) -> String {
    time.to_string().chars().take(10).collect()
}

fn not_axial_message(p: f64) -> String {
    format!(
        "the natural frequencies changed in a way no change of axial force explains (p = {p:.1e}): added mass, a support, or \
         mistaken modes"
    )
}

/// Begins the regression with the first period that can be compensated.
fn begin_regression(tracker: &mut Tracker, period: &Period) {
    let plan = &tracker.plan;
    let state = &mut tracker.state;
    let (Some(baseline), Some(shift)) = (&state.segment.baseline, &tracker.shift) else {
        return;
    };
    if state.regression.is_some() || (plan.compensates() && period.lagged_c.is_none()) {
        return;
    }
    if plan.compensates() && state.segment.reference_c.is_none() {
        state.segment.reference_c = plan.track.reference_temperature_c.or_else(|| {
            period
                .lagged_c
                .as_ref()
                .and_then(|lagged| lagged.first().copied())
        });
    }
    state.regression = Some(Regression::new(&plan.regression_prior(baseline, shift)));
}

/// Moves regression and charts on by one period; the signal of the charts, if any.
fn chart(tracker: &mut Tracker, period: &mut Period) -> Option<Signal> {
    let plan = &tracker.plan;
    let state = &mut tracker.state;
    let has_learned = state.has_learned(plan.track.learning_periods);
    let warmer_k = state.warmer_k(period)?;
    let is_frozen = state.is_frozen();
    let level = Level::of(state, state.regression.as_ref()?);
    let regression = state.regression.as_mut()?;
    let statistic = period.statistic(&warmer_k);
    let prediction = regression.predict(&statistic);
    let residual = regression.residual(&statistic);
    let mut charted = placed(period, &warmer_k, &prediction, residual, regression, &level);
    // A wild period is no evidence about temperature; while learning it cannot be told.
    if !is_frozen && (!has_learned || residual.abs() < CLAMP) {
        regression.update(&statistic);
    }
    let mut signal = None;
    if has_learned {
        let charts = state.charts.get_or_insert_with(|| Charts::new(plan.design));
        signal = charts.update(period.index, residual);
        charted.cusum = Some(charts.statistic());
    }
    period.charted = Some(charted);
    signal
}

fn placed(
    period: &Period,
    warmer_k: &[f64],
    prediction: &Prediction,
    residual: f64,
    regression: &Regression,
    level: &Level,
) -> Charted {
    let expected = libm::exp(prediction.mean);
    let (at_reference, compensation_sd) = level.change(regression, period.delta, warmer_k, prediction);
    Charted {
        expected: expected - 1.0,
        expected_sd: expected * prediction.sd,
        residual,
        leverage: prediction.leverage,
        at_reference,
        at_reference_sd: ((1.0 + period.delta) * regression.noise_sd()).hypot(compensation_sd),
        temperature_c: temperature_c(regression, period),
        cusum: None,
    }
}

/// P(misfit at least this large | axial) of the change a signal is about. What happened only lately is diluted in a
/// long onset: the last periods are asked too, and the smallest probability counts, times the number of questions.
fn axial_p(tracker: &Tracker, period: &Period, signal: Signal) -> f64 {
    let Some(shift) = &tracker.shift else { return 1.0 };
    let state = &tracker.state;
    let onset = state.periods.partition_point(|known| known.index < signal.since);
    let since: Vec<&Period> = state.periods[onset..]
        .iter()
        .chain(std::iter::once(period))
        .collect();
    let windows = [since.len(), tracker.plan.alarm.confirm.min(since.len()), 1];
    let smallest = windows.iter().map(|&count| {
        let (log_ratio, misfit) = combined_misfit(since[since.len() - count..].iter().copied());
        shift.not_axial_p(log_ratio, &misfit)
    });
    (smallest.fold(1.0, f64::min) * windows.len() as f64).min(1.0)
}

/// Learns the regression anew from the periods before `since`, if there are enough; whether there are.
fn learn_anew(tracker: &mut Tracker, since: i64) -> bool {
    let plan = &tracker.plan;
    let state = &mut tracker.state;
    let (Some(baseline), Some(shift)) = (&state.segment.baseline, &tracker.shift) else {
        return false;
    };
    let before = state.periods.partition_point(|known| known.index < since);
    let mut regression = Regression::new(&plan.regression_prior(baseline, shift));
    for known in &state.periods[..before] {
        if let Some(warmer_k) = state.warmer_k(known) {
            let is_wild = known
                .charted
                .is_some_and(|charted| charted.cusum.is_some() && charted.residual.abs() >= CLAMP);
            if !is_wild && !state.was_frozen(known.index) {
                regression.update(&known.statistic(&warmer_k));
            }
        }
    }
    let is_enough = regression.periods() >= plan.track.learning_periods;
    if is_enough {
        state.regression = Some(regression);
    }
    is_enough
}

/// Takes out of the regression what it has learned since a change began, and refers the period to what is left.
fn forget_since(tracker: &mut Tracker, since: i64, period: &mut Period) {
    if !learn_anew(tracker, since) {
        return;
    }
    let state = &tracker.state;
    if let (Some(warmer_k), Some(regression), Some(mut charted)) =
        (state.warmer_k(period), &state.regression, period.charted)
    {
        let prediction = regression.predict(&period.statistic(&warmer_k));
        let level = Level::of(state, regression);
        let anew = placed(
            period,
            &warmer_k,
            &prediction,
            charted.residual,
            regression,
            &level,
        );
        charted.at_reference = anew.at_reference;
        charted.at_reference_sd = anew.at_reference_sd;
        period.charted = Some(charted);
    }
}

/// Onset, size and rate of the change in the segment's periods, with one more if it is not among them yet. Earlier
/// changes that ended are left out.
fn estimate(tracker: &Tracker, last: Option<&Period>) -> Option<Change> {
    let state = &tracker.state;
    let regression = state.regression.as_ref()?;
    let reference_c = state.segment.reference_c;
    let is_past = |index: i64| {
        let ended = state.frozen.iter().filter_map(|(from, to)| Some((from, (*to)?)));
        ended.into_iter().any(|(from, to)| *from <= index && index <= to)
    };
    let samples: Vec<(Sample, bool)> = state
        .periods
        .iter()
        .chain(last)
        .filter(|period| !is_past(period.index))
        .filter_map(|period| {
            let warmer_k = match reference_c {
                Some(reference_c) => temperature_c(regression, period)? - reference_c,
                None => 0.0,
            };
            let is_charted = period.charted?.cusum.is_some();
            let sample = Sample {
                start: period.start,
                delta: libm::log1p(period.delta),
                warmer_k,
            };
            Some((sample, is_charted))
        })
        .collect();
    let earliest = samples.iter().position(|(_, is_charted)| *is_charted)?;
    let series: Vec<Sample> = samples.into_iter().map(|(sample, _)| sample).collect();
    let mut change = change::estimate(&series, earliest, regression.autocorrelation())?;
    if let Some(shift) = &tracker.shift {
        // How large a change of frequencies is as a change of force, no number of periods tells.
        let size = change.size.mean.clamp(-0.9, 10.0);
        let u = libm::log1p(size);
        let share = if size == 0.0 {
            0.0
        } else {
            (1.0 + size) * shift.static_sd(u) / size.abs()
        };
        widen(&mut change.size, share);
        widen(&mut change.rate_per_year, share);
    }
    Some(change)
}

/// An interval with a further independent standard deviation, as a share of its mean.
fn widen(interval: &mut Interval, share: f64) {
    let sd = interval.sd.hypot(share * interval.mean);
    if interval.sd > 0.0 {
        let wider = sd / interval.sd;
        interval.q025 = interval.mean - wider * (interval.mean - interval.q025);
        interval.q975 = interval.mean + wider * (interval.q975 - interval.mean);
        interval.sd = sd;
    }
}
