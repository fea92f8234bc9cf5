//! The records of one period as one statistic, with the result of the drift watch.

use super::Filters;
use super::filters::FILTERS_D;
use super::unread::Covariance;
use crate::signal::record::{Reading, Timestamp};
use crate::track::observation::Observation;
use crate::track::relative::{Misfit, Relative};
use serde::{Deserialize, Serialize};

/// A record of a period that is still open.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Pending {
    /// Time of its first sample.
    pub start: Timestamp,
    /// Time of its end, at which its temperature is taken.
    pub end: Timestamp,
    /// N_t / N_0 - 1.
    pub delta: f64,
    /// Standard error of delta from the record's frequency errors alone.
    pub sd: f64,
    /// The misfit of its modes.
    pub misfit: Vec<Misfit>,
}

impl Pending {
    /// A record from an observation and its relative force.
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
    /// Number of periods since 1970.
    pub index: i64,
    /// Its beginning.
    pub start: Timestamp,
    /// Start of the first of its records; `None` from earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub began: Option<Timestamp>,
    /// Mean time of its records, weighted as delta; `None` from earlier versions.
    #[serde(default)]
    pub measured: Option<Timestamp>,
    /// Number of records in it.
    pub records: usize,
    /// delta: the records' N_t / N_0 - 1, weighted by their precision.
    pub delta: f64,
    /// Standard error of delta from the frequency errors of its records.
    pub delta_sd: f64,
    /// Low-passed temperatures beside delta \[degC\], as [`Filters`] has them; `None` if not known.
    #[serde(default)]
    pub filtered_c: Option<[f64; FILTERS_D.len()]>,
    /// Covariance of their errors by what the temperature did since its last reading \[K^2\]; `None` where each record lies between dense
    /// readings, and once the watch has taken the period.
    #[serde(skip)]
    pub unread_k2: Option<Covariance>,
    /// Temperatures at the lags of earlier versions, for resuming from their stores \[degC\].
    #[serde(default, skip_serializing)]
    pub lagged_c: Option<Vec<f64>>,
    /// The misfit of the modes, combined.
    pub misfit: Vec<Misfit>,
    /// P(misfit at least this large | the change is axial).
    pub not_axial_p: f64,
    /// Result of the drift watch; `None` before there is one.
    pub charted: Option<Charted>,
}

/// Result of the drift watch for a period.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Charted {
    /// Predictive mean of delta from all periods before.
    pub expected: f64,
    /// Predictive standard deviation.
    pub expected_sd: f64,
    /// r: standard normal without a change.
    pub residual: f64,
    /// Share of the predictive variance by uncertainty of the effect of temperature, not by noise.
    pub leverage: f64,
    /// N_t / N_0 - 1 at the reference temperature: delta less the effect of temperature, relative to the
    /// baseline; `None` without a temperature.
    pub at_reference: Option<f64>,
    /// Its standard error: noise, fluctuation and uncertainty of the effect of temperature.
    pub at_reference_sd: Option<f64>,
    /// Standard error of delta by what the temperature did since its last reading; `None` where each record lies between dense readings.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unread_sd: Option<f64>,
    /// The rod's temperature: the low pass of six hours, or of the declared lag \[degC\]; `None` without
    /// compensation.
    pub temperature_c: Option<f64>,
    /// Evidence of a change after this period.
    #[serde(default)]
    pub evidence: Evidence,
}

/// Evidence of a change: each detector's statistic over its limit, with an alarm above one; `None` for a
/// detector that did not take the period.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Evidence {
    /// Evidence of the detector with temperature, and with the other rods of the site if there are at least
    /// two.
    pub compensated: Option<f64>,
    /// Evidence of the detector with the other rods only.
    pub peers: Option<f64>,
    /// Evidence of the detector with the rod's own data only.
    pub blind: Option<f64>,
}

impl Evidence {
    /// Evidence of the best-informed detector; zero before one has begun.
    pub fn best_informed(&self) -> f64 {
        self.compensated.or(self.peers).or(self.blind).unwrap_or(0.0)
    }
}

impl Period {
    /// Start of its first record; of one by an earlier version, its [`time`](Self::time).
    pub fn began(&self) -> Timestamp {
        self.began.unwrap_or_else(|| self.time())
    }

