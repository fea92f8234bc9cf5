//! Shifts of a particle's log-frequencies by u = ln(N / N_0) as polynomials, and their use for one record.

use crate::numerics::simd::{Kernel, vectorised};
use crate::rod::beam::forward::ForwardModel;
use crate::track::baseline::particles::log_frequencies_of;
use std::f64::consts::PI;

/// Lower end of the prepared range of u: from a loss of 55 % to a gain of 82 %.
pub(crate) const LOW: f64 = -0.8;
/// Upper end of the range, see [`LOW`].
pub(crate) const HIGH: f64 = 0.6;

/// Degree of the polynomials. ln f is analytic in u as far as N = 0 (Im u = pi), so that each degree gains about a digit.
const DEGREE: usize = 9;
/// Number of their coefficients.
pub(crate) const TERMS: usize = DEGREE + 1;

/// Number of particles worked on at once.
pub(crate) const LANES: usize = 8;

/// Gauss-Newton steps of each particle from the common estimate; each squares an error that is a percent at first.
const STEPS: usize = 2;

/// Factor by which proposals are wider than the linearised posterior, so that no weight is large.
const WIDER: f64 = 1.05;

/// One number for each particle of a block.
pub(crate) type Lanes = [f64; LANES];

/// The polynomials of all particles, in blocks of [`LANES`].
#[derive(Debug, Clone)]
pub(crate) struct Polynomials {
    modes: usize,
    /// Block by block, mode by mode, ascending power of v in -1 to 1.
    coefficients: Vec<Lanes>,
}

/// The modes of one record beside the baseline's.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Seen {
    /// Index of the prepared mode.
    pub mode: usize,
    /// z: ln f less the baseline's.
    pub z: f64,
    /// 1 / var(z), the particle given.
    pub precision: f64,
}

impl Polynomials {
    /// Polynomials for the modes of `orders`, of the particles with an answer over the whole range, with
    /// their indices.
    pub fn new(thetas: &[f64], orders: &[usize], model: &dyn ForwardModel) -> (Self, Vec<usize>) {
        let width = model.parameterisation().len();
        let highest = orders.iter().copied().max().unwrap_or(0);
        let nodes: [f64; TERMS] = std::array::from_fn(|k| libm::cos(PI * (k as f64 + 0.5) / TERMS as f64));
        // The last place is u = 0, from which shifts are counted.
        let mut moved = Vec::with_capacity(thetas.len() * (TERMS + 1));
        for theta in thetas.chunks_exact(width) {
            for u in nodes.iter().map(|&v| u_of(v)).chain([0.0]) {
                let first = moved.len();
                moved.extend_from_slice(theta);
                moved[first] *= libm::exp(u);
            }
        }
        let mut logs = vec![0.0; moved.len() / width * highest];
        log_frequencies_of(model, &moved, highest, &mut logs);
        let powers = powers(&nodes);
        let mut places = Vec::new();
        let mut rows: Vec<[f64; TERMS]> = Vec::new();
        for (i, logs) in logs.chunks_exact(highest.max(1) * (TERMS + 1)).enumerate() {
            if logs.iter().any(|log| !log.is_finite()) {
                continue;
            }
            places.push(i);
            for order in orders {
                let values: [f64; TERMS] = std::array::from_fn(|k| {
                    logs[k * highest + order - 1] - logs[TERMS * highest + order - 1]
                });
                let mut row: [f64; TERMS] =
                    std::array::from_fn(|power| (0..TERMS).map(|k| powers[power][k] * values[k]).sum());
                // No shift at u = 0, to the last bit but rounding.
                row[0] -= horner(&row, v_of(0.0));
                rows.push(row);
            }
        }
        let modes = orders.len();
        let blocks = places.len().div_ceil(LANES);
        let mut coefficients = vec![[0.0; LANES]; blocks * modes * TERMS];
        for place in 0..blocks * LANES {
            // A block that is not full repeats the last particle.
            let source = place.min(places.len() - 1);
            for mode in 0..modes {
                for power in 0..TERMS {
                    coefficients[(place / LANES * modes + mode) * TERMS + power][place % LANES] =
                        rows[source * modes + mode][power];
                }
            }
        }
        (Self { modes, coefficients }, places)
    }

    /// Number of blocks of particles.
    pub fn blocks(&self) -> usize {
        self.coefficients.len() / (self.modes * TERMS)
    }

    /// The mean polynomial of each mode over the first `count` particles, for [`horner`] in v.
    pub fn means(&self, count: usize) -> Vec<[f64; TERMS]> {
        let mut means = vec![[0.0; TERMS]; self.modes];
        for place in 0..count {
            for (mode, mean) in means.iter_mut().enumerate() {
                for (power, mean) in mean.iter_mut().enumerate() {
                    *mean += self.coefficient(place, mode, power) / count as f64;
                }
            }
        }
        means
    }

