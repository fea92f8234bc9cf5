//! What temperature explains of delta: recursive Bayesian regression over a grid of lags and
//! autocorrelations, with predictive residuals that are N(0, 1) without a change.
//!
//! Thermal force adds to the axial force, so the straight line is one of the ratio, not of its logarithm:
//!
//! ```text
//! e^delta_t - 1 = a + beta w_t + gamma w_t^2 + q_t e_t,     w_t = T_lag,t - T_ref,
//! e_t = rho e_t' + sqrt(1 - rho^2) s v_t
//! ```
//!
//! The curvature gamma is small but not nothing: slopes d ln f/d ln N that are a little wrong bend the ratio, and modulus and
//! expansion themselves change with temperature. Without it a fully restrained rod alarms in its first warm season.
//! Here v_t are independent N(0, 1), rho = phi^gap for periods `gap` apart, and q_t known: the expected ratio (the error
//! of a logarithm is an error in proportion), times how the noise goes with the measurement's standard error: not at
//! all, partly, or wholly. For a given lag, phi and kind of noise this is a conjugate regression in (a, beta, gamma, s^2), and delta's predictive law
//! Student's t; the whole is the mixture over the grid by posterior weight. Under the model F(delta_t) is exactly
//! uniform and independent from period to period, however little has been learned: nothing is plugged in.

use super::member::{Member, Numbers, Row};
use super::tail;
use serde::{Deserialize, Serialize};

pub use super::whiteness::{Whiteness, whiteness};

/// Autocorrelations between neighbouring periods that are tried, and their prior weights.
const PHIS: [(f64, f64); 7] = [
    (-0.15, 0.12),
    (0.0, 0.30),
    (0.15, 0.20),
    (0.3, 0.15),
    (0.45, 0.11),
    (0.65, 0.08),
    (0.85, 0.04),
];
/// Kinds of noise: the share of the variance that goes with the square of the measurement's standard error, in a
/// period whose standard error is the first's.
const NOISE_SHARES: [f64; NOISES] = [0.0, 0.4, 1.0];
const NOISES: usize = 3;
/// Shape of the noise variance's prior law: half a period's worth of knowledge.
const SHAPE: f64 = 0.25;
/// The prior of the coefficients is conjugate if it scales with the noise; it is as wide as stated where the noise
/// is this share of the first period's standard error, and wider where there is more noise.
const CONJUGATE: f64 = 0.5;
/// Least standard error believed \[-\].
const LEAST_SD: f64 = 1e-6;
/// Least ln weight: a member may come back.
const LEAST_LN_WEIGHT: f64 = -60.0;
/// Weights below do not count.
const NEGLIGIBLE: f64 = 1e-14;

/// One period as the regression sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Statistic<'a> {
    /// Periods since 1970.
    pub period: i64,
    /// delta.
    pub delta: f64,
    /// Standard error of delta from frequency errors.
    pub sd: f64,
    /// Low-passed temperature less the reference \[K\], one per lag; empty without compensation.
    pub warmer_k: &'a [f64],
}

/// What is known beforehand.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RegressionPrior {
    /// Mean of beta = -kappa E A alpha / N_0 \[1/K\].
    pub slope_mean: f64,
    /// Its standard deviation \[1/K\].
    pub slope_sd: f64,
    /// Standard deviation of the intercept \[-\].
    pub intercept_sd: f64,
    /// Standard deviation of the curvature gamma \[1/K^2\].
    pub curvature_sd: f64,
    /// How many lags there are; zero: no compensation.
    pub lags: usize,
}

/// What the regression expects of a period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prediction {
    /// Predictive mean of delta.
    pub mean: f64,
    /// Predictive standard deviation.
    pub sd: f64,
    /// Share of the predictive variance that is uncertainty of the coefficients.
    pub leverage: f64,
    /// What temperature alone explains of the statistic's delta: delta - ln(e^delta - beta w - gamma w^2) with the
    /// posterior means, so that delta less this is ln(N_t / N_0) at the reference temperature.
    pub thermal: f64,
    /// Standard deviation of intercept + thermal part, as one of delta.
    pub thermal_sd: f64,
    /// Posterior mean of the intercept a \[-\].
    pub intercept: f64,
}

