//! One bank of Kalman filters with unknown noise: the conjugate law of coefficients, fluctuation and noise variance for every
//! member, and the mixture of their predictive laws.
//!
//! For a period with ratio y, stated error s and columns X, and an onset's regressor h (0 without one, 1 for a step, years
//! since the onset for a ramp), a member holds the state x = (c, a, b_1.., v, u):
//!
//! ```text
//! y = c h + a + X b + v + u + sigma sqrt(R) e,       R = 0.3 + 0.7 (s / s0)^2,     e ~ N(0, 1)
//! u <- f u + sigma sqrt(r (1 - f^2)) n,              f = exp(-gap / tau);           v likewise with r2, tau2
//! sigma^2 ~ inverse gamma(alpha, beta),              cov(x) = sigma^2 P
//! ```
//!
//! so that y has Student's t law with 2 alpha degrees of freedom, S = R + H P H' and scale^2 = S beta / alpha. Two more terms
//! keep wild readings and sudden weather from being learned as something else:
//!
//! ```text
//! p(y) = (1 - 0.01 - k) t(e; S) + 0.01 t_3(e; 0.06^2 + 9 S) + k t(e; S + 24 r (1 - f^2))
//! ```
//!
//! The largest decides: the first is learned as it is, the second not at all, the third after P_uu grew by 24 r (1 - f^2).

use super::prior::{BankPrior, Fluctuation};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Share of the noise variance that does not follow the stated error.
const UNSTATED: f64 = 0.3;
/// Shape of the prior law of the noise variance: four degrees of freedom; its mean is 2 s0^2.
const SHAPE: f64 = 2.0;
/// Probability of a wild reading, its spread \[-\], the widening of the rest, and its degrees of freedom.
const WILD: f64 = 0.01;
const WILD_SD: f64 = 0.06;
const WILD_WIDER: f64 = 9.0;
const WILD_SHAPE: f64 = 1.5;
/// Growth of the fluctuation's variance in a jump, in the variance a period adds.
const KICK: f64 = 24.0;
/// Least ln weight in a bank that must stay open to every member: one may come back.
const LEAST_LN_WEIGHT: f64 = -60.0;
/// Least ln weight a copy keeps.
pub(super) const NEGLIGIBLE_LN_WEIGHT: f64 = -13.8;
/// Columns beyond are faults.
const GREATEST: f64 = 1e6;
/// Ratios are taken as within these.
const RATIOS: [f64; 2] = [-1.0, 10.0];
/// Stated errors are taken as at most so many typical ones.
const GREATEST_ERROR: f64 = 1e6;

/// One period of one rod as a bank sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen<'a> {
    /// Event time \[d\]; real gaps count.
    pub day: f64,
    /// N_t / N_0 - 1.
    pub ratio: f64,
    /// Its stated standard error.
    pub sd: f64,
    /// Regressors, as many as the prior has columns.
    pub columns: &'a [f64],
}

/// Predictive law of a period.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Law {
    /// Mean of the ratio.
    pub mean: f64,
    /// Standard deviation.
    pub sd: f64,
    /// Share of the variance that is uncertainty of the coefficients, of the level with them.
    pub leverage: f64,
}

impl Law {
    /// The ratio in standard deviations from the mean.
    pub fn residual(&self, ratio: f64) -> f64 {
        (ratio - self.mean) / self.sd
    }
}

/// A period made ready: regressors of the whole state, response, variance of its error in noise variances.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Row {
    day: f64,
    pub ratio: f64,
    error: f64,
    x: Vec<f64>,
}

impl Row {
    /// `None` for what no filter can take: not finite, wrong number of columns, regressors beyond reason.
    pub fn new(prior: &BankPrior, seen: &Seen) -> Option<Self> {
        let is_sane = seen.day.is_finite()
            && seen.ratio.is_finite()
            && seen.sd.is_finite()
            && seen.columns.len() == prior.columns.len()
            && seen.columns.iter().all(|x| x.abs() <= GREATEST);
        if !is_sane {
            return None;
        }
        let share = (seen.sd / prior.noise_sd).clamp(0.0, GREATEST_ERROR);
        let mut x = Vec::with_capacity(seen.columns.len() + 4);
        x.extend([0.0, 1.0]);
        x.extend_from_slice(seen.columns);
        x.extend([1.0, 1.0]);
        Some(Self {
            day: seen.day,
            ratio: seen.ratio.clamp(RATIOS[0], RATIOS[1]),
            error: UNSTATED + (1.0 - UNSTATED) * share * share,
            x,
        })
    }