    fn coefficient(&self, place: usize, mode: usize, power: usize) -> f64 {
        self.coefficients[(place / LANES * self.modes + mode) * TERMS + power][place % LANES]
    }

    /// The shift of one mode of one particle at u.
    pub fn shift(&self, place: usize, mode: usize, u: f64) -> f64 {
        let row: [f64; TERMS] = std::array::from_fn(|power| self.coefficient(place, mode, power));
        horner(&row, v_of(u))
    }

    /// Coefficients of one block of particles, mode by mode, ascending power.
    pub(super) fn block(&self, block: usize) -> &[Lanes] {
        let width = self.modes * TERMS;
        &self.coefficients[block * width..][..width]
    }
}

/// v in -1 to 1 for u.
pub(super) fn v_of(u: f64) -> f64 {
    (u - 0.5 * (HIGH + LOW)) * (2.0 / (HIGH - LOW))
}

fn u_of(v: f64) -> f64 {
    0.5 * (HIGH + LOW) + 0.5 * (HIGH - LOW) * v
}

/// `[power][node]`: from values at the Chebyshev nodes to the coefficients of the interpolating polynomial, by way of its
/// Chebyshev series.
fn powers(nodes: &[f64; TERMS]) -> [[f64; TERMS]; TERMS] {
    let mut chebyshev = [[0.0; TERMS]; TERMS];
    chebyshev[0][0] = 1.0;
    chebyshev[1][1] = 1.0;
    for j in 2..TERMS {
        for power in 0..TERMS {
            let twice = if power > 0 {
                2.0 * chebyshev[j - 1][power - 1]
            } else {
                0.0
            };
            chebyshev[j][power] = twice - chebyshev[j - 2][power];
        }
    }
    let mut matrix = [[0.0; TERMS]; TERMS];
    for (k, &node) in nodes.iter().enumerate() {
        for (j, row) in chebyshev.iter().enumerate() {
            let at_node = horner(row, node) * if j == 0 { 1.0 } else { 2.0 } / TERMS as f64;
            for power in 0..TERMS {
                matrix[power][k] += row[power] * at_node;
            }
        }
    }
    matrix
}

fn horner(row: &[f64; TERMS], v: f64) -> f64 {
    row.iter().rev().fold(0.0, |sum, c| sum * v + c)
}

/// Value and derivative by u of a mean polynomial at u.
pub(crate) fn mean_and_slope(row: &[f64; TERMS], u: f64) -> (f64, f64) {
    let (value, slope) = value_and_slope(&row.map(|c| [c; 1]), &[v_of(u)]);
    (value[0], slope[0])
}

/// Value and derivative by u.
#[inline(always)]
fn value_and_slope<const L: usize>(coefficients: &[[f64; L]], v: &[f64; L]) -> ([f64; L], [f64; L]) {
    let (mut value, mut slope) = ([0.0; L], [0.0; L]);
    for c in coefficients.iter().rev() {
        for l in 0..L {
            slope[l] = slope[l] * v[l] + value[l];
            value[l] = value[l] * v[l] + c[l];
        }
    }
    slope.iter_mut().for_each(|s| *s *= 2.0 / (HIGH - LOW));
    (value, slope)
}

/// Distribution from which u is proposed.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Proposal {
    /// Around each particle's own estimate, from the common one; the lattice holds standard normals.
    Near(f64),
    /// Evenly over the range; the lattice holds shares from 0 to 1.
    Everywhere,
}

/// Draws of u for every particle and the logarithms of their weights (a flat prior of u over its range).
pub(crate) struct Draws<'a> {
    /// The particles.
    pub polynomials: &'a Polynomials,
    /// The record.
    pub seen: &'a [Seen],
    /// Number of draws per particle.
    pub per_particle: usize,
    /// Distribution from which u is proposed.
    pub proposal: Proposal,
    /// Points from which u is made, block by block and within a block draw by draw.
    pub lattice: &'a [Lanes],
    /// Index of the first block of the lattice.
    pub offset: usize,
    /// u, draw by draw and within a draw block by block.
    pub u: &'a mut [Lanes],
    /// ln of the weight without its factor.
    pub log_weight: &'a mut [Lanes],
    /// Factor of the weight.
    pub factor: &'a mut [Lanes],
}

impl Draws<'_> {
    /// Fills `u`, `log_weight` and `factor`.
    pub fn draw(self) {
        vectorised(self);
    }
}