/// The period learned last.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Last {
    period: i64,
    ratio: f64,
    warmer_k: Vec<f64>,
    scales: [f64; NOISES],
}

/// The regressions over the grid, each with its weight.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Regression {
    prior: RegressionPrior,
    periods: usize,
    /// The first period's standard error.
    first_sd: Option<f64>,
    last: Option<Last>,
    /// By lag, then phi, then noise; empty before the first period.
    members: Vec<Member>,
}

/// A statistic made ready for every member.
struct Prepared {
    ratio: f64,
    warmer_k: Vec<f64>,
    scales: [f64; NOISES],
    gap: Option<i32>,
}

/// A member with its row and weight.
struct Weighted<'a> {
    weight: f64,
    member: &'a Member,
    lag: usize,
    phi: f64,
    noise: usize,
}

impl Regression {
    /// Before any data.
    pub fn new(prior: &RegressionPrior) -> Self {
        Self {
            prior: prior.clone(),
            periods: 0,
            first_sd: None,
            last: None,
            members: Vec::new(),
        }
    }

    /// Periods learned from.
    pub fn periods(&self) -> usize {
        self.periods
    }

    /// What is expected of a period. Only `thermal` looks at its delta.
    pub fn predict(&self, statistic: &Statistic) -> Prediction {
        let members = self.members_for(statistic);
        let prepared = self.prepare(&members, statistic);
        let a = self.shape();
        // Variance of Student's t over its squared scale; bounded where it has none.
        let heavy = 2.0 * a / (2.0 * a - 2.0).max(0.5);
        let [
            mut mean,
            mut square,
            mut own,
            mut line,
            mut line_square,
            mut thermal,
            mut intercept,
        ] = [0.0; 7];
        for part in self.weighted(&members) {
            let (row, unscale) = self.row(&part, &prepared);
            let Weighted { weight, member, .. } = part;
            let warmer = prepared.warmer_k[part.lag];
            let noise = member.b / a * heavy;
            let location = prepared.ratio + unscale * (member.location(row.x) - row.response);
            let coefficients = noise * member.spread(row.x) * unscale * unscale;
            mean += weight * location;
            square += weight * (location * location + coefficients + noise * unscale * unscale);
            own += weight * noise * unscale * unscale;
            let here = columns(warmer);
            let value = member.location(here);
            line += weight * value;
            line_square += weight * (value * value + noise * member.spread(here));
            thermal += weight * (value - member.mean[0]);
            intercept += weight * member.mean[0];
        }
        let variance = (square - mean * mean).max(own).max(f64::MIN_POSITIVE);
        let level = (1.0 + mean).max(1e-3);
        Prediction {
            mean: libm::log(level),
            sd: variance.sqrt() / level,
            leverage: (1.0 - own / variance).clamp(0.0, 1.0),
            thermal: -libm::log((1.0 - thermal / (1.0 + prepared.ratio).max(1e-3)).max(1e-3)),
            thermal_sd: (line_square - line * line).max(0.0).sqrt() / level,
            intercept,
        }
    }

    /// r = Phi^-1(F(delta)): the predictive residual, right in the tails and finite.
    pub fn residual(&self, statistic: &Statistic) -> f64 {
        let members = self.members_for(statistic);
        let prepared = self.prepare(&members, statistic);
        let a = self.shape();
        let parts: Vec<(f64, f64)> = self
            .weighted(&members)
            .map(|part| {
                let (row, _) = self.row(&part, &prepared);
                let (t, _) = part.member.student(&row, a);
                (part.weight, tail::student_deviate(t, 2.0 * a))
            })
            .collect();
        tail::mixture_deviate(&parts)
    }

