//! What a closed period says: temperature taken out, charts moved on, conditions looked at.

use super::Tracker;
use super::alarm::{AlarmEvent, Board, Finding, Kind};
use super::change::{self, Change, Sample};
use super::chart::{CLAMP, Charts, Signal};
use super::period::{Charted, Period, at_reference, combined_misfit};
use super::regression::{Prediction, Regression};
use super::settings::AlarmSettings;
use super::state::State;
use crate::record::Timestamp;
use statrs::distribution::{ContinuousCDF, Normal};

/// A chart's alarm is no drift if a change of axial force explains the misfit since its onset with less than this
/// probability.
const SIGNAL_NOT_AXIAL_P: f64 = 0.01;

/// The condition of `not-axial` ends above this many times the probability that raised it.
const NOT_AXIAL_OVER: f64 = 10.0;

/// Share of the predictive variance that is uncertainty of the regression: above the first the charts are nearly blind,
/// below the second they see again.
const BLIND: (f64, f64) = (0.9, 0.7);

/// Takes a period that no record can come into any more: its place on the charts, and the news it makes. `time` is the
/// event time at which this is known.
pub(super) fn close(tracker: &mut Tracker, mut period: Period, time: Timestamp) -> (Period, Vec<AlarmEvent>) {
    begin_regression(tracker, &period);
    let signal = chart(tracker, &mut period);
    let verdict = signal.map(|signal| judge(tracker, &mut period, signal));
    let plan = &tracker.plan;
    let alarm = &plan.alarm;
    let has_learned = tracker.state.has_learned(plan.track.learning_periods);
    let limit = exceeds_limit(&period, alarm).filter(|_| has_learned);
    let state = &mut tracker.state;

    let is_axial = if period.not_axial_p < alarm.not_axial_p {
        Some(false)
    } else if period.not_axial_p > NOT_AXIAL_OVER * alarm.not_axial_p {
        Some(true)
    } else {
        None
    };
    let misfits = state.watches.look(
        Kind::NotAxial,
        is_axial.map(|axial| !axial),
        alarm.confirm,
        alarm.confirm,
    );
    let losses = state.watches.look(
        Kind::Limit,
        limit.as_ref().and_then(|(holds, _)| *holds),
        alarm.confirm,
        alarm.confirm,
    );
    let blind = period.charted.filter(|_| has_learned).map(|charted| {
        if charted.leverage > BLIND.0 {
            Some(true)
        } else if charted.leverage < BLIND.1 {
            Some(false)
        } else {
            None
        }
    });
    let blindness = blind.map(|blind| {
        state
            .watches
            .look(Kind::OutsideTraining, blind, alarm.confirm, alarm.confirm)
    });

    let is_calm = state.charts.as_ref().is_none_or(Charts::is_calm);
    let mut board = Board::new(&state.rod, state.segment.number, &mut state.alarms);
    if misfits == Finding::Holds {
        board.raise(Kind::NotAxial, time, not_axial_message(period.not_axial_p), None);
        state.frozen = true;
    } else if misfits == Finding::Over && is_calm {
        board.clear(Kind::NotAxial, time);
    }
    if let Some(signal) = verdict
        && !board.holds(Kind::Drift)
        && !board.holds(Kind::NotAxial)
    {
        match signal {
            Judged::Drift(change) => {
                let message = change
                    .as_ref()
                    .map_or_else(|| "the axial force changed".to_owned(), drift_message);
                board.raise(Kind::Drift, time, message, change);
            }
            Judged::NotAxial(p) => board.raise(Kind::NotAxial, time, not_axial_message(p), None),
        }
        state.frozen = true;
    } else if is_calm {
        board.clear(Kind::Drift, time);
    }
    if let (Finding::Holds, Some((_, message))) = (losses, limit) {
        board.raise(Kind::Limit, time, message, None);
    } else if losses == Finding::Over {
        board.clear(Kind::Limit, time);
    }
    match blindness {
        Some(Finding::Holds) => board.raise(
            Kind::OutsideTraining,
            time,
            "the temperature is far from all learned so far: until more is learned, the charts see only large changes"
                .to_owned(),
            None,
        ),
        Some(Finding::Over) => board.clear(Kind::OutsideTraining, time),
        _ => {}
    }
    let warns = board.holds(Kind::Drift) || board.holds(Kind::NotAxial);
    let events = board.into_events();
    if state.frozen && !warns {
        state.frozen = false;
        if let Some(charts) = &mut state.charts {
            charts.reset();
        }
    }
    (period, events)
}

/// What the tracker knows about a change of force now, for a standing alarm that is told again.
pub(super) fn change_now(tracker: &Tracker) -> Option<Change> {
    let state = &tracker.state;
    estimate(state, None)
}

