//! The relative force of one record: approximate Bayesian computation on the shift from the baseline.

mod bend;
mod interval;
mod shift;
mod spread;
mod weighted;

pub use interval::Interval;

use super::baseline::levels::{self, LEAST_LOG_SD};
use super::baseline::{Baseline, BaselineMode};
use super::observation::{LogMode, Observation};
use super::relative::bend::Bend;
use super::relative::shift::{
    Draws, HIGH, LANES, LOW, Lanes, Polynomials, Proposal, Seen, TERMS, mean_and_slope,
};
use super::relative::spread::Spread;
use super::relative::weighted::{Moments, PER_PARTICLE, lattice, quantiles};
use crate::numerics::exp::exp_each;
use crate::numerics::tail::{chi_square_tail, normal_quantile};
use crate::rod::beam::forward::{ForwardModel, MAX_MODES};
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};
use std::sync::OnceLock;

/// Standard error of u above which the record carries so little information that u is drawn from its whole
/// range.
const NARROW: f64 = 0.1;

/// Standard errors that an estimate must stay away from the ends of the range.
const SAFE: f64 = 5.0;

/// Range of N_t / N_0 - 1 within which a change is one of force.
const LEAST_RATIO: f64 = -0.9;
const MOST_RATIO: f64 = 10.0;

/// Most steps of the common estimate, and the step that ends them.
const STEPS: usize = 30;
const CONVERGED: f64 = 1e-9;

/// Deviation of one mode from the change of axial force that [`Relative::estimate`] states: together they are the mode again.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Misfit {
    /// Mode order, from 1.
    pub order: usize,
    /// Part of ln f that the change of force leaves unexplained.
    pub residual: f64,
    /// Standard error of z_n from this record's frequency alone.
    pub sd: f64,
}

/// N_t / N_0 from one record at its own temperature.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Relative {
    /// Posterior of N_t / N_0.
    pub ratio: Interval,
    /// Posterior of N_t \[N\], jointly with the static parameters.
    pub force_n: Interval,
    /// delta: posterior mean of u = ln(N_t / N_0).
    pub log_ratio: f64,
    /// Posterior standard deviation of u.
    pub log_sd: f64,
    /// u by weighted least squares with the mean of the particles' shifts, as used by the charts. Unlike the
    /// posterior mean it does not weigh the particles anew by every record's noise, which they all share.
    pub estimate: f64,
    /// Standard error of the estimate from this record's frequency errors alone: new with every record.
    pub record_sd: f64,
    /// Q: squared misfit of the modes to a change of axial force, chi-square with `freedom` degrees of freedom.
    pub q: f64,
    /// Measured modes less one.
    pub freedom: usize,
    /// P(chi-square > Q): small if the change is not axial. One if there is a single mode.
    pub not_axial_p: f64,
    /// The misfit, mode by mode.
    pub misfit: Vec<Misfit>,
    /// Effective number of draws.
    pub ess: f64,
    /// Draws of (particle, u).
    pub draws: usize,
}

/// Reason why a record has no relative force.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NoRelative {
    /// None of its modes is in the baseline.
    NoCommonMode,
    /// It differs by more than the prepared range.
    OutsideRange,
}

/// A baseline prepared for records: shifts of each particle's log-frequencies by u.
#[derive(Debug, Clone)]
pub struct Shift {
    modes: Vec<BaselineMode>,
    overdispersion: f64,
    /// N_i and ln N_i of the particles with a model answer.
    forces: Vec<f64>,
    log_forces: Vec<f64>,
    polynomials: Polynomials,
    /// The mean polynomial of each mode.
    means: Vec<[f64; TERMS]>,
    /// Scatter of the particles' shifts.
    spread: Spread,
    /// Standard normals spread evenly over all draws and within each particle's, and the shares they are
    /// quantiles of.
    normals: Vec<Lanes>,
    shares: Vec<Lanes>,
    /// Bend by the static parameters, computed on first use.
    bend: OnceLock<Bend>,
}

/// Modes of one record that the baseline has too.
struct Common {
    /// Index in the baseline.
    mode: usize,
    order: usize,
    z: f64,
    /// Variance of z from this record's frequency, overdispersion included.
    record_variance: f64,
    /// The same with the baseline's.
    variance: f64,
}

