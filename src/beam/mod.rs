//! The tensioned Euler-Bernoulli beam on rotational springs (paper, section 4.3).

pub mod section;

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
