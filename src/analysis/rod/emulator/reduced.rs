//! The reduced emulator: one Legendre chaos for every rod, tension and support, in three numbers.
//!
//! A beam's natural frequencies are `f_n = phi_n / (2 pi l) sqrt((N + EI phi_n^2 / l^2) / m)`, where the
//! wavenumber `phi_n` depends on nothing but the dimensionless tension `t = N l^2 / EI = 1 / lambda^2`
//! and the two end stiffnesses `k l / EI`. The emulator expands `phi_n` in
//!
//! ```text
//! u = lambda / (lambda + 1/5),   s = k / (k + sqrt(EI N + 49 (EI / l)^2))   left and right.
//! ```
//!
//! All three run from 0 to 1 and both ends are included: u = 0 is a string, u = 1 a beam without tension,
//! s = 0 a hinge, s = 1 a clamp. So the trained range holds every beam there is, and nothing is ever
//! extrapolated. (With the simpler `s = k / (k + sqrt(EI N))` the range must end near lambda = 0.4, for
//! the stiffness that an end rotation meets does not vanish with the tension.)
//!
//! The wavenumber is smoother than the frequency and costs a square root at the end instead of an
//! exponential. It is symmetric in the two ends, which halves the terms. Coefficients are discrete
//! projections on a tensor Gauss-Legendre grid of exact solutions; terms that contribute less than 1e-7
//! are left out. Measured errors are in docs/emulators.md.

use super::expansion::{Expansion, LANES};
use super::reduced_fit::{DEGREES_S, INNER};
use crate::numerics::orthogonal::Recurrence;
use crate::numerics::simd::{Kernel, vectorised};
use crate::rod::beam::forward::{FEW, ForwardModel, MAX_MODES};
use crate::rod::beam::{Beam, OutsideRange, Parameterisation};
use std::f64::consts::PI;
use std::sync::{Arc, LazyLock};

/// Value of lambda at which u is one half.
pub(super) const LAMBDA: f64 = 0.2;
/// Square of the stiffness at which s is one half: `k = sqrt(BENDING) EI / l` without tension: of the order
/// of the stiffness that the lowest modes' end rotations meet.
pub(super) const BENDING: f64 = 49.0;

/// The expansions of all modes' wavenumbers.
#[derive(Debug, Clone)]
pub struct Reduced {
    pub(super) legendre: Recurrence,
    /// Degrees in the two ends, first not below second, of the outer functions.
    pub(super) pairs: Vec<(usize, usize)>,
    pub(super) expansions: Vec<Expansion>,
    pub(super) inner: usize,
    pub(super) degrees: usize,
}

static SHARED: LazyLock<Arc<Reduced>> = LazyLock::new(|| Arc::new(Reduced::shipped()));

/// The fit as [`Reduced::save`] writes it: it takes 17 ms, half of the start of a replay. A test compares the two.
const SHIPPED: &[u8] = include_bytes!("reduced.postcard");

impl Reduced {
    /// The emulator of this process.
    pub fn shared() -> Arc<Self> {
        Arc::clone(&SHARED)
    }

    fn shipped() -> Self {
        postcard::from_bytes(SHIPPED)
            .map_or_else(|_| Self::fit(), |(pairs, expansions)| Self::of(pairs, expansions))
    }

    /// Degrees and coefficients, to be shipped with the program.
    ///
    /// # Errors
    /// None that a fit can have.
    pub fn save(&self) -> Result<Vec<u8>, postcard::Error> {
        postcard::to_stdvec(&(&self.pairs, &self.expansions))
    }

    /// From the degrees in the two ends of the outer functions, and one expansion per mode.
    pub(super) fn of(pairs: Vec<(usize, usize)>, expansions: Vec<Expansion>) -> Self {
        Self {
            legendre: Recurrence::legendre(INNER.max(DEGREES_S)),
            inner: expansions.iter().map(Expansion::longest_run).max().unwrap_or(0),
            degrees: pairs.iter().map(|&(j, _)| j + 1).max().unwrap_or(0),
            pairs,
            expansions,
        }
    }

    /// Number of coefficients of mode `order`.
    pub fn terms(&self, order: usize) -> usize {
        self.expansions
            .get(order.wrapping_sub(1))
            .map_or(0, Expansion::terms)
    }

