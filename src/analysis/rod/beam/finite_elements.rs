//! Natural frequencies by finite elements: the paper's forward model (section 4.3).

use super::OutsideRange;
use super::assembly::Assembly;
use super::eigen::{Eigenvalue, lowest};
use super::forward::{ForwardModel, MAX_MODES};
use super::{Beam, Parameterisation};
use std::f64::consts::PI;

/// Number of elements in the paper.
pub const ELEMENTS: usize = 50;
/// Fewest elements allowed: a little over twice as many degrees of freedom as modes.
pub const FEWEST_ELEMENTS: usize = 8;

/// The first `out.len()` natural frequencies \[Hz\] of `beam` divided into `elements` equal elements; at
/// most [`MAX_MODES`].
///
/// Any tension from zero, any end stiffness from zero to infinity.
pub fn frequencies(beam: &Beam, elements: usize, out: &mut [f64]) -> Result<(), OutsideRange> {
    solve(beam, elements, out, |_, frequency_hz| frequency_hz)
}

/// Solves and writes `result(eigenvalue, frequency)` per mode.
fn solve(
    beam: &Beam,
    elements: usize,
    out: &mut [f64],
    result: impl Fn(&Eigenvalue, f64) -> f64,
) -> Result<(), OutsideRange> {
    beam.check("finite-element model")?;
    let assembly = Assembly::new(beam, elements.max(FEWEST_ELEMENTS));
    let mut eigenvalues = [Eigenvalue::default(); MAX_MODES];
    let eigenvalues = &mut eigenvalues[..out.len()];
    lowest(&assembly, eigenvalues);
    for (out, eigenvalue) in out.iter_mut().zip(eigenvalues) {
        let frequency_hz = assembly.circular_frequency_squared(eigenvalue.mu).sqrt() / (2.0 * PI);
        *out = result(eigenvalue, frequency_hz);
    }
    Ok(())
}

/// The finite-element model of a parameterised rod.
#[derive(Debug, Clone)]
pub struct FiniteElements {
    parameterisation: Parameterisation,
    elements: usize,
}

impl FiniteElements {
    /// `elements` equal elements, but no fewer than [`FEWEST_ELEMENTS`].
    pub fn new(parameterisation: Parameterisation, elements: usize) -> Self {
        Self {
            parameterisation,
            elements: elements.max(FEWEST_ELEMENTS),
        }
    }

    /// Number of elements.
    pub fn elements(&self) -> usize {
        self.elements
    }
}

