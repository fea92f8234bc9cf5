//! Cross-sections, the quantities that describe a rod, and how they become a [`Beam`].

use super::Beam;
use serde::Serialize;
use std::f64::consts::PI;

/// One physical quantity of a rod.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    /// Axial force, tension positive \[N\].
    AxialForce,
    /// Young's modulus \[Pa\].
    YoungsModulus,
    /// Mass density \[kg/m^3\].
    Density,
    /// Side of a square section \[m\].
    Side,
    /// Diameter of a round section \[m\].
    Diameter,
    /// Width of a rectangle, across the plane of vibration \[m\].
    Width,
    /// Height of a rectangle, in the plane of vibration \[m\].
    Height,
    /// Flexural rigidity given directly \[N m^2\].
    FlexuralRigidity,
    /// Mass per length given directly \[kg/m\].
    MassPerLength,
    /// Rotational stiffness of the left support \[N m/rad\].
    SpringLeft,
    /// Rotational stiffness of the right support \[N m/rad\].
    SpringRight,
    /// Free length \[m\].
    Length,
}

impl Quantity {
    /// Name in configuration, JSON and tables, with its unit.
    pub fn key(self) -> &'static str {
        match self {
            Self::AxialForce => "axial_force_n",
            Self::YoungsModulus => "youngs_modulus_pa",
            Self::Density => "density_kg_m3",
            Self::Side => "side_m",
            Self::Diameter => "diameter_m",
            Self::Width => "width_m",
            Self::Height => "height_m",
            Self::FlexuralRigidity => "flexural_rigidity_n_m2",
            Self::MassPerLength => "mass_per_length_kg_m",
            Self::SpringLeft => "spring_left_n_m",
            Self::SpringRight => "spring_right_n_m",
            Self::Length => "length_m",
        }
    }
}

/// Shape of a cross-section, or [`Section::Direct`] where rigidity and mass are given directly.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Section {
    /// Square of a given side (the paper's).
    Square,
    /// Solid circle of a given diameter.
    Round,
    /// Rectangle: width across, height in the plane of vibration.
    Rectangle,
    /// Flexural rigidity and mass per length given directly.
    Direct,
}

impl Section {
    /// Every section, in the order of the documentation.
    pub const ALL: [Self; 4] = [Self::Square, Self::Round, Self::Rectangle, Self::Direct];

    /// Name in configuration and JSON.
    pub fn key(self) -> &'static str {
        match self {
            Self::Square => "square",
            Self::Round => "round",
            Self::Rectangle => "rectangle",
            Self::Direct => "direct",
        }
    }

    /// The quantities of a rod of this section, in the order of `theta`: axial force first, then
    /// material and section, then the springs left and right, then the length.
    pub fn quantities(self) -> &'static [Quantity] {
        use Quantity::*;
        match self {
            Self::Square => &[
                AxialForce,
                YoungsModulus,
                Density,
                Side,
                SpringLeft,
                SpringRight,
                Length,
            ],
            Self::Round => &[
                AxialForce,
                YoungsModulus,
                Density,
                Diameter,
                SpringLeft,
                SpringRight,
                Length,
            ],
            Self::Rectangle => &[
                AxialForce,
                YoungsModulus,
                Density,
                Width,
                Height,
                SpringLeft,
                SpringRight,
                Length,
            ],
            Self::Direct => &[
                AxialForce,
                FlexuralRigidity,
                MassPerLength,
                SpringLeft,
                SpringRight,
                Length,
            ],
        }
    }
}

/// Meaning of the entries of a parameter vector `theta`, and the map to a [`Beam`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Parameterisation {
    section: Section,
}

impl Parameterisation {
    /// The parameter vector of a rod of this section.
    pub fn new(section: Section) -> Self {
        Self { section }
    }

    /// Section of the rod.
    pub fn section(&self) -> Section {
        self.section
    }