    /// Frequencies \[Hz\] of `L` beams, mode by mode; no meaning where the parameters are no beam.
    #[inline(always)]
    fn block<const L: usize>(&self, beams: &[Beam; L], out: &mut [[f64; L]]) {
        let (mut t, mut unit) = ([0.0; L], [0.0; L]);
        let (mut u, mut left, mut right) = ([0.0; L], [0.0; L], [0.0; L]);
        for l in 0..L {
            let beam = &beams[l];
            let length = beam.length_m;
            let bending = beam.flexural_rigidity_n_m2 / length;
            t[l] = beam.axial_force_n * length / bending;
            unit[l] = (bending / (beam.mass_per_length_kg_m * length)).sqrt() / (2.0 * PI * length);
            let scale = bending * (t[l] + BENDING).sqrt();
            u[l] = 2.0 / (1.0 + LAMBDA * t[l].sqrt()) - 1.0;
            left[l] = 2.0 / (1.0 + scale / beam.end_stiffness_n_m[0]) - 1.0;
            right[l] = 2.0 / (1.0 + scale / beam.end_stiffness_n_m[1]) - 1.0;
        }
        let mut inner = [[0.0; L]; INNER];
        let (mut p, mut q) = ([[0.0; L]; DEGREES_S], [[0.0; L]; DEGREES_S]);
        self.legendre.values(&u, &mut inner[..self.inner]);
        self.legendre.values(&left, &mut p[..self.degrees]);
        self.legendre.values(&right, &mut q[..self.degrees]);
        let mut outer = [[0.0; L]; DEGREES_S * (DEGREES_S + 1) / 2];
        for (outer, &(j, k)) in outer.iter_mut().zip(&self.pairs) {
            for l in 0..L {
                outer[l] = if j == k {
                    p[j][l] * q[j][l]
                } else {
                    p[j][l] * q[k][l] + p[k][l] * q[j][l]
                };
            }
        }
        for (out, expansion) in out.iter_mut().zip(&self.expansions) {
            let phi = expansion.evaluate(&outer[..self.pairs.len()], &inner);
            for l in 0..L {
                out[l] = unit[l] * phi[l] * (phi[l] * phi[l] + t[l]).sqrt();
            }
        }
    }

    /// The first `out.len()` natural frequencies \[Hz\] of `beam`.
    pub fn frequencies(&self, beam: &Beam, out: &mut [f64]) -> Result<(), OutsideRange> {
        beam.check("reduced emulator")?;
        let mut rows = [[0.0]; MAX_MODES];
        self.block(&[*beam], &mut rows[..out.len()]);
        out.iter_mut().zip(rows).for_each(|(out, [f])| *out = f);
        Ok(())
    }

    /// The slopes `d ln f_n / d ln N`, by differentiating the expansions.
    pub fn log_slopes(&self, beam: &Beam, out: &mut [f64]) -> Result<(), OutsideRange> {
        beam.check("reduced emulator")?;
        let bending = beam.flexural_rigidity_n_m2 / beam.length_m;
        let t = beam.axial_force_n * beam.length_m / bending;
        let scale = bending * (t + BENDING).sqrt();
        // Each variable and t times its derivative by t.
        let u = 1.0 / (1.0 + LAMBDA * t.sqrt());
        let u_t = -0.5 * u * (1.0 - u);
        let ends = beam.end_stiffness_n_m.map(|k| 1.0 / (1.0 + scale / k));
        let ends_t = ends.map(|s| -0.5 * s * (1.0 - s) * t / (t + BENDING));

        let (mut inner, mut inner_t) = ([[0.0]; INNER], [[0.0]; INNER]);
        let mut p = [[[0.0]; DEGREES_S]; 2];
        let mut p_t = [[[0.0]; DEGREES_S]; 2];
        let each = |x: f64, x_t: f64, values: &mut [[f64; 1]], slopes: &mut [[f64; 1]]| {
            self.legendre.values_and_slopes(2.0 * x - 1.0, values, slopes);
            slopes.iter_mut().for_each(|[slope]| *slope *= 2.0 * x_t);
        };
        each(u, u_t, &mut inner[..self.inner], &mut inner_t[..self.inner]);
        for end in 0..2 {
            each(
                ends[end],
                ends_t[end],
                &mut p[end][..self.degrees],
                &mut p_t[end][..self.degrees],
            );
        }
        let product = |a: &[[f64; 1]], b: &[[f64; 1]]| -> Vec<[f64; 1]> {
            let pair = |&(j, k): &(usize, usize)| {
                if j == k {
                    [a[j][0] * b[j][0]]
                } else {
                    [a[j][0] * b[k][0] + a[k][0] * b[j][0]]
                }
            };
            self.pairs.iter().map(pair).collect()
        };
        let outer = product(&p[0], &p[1]);
        let outer_t: Vec<[f64; 1]> = product(&p_t[0], &p[1])
            .iter()
            .zip(product(&p[0], &p_t[1]))
            .map(|(a, b)| [a[0] + b[0]])
            .collect();
        for (out, expansion) in out.iter_mut().zip(&self.expansions) {
            let [phi] = expansion.evaluate(&outer, &inner);
            let phi_t = expansion.evaluate(&outer_t, &inner)[0] + expansion.evaluate(&outer, &inner_t)[0];
            *out = phi_t / phi + (phi * phi_t + 0.5 * t) / (phi * phi + t);
        }
        Ok(())
    }
}