impl Kernel for Draws<'_> {
    #[inline(always)]
    fn run(self) {
        let modes = self.polynomials.modes;
        let blocks = self.polynomials.blocks();
        for (block, coefficients) in self
            .polynomials
            .coefficients
            .chunks_exact(modes * TERMS)
            .enumerate()
        {
            let (mut centre, mut width) = ([0.0; LANES], [0.0; LANES]);
            if let Proposal::Near(estimate) = self.proposal {
                centre = [estimate; LANES];
                for _ in 0..STEPS {
                    let (mut information, mut force) = ([0.0; LANES], [0.0; LANES]);
                    let v = centre.map(v_of);
                    for seen in self.seen {
                        let (value, slope) = value_and_slope(&coefficients[seen.mode * TERMS..][..TERMS], &v);
                        for l in 0..LANES {
                            information[l] += seen.precision * slope[l] * slope[l];
                            force[l] += seen.precision * slope[l] * (seen.z - value[l]);
                        }
                    }
                    for l in 0..LANES {
                        centre[l] = (centre[l] + force[l] / information[l]).clamp(LOW, HIGH);
                        width[l] = WIDER / information[l].sqrt();
                    }
                }
            }
            let lattice = &self.lattice[(block + self.offset) % blocks * self.per_particle..];
            for (j, points) in lattice[..self.per_particle].iter().enumerate() {
                let (mut u, mut factor, mut log_weight) = ([0.0; LANES], [1.0; LANES], [0.0; LANES]);
                for l in 0..LANES {
                    match self.proposal {
                        Proposal::Near(_) => {
                            u[l] = centre[l] + width[l] * points[l];
                            factor[l] = width[l];
                            log_weight[l] = 0.5 * points[l] * points[l];
                        }
                        Proposal::Everywhere => u[l] = LOW + (HIGH - LOW) * points[l],
                    }
                    if !(LOW..=HIGH).contains(&u[l]) {
                        factor[l] = 0.0;
                        u[l] = u[l].clamp(LOW, HIGH);
                    }
                }
                let v = u.map(v_of);
                for seen in self.seen {
                    let (value, _) = value_and_slope(&coefficients[seen.mode * TERMS..][..TERMS], &v);
                    for l in 0..LANES {
                        let off = seen.z - value[l];
                        log_weight[l] -= 0.5 * seen.precision * off * off;
                    }
                }
                self.u[j * blocks + block] = u;
                self.log_weight[j * blocks + block] = log_weight;
                self.factor[j * blocks + block] = factor;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;
    use crate::rod::emulator::ReducedModel;
    use crate::rod::prior::RodPrior;

    #[test]
    fn polynomials_follow_the_model_over_the_whole_range() {
        let prior = RodPrior::todi();
        let model = ReducedModel::new(*prior.parameterisation());
        let mut generator = random::stream(1, 0);
        let mut thetas = vec![0.0; 7 * 203];
        thetas
            .chunks_exact_mut(7)
            .for_each(|theta| prior.sample(&mut generator, theta));
        thetas[7 * 100] = f64::NAN;
        let orders = [1, 3, 5];
        let (polynomials, places) = Polynomials::new(&thetas, &orders, &model);
        assert_eq!(places.len(), 202);
        assert!(!places.contains(&100));
        let means = polynomials.means(places.len());
        for step in 0..=70 {
            let u = LOW + (HIGH - LOW) * f64::from(step) / 70.0;
            let mut sums = [0.0; 3];
            for (place, &i) in places.iter().enumerate() {
                let mut theta = thetas[7 * i..7 * (i + 1)].to_vec();
                let (mut before, mut after) = ([0.0; 5], [0.0; 5]);
                model.frequencies(&theta, &mut before).unwrap();
                theta[0] *= u.exp();
                model.frequencies(&theta, &mut after).unwrap();
                for (mode, order) in orders.iter().enumerate() {
                    let direct = (after[order - 1] / before[order - 1]).ln();
                    sums[mode] += direct / places.len() as f64;
                    let error = (polynomials.shift(place, mode, u) - direct).abs();
                    assert!(error < 1e-7, "{error:e} at {u} of {theta:?}");
                }
            }
            for mode in 0..3 {
                assert!((mean_and_slope(&means[mode], u).0 - sums[mode]).abs() < 1e-7);
            }
        }
    }

    #[test]
    fn a_slope_is_the_derivative() {
        let row = [0.3, -0.2, 0.7, 0.1, 0.0, 0.4, 0.0, 0.0, 0.0, -0.2];
        let h = 1e-5;
        let (above, below) = (mean_and_slope(&row, 0.2 + h).0, mean_and_slope(&row, 0.2 - h).0);
        assert!((mean_and_slope(&row, 0.2).1 - (above - below) / (2.0 * h)).abs() < 1e-8);
    }
}