    /// The quantities in the order of `theta`.
    pub fn quantities(&self) -> &'static [Quantity] {
        self.section.quantities()
    }

    /// Number of entries of `theta`.
    #[expect(clippy::len_without_is_empty, reason = "every section has quantities")]
    pub fn len(&self) -> usize {
        self.quantities().len()
    }

    /// Index of a quantity in `theta`, or `None` if this section does not have it.
    pub fn index(&self, quantity: Quantity) -> Option<usize> {
        self.quantities().iter().position(|&q| q == quantity)
    }

    /// The beam that `theta` (SI, length [`Self::len`]) describes.
    ///
    /// Square: EI = E a^4 / 12, m = rho a^2. Round: EI = E pi d^4 / 64, m = rho pi d^2 / 4.
    /// Rectangle: EI = E w h^3 / 12, m = rho w h.
    #[inline]
    pub fn beam(&self, theta: &[f64]) -> Beam {
        let (rigidity, mass, rest) = match self.section {
            Section::Square => {
                let (e, rho, a) = (theta[1], theta[2], theta[3]);
                (e * a.powi(4) / 12.0, rho * a * a, 4)
            }
            Section::Round => {
                let (e, rho, d) = (theta[1], theta[2], theta[3]);
                (e * PI * d.powi(4) / 64.0, rho * PI * d * d / 4.0, 4)
            }
            Section::Rectangle => {
                let (e, rho, w, h) = (theta[1], theta[2], theta[3], theta[4]);
                (e * w * h.powi(3) / 12.0, rho * w * h, 5)
            }
            Section::Direct => (theta[1], theta[2], 3),
        };
        Beam {
            length_m: theta[rest + 2],
            flexural_rigidity_n_m2: rigidity,
            mass_per_length_kg_m: mass,
            axial_force_n: theta[0],
            end_stiffness_n_m: [theta[rest], theta[rest + 1]],
        }
    }

    /// Height of the section in the plane of vibration \[m\]; `None` for a rod given directly.
    pub fn height(&self, theta: &[f64]) -> Option<f64> {
        match self.section {
            Section::Square | Section::Round => Some(theta[3]),
            Section::Rectangle => Some(theta[4]),
            Section::Direct => None,
        }
    }

    /// Axial rigidity E A \[N\] of the rod that `theta` describes. A rod given directly by its flexural rigidity has no
    /// section: it is taken as steel, E A = 2.0e11 Pa m / 7700 kg/m^3 with m its mass per length.
    pub fn axial_rigidity(&self, theta: &[f64]) -> f64 {
        match self.section {
            Section::Square => theta[1] * theta[3] * theta[3],
            Section::Round => theta[1] * PI * theta[3] * theta[3] / 4.0,
            Section::Rectangle => theta[1] * theta[3] * theta[4],
            Section::Direct => 2.0e11 * theta[2] / 7700.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_section_starts_with_force_and_ends_with_springs_and_length() {
        for section in Section::ALL {
            let quantities = section.quantities();
            assert_eq!(quantities[0], Quantity::AxialForce);
            let tail = &quantities[quantities.len() - 3..];
            assert_eq!(
                tail,
                [Quantity::SpringLeft, Quantity::SpringRight, Quantity::Length]
            );
        }
    }

    #[test]
    fn a_square_and_the_same_rectangle_are_one_beam() {
        let square = Parameterisation::new(Section::Square);
        let rectangle = Parameterisation::new(Section::Rectangle);
        let a = square.beam(&[8e5, 2e11, 7500.0, 0.07, 1.0, 2.0, 14.0]);
        let b = rectangle.beam(&[8e5, 2e11, 7500.0, 0.07, 0.07, 1.0, 2.0, 14.0]);
        // Products in another order: equal to a few ulp.
        assert!((a.flexural_rigidity_n_m2 / b.flexural_rigidity_n_m2 - 1.0).abs() < 1e-14);
        assert_eq!(a.end_stiffness_n_m, b.end_stiffness_n_m);
        assert_eq!(a.length_m, 14.0);
    }
}
