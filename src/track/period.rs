//! The records of one decorrelation period as one statistic, and what the charts made of it.

use super::Observation;
use super::regression::Statistic;
use super::relative::{Misfit, Relative};
use super::thermal::Thermal;
use crate::record::{Reading, Timestamp};
use serde::{Deserialize, Serialize};

/// A record of a period that is still open.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Pending {
    /// Time of its first sample.
    pub start: Timestamp,
    /// Time of its end: its temperature is asked for then.
    pub end: Timestamp,
    /// N_t / N_0 - 1.
    pub delta: f64,
    /// Standard error of delta from the record's frequency errors alone.
    pub sd: f64,
    /// The misfit of its modes.
    pub misfit: Vec<Misfit>,
}

impl Pending {
    /// Of an observation and its relative force.
    pub fn new(observation: &Observation, relative: &Relative) -> Self {
        Self {
            start: observation.start,
            end: observation.start.plus_seconds(observation.duration_s),
            delta: libm::expm1(relative.estimate),
            sd: relative.record_sd * libm::exp(relative.estimate),
            misfit: relative.misfit.clone(),
        }
    }
}

/// One period of one rod.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Period {
    /// Periods since 1970.
    pub index: i64,
    /// Its beginning.
    pub start: Timestamp,
    /// Records in it.
    pub records: usize,
    /// delta: the records' N_t / N_0 - 1, weighted by their precision.
    pub delta: f64,
    /// Standard error of delta from the frequency errors of its records.
    pub delta_sd: f64,
    /// Temperatures beside delta \[degC\], one per thermal lag; `None` if not known.
    pub lagged_c: Option<Vec<f64>>,
    /// The misfit of the modes, combined.
    pub misfit: Vec<Misfit>,
    /// P(misfit at least this large | the change is axial).
    pub not_axial_p: f64,
    /// What the regression and the charts made of it; `None` while it could not be compensated.
    pub charted: Option<Charted>,
}

impl Period {
    /// What the regression takes from it: the logarithm of the ratio and its standard error.
    pub(super) fn statistic<'w>(&self, warmer_k: &'w [f64]) -> Statistic<'w> {
        statistic(self.index, self.delta, self.delta_sd, warmer_k)
    }
}

/// A change N_t / N_0 - 1 as the regression takes it.
pub(super) fn statistic(period: i64, delta: f64, sd: f64, warmer_k: &[f64]) -> Statistic<'_> {
    let ratio = (1.0 + delta).max(f64::MIN_POSITIVE);
    Statistic {
        period,
        delta: libm::log(ratio),
        sd: sd / ratio,
        warmer_k,
    }
}

/// A period's place on the charts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Charted {
    /// Predictive mean of delta from all periods before.
    pub expected: f64,
    /// Predictive standard deviation.
    pub expected_sd: f64,
    /// r: standard normal without a change.
    pub residual: f64,
    /// Share of the predictive variance that is uncertainty of the regression rather than noise.
    pub leverage: f64,
    /// N_t / N_0 - 1 at the reference temperature: delta less what temperature explains, counted from the baseline.
    pub at_reference: f64,
    /// Its standard error: noise of the period and regression.
    pub at_reference_sd: f64,
    /// The low-passed temperature, averaged over the lags' weights \[degC\]; `None` without compensation.
    pub temperature_c: Option<f64>,
    /// The charts after this period: \[chart\]\[0 up, 1 down\]; `None` while learning.
    pub cusum: Option<[[f64; 2]; 2]>,
}

/// The number of the period of `period_s` seconds that holds `time`, since 1970.
pub fn index_of(time: Timestamp, period_s: f64) -> i64 {
    time.as_nanos().div_euclid(nanos(period_s))
}

/// The beginning of a period; saturates at the ends of time.
pub fn start_of(index: i64, period_s: f64) -> Timestamp {
    Timestamp::from_nanos(index.saturating_mul(nanos(period_s)))
}

fn nanos(period_s: f64) -> i64 {
    ((period_s * 1e9) as i64).max(1)
}