impl Shift {
    /// Prepares a baseline; particles without a model answer are left out.
    pub fn new(baseline: &Baseline, model: &dyn ForwardModel) -> Self {
        let width = model.parameterisation().len();
        let orders: Vec<usize> = baseline.modes.iter().map(|mode| mode.order).collect();
        let (polynomials, places) = Polynomials::new(&baseline.particles, &orders, model);
        let shares = lattice(polynomials.blocks());
        let forces: Vec<f64> = places
            .iter()
            .map(|place| baseline.particles[place * width])
            .collect();
        let means = polynomials.means(places.len());
        Self {
            modes: baseline.modes.clone(),
            overdispersion: baseline.overdispersion,
            log_forces: forces.iter().map(|force| libm::log(*force)).collect(),
            forces,
            spread: Spread::new(&polynomials, places.len(), &means),
            means,
            normals: shares.iter().map(|lanes| lanes.map(normal_quantile)).collect(),
            shares,
            polynomials,
            bend: OnceLock::new(),
        }
    }

    /// P(misfit at least this large | the change is axial) for the combined misfit of several records, at a mean
    /// ln(N_t / N_0) of `delta`. The baseline's error and the particles' uncertainty, which all records share, are taken
    /// into account here.
    pub fn not_axial_p(&self, delta: f64, misfit: &[Misfit]) -> f64 {
        let known: Vec<(usize, &Misfit)> = misfit
            .iter()
            .filter_map(|one| Some((self.modes.iter().position(|mode| mode.order == one.order)?, one)))
            .collect();
        let places: Vec<usize> = known.iter().map(|(mode, _)| *mode).collect();
        let residuals: Vec<f64> = known.iter().map(|(_, one)| one.residual).collect();
        let variances: Vec<f64> = known
            .iter()
            .map(|(mode, one)| one.sd * one.sd + self.modes[*mode].log_sd.powi(2))
            .collect();
        let (q, freedom) = self.misfit_square(&places, &residuals, &variances, delta);
        chi_square_tail(q, freedom)
    }

    /// ln f of a mode of the baseline once the force has changed to u = ln(N_t / N_0), by the particles' mean.
    pub(super) fn log_frequency(&self, order: usize, u: f64) -> Option<f64> {
        let mode = self.modes.iter().position(|mode| mode.order == order)?;
        Some(self.modes[mode].log_frequency + mean_and_slope(&self.means[mode], u).0)
    }

    /// d ln f / d ln N of a mode of the baseline, by the particles' mean.
    pub(super) fn slope(&self, order: usize) -> Option<f64> {
        let mode = self.modes.iter().position(|mode| mode.order == order)?;
        Some(mean_and_slope(&self.means[mode], 0.0).1)
    }

    /// Standard deviation of N_t / N_0 that the particles' different slopes leave, however many records show that it went from 1 +
    /// `before` to 1 + `now`: the least width of a change's interval. What moved the force to where it was is learned in the same
    /// units and makes no error.
    pub(super) fn static_sd(&self, before: f64, now: f64) -> f64 {
        if self.modes.is_empty() || self.log_forces.is_empty() {
            return 0.0;
        }
        let terms: Vec<_> = [(-1.0, before), (1.0, now)]
            .into_iter()
            .flat_map(|(sign, ratio)| {
                let ratio: f64 = ratio.clamp(LEAST_RATIO, MOST_RATIO);
                let u = libm::log1p(ratio).clamp(LOW, HIGH);
                // The weights with which the modes' shifts make up the ratio.
                let slopes = self.means.iter().map(|mean| mean_and_slope(mean, u).1);
                let precision = |mode: &BaselineMode| mode.log_sd.max(LEAST_LOG_SD).powi(-2);
                let weights: Vec<(f64, f64)> = self
                    .modes
                    .iter()
                    .zip(slopes)
                    .map(|(mode, slope)| (precision(mode) * slope, slope))
                    .collect();
                let information: f64 = weights.iter().map(|(weight, slope)| weight * slope).sum();
                let share = sign * (1.0 + ratio) / information;
                weights
                    .into_iter()
                    .enumerate()
                    .map(move |(mode, (weight, _))| (share * weight, (mode, u)))
            })
            .collect();
        self.spread.sd_of(&terms)
    }

