//! A reported change of force: onset, size and rate, with credible intervals.

use crate::signal::record::Timestamp;
use crate::track::drift;
use crate::track::relative::Interval;
use serde::{Deserialize, Serialize};

/// Standard normal quantile of a 95 % interval.
const Z: f64 = 1.959_963_984_540_054;

/// Estimate of a change.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// Median of the onset's posterior.
    pub onset: Timestamp,
    /// 95 % interval of the onset.
    pub onset_q025: Timestamp,
    /// 95 % interval of the onset.
    pub onset_q975: Timestamp,
    /// Relative change of force up to the last period, as a share of N_0 \[-\].
    pub size: Interval,
    /// Relative change per year while it lasts, if it is a ramp \[1/year\].
    pub rate_per_year: Interval,
    /// Probability that it is a step rather than a ramp.
    pub step_probability: f64,
}

impl Change {
    /// Change by a detector. `static_sd`: share of the size that the static parameters leave uncertain with
    /// any number of records.
    pub(crate) fn told(change: &drift::Change, static_sd: f64) -> Self {
        let size = Interval {
            mean: change.size,
            sd: change.size_sd,
            q025: change.size_interval[0],
            q975: change.size_interval[1],
        };
        let (rate, rate_sd) = change.rate_per_year.unwrap_or((0.0, 0.0));
        let rate = Interval {
            mean: rate,
            sd: rate_sd,
            q025: rate - Z * rate_sd,
            q975: rate + Z * rate_sd,
        };
        Self {
            onset: Timestamp::from_days(change.onset),
            onset_q025: Timestamp::from_days(change.onset_interval[0]),
            onset_q975: Timestamp::from_days(change.onset_interval[1]),
            size: widened(size, static_sd),
            rate_per_year: widened(rate, static_sd),
            step_probability: 1.0 - change.ramp_probability,
        }
    }
}

/// An interval with a further independent standard deviation, as a share of its mean.
fn widened(interval: Interval, share: f64) -> Interval {
    let sd = interval.sd.hypot(share * interval.mean);
    let wider = if interval.sd > 0.0 { sd / interval.sd } else { 1.0 };
    Interval {
        mean: interval.mean,
        sd,
        q025: interval.mean - wider * (interval.mean - interval.q025),
        q975: interval.mean + wider * (interval.q975 - interval.mean),
    }
}
