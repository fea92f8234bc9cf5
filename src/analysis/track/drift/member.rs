//! One member of a bank: a Kalman filter with unknown noise, its prediction and its step.
//!
//! Its covariance is kept as the upper triangle by rows.

use super::prior::{BankPrior, Fluctuation};
use super::row::Row;
use serde::{Deserialize, Serialize};

/// Shape of the prior law of the noise variance: four degrees of freedom; its mean is 2 s0^2.
const SHAPE: f64 = 2.0;

/// State of one member.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Member {
    /// Index among the prior's members.
    pub which: u8,
    /// Its weight; those of a bank sum to one.
    pub weight: f64,
    /// alpha and beta of the noise variance's inverse gamma law.
    pub shape: f64,
    pub rate: f64,
    /// Mean of the state: change, intercept, columns, slow fluctuation, fluctuation.
    pub mean: Vec<f64>,
    /// Covariance over the noise variance: upper triangle by rows.
    pub cov: Vec<f64>,
}

/// Decay of a member's fluctuations from one period to the next.
#[derive(Debug, Clone, Copy)]
pub(super) struct Decay {
    fast: f64,
    slow: f64,
    /// Variance that the first fluctuation gains, in noise variances.
    pub added: f64,
}

/// Passage of time to a period, for every member of the prior.
#[derive(Debug, Clone)]
pub(super) struct Passage {
    pub day: f64,
    decays: Vec<Decay>,
}

impl Passage {
    /// Passage from the last period, if any, to `day`; an earlier day counts as the last.
    pub fn new(prior: &BankPrior, last: Option<f64>, day: f64) -> Self {
        let gap = last.map_or(0.0, |last| (day - last).max(0.0));
        // Members share a few memories.
        let mut fades: Vec<(f64, f64, f64)> = Vec::new();
        let mut fade = |memory_d: f64| {
            let known = fades.iter().copied().find(|known| known.0 == memory_d);
            known.unwrap_or_else(|| {
                let fade = (
                    memory_d,
                    libm::exp(-gap / memory_d),
                    libm::expm1(-2.0 * gap / memory_d),
                );
                fades.push(fade);
                fade
            })
        };
        let decay = |fluctuation: &Fluctuation| {
            let (_, fast, grows) = fade(fluctuation.memory_d);
            Decay {
                fast,
                slow: fade(fluctuation.slow_memory_d).1,
                added: -fluctuation.variance * grows,
            }
        };
        Self {
            day: last.map_or(day, |last| last.max(day)),
            decays: prior.members.iter().map(decay).collect(),
        }
    }

    pub fn of(&self, member: &Member) -> &Decay {
        &self.decays[usize::from(member.which)]
    }
}

/// Prediction of one member.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ahead {
    pub error: f64,
    /// S = R + q alpha / beta + H P H'.
    pub total: f64,
}

impl Member {
    /// A member before the first period.
    pub fn new(prior: &BankPrior, which: usize) -> Self {
        let fluctuation = &prior.members[which];
        let noise = prior.noise_sd * prior.noise_sd;
        let width = prior.columns.len() + 4;
        let mut mean = vec![0.0, 0.0];
        mean.extend(prior.columns.iter().map(|law| law.mean));
        mean.extend([0.0, 0.0]);
        let mut variances = vec![0.0, prior.intercept_sd * prior.intercept_sd / noise];
        variances.extend(prior.columns.iter().map(|law| law.sd * law.sd / noise));
        variances.extend([fluctuation.slow_variance, fluctuation.variance]);
        let mut cov = vec![0.0; width * (width + 1) / 2];
        for (row, variance) in variances.into_iter().enumerate() {
            cov[place(width, row, row)] = variance;
        }
        Self {
            which: which as u8,
            weight: fluctuation.probability,
            shape: SHAPE,
            rate: 2.0 * (SHAPE - 1.0) * noise,
            mean,
            cov,
        }
    }