    /// Mean time of its records; of one by an earlier version, its beginning.
    pub fn time(&self) -> Timestamp {
        self.measured.unwrap_or(self.start)
    }
}

/// Number of the period of `period_s` seconds that contains `time`, since 1970.
pub fn index_of(time: Timestamp, period_s: f64) -> i64 {
    time.as_nanos().div_euclid(nanos(period_s))
}

/// Begin of a period; saturates at the ends of time.
pub fn start_of(index: i64, period_s: f64) -> Timestamp {
    Timestamp::from_nanos(index.saturating_mul(nanos(period_s)))
}

fn nanos(period_s: f64) -> i64 {
    ((period_s * 1e9) as i64).max(1)
}

/// Combines the records of one period, ascending in time. `filters` are run along `readings` up to the end of the last
/// record, but not beyond the trusted ones; the readings used are taken out. Where the next reading is there, a record's temperature lies on
/// the line to it.
/// `not_axial_p(ln(1 + delta), misfit)` judges the combined misfit.
///
/// delta = sum w_i delta_i / sum w_i with w_i = 1 / sd_i^2, and the temperatures with the same weights,
/// since delta is linear in them. Records without a temperature are left out if others have one.
pub fn combine(
    index: i64,
    period_s: f64,
    records: &[Pending],
    filters: &mut Filters,
    readings: &mut Vec<Reading>,
    trusted_until: Option<Timestamp>,
    not_axial_p: impl Fn(f64, &[Misfit]) -> f64,
) -> Period {
    let temperatures: Vec<Option<([f64; FILTERS_D.len()], Option<Covariance>)>> = records
        .iter()
        .map(|record| {
            let until = trusted_until.map_or(record.end, |trusted| trusted.min(record.end));
            let used = readings.partition_point(|reading| reading.time <= until);
            for reading in readings.drain(..used) {
                filters.push(reading.time.days(), reading.celsius);
            }
            let day = record.end.days();
            let next = (readings.first()).filter(|next| trusted_until.is_none_or(|until| next.time <= until));
            filters.known(day, next.map(|next| (next.time.days(), next.celsius)))
        })
        .collect();
    let compensated = temperatures.iter().any(Option::is_some);
    let start = start_of(index, period_s);
    let mut began = None;
    let mut weight = 0.0;
    let mut delta = 0.0;
    let mut measured_s = 0.0;
    let mut filtered_c = [0.0; FILTERS_D.len()];
    let mut unread_k2 = Covariance::default();
    let mut misfit: Vec<(Misfit, f64)> = Vec::new();
    for (record, temperature) in records.iter().zip(&temperatures) {
        if compensated && temperature.is_none() {
            continue;
        }
        let w = 1.0 / (record.sd * record.sd);
        weight += w;
        delta += w * record.delta;
        began = began.or(Some(record.start));
        measured_s += w * 0.5 * (record.start.seconds_since(start) + record.end.seconds_since(start));
        if let Some((celsius, of_record)) = temperature {
            filtered_c
                .iter_mut()
                .zip(celsius)
                .for_each(|(sum, one)| *sum += w * one);
            let of_record = of_record.iter().flatten().flatten();
            (unread_k2.iter_mut().flatten().zip(of_record)).for_each(|(sum, one)| *sum += w * one);
        }
        for one in &record.misfit {
            add(&mut misfit, one);
        }
    }
    delta /= weight;
    filtered_c.iter_mut().for_each(|sum| *sum /= weight);
    unread_k2.iter_mut().flatten().for_each(|sum| *sum /= weight);
    let misfit = averaged(misfit);
    Period {
        index,
        start,
        began,
        measured: Some(start.plus_seconds(measured_s / weight)),
        records: records.len(),
        delta,
        delta_sd: weight.sqrt().recip(),
        filtered_c: compensated.then_some(filtered_c),
        unread_k2: Some(unread_k2).filter(|unread_k2| unread_k2.iter().flatten().any(|one| *one > 0.0)),
        lagged_c: None,
        not_axial_p: not_axial_p(libm::log1p(delta.max(-1.0 + 1e-9)), &misfit),
        misfit,
        charted: None,
    }
}

/// The misfit of several periods together, with ln(1 + delta) of the root mean square of their deltas, signed as their mean:
/// the effect of wrong static parameters on the misfit grows with delta, and periods of summer and winter
/// must not cancel.
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