/// Combines the records of one period, ascending in time. `thermal` is run along `readings` up to the end of the last
/// record; the readings used are taken out. `not_axial_p(ln(1 + delta), misfit)` judges the combined misfit.
///
/// delta = sum w_i delta_i / sum w_i with w_i = 1 / sd_i^2, and the temperatures with the same weights,
/// since delta is linear in them. Records without a temperature are left out if others have one.
pub fn combine(
    index: i64,
    period_s: f64,
    records: &[Pending],
    thermal: &mut Thermal,
    readings: &mut Vec<Reading>,
    not_axial_p: impl Fn(f64, &[Misfit]) -> f64,
) -> Period {
    let lags = thermal.lags_s.len();
    let temperatures: Vec<Option<Vec<f64>>> = records
        .iter()
        .map(|record| {
            let used = readings.partition_point(|reading| reading.time <= record.end);
            for reading in readings.drain(..used) {
                thermal.push(reading);
            }
            thermal.at(record.end).filter(|_| thermal.has_settled(record.end))
        })
        .collect();
    let compensated = lags > 0 && temperatures.iter().any(Option::is_some);
    let mut weight = 0.0;
    let mut delta = 0.0;
    let mut lagged_c = vec![0.0; lags];
    let mut misfit: Vec<(Misfit, f64)> = Vec::new();
    for (record, temperature) in records.iter().zip(&temperatures) {
        if compensated && temperature.is_none() {
            continue;
        }
        let w = 1.0 / (record.sd * record.sd);
        weight += w;
        delta += w * record.delta;
        for (sum, celsius) in lagged_c.iter_mut().zip(temperature.iter().flatten()) {
            *sum += w * celsius;
        }
        for one in &record.misfit {
            add(&mut misfit, one);
        }
    }
    delta /= weight;
    lagged_c.iter_mut().for_each(|sum| *sum /= weight);
    let misfit = averaged(misfit);
    Period {
        index,
        start: start_of(index, period_s),
        records: records.len(),
        delta,
        delta_sd: weight.sqrt().recip(),
        lagged_c: compensated.then_some(lagged_c),
        not_axial_p: not_axial_p(libm::log1p(delta.max(-1.0 + 1e-9)), &misfit),
        misfit,
        charted: None,
    }
}

/// The misfit of several periods together, with ln(1 + delta) of the root mean square of their deltas, signed as their mean:
/// what wrong static parameters do to the misfit grows with delta, and periods of summer and winter must not cancel.
pub fn combined_misfit<'a>(periods: impl Iterator<Item = &'a Period>) -> (f64, Vec<Misfit>) {
    let mut misfit = Vec::new();
    let (mut weight, mut delta, mut square) = (0.0, 0.0, 0.0);
    for period in periods {
        let w = 1.0 / (period.delta_sd * period.delta_sd);
        weight += w;
        delta += w * period.delta;
        square += w * period.delta * period.delta;
        for one in &period.misfit {
            add(&mut misfit, one);
        }
    }
    let typical = (square / weight).sqrt().copysign(delta);
    (libm::log1p(typical.max(-1.0 + 1e-9)), averaged(misfit))
}

/// Adds one mode's misfit to the precision-weighted sums (residual: sum w r; second: sum w).
fn add(sums: &mut Vec<(Misfit, f64)>, one: &Misfit) {
    let w = 1.0 / (one.sd * one.sd);
    match sums.iter_mut().find(|(sum, _)| sum.order == one.order) {
        Some((sum, weight)) => {
            sum.residual += w * one.residual;
            *weight += w;
        }
        None => sums.push((
            Misfit {
                residual: w * one.residual,
                ..*one
            },
            w,
        )),
    }
}

fn averaged(sums: Vec<(Misfit, f64)>) -> Vec<Misfit> {
    let mut misfit: Vec<Misfit> = sums
        .into_iter()
        .map(|(sum, weight)| Misfit {
            order: sum.order,
            residual: sum.residual / weight,
            sd: weight.sqrt().recip(),
        })
        .collect();
    misfit.sort_by_key(|one| one.order);
    misfit
}