impl ForwardModel for FiniteElements {
    fn name(&self) -> &'static str {
        "finite-elements"
    }

    fn parameterisation(&self) -> &Parameterisation {
        &self.parameterisation
    }

    fn modes(&self) -> usize {
        MAX_MODES
    }

    fn frequencies(&self, theta: &[f64], out: &mut [f64]) -> Result<(), OutsideRange> {
        frequencies(&self.parameterisation.beam(theta), self.elements, out)
    }

    fn log_slopes(&self, theta: &[f64], out: &mut [f64]) -> Result<(), OutsideRange> {
        // By Rayleigh's quotient, d ln omega^2 / d ln N is tension's share of the strain energy.
        let share = |eigenvalue: &Eigenvalue, _| 0.5 * eigenvalue.tension_share;
        solve(&self.parameterisation.beam(theta), self.elements, out, share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rod::beam::{exact, hinged_frequency};
    use nalgebra::{DMatrix, SymmetricEigen};
    use proptest::prelude::*;

    fn todi(n: f64, k: [f64; 2]) -> Beam {
        Beam {
            length_m: 14.0,
            flexural_rigidity_n_m2: 2e11 * 0.07f64.powi(4) / 12.0,
            mass_per_length_kg_m: 7500.0 * 0.0049,
            axial_force_n: n,
            end_stiffness_n_m: k,
        }
    }

    fn both(beam: &Beam, elements: usize) -> ([f64; 5], [f64; 5]) {
        let (mut fe, mut closed) = ([0.0; 5], [0.0; 5]);
        frequencies(beam, elements, &mut fe).unwrap();
        exact::frequencies(beam, &mut closed).unwrap();
        (fe, closed)
    }

    /// All eigenvalues by a dense general solver: Cholesky reduction with the mass matrix.
    fn dense(assembly: &Assembly) -> Vec<f64> {
        let full = |band: &[[f64; 4]]| {
            DMatrix::from_fn(assembly.size, assembly.size, |i, j| {
                let (row, column) = (i.max(j), i.min(j));
                if row - column <= 3 {
                    band[column][row - column]
                } else {
                    0.0
                }
            })
        };
        let l = full(&assembly.mass).cholesky().unwrap().l();
        let half = l.solve_lower_triangular(&full(&assembly.stiffness)).unwrap();
        let reduced = l.solve_lower_triangular(&half.transpose()).unwrap();
        let symmetric = (&reduced + reduced.transpose()) * 0.5;
        let mut values: Vec<f64> = SymmetricEigen::new(symmetric)
            .eigenvalues
            .iter()
            .copied()
            .collect();
        values.sort_by(f64::total_cmp);
        values
    }

    #[test]
    fn fifty_elements_differ_from_the_exact_model_as_stated() {
        // Design 4.1: about 1e-6, 4e-6, 1e-5 Hz in modes 1 to 3 at the prior mean.
        let (fe, closed) = both(&todi(8e5, [4e5; 2]), 50);
        for (i, stated) in [1e-6, 4e-6, 1e-5].into_iter().enumerate() {
            let difference = fe[i] - closed[i];
            assert!(
                difference > 0.3 * stated && difference < 3.0 * stated,
                "{i}: {difference:e}"
            );
        }
    }

    #[test]
    fn the_error_falls_with_the_fourth_power_of_the_element_length() {
        for beam in [
            todi(8e5, [4e5; 2]),
            todi(1e4, [0.0, 1e9]),
            todi(0.0, [f64::INFINITY; 2]),
        ] {
            let error = |elements| {
                let (fe, closed) = both(&beam, elements);
                [0, 2, 4].map(|i| fe[i] / closed[i] - 1.0)
            };
            let (coarse, fine) = (error(20), error(40));
            for i in 0..3 {
                let order = (coarse[i] / fine[i]).log2();
                // The next term is of relative size (beta h)^2, below 0.1 here.
                assert!((order - 4.0).abs() < 0.15, "{order}");
            }
        }
    }

    #[test]
    fn a_hinged_beam_and_a_hinged_string_have_their_closed_forms() {
        for n in [0.0, 1e3, 8e5] {
            let beam = todi(n, [0.0; 2]);
            let (fe, _) = both(&beam, 50);
            for (i, f) in fe.into_iter().enumerate() {
                let order = (i + 1) as f64;
                // Cubic elements: (n pi / 50)^4 / 1440 relative, half of that of the eigenvalue.
                let bound = 1.2 * (order * PI / 50.0).powi(4) / 1440.0;
                assert!((f / hinged_frequency(&beam, i + 1) - 1.0).abs() < bound);
            }
        }
    }

    proptest! {
        #![proptest_config(crate::rod::beam::seeded(48))]

        #[test]
        fn the_dense_solver_finds_the_same_eigenvalues(
            log_lambda in -4.0f64..1.0, s_l in 0.0f64..1.0, s_r in 0.0f64..1.0, elements in 8usize..=24,
        ) {
            let lambda = 10f64.powf(log_lambda);
            let ends = [s_l, s_r].map(|s| s / (1.0 - s) * lambda);
            let beam = Beam {
                length_m: 1.0,
                flexural_rigidity_n_m2: lambda * lambda,
                mass_per_length_kg_m: 1.0,
                axial_force_n: 1.0,
                end_stiffness_n_m: ends,
            };
            let assembly = Assembly::new(&beam, elements);
            let mut found = [Eigenvalue::default(); 5];
            lowest(&assembly, &mut found);
            let dense = dense(&assembly);
            for (found, dense_mu) in found.iter().zip(&dense) {
                // The dense solver is good to the rounding of the largest eigenvalue.
                let rounding = 1e-15 * dense[dense.len() - 1] * 10.0;
                prop_assert!((found.mu - dense_mu).abs() < rounding, "{} {dense_mu}", found.mu);
            }
        }
    }

    proptest! {
        #![proptest_config(crate::rod::beam::seeded(400))]

        #[test]
        fn no_mode_is_missed_or_swapped(
            log_lambda in -4.0f64..1.0, s_l in 0.0f64..=1.0, s_r in 0.0f64..=1.0,
        ) {
            let lambda = 10f64.powf(log_lambda);
            let beam = Beam {
                length_m: 1.0,
                flexural_rigidity_n_m2: lambda * lambda,
                mass_per_length_kg_m: 1.0,
                axial_force_n: 1.0,
                end_stiffness_n_m: [s_l, s_r].map(|s| s / (1.0 - s) * lambda),
            };
            let (fe, closed) = both(&beam, 50);
            for i in 0..5 {
                // Rayleigh-Ritz: never below, and of fourth order in element length over wave length. An end
                // layer of width lambda thinner than the element costs up to a part of its length.
                let wave = ((i + 2) as f64 * PI / 50.0).powi(4) / 1440.0;
                let layer = 0.01 * (0.02 / lambda).min(1.0).powi(4);
                let bound = 2.0 * wave + layer + 1e-11;
                let error = fe[i] / closed[i] - 1.0;
                prop_assert!(error > -1e-11 && error < bound, "{error:e} {bound:e}");
            }
        }

        #[test]
        fn slopes_agree_with_the_exact_model(log_n in 3.0f64..6.5, log_k in 3.0f64..8.0) {
            let theta = [10f64.powf(log_n), 2e11, 7500.0, 0.07, 10f64.powf(log_k), 4e5, 14.0];
            let square = Parameterisation::new(crate::rod::beam::Section::Square);
            let (mut fe, mut closed) = ([0.0; 5], [0.0; 5]);
            FiniteElements::new(square, 50).log_slopes(&theta, &mut fe).unwrap();
            exact::Exact::new(square).log_slopes(&theta, &mut closed).unwrap();
            for i in 0..5 {
                // Of the order of the relative frequency error at the thinnest boundary layer.
                prop_assert!((fe[i] - closed[i]).abs() < 2e-4, "{} {}", fe[i], closed[i]);
            }
        }
    }
}