    /// Puts an onset's regressor in.
    pub fn with_onset(&mut self, h: f64) -> &Self {
        self.x[0] = h;
        self
    }
}

/// State of one member.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Member {
    /// Place in the prior's members.
    pub which: u8,
    /// ln of the weight; weights sum to one.
    pub ln_weight: f64,
    /// alpha and beta of the noise variance's inverse gamma law.
    pub shape: f64,
    pub rate: f64,
    /// Mean of the state: change, intercept, columns, slow fluctuation, fluctuation.
    pub mean: Vec<f64>,
    /// Covariance over the noise variance: upper triangle by rows.
    pub cov: Vec<f64>,
}

/// Prediction of one member.
#[derive(Debug, Clone, Copy)]
struct Ahead {
    error: f64,
    /// S.
    total: f64,
}

/// The term of the predictive law that a reading was learned by.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Term {
    Usual,
    Wild,
    Kick,
}

impl Member {
    /// Before the first period.
    fn new(prior: &BankPrior, which: usize) -> Self {
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
            ln_weight: libm::log(fluctuation.probability),
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

    /// Lets the fluctuations run on for `gap` days.
    fn advance(&mut self, fluctuation: &Fluctuation, gap: f64) {
        let width = self.mean.len();
        let (slow, fast) = (width - 2, width - 1);
        let f = libm::exp(-gap / fluctuation.memory_d);
        let g = libm::exp(-gap / fluctuation.slow_memory_d);
        for row in 0..slow {
            let at = place(width, row, slow);
            self.cov[at] *= g;
            self.cov[at + 1] *= f;
        }
        let at = place(width, slow, slow);
        self.cov[at] = g * g * self.cov[at] + fluctuation.slow_variance * (1.0 - g * g);
        self.cov[at + 1] *= f * g;
        self.cov[at + 2] = f * f * self.cov[at + 2] + fluctuation.variance * (1.0 - f * f);
        self.mean[slow] *= g;
        self.mean[fast] *= f;
    }

    /// Prediction of a row; `along` becomes P H'.
    fn ahead(&self, row: &Row, along: &mut [f64]) -> Ahead {
        times(&self.cov, &row.x, along);
        let spread: f64 = row.x.iter().zip(along.iter()).map(|(x, a)| x * a).sum();
        let location: f64 = row.x.iter().zip(&self.mean).map(|(x, m)| x * m).sum();
        Ahead {
            error: row.ratio - location,
            total: row.error + spread.max(0.0),
        }
    }

    /// Kalman and inverse gamma step.
    fn learn(&mut self, ahead: Ahead, along: &[f64]) {
        let width = self.mean.len();
        let gain = ahead.error / ahead.total;
        for (mean, along) in self.mean.iter_mut().zip(along) {
            *mean += along * gain;
        }
        let mut at = 0;
        for row in 0..width {
            let share = along[row] / ahead.total;
            let entries = &mut self.cov[at..at + width - row];
            for (entry, along) in entries.iter_mut().zip(&along[row..]) {
                *entry -= share * along;
            }
            entries[0] = entries[0].max(0.0);
            at += width - row;
        }
        self.rate += 0.5 * ahead.error * gain;
        self.shape += 0.5;
    }
}

/// Filters side by side, one per member.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Bank {
    /// Time of the last period.
    pub day: Option<f64>,
    pub members: Vec<Member>,
}

impl Bank {
    /// Before the first period.
    pub fn new(prior: &BankPrior) -> Self {
        let members = (0..prior.members.len().min(256)).map(|which| Member::new(prior, which));
        let mut bank = Self {
            day: None,
            members: members.collect(),
        };
        bank.normalise();
        bank
    }

    /// A copy in which the change has standard deviation `size`, without negligible members.
    pub fn with_change(&self, size: f64) -> Self {
        let members = self.members.iter().filter(|member| member.ln_weight >= NEGLIGIBLE_LN_WEIGHT);
        let mut bank = Self {
            day: self.day,
            members: members.cloned().collect(),
        };
        for member in &mut bank.members {
            member.cov[0] += size * size / member.scale2();
        }
        bank.normalise();
        bank
    }

