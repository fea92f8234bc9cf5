//! The tensioned Euler-Bernoulli beam on rotational springs (paper, section 4.3).

pub mod assembly;
pub mod eigen;
pub mod element;
pub mod exact;
pub mod finite_elements;
pub mod section;

use crate::forward::OutsideRange;
use std::f64::consts::PI;

pub use exact::Exact;
pub use finite_elements::FiniteElements;
pub use section::{Parameterisation, Quantity, Section};

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
    /// Refuses what is no tensioned beam: every quantity finite and positive, but the axial force may be
    /// zero and an end stiffness zero or infinite.
    pub fn check(&self, model: &'static str) -> Result<(), OutsideRange> {
        let positive = f64::MIN_POSITIVE;
        let [left, right] = self.end_stiffness_n_m;
        let checks = [
            ("free length [m]", self.length_m, positive, f64::MAX),
            (
                "flexural rigidity [N m^2]",
                self.flexural_rigidity_n_m2,
                positive,
                f64::MAX,
            ),
            (
                "mass per length [kg/m]",
                self.mass_per_length_kg_m,
                positive,
                f64::MAX,
            ),
            ("axial force [N]", self.axial_force_n, 0.0, f64::MAX),
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
pub fn hinged_frequency(beam: &Beam, order: usize) -> f64 {
    let wavenumber = order as f64 * PI / beam.length_m;
    let stiffness = beam.axial_force_n + beam.flexural_rigidity_n_m2 * wavenumber * wavenumber;
    wavenumber * (stiffness / beam.mass_per_length_kg_m).sqrt() / (2.0 * PI)
}
