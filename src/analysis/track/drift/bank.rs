//! One bank of Kalman filters with unknown noise: the conjugate law of coefficients, fluctuation and noise variance for every
//! member, and the mixture of their predictive laws.
//!
//! For a period with ratio y, stated error s (typically s1) and columns X, and an onset's regressor h (0 without one, 1 for a step, years
//! since the onset for a ramp), a member holds the state x = (c, a, b_1.., v, u):
//!
//! ```text
//! y = c h + a + X b + v + u + sqrt(sigma^2 R + q) e,    R = 0.3 + 0.7 (s / s1)^2,     e ~ N(0, 1)
//! u <- f u + sigma sqrt(r (1 - f^2)) n,              f = exp(-gap / tau);           v likewise with r2, tau2
//! sigma^2 ~ inverse gamma(alpha, beta),              cov(x) = sigma^2 P
//! q = E[b'U b]
//! ```
//!
//! with U the covariance of the filters' errors by what the temperature did since its last reading (`unread.rs`; zero where they are dense):
//! y has Student's t law with 2 alpha degrees of freedom, S = R + q / sigma^2 + H P H' and scale^2 = S beta / alpha. Two more terms
//! keep wild readings and sudden weather from being learned as something else:
//!
//! ```text
//! p(y) = (1 - 0.01 - k) t(e; S) + 0.01 t_3(e; 0.06^2 + 9 S) + k t(e; S + 24 r (1 - f^2))
//! ```
//!

use super::densities::{Densities, Gammas, KICK, Term, WILD, WILD_SD, WILD_SHAPE, WILD_WIDER};
use super::member::{Member, Passage, place, quadratic};
use super::prior::BankPrior;
use super::row::{COLUMNS, Law, Row};
use super::unread::Covariance;
use crate::numerics::simd::{Kernel, vectorised};
use rand::{Rng, RngExt};
use rand_distr::{ChiSquared, Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

/// Least weight in a bank that must keep every member: one may become likely again.
const LEAST_WEIGHT: f64 = 1e-26;
/// Least weight that an onset particle keeps. What is left is a density of its own, so that R stays as rare.
const NEGLIGIBLE_WEIGHT: f64 = 0.005;

/// Filters side by side, one per member.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Bank {
    /// Time of the last period.
    pub day: Option<f64>,
    pub members: Vec<Member>,
}