/// [`Reduced::block`] as work to be vectorised.
struct Block<'a> {
    emulator: &'a Reduced,
    beams: &'a [Beam; LANES],
    out: &'a mut [[f64; LANES]],
}

impl Kernel for Block<'_> {
    #[inline(always)]
    fn run(self) {
        self.emulator.block(self.beams, self.out);
    }
}

/// The reduced emulator of a parameterised rod (the default model).
#[derive(Debug, Clone)]
pub struct ReducedModel {
    parameterisation: Parameterisation,
    emulator: Arc<Reduced>,
}

impl ReducedModel {
    /// The shared emulator for rods with these quantities.
    pub fn new(parameterisation: Parameterisation) -> Self {
        Self {
            parameterisation,
            emulator: Reduced::shared(),
        }
    }
}

impl ForwardModel for ReducedModel {
    fn name(&self) -> &'static str {
        "reduced"
    }

    fn parameterisation(&self) -> &Parameterisation {
        &self.parameterisation
    }

    fn modes(&self) -> usize {
        MAX_MODES
    }

    fn frequencies(&self, theta: &[f64], out: &mut [f64]) -> Result<(), OutsideRange> {
        self.emulator.frequencies(&self.parameterisation.beam(theta), out)
    }

    fn log_slopes(&self, theta: &[f64], out: &mut [f64]) -> Result<(), OutsideRange> {
        self.emulator.log_slopes(&self.parameterisation.beam(theta), out)
    }

    fn frequencies_of_many(&self, thetas: &[f64], modes: usize, out: &mut [f64]) {
        let width = self.parameterisation.len();
        let mut rows = [[0.0; LANES]; MAX_MODES];
        let rows = &mut rows[..modes];
        for (thetas, out) in thetas.chunks(LANES * width).zip(out.chunks_mut(LANES * modes)) {
            let count = thetas.len() / width;
            if count < FEW {
                self.one_by_one(thetas, modes, out);
                continue;
            }
            let beams: [Beam; LANES] = std::array::from_fn(|l| {
                // A block that is not full repeats its last point.
                let first = l.min(count - 1) * width;
                self.parameterisation.beam(&thetas[first..first + width])
            });
            vectorised(Block {
                emulator: &self.emulator,
                beams: &beams,
                out: rows,
            });
            for (l, out) in out.chunks_exact_mut(modes).enumerate() {
                let valid = beams[l].check("reduced emulator").is_ok();
                for (out, row) in out.iter_mut().zip(rows.iter()) {
                    *out = if valid { row[l] } else { f64::NAN };
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;
    use crate::rod::beam::{Section, exact, hinged_frequency};
    use crate::rod::emulator::validate;
    use crate::rod::prior::RodPrior;
    use proptest::prelude::*;

    fn beam(tension: f64, ends: [f64; 2]) -> Beam {
        Beam {
            length_m: 1.0,
            flexural_rigidity_n_m2: 1.0,
            mass_per_length_kg_m: 1.0,
            axial_force_n: tension,
            end_stiffness_n_m: ends,
        }
    }

    /// The largest relative error of a frequency and error of a slope.
    fn errors(beam: &Beam) -> (f64, f64) {
        let (mut f, mut exact_f) = ([0.0; 5], [0.0; 5]);
        let (mut s, mut exact_s) = ([0.0; 5], [0.0; 5]);
        Reduced::shared().frequencies(beam, &mut f).unwrap();
        Reduced::shared().log_slopes(beam, &mut s).unwrap();
        exact::frequencies(beam, &mut exact_f).unwrap();
        exact::log_slopes(beam, &mut exact_s).unwrap();
        let value = (0..5).map(|i| (f[i] / exact_f[i] - 1.0).abs());
        let slope = (0..5).map(|i| (s[i] - exact_s[i]).abs());
        (value.fold(0.0, f64::max), slope.fold(0.0, f64::max))
    }

    #[test]
    fn corners_of_the_range_are_as_good_as_its_middle() {
        let inf = f64::INFINITY;
        for tension in [0.0, 1e-300, 1e-6, 1.0, 1e3, 1e8, 1e30] {
            for ends in [
                [0.0, 0.0],
                [0.0, inf],
                [inf, inf],
                [1e-9, 1e9],
                [7.0, inf],
                [1e300, 1e-300],
            ] {
                let (value, slope) = errors(&beam(tension, ends));
                assert!(
                    value < 3e-6 && slope < 5e-6,
                    "{tension} {ends:?}: {value:e} {slope:e}"
                );
            }
        }
        let hinged = beam(25.0, [0.0; 2]);
        let mut f = [0.0; 5];
        Reduced::shared().frequencies(&hinged, &mut f).unwrap();
        for (i, f) in f.into_iter().enumerate() {
            assert!((f / hinged_frequency(&hinged, i + 1) - 1.0).abs() < 3e-6);
        }
    }

    proptest! {
        #![proptest_config(crate::rod::beam::seeded(2000))]

        #[test]
        fn the_error_is_below_three_millionths_for_every_beam(
            u in 0.0f64..=1.0, log_t in -12.0f64..16.0, s in prop::array::uniform2(0.0f64..=1.0), wide: bool,
        ) {
            // Evenly in the emulator's own variable, and over all magnitudes of tension.
            let tension = if wide { 10f64.powf(log_t) } else { ((1.0 - u) / (LAMBDA * u)).powi(2).min(1e30) };
            let scale = (tension + BENDING).sqrt();
            let (value, slope) = errors(&beam(tension, s.map(|s| s / (1.0 - s) * scale)));
            prop_assert!(value < 3e-6, "{value:e}");
            prop_assert!(slope < 5e-6, "{slope:e}");
        }
    }

    #[test]
    fn over_the_papers_prior_it_is_better_than_a_millionth() {
        let prior = RodPrior::todi();
        let model = ReducedModel::new(*prior.parameterisation());
        let exact = exact::Exact::new(*prior.parameterisation());
        let report = validate::on_prior(&model, None, &exact, &prior, (5000, 3), &|_| ());
        assert_eq!(report.outside, 0);
        for mode in &report.modes {
            // A first trial of this idea reached 4e-7, 4e-6, 9e-6 rms and 3e-5 at most (design 4.2).
            assert!(mode.relative.rms < 1e-7 && mode.relative.max < 1e-6, "{mode:?}");
            assert!(mode.slope.is_some_and(|slope| slope.max < 2e-6), "{mode:?}");
        }
    }

    #[test]
    fn a_point_has_the_same_bits_alone_and_in_any_block_and_what_is_no_beam_is_nan() {
        let prior = RodPrior::todi();
        let model = ReducedModel::new(Parameterisation::new(Section::Square));
        let mut generator = random::stream(5, 0);
        let count = 2 * LANES + 5;
        let mut thetas = vec![0.0; 7 * count];
        thetas
            .chunks_exact_mut(7)
            .for_each(|theta| prior.sample(&mut generator, theta));
        thetas[7 * 20] = -1.0;
        let mut many = vec![0.0; 3 * count];
        model.frequencies_of_many(&thetas, 3, &mut many);
        for (i, (theta, row)) in thetas.chunks_exact(7).zip(many.chunks_exact(3)).enumerate() {
            let mut alone = [0.0; 3];
            let answer = model.frequencies(theta, &mut alone);
            if i == 20 {
                assert!(answer.is_err() && row.iter().all(|f| f.is_nan()));
            } else {
                assert_eq!(row, alone);
            }
        }
    }
}