    /// Learns a period; one that is not finite teaches nothing.
    pub fn update(&mut self, statistic: &Statistic) {
        if !(statistic.delta.is_finite() && statistic.warmer_k.iter().all(|k| k.is_finite())) {
            return;
        }
        let mut members = self.members_for(statistic).into_owned();
        let prepared = self.prepare(&members, statistic);
        let (a, freedom) = (self.shape(), 2.0 * self.shape());
        for (index, member) in members.iter_mut().enumerate() {
            let (lag, phi, noise) = place(index);
            let part = Weighted {
                weight: 1.0,
                member,
                lag,
                phi,
                noise,
            };
            let (row, unscale) = self.row(&part, &prepared);
            let (t, scale) = member.student(&row, a);
            member.ln_weight -=
                0.5 * (freedom + 1.0) * libm::log1p(t * t / freedom) + libm::log(scale * unscale);
            member.learn(&row);
        }
        let highest = members
            .iter()
            .map(|member| member.ln_weight)
            .fold(f64::NEG_INFINITY, f64::max);
        for member in &mut members {
            member.ln_weight = (member.ln_weight - highest).max(LEAST_LN_WEIGHT);
        }
        let finite = |member: &Member| Numbers::from(*member).iter().all(|value| value.is_finite());
        if !members.iter().all(finite) {
            return;
        }
        self.first_sd.get_or_insert(believed(statistic.sd));
        self.members = members;
        self.periods += 1;
        self.last = Some(Last {
            period: statistic.period,
            ratio: prepared.ratio,
            warmer_k: prepared.warmer_k,
            scales: prepared.scales,
        });
    }

    /// Posterior mean and standard deviation of beta \[1/K\].
    pub fn slope(&self) -> (f64, f64) {
        if self.members.is_empty() {
            return (self.prior.slope_mean, self.prior.slope_sd);
        }
        let a = self.shape();
        let (mut mean, mut square) = (0.0, 0.0);
        for part in self.weighted(&self.members) {
            let slope = part.member.mean[1];
            mean += part.weight * slope;
            square +=
                part.weight * (slope * slope + part.member.b / (a - 1.0).max(0.5 * a) * part.member.cov[3]);
        }
        (mean, (square - mean * mean).max(0.0).sqrt())
    }

    /// Posterior weight of each lag, summing to one; a lag half way between two counts half for each.
    pub fn lag_weights(&self) -> Vec<f64> {
        let mut weights = vec![0.0; self.prior.lags];
        if self.members.is_empty() {
            weights.fill(1.0 / self.prior.lags.max(1) as f64);
        }
        for part in self.weighted(&self.members) {
            for lag in [part.lag / 2, part.lag.div_ceil(2)] {
                if let Some(slot) = weights.get_mut(lag) {
                    *slot += 0.5 * part.weight;
                }
            }
        }
        weights
    }

    /// Posterior mean of the AR(1) coefficient between neighbouring periods.
    pub fn autocorrelation(&self) -> f64 {
        if self.members.is_empty() {
            return PHIS.iter().map(|(phi, weight)| phi * weight).sum();
        }
        self.weighted(&self.members)
            .map(|part| part.weight * part.phi)
            .sum()
    }

    /// Posterior mean of the noise standard deviation of one period, as of delta, at the period learned last;
    /// zero before the first.
    pub fn noise_sd(&self) -> f64 {
        let a = self.shape();
        let Some(last) = &self.last else { return 0.0 };
        self.weighted(&self.members)
            .map(|part| {
                let own = last.scales[part.noise] / last.scales[0];
                part.weight * own * (part.member.b / (a - 1.0).max(0.5 * a)).sqrt()
            })
            .sum()
    }

    fn shape(&self) -> f64 {
        SHAPE + 0.5 * self.periods as f64
    }

