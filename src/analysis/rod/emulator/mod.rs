//! Emulators that stand in for the beam: chaos expansions and a perceptron, with their error reports.

pub mod design;
pub mod domain;
pub mod expansion;
pub mod fallback;
pub mod fit;
pub mod germ;
pub mod pce;
pub mod reduced;
mod reduced_fit;
pub mod sobol;
pub mod training;
pub mod validate;

pub use fallback::OrExact;
pub use pce::Pce;
pub use reduced::{Reduced, ReducedModel};
pub use training::{FitError, Training};
pub use validate::ErrorReport;

use serde::Serialize;

/// Forward model used for the natural frequencies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "kebab-case", tag = "model")]
pub enum ModelSettings {
    /// Roots of the characteristic determinant.
    Exact,
    /// Two-node beam elements.
    FiniteElements {
        /// Number of elements; the paper uses 50.
        elements: usize,
    },
    /// Chaos in the dimensionless groups, one for every rod and prior (the default).
    #[default]
    Reduced,
    /// The paper's Hermite chaos in the germs of the uncertain parameters.
    Pce {
        /// Total order; the paper uses 5.
        order: usize,
    },
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rod::beam::{Beam, exact, finite_elements};

    #[test]
    fn no_model_overflows_anywhere_in_the_range() {
        let reduced = Reduced::shared();
        let magnitudes = [1e-30, 1.0, 1e30];
        let index = |i: usize, digit: u32| i / 3usize.pow(digit) % 3;
        for i in 0..3usize.pow(6) {
            let beam = Beam {
                length_m: magnitudes[index(i, 0)],
                flexural_rigidity_n_m2: magnitudes[index(i, 1)],
                mass_per_length_kg_m: magnitudes[index(i, 2)],
                axial_force_n: [0.0, 1.0, 1e30][index(i, 3)],
                end_stiffness_n_m: [4, 5].map(|digit| [0.0, 1e300, f64::INFINITY][index(i, digit)]),
            };
            let mut f = [[0.0; 5]; 6];
            exact::frequencies(&beam, &mut f[0]).unwrap();
            finite_elements::frequencies(&beam, 50, &mut f[1]).unwrap();
            reduced.frequencies(&beam, &mut f[2]).unwrap();
            exact::log_slopes(&beam, &mut f[3]).unwrap();
            reduced.log_slopes(&beam, &mut f[4]).unwrap();
            assert!(f.as_flattened().iter().all(|f| f.is_finite()), "{beam:?} {f:?}");
            for mode in 0..5 {
                // Unresolved end layers of the elements cost up to a part of their length.
                assert!((f[1][mode] / f[0][mode] - 1.0).abs() < 0.02, "{beam:?} {f:?}");
                assert!((f[2][mode] / f[0][mode] - 1.0).abs() < 3e-6, "{beam:?} {f:?}");
            }
        }
        let beam = Beam {
            length_m: 1e31,
            flexural_rigidity_n_m2: 1.0,
            mass_per_length_kg_m: 1.0,
            axial_force_n: 1.0,
            end_stiffness_n_m: [0.0; 2],
        };
        assert_eq!(beam.check("beam").unwrap_err().what, "free length [m]");
    }
}