    /// Makes weights sum to one.
    fn normalise(&mut self) {
        let total = ln_sum(self.members.iter().map(|member| member.ln_weight));
        self.members.iter_mut().for_each(|member| member.ln_weight -= total);
    }

    /// Forgets members whose weight is negligible.
    pub fn prune(&mut self) {
        self.members.retain(|member| member.ln_weight >= NEGLIGIBLE_LN_WEIGHT);
        self.normalise();
    }

    /// Days since the last period, not negative.
    fn gap(&self, day: f64) -> f64 {
        self.day.map_or(0.0, |last| (day - last).max(0.0))
    }

    /// Lets time run on to a row's.
    pub fn advance(&mut self, prior: &BankPrior, row: &Row) {
        let gap = self.gap(row.day);
        for member in &mut self.members {
            member.advance(&prior.members[usize::from(member.which)], gap);
        }
        self.day = Some(self.day.map_or(row.day, |last| last.max(row.day)));
    }

    /// Learns a row at the time the bank was advanced to, `gap` days after the one before; returns ln p(y).
    pub fn learn(&mut self, prior: &BankPrior, row: &Row, gap: f64) -> f64 {
        let mut along = vec![0.0; row.x.len()];
        let mut gammas = Gammas::default();
        let usual = libm::log(1.0 - WILD - prior.kick);
        let (wild, kick) = (libm::log(WILD), libm::log(prior.kick));
        for member in &mut self.members {
            let fluctuation = &prior.members[usize::from(member.which)];
            let ahead = member.ahead(row, &mut along);
            let (scale2, kicked) = (member.scale2(), KICK * added(fluctuation, gap));
            let constant = gammas.of(member.shape);
            let density = |total: f64| constant + student(ahead.error, total * scale2, member.shape);
            let usual = usual + density(ahead.total);
            let spread2 = WILD_SD * WILD_SD + WILD_WIDER * ahead.total * scale2;
            let wild = wild + ln_gammas(WILD_SHAPE) + student(ahead.error, spread2, WILD_SHAPE);
            let kick = kick + density(ahead.total + kicked);
            let terms = [(Term::Usual, usual), (Term::Wild, wild), (Term::Kick, kick)];
            let chosen = terms.iter().fold(terms[0], |best, term| if term.1 > best.1 { *term } else { best });
            member.ln_weight += ln_sum(terms.iter().map(|term| term.1));
            match chosen.0 {
                Term::Wild => {}
                Term::Kick => {
                    if let Some(variance) = member.cov.last_mut() {
                        *variance += kicked;
                    }
                    let ahead = member.ahead(row, &mut along);
                    member.learn(ahead, &along);
                }
                Term::Usual => member.learn(ahead, &along),
            }
        }
        let ln_density = ln_sum(self.members.iter().map(|member| member.ln_weight));
        for member in &mut self.members {
            member.ln_weight = (member.ln_weight - ln_density).max(LEAST_LN_WEIGHT);
        }
        ln_density
    }

    /// Predictive law of the usual term at the time the bank was advanced to.
    pub fn law(&self, row: &Row) -> Law {
        let mut along = vec![0.0; row.x.len()];
        let fixed = row.x.len() - 2;
        let (mut mean, mut square, mut variance, mut of_coefficients) = (0.0, 0.0, 0.0, 0.0);
        for member in &self.members {
            let weight = libm::exp(member.ln_weight);
            let ahead = member.ahead(row, &mut along);
            let location = row.ratio - ahead.error;
            let noise = member.noise();
            mean += weight * location;
            square += weight * location * location;
            variance += weight * noise * ahead.total;
            of_coefficients += weight * noise * quadratic(&member.cov, &row.x, fixed);
        }
        let between = (square - mean * mean).max(0.0);
        let variance = variance + between;
        Law {
            mean,
            sd: variance.sqrt(),
            leverage: ((of_coefficients + between) / variance).clamp(0.0, 1.0),
        }
    }

    /// Makes the level as unknown as before the first period.
    pub fn loosen(&mut self, prior: &BankPrior) {
        for member in &mut self.members {
            let at = place(member.mean.len(), 1, 1);
            member.cov[at] += prior.intercept_sd * prior.intercept_sd / member.scale2();
        }
    }

