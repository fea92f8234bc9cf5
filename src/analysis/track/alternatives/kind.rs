//! Kinds of change, with the priors of their sizes.

use serde::{Deserialize, Serialize};

/// Odds of a decision: for a change of the axial force against everything else together, or the reverse.
pub const DECIDED: f64 = 20.0;

/// A kind of change. Its size is the natural logarithm of the ratio of the changed quantity, after to before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// The axial force.
    Force,
    /// The rotational stiffness of both supports, by one ratio.
    BothSupports,
    /// The rotational stiffness of one support, either.
    OneSupport,
    /// The mass per length, evenly over the rod.
    Mass,
    /// Young's modulus.
    Modulus,
    /// The width of the section in every direction, by corrosion for example: rigidity by its fourth power, mass by
    /// its square, at the same force.
    Section,
    /// None of these: every mode moves independently, as by an interfering line, a local mass, or several
    /// changes together.
    Other,
}

impl Kind {
    /// Every kind, in the order of the results.
    pub const ALL: [Self; 7] = [
        Self::Force,
        Self::BothSupports,
        Self::OneSupport,
        Self::Mass,
        Self::Modulus,
        Self::Section,
        Self::Other,
    ];

    /// Smallest and largest size, and the scale of its distribution: Student's t with three degrees of freedom about none,
    /// cut to that range, so that half of the changes are below 0.76 scales and 1 in 75 is beyond five. A section only loses. Half of
    /// the changes of force are [smaller](Self::creep).
    pub(super) fn sizes(self) -> (f64, f64, f64) {
        match self {
            Self::Force => (-1.6, 0.6, 0.05),
            Self::BothSupports | Self::OneSupport => (-4.0, 2.0, 0.5),
            Self::Mass => (-0.2, 0.4, 0.01),
            Self::Modulus => (-0.4, 0.2, 0.01),
            Self::Section => (-0.3, 0.0, 0.01),
            Self::Other => (0.0, 0.0, 0.0),
        }
    }

    /// Scale of the small half of the changes of a kind that also creeps: walls and timber give way by tenths of a per cent of a rod's
    /// force, and no mass, modulus or section goes by so little.
    pub(super) fn creep(self) -> Option<f64> {
        (self == Self::Force).then_some(0.005)
    }

    /// Probability of a size up to `x` before its range is cut.
    pub(super) fn probability_below(self, x: f64) -> f64 {
        let (_, _, scale) = self.sizes();
        let large = probability_below(x, scale);
        let both = |small: f64| 0.5 * (large + probability_below(x, small));
        self.creep().map_or(large, both)
    }

    /// Name of the changed quantity, for people.
    pub(super) fn words(self) -> &'static str {
        match self {
            Self::Force => "the axial force",
            Self::BothSupports => "the stiffness of both supports",
            Self::OneSupport => "the stiffness of one support",
            Self::Mass => "the mass",
            Self::Modulus => "the modulus",
            Self::Section => "the section's area",
            Self::Other => "another kind",
        }
    }

    /// Ratio, after to before, of a size; for a section that of its area.
    pub(super) fn ratio(self, size: f64) -> f64 {
        libm::exp(if self == Self::Section { 2.0 * size } else { size })
    }
}

/// Student's t with three degrees of freedom: F(t) = 1/2 + (atan(s) + s / (1 + s^2)) / pi, s = t / sqrt 3.
fn probability_below(x: f64, scale: f64) -> f64 {
    let s = x / scale / 3f64.sqrt();
    0.5 + (libm::atan(s) + s / (1.0 + s * s)) / std::f64::consts::PI
}

/// Decision for or against the axial force, if the odds suffice.
pub(super) fn is_axial(probability: f64) -> Option<bool> {
    let odds = probability / (1.0 - probability).max(f64::MIN_POSITIVE);
    if odds >= DECIDED {
        Some(true)
    } else if odds * DECIDED <= 1.0 {
        Some(false)
    } else {
        None
    }
}
