//! The labels' model of a rod: five whitened coordinates, all its natural frequencies and their gradients.
//!
//! With `c = ln(sqrt(EI/m) / (2 pi L^2))`, `e = ln(L^2/EI)` and the dimensionless tension `u = N e^e` every
//! frequency is `ln f_n = c + ln w_n(u, ends)`. Beforehand `c` and `e` are jointly normal with the moments
//! that the configured priors of modulus, density, section and length give them; the axial force and both
//! springs keep their own distributions, each a function of one standard normal coordinate.

use super::quantile::{Quantile, log_moments};
use super::wavenumber::frequency;
use crate::rod::beam::Quantity;
use crate::rod::beam::forward::MAX_ORDERS;
use crate::rod::prior::RodPrior;
use std::f64::consts::TAU;

/// Coordinates of a rod: level `c`, rest of `e`, axial force, left and right spring.
pub(super) const COORDINATES: usize = 5;
/// Coordinates of a rod, independent standard normals under the prior.
pub(super) type Point = [f64; COORDINATES];

pub(super) const LEVEL: usize = 0;
pub(super) const FORCE: usize = 2;
pub(super) const LEFT: usize = 3;
pub(super) const RIGHT: usize = 4;

/// Unit of the springs, in EI / L, in which fixity is resolved best.
const SPRING_UNIT: f64 = 10.0;

/// Prior of a rod in the labels' coordinates.
#[derive(Debug, Clone)]
pub(super) struct Rod {
    /// Mean and standard deviation of `c`.
    pub(super) level: (f64, f64),
    /// Mean of `e`, its derivative along the level's coordinate, standard deviation of the rest.
    pub(super) slenderness: (f64, f64, f64),
    /// Quantile of ln N, its prior doubted.
    pub(super) force: Quantile,
    /// Range of ln N if its prior is right.
    pub(super) log_force_range: (f64, f64),
    /// `k / (k + 10 EI/L)` of each end, EI/L at its mean.
    pub(super) ends: [Quantile; 2],
}

impl Rod {
    /// From the configured priors; `None` if they hold no tensioned rod.
    pub(super) fn new(prior: &RodPrior) -> Option<Self> {
        let (mut level, mut slenderness) = (-libm::log(TAU), 0.0);
        let (mut level_var, mut covariance, mut slenderness_var) = (0.0, 0.0, 0.0);
        for (&quantity, prior) in prior.parameterisation().quantities().iter().zip(prior.priors()) {
            let Some((in_level, in_slenderness)) = powers(quantity) else {
                continue;
            };
            let (mean, sd) = log_moments(prior);
            level += in_level * mean;
            slenderness += in_slenderness * mean;
            level_var += in_level * in_level * sd * sd;
            covariance += in_level * in_slenderness * sd * sd;
            slenderness_var += in_slenderness * in_slenderness * sd * sd;
        }
        // A section's constants, such as 1/12 in EI = E a^4 / 12.
        let ones = vec![1.0; prior.parameterisation().len()];
        let unit_beam = prior.parameterisation().beam(&ones);
        let constant = libm::log(unit_beam.flexural_rigidity_n_m2);
        level += 0.5 * (constant - libm::log(unit_beam.mass_per_length_kg_m));
        slenderness -= constant;
        let level_sd = level_var.max(1e-12).sqrt();
        let by_level = covariance / level_sd;
        let rest_sd = (slenderness_var - by_level * by_level).max(0.0).sqrt();
        let length_m = libm::exp(log_moments(prior.of(Quantity::Length)?).0);
        let unit = SPRING_UNIT * length_m * libm::exp(-slenderness);
        let end = |quantity| prior.of(quantity).map(|k| Quantile::of_stiffness(k, unit));
        let force = prior.of(Quantity::AxialForce)?;
        let rod = Self {
            log_force_range: Quantile::log_range(force),
            level: (level, level_sd),
            slenderness: (slenderness, by_level, rest_sd),
            force: Quantile::of_force(force)?,
            ends: [end(Quantity::SpringLeft)?, end(Quantity::SpringRight)?],
        };
        [level, slenderness, rest_sd]
            .iter()
            .all(|x| x.is_finite())
            .then_some(rod)
    }

    /// The rod at a point.
    pub(super) fn at(&self, q: &Point) -> Place {
        let (c0, c_by) = self.level;
        let (e0, e_by_level, e_by_rest) = self.slenderness;
        let rise = e_by_level * q[LEVEL] + e_by_rest * q[1];
        let (log_force, log_force_by) = self.force.at(q[FORCE]);
        let tension = libm::exp((log_force + e0 + rise).clamp(-30.0, 30.0));
        let unit = SPRING_UNIT * libm::exp(rise);
        let mut fixities = [0.0; 2];
        let mut fixity_slopes = [[0.0; COORDINATES]; 2];
        for (end, of_end) in self.ends.iter().enumerate() {
            let (share, by) = of_end.at(q[LEFT + end]);
            let share = share.clamp(0.0, 1.0);
            let sum = 1.0 - share + unit * share;
            fixities[end] = unit * share / sum;
            let by_rise = unit * share * (1.0 - share) / (sum * sum);
            fixity_slopes[end][LEVEL] = by_rise * e_by_level;
            fixity_slopes[end][1] = by_rise * e_by_rest;
            fixity_slopes[end][LEFT + end] = unit * by / (sum * sum);
        }
        Place {
            level: c0 + c_by * q[LEVEL],
            level_by: c_by,
            tension,
            tension_slopes: [
                tension * e_by_level,
                tension * e_by_rest,
                tension * log_force_by,
                0.0,
                0.0,
            ],
            fixities,
            fixity_slopes,
        }
    }
}

