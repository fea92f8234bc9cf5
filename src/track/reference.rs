//! Force and relative force at the reference temperature.
//!
//! What temperature explains of a change is beta (T - T_ref). What is left is counted from the level of the baseline, not
//! from the regression's intercept: the intercept goes on learning, and would take a slow loss with it.
//!
//! ```text
//! change = (delta - beta (T - T_ref)) - (mean of the same over the baseline's periods)
//! ```

use super::period::{self, Period};
use super::regression::{Prediction, Regression};
use super::relative::{Interval, Relative};
use super::state::State;
use super::verdict::AtReference;
use super::{Observation, Tracker};

/// Periods the level is taken from at least, and the regression must have learned before force is referred to another
/// temperature.
const FEWEST_PERIODS: usize = 10;

/// The level that changes at the reference temperature are counted from.
pub(super) struct Level {
    /// N_t / N_0 - 1 at the reference temperature, mean over the baseline's periods.
    value: f64,
    /// Its standard error from their noise.
    sd: f64,
    /// Low-passed temperature less the reference over the same periods, averaged over the lags' weights \[K\].
    warmer_k: f64,
}

impl Level {
    /// From the periods that begin within the baseline, the first ten at least. Zero if there are none.
    pub fn of(state: &State, regression: &Regression) -> Self {
        let last = state.segment.baseline.as_ref().map(|baseline| baseline.last);
        let known = state
            .periods
            .iter()
            .filter_map(|period| Some((period, state.warmer_k(period)?)));
        let (mut count, mut delta, mut warmer_k) = (0.0, 0.0, vec![0.0; state.thermal.lags_s.len()]);
        for (place, (period, warmer)) in known.enumerate() {
            if place >= FEWEST_PERIODS && last.is_none_or(|last| period.start > last) {
                break;
            }
            count += 1.0;
            delta += period.delta;
            warmer_k.iter_mut().zip(&warmer).for_each(|(sum, k)| *sum += k);
        }
        if count == 0.0 {
            return Self {
                value: 0.0,
                sd: 0.0,
                warmer_k: 0.0,
            };
        }
        delta /= count;
        warmer_k.iter_mut().for_each(|sum| *sum /= count);
        let noise = regression.noise_sd();
        let prediction = regression.predict(&period::statistic(0, delta, noise, &warmer_k));
        Self {
            value: compensated(delta, &prediction),
            sd: noise / f64::sqrt(count),
            warmer_k: averaged(regression, &warmer_k),
        }
    }

    /// The change at the reference temperature, and the standard deviation that compensation adds to it.
    pub fn change(
        &self,
        regression: &Regression,
        delta: f64,
        warmer_k: &[f64],
        prediction: &Prediction,
    ) -> (f64, f64) {
        let (_, slope_sd) = regression.slope();
        let warmer_k = averaged(regression, warmer_k) - self.warmer_k;
        let slope_sd = if regression.lag_weights().is_empty() {
            0.0
        } else {
            slope_sd
        };
        (
            compensated(delta, prediction) - self.value,
            self.sd.hypot(slope_sd * warmer_k),
        )
    }
}

/// N_t / N_0 - 1 less what temperature explains of it.
fn compensated(delta: f64, prediction: &Prediction) -> f64 {
    (1.0 + delta) * libm::exp(-prediction.thermal) - 1.0
}

/// The mean over the lags' weights.
fn averaged(regression: &Regression, by_lag: &[f64]) -> f64 {
    let weights = regression.lag_weights();
    weights
        .iter()
        .zip(by_lag)
        .map(|(weight, value)| weight * value)
        .sum()
}

/// The mean over the lags' weights of the period's low-passed temperatures \[degC\].
pub(super) fn temperature_c(regression: &Regression, period: &Period) -> Option<f64> {
    Some(averaged(regression, period.lagged_c.as_ref()?))
}

/// Force and relative force of one record at the reference temperature, by what the closed periods taught.
pub(super) fn of_record(
    tracker: &Tracker,
    observation: &Observation,
    relative: &Relative,
) -> Option<AtReference> {
    let state = &tracker.state;
    let regression = state
        .regression
        .as_ref()
        .filter(|regression| regression.periods() >= FEWEST_PERIODS)?;
    let reference_c = state.segment.reference_c?;
    let end = observation.start.plus_seconds(observation.duration_s);
    let mut thermal = state.thermal.clone();
    for reading in state.readings.iter().take_while(|reading| reading.time <= end) {
        thermal.push(*reading);
    }
    let warmer_k: Vec<f64> = thermal
        .at(end)?
        .iter()
        .map(|celsius| celsius - reference_c)
        .collect();
    let ratio = &relative.ratio;
    let delta = ratio.mean - 1.0;
    let index = period::index_of(observation.start, tracker.plan.track.period_s);
    let statistic = period::statistic(index, delta, relative.record_sd * ratio.mean, &warmer_k);
    let prediction = regression.predict(&statistic);
    let (change, change_sd) = Level::of(state, regression).change(regression, delta, &warmer_k, &prediction);
    // N at the reference temperature is N_t less what temperature explains of N_t / N_0, times N_0.
    let force = &relative.force_n;
    let factor = libm::exp(-prediction.thermal);
    Some(AtReference {
        temperature_c: reference_c,
        ratio: moved(ratio, 1.0, delta - change, change_sd),
        force_n: moved(force, factor, 0.0, prediction.thermal_sd * force.mean),
    })
}

/// `interval` times `factor` less `shift`, with a further independent standard deviation.
fn moved(interval: &Interval, factor: f64, shift: f64, further_sd: f64) -> Interval {
    let mean = interval.mean * factor - shift;
    let sd = (interval.sd * factor).hypot(further_sd);
    let widening = if interval.sd > 0.0 { sd / interval.sd } else { 1.0 };
    Interval {
        mean,
        sd,
        q025: mean - widening * (interval.mean - interval.q025),
        q975: mean + widening * (interval.q975 - interval.mean),
    }
}
