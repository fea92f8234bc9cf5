//! Mean, spread and 95 % interval of one quantity.

use crate::inference::Marginal;
use serde::{Deserialize, Serialize};

/// Mean, spread and 95 % interval of one quantity.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub sd: f64,
    /// 2.5 % quantile.
    pub q025: f64,
    /// 97.5 % quantile.
    pub q975: f64,
}

impl Interval {
    /// The interval of a normal law.
    pub fn normal(mean: f64, sd: f64) -> Self {
        Self {
            mean,
            sd,
            q025: mean - Z * sd,
            q975: mean + Z * sd,
        }
    }
}

/// Standard normal quantile of a 95 % interval.
const Z: f64 = 1.959_963_984_540_054;

impl From<&Marginal> for Interval {
    fn from(of: &Marginal) -> Self {
        Self {
            mean: of.mean,
            sd: of.sd,
            q025: of.q025,
            q975: of.q975,
        }
    }
}