/// A rod at one point of its coordinates.
pub(super) struct Place {
    level: f64,
    level_by: f64,
    tension: f64,
    tension_slopes: Point,
    fixities: [f64; 2],
    fixity_slopes: [Point; 2],
}

/// Earlier phases per order, as first guesses; NaN where there is none.
pub(super) type Guesses = [f64; MAX_ORDERS];
pub(super) const NO_GUESSES: Guesses = [f64::NAN; MAX_ORDERS];

impl Place {
    /// `ln f_n` and its gradient along the coordinates.
    pub(super) fn log_frequency(&self, order: usize, guesses: &mut Guesses) -> (f64, Point) {
        let guess = &mut guesses[order - 1];
        let known = (!guess.is_nan()).then_some(*guess);
        let found = frequency(order, self.tension, self.fixities, known);
        *guess = found.phase;
        let mut slope = [0.0; COORDINATES];
        for (i, slope) in slope.iter_mut().enumerate() {
            *slope = found.slope[0] * self.tension_slopes[i]
                + found.slope[1] * self.fixity_slopes[0][i]
                + found.slope[2] * self.fixity_slopes[1][i];
        }
        slope[LEVEL] += self.level_by;
        (self.level + found.log, slope)
    }
}

/// Powers of a quantity in `exp(c)` and `exp(e)`; `None` for force and springs.
fn powers(quantity: Quantity) -> Option<(f64, f64)> {
    // Powers in EI and in m; the length by itself.
    let (rigidity, mass) = match quantity {
        Quantity::AxialForce | Quantity::SpringLeft | Quantity::SpringRight => return None,
        Quantity::Length => return Some((-2.0, 2.0)),
        Quantity::YoungsModulus | Quantity::FlexuralRigidity => (1.0, 0.0),
        Quantity::Density | Quantity::MassPerLength => (0.0, 1.0),
        Quantity::Side | Quantity::Diameter => (4.0, 2.0),
        Quantity::Width => (1.0, 1.0),
        Quantity::Height => (3.0, 1.0),
    };
    Some((0.5 * rigidity - 0.5 * mass, -rigidity))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rod::beam::{Parameterisation, Section, exact};
    use crate::rod::prior::Prior;

    #[test]
    fn the_centre_is_the_configured_rods_and_gradients_are_its_derivatives() {
        for (section, priors) in [
            (Section::Square, RodPrior::todi().priors().to_vec()),
            (
                Section::Rectangle,
                vec![
                    Prior::LogNormal {
                        median: 2e4,
                        log_sd: 0.3,
                    },
                    Prior::LogNormal {
                        median: 2e11,
                        log_sd: 0.05,
                    },
                    Prior::LogNormal {
                        median: 7800.0,
                        log_sd: 0.02,
                    },
                    Prior::LogNormal {
                        median: 0.06,
                        log_sd: 0.02,
                    },
                    Prior::LogNormal {
                        median: 0.02,
                        log_sd: 0.02,
                    },
                    Prior::Fixed { value: 0.0 },
                    Prior::Uniform { low: 0.0, high: 9e4 },
                    Prior::LogNormal {
                        median: 4.0,
                        log_sd: 0.01,
                    },
                ],
            ),
        ] {
            let prior = RodPrior::new(Parameterisation::new(section), priors).unwrap();
            let rod = Rod::new(&prior).unwrap();
            let mut centre = prior.centre();
            centre[0] = libm::exp(rod.force.at(0.0).0);
            let mut exact_hz = [0.0; MAX_ORDERS];
            exact::frequencies(&prior.parameterisation().beam(&centre), &mut exact_hz).unwrap();
            let q = [0.3, -0.2, 0.4, 0.5, -0.6];
            for (i, exact_hz) in exact_hz.iter().enumerate() {
                let value = |q: &Point| rod.at(q).log_frequency(i + 1, &mut NO_GUESSES.clone()).0;
                // Means of logarithms against means: 4 % for a modulus known to 30 %.
                assert!((value(&[0.0; COORDINATES]) - exact_hz.ln()).abs() < 0.05);
                let (_, slopes) = rod.at(&q).log_frequency(i + 1, &mut NO_GUESSES.clone());
                for (which, slope) in slopes.iter().enumerate() {
                    let moved = |by: f64| {
                        let mut moved = q;
                        moved[which] += by;
                        value(&moved)
                    };
                    let difference = (moved(1e-3) - moved(-1e-3)) / 2e-3;
                    // Second differences of the cubic pieces, and 3e-7 of either solution.
                    assert!((slope - difference).abs() < 1e-3, "{which}: {slope} {difference}");
                }
            }
        }
    }
}
