//! The tensioned Euler-Bernoulli beam on rotational springs (paper, section 4.3).

pub mod assembly;
#[cfg(test)]
pub(crate) mod dense;
pub mod eigen;
pub mod element;
pub mod exact;
pub mod finite_elements;
pub mod forward;
pub mod receptance;
pub mod section;
pub mod shape;

pub use exact::Exact;
pub use finite_elements::FiniteElements;
pub use section::{Parameterisation, Quantity, Section};

use thiserror::Error;

/// Parameters outside the range in which a model can be trusted.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("{what} = {value:.4e} lies outside the {model}'s range {low:.4e} to {high:.4e}")]
pub struct OutsideRange {
    /// Name of the model that refuses, as users type it.
    pub model: &'static str,
    /// Name of the quantity that lies outside.
    pub what: &'static str,
    /// Value of that quantity, SI.
    pub value: f64,
    /// Lower end of the range.
    pub low: f64,
    /// Upper end of the range.
    pub high: f64,
}

/// A uniform beam under tension on two supports with rotational springs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Beam {
    /// Free length l \[m\].
    pub length_m: f64,
    /// Flexural rigidity EI \[N m^2\].
    pub flexural_rigidity_n_m2: f64,
    /// Mass per length m \[kg/m\].
    pub mass_per_length_kg_m: f64,
    /// Axial force N \[N\], tension positive.
    pub axial_force_n: f64,
    /// Rotational stiffness of the left and right support \[N m/rad\]; zero is a hinge.
    pub end_stiffness_n_m: [f64; 2],
}

impl Beam {
    /// Returns an error unless this is a tensioned beam: every quantity positive, but the axial force may be
    /// zero, and an end stiffness zero or infinite. Magnitudes outside 1e-30 to 1e30 are refused so that
    /// nothing can overflow.
    pub fn check(&self, model: &'static str) -> Result<(), OutsideRange> {
        const LEAST: f64 = 1e-30;
        const MOST: f64 = 1e30;
        let [left, right] = self.end_stiffness_n_m;
        let checks = [
            ("free length [m]", self.length_m, LEAST, MOST),
            (
                "flexural rigidity [N m^2]",
                self.flexural_rigidity_n_m2,
                LEAST,
                MOST,
            ),
            ("mass per length [kg/m]", self.mass_per_length_kg_m, LEAST, MOST),
            ("axial force [N]", self.axial_force_n, 0.0, MOST),
            ("left end stiffness [N m/rad]", left, 0.0, f64::INFINITY),
            ("right end stiffness [N m/rad]", right, 0.0, f64::INFINITY),
        ];
        for (what, value, low, high) in checks {
            if !(value >= low && value <= high) {
                return Err(OutsideRange {
                    model,
                    what,
                    value,
                    low,
                    high,
                });
            }
        }
        Ok(())
    }
}

/// Natural frequency `order` \[Hz\] of the same beam on hinges:
/// `n^2 pi / (2 l^2) sqrt(EI / m) sqrt(1 + N l^2 / (n^2 pi^2 EI))`.
#[cfg(test)]
pub(crate) fn hinged_frequency(beam: &Beam, order: usize) -> f64 {
    let wavenumber = order as f64 * std::f64::consts::PI / beam.length_m;
    let stiffness = beam.axial_force_n + beam.flexural_rigidity_n_m2 * wavenumber * wavenumber;
    wavenumber * (stiffness / beam.mass_per_length_kg_m).sqrt() / (2.0 * std::f64::consts::PI)
}

/// Configuration of this crate's property tests: a fixed number of cases from a fixed seed.
#[cfg(test)]
pub(crate) fn seeded(cases: u32) -> proptest::test_runner::Config {
    proptest::test_runner::Config {
        cases,
        rng_seed: proptest::test_runner::RngSeed::Fixed(1),
        failure_persistence: None,
        ..Default::default()
    }
}