impl Bank {
    /// A bank before the first period.
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
        let members = self.members.iter();
        let members = members.filter(|member| member.weight >= NEGLIGIBLE_WEIGHT);
        let mut bank = Self {
            day: self.day,
            members: members.cloned().collect(),
        };
        bank.wander(size * size);
        bank.normalise();
        bank
    }

    /// Adds to the variance of the change.
    pub fn wander(&mut self, variance: f64) {
        for member in &mut self.members {
            member.cov[0] += variance / member.scale2();
        }
    }

    /// Makes weights sum to one.
    fn normalise(&mut self) {
        let total: f64 = self.members.iter().map(|member| member.weight).sum();
        self.members.iter_mut().for_each(|member| member.weight /= total);
    }

    /// Forgets members whose weight is negligible.
    pub fn prune(&mut self) {
        self.members.retain(|member| member.weight >= NEGLIGIBLE_WEIGHT);
        self.normalise();
    }

    /// Advances time.
    pub fn advance(&mut self, prior: &BankPrior, passage: &Passage) {
        for member in &mut self.members {
            member.advance(&prior.members[usize::from(member.which)], passage.of(member));
        }
        self.day = Some(passage.day);
    }

    /// Learns a row after the passage to it; returns ln p(y).
    pub fn learn(&mut self, prior: &BankPrior, row: &Row, passage: &Passage) -> f64 {
        vectorised(Learn {
            members: &mut self.members,
            kick: prior.kick,
            row,
            passage,
        });
        let density: f64 = self.members.iter().map(|member| member.weight).sum();
        for member in &mut self.members {
            member.weight = (member.weight / density).max(LEAST_WEIGHT);
        }
        libm::log(density)
    }

    /// Narrows the covariances as any ratio of a row would; means, noise and weights stay.
    pub fn narrow(&mut self, row: &Row) {
        let mut along = vec![0.0; row.x.len()];
        for member in &mut self.members {
            let ahead = member.ahead(row, &mut along);
            member.narrow(ahead.total, &along);
        }
    }

    /// A ratio drawn from the predictive law after the passage to a row.
    pub fn draw<R: Rng>(&self, prior: &BankPrior, row: &Row, passage: &Passage, generator: &mut R) -> f64 {
        let mut along = vec![0.0; row.x.len()];
        let mut left: f64 = generator.random();
        let mut chosen = 0;
        for (at, member) in self.members.iter().enumerate() {
            chosen = at;
            left -= member.weight;
            if left < 0.0 {
                break;
            }
        }
        let member = &self.members[chosen];
        let ahead = member.ahead(row, &mut along);
        let scale2 = member.scale2();
        let term: f64 = generator.random();
        let (scale2, shape) = if term < WILD {
            (WILD_SD * WILD_SD + WILD_WIDER * ahead.total * scale2, WILD_SHAPE)
        } else if term < WILD + prior.kick {
            let kicked = KICK * passage.of(member).added;
            ((ahead.total + kicked) * scale2, member.shape)
        } else {
            (ahead.total * scale2, member.shape)
        };
        let normal: f64 = StandardNormal.sample(generator);
        let divisor = ChiSquared::new(2.0 * shape).map_or(1.0, |law| law.sample(generator) / (2.0 * shape));
        row.ratio - ahead.error + normal * (scale2 / divisor).sqrt()
    }

    /// Predictive law of the usual term at the time the bank was advanced to.
    pub fn law(&self, row: &Row) -> Law {
        let mut along = vec![0.0; row.x.len()];
        let fixed = row.x.len() - 2;
        let (mut mean, mut square, mut variance, mut of_coefficients) = (0.0, 0.0, 0.0, 0.0);
        for member in &self.members {
            let ahead = member.ahead(row, &mut along);
            let location = row.ratio - ahead.error;
            let noise = member.noise();
            mean += member.weight * location;
            square += member.weight * location * location;
            variance += member.weight * noise * ahead.total;
            of_coefficients += member.weight * noise * quadratic(&member.cov, &row.x, fixed);
        }
        let between = (square - mean * mean).max(0.0);
        let variance = variance + between;
        Law {
            mean,
            sd: variance.sqrt(),
            leverage: ((of_coefficients + between) / variance).clamp(0.0, 1.0),
        }
    }

    /// Resets the uncertainty of the level to that before the first period.
    pub fn loosen(&mut self, prior: &BankPrior) {
        for member in &mut self.members {
            let at = place(member.mean.len(), 1, 1);
            member.cov[at] += prior.intercept_sd * prior.intercept_sd / member.scale2();
        }
    }

    /// Variance of a ratio whose filters have errors of covariance U \[K^2\]: E[b'U b] over the slopes b.
    pub fn unread(&self, unread_k2: &Covariance) -> f64 {
        let mut sum = 0.0;
        for member in &self.members {
            let (width, noise) = (member.mean.len(), member.noise());
            let mut of_member = 0.0;
            for (i, row) in unread_k2.iter().enumerate() {
                for (j, unread_k2) in row.iter().enumerate() {
                    let (one, other) = (COLUMNS + i.min(j), COLUMNS + i.max(j));
                    let slopes =
                        member.mean[one] * member.mean[other] + noise * member.cov[place(width, one, other)];
                    of_member += unread_k2 * slopes;
                }
            }
            sum += member.weight * of_member;
        }
        sum.max(0.0)
    }

    /// Mean and standard deviation of the change c.
    pub fn change(&self) -> (f64, f64) {
        let (mut mean, mut square, mut variance) = (0.0, 0.0, 0.0);
        for member in &self.members {
            let weight = member.weight;
            mean += weight * member.mean[0];
            square += weight * member.mean[0] * member.mean[0];
            variance += weight * member.noise() * member.cov[0];
        }
        (mean, (variance + (square - mean * mean).max(0.0)).sqrt())
    }
}