    /// beta / alpha.
    pub fn scale2(&self) -> f64 {
        self.rate / self.shape
    }

    /// Posterior mean of the noise variance.
    pub fn noise(&self) -> f64 {
        self.rate / (self.shape - 1.0)
    }

    /// Lets the fluctuations decay.
    pub fn advance(&mut self, fluctuation: &Fluctuation, decay: &Decay) {
        let width = self.mean.len();
        let (slow, fast) = (width - 2, width - 1);
        let (f, g) = (decay.fast, decay.slow);
        let mut at = slow;
        for row in 0..slow {
            self.cov[at] *= g;
            self.cov[at + 1] *= f;
            at += width - row - 1;
        }
        self.cov[at] = g * g * self.cov[at] + fluctuation.slow_variance * (1.0 - g * g);
        self.cov[at + 1] *= f * g;
        self.cov[at + 2] = f * f * self.cov[at + 2] + decay.added;
        self.mean[slow] *= g;
        self.mean[fast] *= f;
    }

    /// Prediction of a row; `along` becomes P H'.
    #[inline(always)]
    pub fn ahead(&self, row: &Row, along: &mut [f64]) -> Ahead {
        times(&self.cov, &row.x, along);
        Ahead {
            error: row.ratio - dot(&row.x, &self.mean),
            total: row.error + row.unread / self.scale2() + dot(&row.x, along).max(0.0),
        }
    }

    /// Kalman and inverse gamma step.
    #[inline(always)]
    pub fn learn(&mut self, ahead: Ahead, along: &[f64]) {
        let gain = ahead.error / ahead.total;
        for (mean, along) in self.mean.iter_mut().zip(along) {
            *mean += along * gain;
        }
        self.narrow(ahead.total, along);
        self.rate += 0.5 * ahead.error * gain;
        self.shape += 0.5;
    }

    /// Covariance after a row with P H' = `along` and S = `total`.
    #[inline(always)]
    pub fn narrow(&mut self, total: f64, along: &[f64]) {
        let width = along.len();
        let mut at = 0;
        for row in 0..width {
            let share = along[row] / total;
            let entries = &mut self.cov[at..at + width - row];
            for (entry, along) in entries.iter_mut().zip(&along[row..]) {
                *entry -= share * along;
            }
            entries[0] = entries[0].max(0.0);
            at += width - row;
        }
    }
}

/// Index of an entry of the upper triangle.
pub(super) const fn place(width: usize, row: usize, column: usize) -> usize {
    row * width - row * (row + 1) / 2 + column
}

/// Product of a symmetric matrix and a vector.
#[inline(always)]
fn times(cov: &[f64], x: &[f64], product: &mut [f64]) {
    product.fill(0.0);
    let mut left = cov;
    for row in 0..x.len() {
        let (entries, rest) = left.split_at(x.len() - row);
        left = rest;
        let head = x[row];
        product[row] += entries[0] * head + dot(&entries[1..], &x[row + 1..]);
        for (product, entry) in product[row + 1..].iter_mut().zip(&entries[1..]) {
            *product += entry * head;
        }
    }
}

/// Scalar product, in four independent sums.
#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 4];
    let (a, b) = (a.chunks_exact(4), b.chunks_exact(4));
    let tail: f64 = a.remainder().iter().zip(b.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in a.zip(b) {
        for lane in 0..4 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + tail
}

/// x'P x over the first `count` entries.
#[inline(always)]
pub(super) fn quadratic(cov: &[f64], x: &[f64], count: usize) -> f64 {
    let mut sum = 0.0;
    let mut left = cov;
    for row in 0..count {
        let (entries, rest) = left.split_at(x.len() - row);
        left = rest;
        let beside = dot(&entries[1..count - row], &x[row + 1..count]);
        sum += x[row] * (x[row] * entries[0] + 2.0 * beside);
    }
    sum.max(0.0)
}