    /// The relative force of one record. The posterior of (i, u) is, with particles of equal weight and a flat prior of u,
    ///
    /// ```text
    /// p(i, u | z) ~ prod_n N(z_n; ln f_n(theta_i, x_i, N_i e^u) - ln f_n(theta_i, x_i, N_i), sd_tn^2 + sd_ybar_n^2):
    /// ```
    ///
    /// approximate Bayesian computation with the error's density as its kernel, which is exact (Wilkinson 2013). Each particle
    /// proposes u around its own weighted least-squares estimate, at points of a lattice rotated by `seed`.
    ///
    /// # Errors
    /// Reason why there is none.
    pub fn relative(&self, observation: &Observation, seed: u64) -> Result<Relative, NoRelative> {
        let common = self.common(observation);
        if common.is_empty() {
            return Err(NoRelative::NoCommonMode);
        }
        let count = self.log_forces.len();
        if count == 0 {
            return Err(NoRelative::OutsideRange);
        }
        let (estimate, information) = self.estimate(&common);
        let width = information.sqrt().recip();
        let proposal = if width < NARROW {
            if !(LOW + SAFE * width..=HIGH - SAFE * width).contains(&estimate) {
                return Err(NoRelative::OutsideRange);
            }
            Proposal::Near(estimate)
        } else {
            Proposal::Everywhere
        };
        let seen: Vec<Seen> = common
            .iter()
            .map(|one| Seen {
                mode: one.mode,
                z: one.z,
                precision: one.variance.recip(),
            })
            .collect();
        let blocks = self.polynomials.blocks();
        let mut u = vec![[0.0; LANES]; blocks * PER_PARTICLE];
        let mut weights = vec![[0.0; LANES]; u.len()];
        let mut factors = vec![[0.0; LANES]; u.len()];
        Draws {
            polynomials: &self.polynomials,
            seen: &seen,
            per_particle: PER_PARTICLE,
            proposal,
            lattice: match proposal {
                Proposal::Near(_) => &self.normals,
                Proposal::Everywhere => &self.shares,
            },
            offset: (seed % blocks as u64) as usize,
            u: &mut u,
            log_weight: &mut weights,
            factor: &mut factors,
        }
        .draw();
        // The particles that fill up the last block have no weight.
        let spare = blocks * LANES - count;
        for block in (0..PER_PARTICLE).map(|j| (j + 1) * blocks - 1) {
            factors[block][LANES - spare..].fill(0.0);
        }
        let (u, weights, factors) = (
            u.as_flattened(),
            weights.as_flattened_mut(),
            factors.as_flattened(),
        );
        let most = weights
            .iter()
            .zip(factors)
            .filter(|(_, factor)| **factor > 0.0)
            .fold(f64::NEG_INFINITY, |most, (weight, _)| most.max(*weight));
        if !most.is_finite() {
            return Err(NoRelative::OutsideRange);
        }
        for (weight, factor) in weights.iter_mut().zip(factors) {
            *weight = if *factor > 0.0 {
                *weight - most
            } else {
                f64::NEG_INFINITY
            };
        }
        exp_each(weights);
        (weights.iter_mut().zip(factors)).for_each(|(weight, factor)| *weight *= factor.max(0.0));
        Ok(self.summary(&common, estimate, u, weights))
    }

    /// Summary of weighted draws, particle by particle and that [`PER_PARTICLE`] times.
    fn summary(&self, common: &[Common], estimate: f64, u: &[f64], weights: &[f64]) -> Relative {
        let places = self.polynomials.blocks() * LANES;
        let moments = Moments::of(weights, u);
        let delta = moments.mean;
        let mut ratios = u.to_vec();
        exp_each(&mut ratios);
        let (mut forces, mut logs) = (Vec::with_capacity(u.len()), Vec::with_capacity(u.len()));
        for (u, ratios) in u.chunks_exact(places).zip(ratios.chunks_exact(places)) {
            logs.extend(u.iter().zip(&self.log_forces).map(|(u, log)| log + u));
            forces.extend(
                ratios
                    .iter()
                    .zip(&self.forces)
                    .map(|(ratio, force)| ratio * force),
            );
            // Those that fill up the last block have no weight.
            logs.extend(&u[self.forces.len()..]);
            forces.extend(&ratios[self.forces.len()..]);
        }
        let interval = |values: &[f64], logs: &[f64]| {
            let moments = Moments::of(weights, values);
            let [q025, q975] = quantiles(logs, weights, [0.025, 0.975]);
            Interval {
                mean: moments.mean,
                sd: moments.sd,
                q025: libm::exp(q025),
                q975: libm::exp(q975),
            }
        };
        let mut record_information = 0.0;
        let misfit: Vec<Misfit> = common
            .iter()
            .map(|one| {
                let (value, slope) = mean_and_slope(&self.means[one.mode], estimate);
                record_information += slope * slope / one.record_variance;
                Misfit {
                    order: one.order,
                    residual: one.z - value,
                    sd: one.record_variance.sqrt(),
                }
            })
            .collect();
        let places: Vec<usize> = common.iter().map(|one| one.mode).collect();
        let residuals: Vec<f64> = misfit.iter().map(|one| one.residual).collect();
        let variances: Vec<f64> = common.iter().map(|one| one.variance).collect();
        let (q, freedom) = self.misfit_square(&places, &residuals, &variances, estimate);
        Relative {
            ratio: interval(&ratios, u),
            force_n: interval(&forces, &logs),
            log_ratio: delta,
            log_sd: moments.sd,
            estimate,
            record_sd: record_information.sqrt().recip(),
            q,
            freedom,
            not_axial_p: chi_square_tail(q, freedom),
            misfit,
            ess: moments.ess,
            draws: self.log_forces.len() * PER_PARTICLE,
        }
    }