    /// The members, or those before the first period.
    fn members_for(&self, statistic: &Statistic) -> std::borrow::Cow<'_, [Member]> {
        if !self.members.is_empty() {
            return (&self.members[..]).into();
        }
        let sd = self.first_sd.unwrap_or(believed(statistic.sd));
        let wide = |prior_sd: f64| (prior_sd / (CONJUGATE * sd)).powi(2);
        let slopes = if self.prior.lags > 0 { 1.0 } else { 0.0 };
        let member = |ln_weight| Member {
            mean: [0.0, slopes * self.prior.slope_mean, 0.0],
            cov: [
                wide(self.prior.intercept_sd),
                0.0,
                0.0,
                slopes * wide(self.prior.slope_sd),
                0.0,
                slopes * wide(self.prior.curvature_sd),
            ],
            b: SHAPE * sd * sd,
            ln_weight,
        };
        let lags = (2 * self.prior.lags).saturating_sub(1).max(1);
        (0..lags * PHIS.len() * NOISES)
            .map(|index| member(libm::log(PHIS[index / NOISES % PHIS.len()].1)))
            .collect::<Vec<_>>()
            .into()
    }

    /// The members that count, with normalised weights.
    fn weighted<'a>(&self, members: &'a [Member]) -> impl Iterator<Item = Weighted<'a>> + use<'a> {
        let sum: f64 = members.iter().map(|member| libm::exp(member.ln_weight)).sum();
        members
            .iter()
            .enumerate()
            .map(move |(index, member)| {
                let (lag, phi, noise) = place(index);
                Weighted {
                    weight: libm::exp(member.ln_weight) / sum,
                    member,
                    lag,
                    phi,
                    noise,
                }
            })
            .filter(|part| part.weight > NEGLIGIBLE)
    }

    fn prepare(&self, members: &[Member], statistic: &Statistic) -> Prepared {
        let ratio = libm::expm1(statistic.delta.clamp(-20.0, 20.0));
        let given = |lag: usize| {
            let value = statistic.warmer_k.get(lag).copied().unwrap_or(0.0);
            if value.is_finite() {
                value.clamp(-1e3, 1e3)
            } else {
                0.0
            }
        };
        // Between two lags their mean: at a day's frequency within 3 % of the lag half way.
        let lags = (2 * self.prior.lags).saturating_sub(1).max(1);
        let warmer_k: Vec<f64> = (0..lags)
            .map(|lag| {
                if self.prior.lags == 0 {
                    0.0
                } else {
                    0.5 * (given(lag / 2) + given(lag.div_ceil(2)))
                }
            })
            .collect();
        let expected: f64 = self
            .weighted(members)
            .map(|part| part.weight * part.member.location(columns(warmer_k[part.lag])))
            .sum();
        let level = (1.0 + expected).clamp(0.2, 5.0);
        let sd = believed(statistic.sd);
        let relative = (sd / self.first_sd.unwrap_or(sd)).clamp(0.1, 10.0).powi(2);
        let gap = self.last.as_ref().and_then(|last| {
            let gap = statistic.period.saturating_sub(last.period);
            (gap > 0).then_some(gap.min(1000) as i32)
        });
        Prepared {
            ratio,
            warmer_k,
            scales: NOISE_SHARES.map(|share| level * (1.0 - share + share * relative).sqrt()),
            gap,
        }
    }

    /// A member's row, and what one unit of its response is in the ratio.
    fn row(&self, part: &Weighted, prepared: &Prepared) -> (Row, f64) {
        let scale = prepared.scales[part.noise];
        let now = columns(prepared.warmer_k[part.lag]);
        let (Some(last), Some(gap)) = (&self.last, prepared.gap) else {
            let row = Row {
                response: prepared.ratio / scale,
                x: now.map(|column| column / scale),
            };
            return (row, scale);
        };
        let rho = part.phi.powi(gap);
        let white = (1.0 - rho * rho).sqrt();
        let before = last.scales[part.noise];
        let then = columns(last.warmer_k.get(part.lag).copied().unwrap_or(0.0));
        let differ = |now: f64, then: f64| (now / scale - rho * then / before) / white;
        let row = Row {
            response: differ(prepared.ratio, last.ratio),
            x: std::array::from_fn(|column| differ(now[column], then[column])),
        };
        (row, scale * white)
    }
}

/// The columns of the line at a temperature difference \[K\].
fn columns(warmer_k: f64) -> [f64; 3] {
    [1.0, warmer_k, warmer_k * warmer_k]
}

/// Lag, phi and noise of a member.
fn place(index: usize) -> (usize, f64, usize) {
    (
        index / (NOISES * PHIS.len()),
        PHIS[index / NOISES % PHIS.len()].0,
        index % NOISES,
    )
}

fn believed(sd: f64) -> f64 {
    if sd.is_finite() {
        sd.clamp(LEAST_SD, 1.0)
    } else {
        1.0
    }
}

#[cfg(test)]
mod oracle;