/// A row and the quantities with which every member of a bank learns it.
struct Learn<'a> {
    members: &'a mut [Member],
    kick: f64,
    row: &'a Row,
    passage: &'a Passage,
}

impl Kernel for Learn<'_> {
    #[inline(always)]
    fn run(self) {
        let mut along = vec![0.0; self.row.x.len()];
        let mut gammas = Gammas::default();
        let usual_share = 1.0 - WILD - self.kick;
        for member in self.members {
            let ahead = member.ahead(self.row, &mut along);
            let (scale2, kicked) = (member.scale2(), KICK * self.passage.of(member).added);
            let ratio = gammas.ratio(member.shape);
            let terms = Densities::new(&ahead, kicked, scale2, member.shape, ratio);
            let weighed = [
                (Term::Usual, usual_share * terms.usual),
                (Term::Wild, WILD * terms.wild),
                (Term::Kick, self.kick * terms.kick),
            ];
            let chosen = weighed.iter().fold(
                weighed[0],
                |best, term| if term.1 > best.1 { *term } else { best },
            );
            member.weight *= weighed.iter().map(|term| term.1).sum::<f64>();
            match chosen.0 {
                Term::Wild => {}
                Term::Kick => {
                    if let Some(variance) = member.cov.last_mut() {
                        *variance += kicked;
                    }
                    let ahead = member.ahead(self.row, &mut along);
                    member.learn(ahead, &along);
                }
                Term::Usual => member.learn(ahead, &along),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Coefficient, Fluctuation, Seen};
    use super::*;
    use crate::numerics::random;
    use nalgebra::{DMatrix, DVector};

    /// A prior of two columns and a single member with memory.
    fn single() -> BankPrior {
        BankPrior {
            stated_sd: 0.002,
            noise_sd: 0.002,
            intercept_sd: 0.03,
            columns: vec![
                Coefficient {
                    mean: -0.005,
                    sd: 0.01,
                },
                Coefficient { mean: 0.0, sd: 0.002 },
            ],
            members: vec![Fluctuation {
                variance: 2.0,
                memory_d: 4.0,
                slow_variance: 0.5,
                slow_memory_d: 25.0,
                probability: 1.0,
            }],
            kick: 0.002,
        }
    }

    /// Periods with gaps, other stated errors, and a change of -1 % from the twentieth on.
    fn periods(count: usize) -> Vec<(f64, f64, f64, [f64; 2])> {
        let mut generator = random::stream(5, 0);
        let mut day = 100.0;
        let mut normal = move || -> f64 { StandardNormal.sample(&mut generator) };
        (0..count)
            .map(|k| {
                day += [1.0, 1.0, 0.5, 3.0, 0.0, 9.0][k % 6];
                let columns = [8.0 * (day / 20.0_f64).sin() + normal(), (day / 60.0_f64).cos()];
                let change = if k < 20 { 0.0 } else { -0.01 };
                let ratio = 0.004 - 0.006 * columns[0] + 0.001 * columns[1] + change + 0.003 * normal();
                (day, ratio, 0.002 * (1.0 + 0.3 * (k % 3) as f64), columns)
            })
            .collect()
    }

    /// The whole series at once by dense linear algebra: mean and covariance of (c, a, b_1, b_2), and the noise's law.
    #[test]
    fn a_member_equals_the_batch_posterior() {
        let prior = single();
        let data = periods(60);
        let mut bank = Bank::new(&prior);
        let mut change: Option<Bank> = None;
        for (k, (day, ratio, sd, columns)) in data.iter().enumerate() {
            let seen = Seen {
                day: *day,
                began: *day,
                measured: *day,
                ratio: *ratio,
                sd: *sd,
                columns,
                unread_k2: None,
            };
            let mut row = Row::new(&prior, &seen).unwrap();
            let passage = Passage::new(&prior, bank.day, *day);
            bank.advance(&prior, &passage);
            if k == 20 {
                // In noise variances, so that the batch may take it as known beforehand.
                let mut copy = bank.clone();
                copy.members[0].cov[0] = 30.0;
                change = Some(copy);
            } else if let Some(change) = &mut change {
                change.advance(&prior, &passage);
            }
            bank.learn(&prior, &row, &passage);
            if let Some(change) = &mut change {
                change.learn(&prior, row.with_onset(1.0), &passage);
            }
        }
        let found = &change.unwrap().members[0];

        let n = data.len();
        let s0 = prior.noise_sd;
        let design = DMatrix::from_fn(n, 4, |k, j| match j {
            0 => f64::from(u8::from(k >= 20)),
            1 => 1.0,
            _ => data[k].3[j - 2],
        });
        let before = DMatrix::from_diagonal(&DVector::from_vec(vec![
            30.0,
            (0.03 / s0) * (0.03 / s0),
            (0.01 / s0) * (0.01 / s0),
            (0.002 / s0) * (0.002 / s0),
        ]));
        let fluctuation = &prior.members[0];
        let cov = DMatrix::from_fn(n, n, |i, j| {
            let gap = (data[i].0 - data[j].0).abs();
            let error = if i == j {
                0.3 + 0.7 * (data[i].2 / s0) * (data[i].2 / s0)
            } else {
                0.0
            };
            error
                + fluctuation.variance * (-gap / fluctuation.memory_d).exp()
                + fluctuation.slow_variance * (-gap / fluctuation.slow_memory_d).exp()
        });
        let expected = DVector::from_vec(vec![0.0, 0.0, -0.005, 0.0]);
        let off = DVector::from_iterator(n, data.iter().map(|period| period.1)) - &design * &expected;
        let inverse = (&cov + &design * &before * design.transpose())
            .try_inverse()
            .unwrap();
        let gain = &before * design.transpose() * &inverse;
        let mean = &expected + &gain * &off;
        let after = &before - &gain * &design * &before;
        let rate = 2.0 * s0 * s0 + 0.5 * (off.transpose() * &inverse * &off)[(0, 0)];

        assert_eq!(found.shape, 2.0 + 0.5 * n as f64);
        assert!((found.rate / rate - 1.0).abs() < 1e-9, "{} {rate}", found.rate);
        for i in 0..4 {
            // The dense inverse has a condition near 1e6, and the state 60 steps of rounding.
            let sd = after[(i, i)].sqrt();
            assert!(
                (found.mean[i] - mean[i]).abs() < 1e-8 * s0 * sd,
                "{i}: {} {}",
                found.mean[i],
                mean[i]
            );
            for j in i..4 {
                let entry = found.cov[place(6, i, j)];
                let scale = sd * after[(j, j)].sqrt();
                assert!(
                    (entry - after[(i, j)]).abs() < 1e-8 * scale,
                    "{i} {j}: {entry} {}",
                    after[(i, j)]
                );
            }
        }
    }

    /// The predictive density integrates to one: this makes R less the number of periods a martingale.
    #[test]
    fn the_predictive_density_is_a_density() {
        let prior = BankPrior::peers(0.002);
        let mut bank = Bank::new(&prior);
        for (k, (day, ratio, sd, columns)) in periods(40).iter().enumerate() {
            let columns = [0.01 * columns[0], 1e-4 * columns[0] * columns[0], 0.0, 0.1];
            let seen = Seen {
                day: *day,
                began: *day,
                measured: *day,
                ratio: *ratio,
                sd: *sd,
                columns: &columns,
                unread_k2: None,
            };
            let mut row = Row::new(&prior, &seen).unwrap();
            let passage = Passage::new(&prior, bank.day, *day);
            bank.advance(&prior, &passage);
            if k % 13 == 12 {
                for copy in [bank.clone(), bank.with_change(0.015)] {
                    let h = 1.0;
                    let law = copy.law(&row);
                    let density = |z: f64| {
                        // Substitution y = mean + sd sinh(z): the tail of t_3 to 1e4 standard deviations, within the clamp.
                        row.ratio = law.mean + law.sd * z.sinh();
                        libm::exp(copy.clone().learn(&prior, row.clone().with_onset(h), &passage))
                            * law.sd
                            * z.cosh()
                    };
                    // Trapezoids of a smooth function; the part beyond 60 sd is 0.01 of t_3 beyond some 5 scales.
                    let reach = (60.0_f64).asinh();
                    let (mut density, steps) = (density, 1200);
                    let width = 2.0 * reach / f64::from(steps);
                    let sum: f64 = (0..=steps)
                        .map(|step| density(-reach + width * f64::from(step)) * width)
                        .sum();
                    assert!((sum - 1.0).abs() < 1e-3, "period {k}: {sum}");
                }
            }
            let row = Row::new(&prior, &seen).unwrap();
            bank.learn(&prior, &row, &passage);
        }
    }

    /// Ten years of hourly periods leave covariances symmetric by storage and positive on the diagonal.
    #[test]
    fn covariances_stay_positive() {
        let prior = single();
        let mut bank = Bank::new(&prior);
        for hour in 0..87_660_u32 {
            let day = f64::from(hour) / 24.0;
            let columns = [15.0 * (day / 58.0).sin(), (day / 58.1).cos()];
            let ratio = -0.005 * columns[0] + 0.001 * f64::from(hour % 5);
            let seen = Seen {
                day,
                began: day,
                measured: day,
                ratio,
                sd: 0.002,
                columns: &columns,
                unread_k2: None,
            };
            let row = Row::new(&prior, &seen).unwrap();
            let passage = Passage::new(&prior, bank.day, day);
            bank.advance(&prior, &passage);
            assert!(bank.learn(&prior, &row, &passage).is_finite());
        }
        let member = &bank.members[0];
        let width = member.mean.len();
        let dense = DMatrix::from_fn(width - 1, width - 1, |i, j| {
            member.cov[place(width, i.min(j) + 1, i.max(j) + 1)]
        });
        let least = dense.symmetric_eigenvalues().min();
        assert!(least > 0.0, "{least}");
    }

    #[test]
    fn what_no_filter_can_take_is_refused_and_the_rest_is_survived() {
        let prior = single();
        let seen = |day, ratio, sd, columns| Seen {
            day,
            began: day,
            measured: day,
            ratio,
            sd,
            columns,
            unread_k2: None,
        };
        for bad in [
            seen(f64::NAN, 0.0, 0.002, &[0.0, 0.0]),
            seen(0.0, f64::INFINITY, 0.002, &[0.0, 0.0]),
            seen(0.0, 0.0, f64::NAN, &[0.0, 0.0]),
            seen(0.0, 0.0, 0.002, &[0.0, f64::NAN]),
            seen(0.0, 0.0, 0.002, &[0.0, 1e9]),
            seen(0.0, 0.0, 0.002, &[0.0]),
        ] {
            assert_eq!(Row::new(&prior, &bad), None);
        }
        let mut bank = Bank::new(&prior);
        let odd = [
            (0.0, 0.0, 0.0),
            (0.0, -1.0, 0.002),
            (1e5, 0.001, 0.002),
            (5.0, 1e300, 0.002),
            (1e5, 0.0, 1e300),
            (1e9, 0.001, -0.002),
        ];
        for (day, ratio, sd) in odd {
            let row = Row::new(&prior, &seen(day, ratio, sd, &[1.0, 1.0])).unwrap();
            let passage = Passage::new(&prior, bank.day, day);
            bank.advance(&prior, &passage);
            assert!(
                bank.learn(&prior, &row, &passage).is_finite(),
                "{day} {ratio} {sd}"
            );
            let law = bank.law(&row);
            assert!(
                law.mean.abs() < 0.1 && law.sd > 0.0 && law.sd.is_finite(),
                "{law:?}"
            );
        }
    }
}