    /// The record's usable modes that the baseline has.
    fn common(&self, observation: &Observation) -> Vec<Common> {
        let usable = |mode: &&LogMode| levels::usable(mode.log_frequency, mode.log_sd);
        self.modes
            .iter()
            .enumerate()
            .filter_map(|(place, known)| {
                let mode = observation.mode(known.order).filter(usable)?;
                let record_variance = (mode.log_sd.max(LEAST_LOG_SD) * self.overdispersion).powi(2);
                Some(Common {
                    mode: place,
                    order: known.order,
                    z: mode.log_frequency - known.log_frequency,
                    record_variance,
                    variance: record_variance + known.log_sd * known.log_sd,
                })
            })
            .collect()
    }

    /// The weighted least-squares estimate of u by the mean shifts, at most at the range's ends, and its
    /// information.
    fn estimate(&self, common: &[Common]) -> (f64, f64) {
        let (mut u, mut information) = (0.0, 0.0);
        for _ in 0..STEPS {
            let mut force = 0.0;
            information = f64::MIN_POSITIVE;
            for one in common {
                let (value, slope) = mean_and_slope(&self.means[one.mode], u);
                information += slope * slope / one.variance;
                force += slope * (one.z - value) / one.variance;
            }
            let next = (u + force / information).clamp(LOW, HIGH);
            let step = (next - u).abs();
            u = next;
            if step < CONVERGED {
                break;
            }
        }
        (u, information)
    }

    /// Q, the smallest squared misfit of the residuals along the slopes, and its degrees of freedom: `min over d of
    /// (r - s d)' V^-1 (r - s d)`, V the variances and the covariance of the particles' shifts at delta.
    fn misfit_square(
        &self,
        modes: &[usize],
        residuals: &[f64],
        variances: &[f64],
        delta: f64,
    ) -> (f64, usize) {
        let count = modes.len();
        if count < 2 || self.log_forces.is_empty() {
            return (0.0, 0);
        }
        let delta = delta.clamp(LOW, HIGH);
        let covariance = DMatrix::from_fn(count, count, |a, b| {
            let shared = self.spread.between((modes[a], delta), (modes[b], delta));
            shared + if a == b { variances[a] } else { 0.0 }
        });
        let Some(factor) = covariance.cholesky() else {
            return (0.0, 0);
        };
        let residual = DVector::from_column_slice(residuals);
        let slope = DVector::from_iterator(
            count,
            modes
                .iter()
                .map(|mode| mean_and_slope(&self.means[*mode], delta).1),
        );
        let weighted = factor.solve(&residual);
        let along = slope.dot(&weighted);
        let q = residual.dot(&weighted) - along * along / slope.dot(&factor.solve(&slope));
        (q.max(0.0), count - 1)
    }
}

const _: () = assert!(MAX_MODES <= 5, "the closed forms end at four degrees of freedom");

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rod::emulator::ReducedModel;
    use crate::rod::prior::RodPrior;
    use crate::signal::record::Timestamp;
    use crate::track::baseline::particles::log_frequencies_of;
    use crate::track::observation::LogMode;

    /// Periods are compared and explained by both together: what the posterior mean differs by is no misfit.
    #[test]
    fn estimate_and_misfit_are_the_modes_again() {
        let prior = RodPrior::todi();
        let model = ReducedModel::new(*prior.parameterisation());
        let observed = |u: f64, errors: [f64; 3]| {
            let mut theta = prior.centre();
            theta[0] *= libm::exp(u);
            let mut logs = [0.0; 3];
            log_frequencies_of(&model, &theta, 3, &mut logs);
            let mode = |n: usize| LogMode {
                order: n + 1,
                log_frequency: logs[n] + errors[n],
                log_sd: 1e-4 * (n + 1) as f64,
            };
            Observation::of_modes(Timestamp::from_nanos(0), (0..3).map(mode).collect())
        };
        let learned = vec![observed(0.0, [0.0; 3]); 4];
        let baseline = Baseline::learn(&learned, &prior, &model, &[0.01; 5], 128, 1).unwrap();
        let shift = Shift::new(&baseline, &model);
        let record = observed(-0.4, [2e-4, -5e-4, 4e-4]);
        let relative = shift.relative(&record, 1).unwrap();
        for (misfit, mode) in relative.misfit.iter().zip(&record.modes) {
            let again = shift.log_frequency(mode.order, relative.estimate).unwrap() + misfit.residual;
            assert!((again - mode.log_frequency).abs() < 1e-12, "{again} {mode:?}");
        }
        assert!(
            (relative.log_ratio - relative.estimate).abs() > 1e-4,
            "{relative:?}"
        );
    }
}