    /// What the columns explain of a row: mean, and standard deviation of the row's ratio less it and less the level.
    pub fn explained(&self, row: &Row) -> (f64, f64) {
        let mut along = vec![0.0; row.x.len()];
        let mut x = row.x.clone();
        (x[0], x[1]) = (0.0, 0.0);
        let slow = x.len() - 2;
        let (mut mean, mut square, mut variance) = (0.0, 0.0, 0.0);
        for member in &self.members {
            let weight = libm::exp(member.ln_weight);
            times(&member.cov, &x, &mut along);
            let spread: f64 = x.iter().zip(&along).map(|(x, along)| x * along).sum();
            let location: f64 = x[..slow].iter().zip(&member.mean).map(|(x, mean)| x * mean).sum();
            mean += weight * location;
            square += weight * location * location;
            variance += weight * member.noise() * (row.error + spread.max(0.0));
        }
        (mean, (variance + (square - mean * mean).max(0.0)).sqrt())
    }

    /// Mean and standard deviation of the change c.
    pub fn change(&self) -> (f64, f64) {
        let (mut mean, mut square, mut variance) = (0.0, 0.0, 0.0);
        for member in &self.members {
            let weight = libm::exp(member.ln_weight);
            mean += weight * member.mean[0];
            square += weight * member.mean[0] * member.mean[0];
            variance += weight * member.noise() * member.cov[0];
        }
        (mean, (variance + (square - mean * mean).max(0.0)).sqrt())
    }
}

/// Variance the first fluctuation gains in `gap` days, in noise variances.
fn added(fluctuation: &Fluctuation, gap: f64) -> f64 {
    -fluctuation.variance * libm::expm1(-2.0 * gap / fluctuation.memory_d)
}

/// Place of an entry of the upper triangle.
const fn place(width: usize, row: usize, column: usize) -> usize {
    row * width - row * (row + 1) / 2 + column
}

/// Product of a symmetric matrix and a vector.
fn times(cov: &[f64], x: &[f64], product: &mut [f64]) {
    product.fill(0.0);
    let mut at = 0;
    for row in 0..x.len() {
        let entries = &cov[at..at + x.len() - row];
        let mut sum = entries[0] * x[row];
        for (entry, column) in entries[1..].iter().zip(row + 1..) {
            sum += entry * x[column];
            product[column] += entry * x[row];
        }
        product[row] += sum;
        at += x.len() - row;
    }
}

/// x'P x over the first `count` entries.
fn quadratic(cov: &[f64], x: &[f64], count: usize) -> f64 {
    let mut sum = 0.0;
    for row in 0..count {
        let at = place(x.len(), row, row);
        sum += x[row] * x[row] * cov[at];
        for column in row + 1..count {
            sum += 2.0 * x[row] * x[column] * cov[at + column - row];
        }
    }
    sum.max(0.0)
}

/// ln of the sum of exponentials.
pub(super) fn ln_sum(terms: impl Iterator<Item = f64> + Clone) -> f64 {
    let greatest = terms.clone().fold(f64::NEG_INFINITY, f64::max);
    if greatest == f64::NEG_INFINITY {
        return greatest;
    }
    greatest + libm::log(terms.map(|term| libm::exp(term - greatest)).sum())
}

/// ln of Student's t density of 2 `shape` degrees of freedom without its gamma functions.
fn student(error: f64, scale2: f64, shape: f64) -> f64 {
    let dof = 2.0 * shape;
    -0.5 * libm::log(dof * PI * scale2) - (shape + 0.5) * libm::log1p(error * error / (dof * scale2))
}

/// ln Gamma(shape + 1/2) - ln Gamma(shape).
fn ln_gammas(shape: f64) -> f64 {
    libm::lgamma(shape + 0.5) - libm::lgamma(shape)
}

/// The last value of [`ln_gammas`]: most members share a shape.
#[derive(Default)]
struct Gammas {
    shape: f64,
    value: f64,
}

impl Gammas {
    fn of(&mut self, shape: f64) -> f64 {
        if self.shape != shape {
            *self = Self {
                shape,
                value: ln_gammas(shape),
            };
        }
        self.value
    }
}