/// One sentence about a drift.
pub(super) fn drift_message(change: &Change) -> String {
    let percent = |fraction: f64| 100.0 * fraction;
    let verb = if change.size.mean < 0.0 { "fell" } else { "rose" };
    let size = percent(change.size.mean).abs();
    let (low, high) = (percent(change.size.q025).abs(), percent(change.size.q975).abs());
    let (low, high) = (low.min(high), low.max(high));
    format!(
        "the axial force at the reference temperature {verb} by {size:.2} % (95 %: {low:.2} to {high:.2} %) since about {}",
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
    let regression = state.regression.as_mut()?;
    let statistic = period.statistic(&warmer_k);
    let prediction = regression.predict(&statistic);
    let residual = regression.residual(&statistic);
    let mut charted = placed(period, &prediction, residual, regression.noise_sd());
    charted.temperature_c = temperature(regression, period);
    // A wild period is no evidence about temperature; while learning it cannot be told.
    if !state.frozen && (!has_learned || residual.abs() < CLAMP) {
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

/// The mean over the lags' weights of the period's low-passed temperatures \[degC\].
fn temperature(regression: &Regression, period: &Period) -> Option<f64> {
    let lagged_c = period.lagged_c.as_ref()?;
    let weights = regression.lag_weights();
    Some(weights.iter().zip(lagged_c).map(|(w, celsius)| w * celsius).sum())
}

fn placed(period: &Period, prediction: &Prediction, residual: f64, noise_sd: f64) -> Charted {
    let expected = libm::exp(prediction.mean);
    Charted {
        expected: expected - 1.0,
        expected_sd: expected * prediction.sd,
        residual,
        leverage: prediction.leverage,
        at_reference: at_reference(period.delta, prediction),
        at_reference_sd: (1.0 + period.delta) * noise_sd.hypot(prediction.thermal_sd),
        temperature_c: None,
        cusum: None,
    }
}

/// What a signal of the charts is about.
enum Judged {
    Drift(Option<Change>),
    NotAxial(f64),
}

/// Asks whether the change a signal is about is axial, and takes out of the regression what it has learned since the
/// onset. What happened only lately is diluted in a long onset: the last periods are asked too, and the smallest
/// probability counts, times the number of questions.
fn judge(tracker: &mut Tracker, period: &mut Period, signal: Signal) -> Judged {
    let confirm = tracker.plan.alarm.confirm;
    let state = &mut tracker.state;
    let onset = state.periods.partition_point(|known| known.index < signal.since);
    let since: Vec<&Period> = state.periods[onset..]
        .iter()
        .chain(std::iter::once(&*period))
        .collect();
    let windows = [since.len(), confirm.min(since.len()), 1];
    let p = windows
        .iter()
        .map(|&count| {
            let (log_ratio, misfit) = combined_misfit(since[since.len() - count..].iter().copied());
            tracker
                .shift
                .as_ref()
                .map_or(1.0, |shift| shift.not_axial_p(log_ratio, &misfit))
        })
        .fold(1.0, f64::min)
        * windows.len() as f64;
    if !state.frozen {
        forget_since(tracker, signal.since, period);
    }
    if p < SIGNAL_NOT_AXIAL_P {
        return Judged::NotAxial(p);
    }
    Judged::Drift(estimate(&tracker.state, Some(period)))
}

/// Learns the regression anew from the periods before `since`, if there are enough, and refers the period to it.
fn forget_since(tracker: &mut Tracker, since: i64, period: &mut Period) {
    let plan = &tracker.plan;
    let state = &mut tracker.state;
    let before = state.periods.partition_point(|known| known.index < since);
    let (Some(baseline), Some(shift)) = (&state.segment.baseline, &tracker.shift) else {
        return;
    };
    let mut regression = Regression::new(&plan.regression_prior(baseline, shift));
    for known in &state.periods[..before] {
        if let Some(warmer_k) = state.warmer_k(known) {
            let is_wild = known
                .charted
                .is_some_and(|charted| charted.cusum.is_some() && charted.residual.abs() >= CLAMP);
            if !is_wild {
                regression.update(&known.statistic(&warmer_k));
            }
        }
    }
    if regression.periods() < plan.track.learning_periods {
        return;
    }
    if let (Some(warmer_k), Some(charted)) = (state.warmer_k(period), period.charted) {
        let known_statistic = period.statistic(&warmer_k);
        let mut charted = charted;
        let prediction = regression.predict(&known_statistic);
        charted.at_reference = at_reference(period.delta, &prediction);
        charted.at_reference_sd = (1.0 + period.delta) * regression.noise_sd().hypot(prediction.thermal_sd);
        period.charted = Some(charted);
    }
    state.regression = Some(regression);
}

/// Onset, size and rate of the change in the segment's periods, with one more if it is not among them yet.
fn estimate(state: &State, last: Option<&Period>) -> Option<Change> {
    let regression = state.regression.as_ref()?;
    let reference_c = state.segment.reference_c;
    let samples: Vec<(Sample, bool)> = state
        .periods
        .iter()
        .chain(last)
        .filter_map(|period| {
            let warmer_k = match reference_c {
                Some(reference_c) => temperature(regression, period)? - reference_c,
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
    change::estimate(&series, earliest, regression.autocorrelation())
}

/// Whether P(loss > limit | data) exceeds the stated probability, with the sentence that says so; `None` if this
/// period cannot tell. Uncompensated, a limit would be a thermometer.
fn exceeds_limit(period: &Period, alarm: &AlarmSettings) -> Option<(Option<bool>, String)> {
    let charted = period.charted?;
    let (change, sd) = (charted.at_reference, charted.at_reference_sd);
    let probability = Normal::standard().cdf((-alarm.limit_loss - change) / sd);
    let holds = if probability > alarm.limit_probability {
        Some(true)
    } else if probability < 0.5 {
        Some(false)
    } else {
        None
    };
    let message = format!(
        "the loss of axial force at the reference temperature is {:.1} ± {:.1} %, more than {:.1} % with probability {probability:.3}",
        -100.0 * change,
        100.0 * sd,
        100.0 * alarm.limit_loss
    );
    Some((holds, message))
}
