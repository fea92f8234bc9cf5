//! Quantities that can be measured on a rod, and their values by the exact beam.

use super::beam::receptance::{self, PointLoad, PointMass};
use super::beam::shape::Shape;
use super::beam::{Beam, OutsideRange, Parameterisation, Quantity, exact, forward::MAX_MODES};

/// A measurable quantity of a rod under its axial force. Places are shares of the length, from the left support.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Query {
    /// Natural frequency \[Hz\], with a mass on the rod or without.
    Frequency {
        /// Mode order from 1.
        order: usize,
        /// The mass on the rod.
        mass: Option<PointMass>,
    },
    /// Natural frequency with a mass over that without it \[-\].
    FrequencyRatio {
        /// Mode order from 1.
        order: usize,
        /// The mass.
        mass: PointMass,
    },
    /// Static deflection \[m\] under a load, at rest or just before its release.
    Deflection {
        /// The load.
        load: PointLoad,
        /// Place of the sensor.
        read_at: f64,
    },
    /// Bending strain of the face towards which displacement counts positive over displacement \[1/m\], in phase positive:
    /// `-h w''(strain_at) / (2 w(read_at))` with h the section's height in the plane of vibration. Positive at mid-span in mode 1,
    /// negative near a support that holds.
    StrainRatio {
        /// Mode order from 1.
        order: usize,
        /// Place of the strain gauge.
        strain_at: f64,
        /// Place of the displacement sensor.
        read_at: f64,
    },
    /// Modal displacement at one place over that at another, with its sign \[-\].
    AmplitudeRatio {
        /// Mode order from 1.
        order: usize,
        /// Place of the first sensor.
        at: f64,
        /// Place of the second.
        reference_at: f64,
    },
    /// One of the rod's own quantities, SI.
    Quantity(Quantity),
}

impl Query {
    /// Highest mode order it needs; 0 if none.
    fn order(&self) -> usize {
        match *self {
            Self::Frequency { order, .. }
            | Self::FrequencyRatio { order, .. }
            | Self::StrainRatio { order, .. }
            | Self::AmplitudeRatio { order, .. } => order,
            Self::Deflection { .. } | Self::Quantity(_) => 0,
        }
    }

    /// Places it names, as shares of the length.
    pub fn places(&self) -> Vec<f64> {
        match *self {
            Self::Frequency { mass: Some(mass), .. } | Self::FrequencyRatio { mass, .. } => vec![mass.at],
            Self::Deflection { load, read_at } => vec![load.at, read_at],
            Self::StrainRatio {
                strain_at, read_at, ..
            } => vec![strain_at, read_at],
            Self::AmplitudeRatio { at, reference_at, .. } => vec![at, reference_at],
            Self::Frequency { mass: None, .. } | Self::Quantity(_) => Vec::new(),
        }
    }

    /// True if its answer may be negative.
    pub fn is_signed(&self) -> bool {
        matches!(self, Self::AmplitudeRatio { .. } | Self::StrainRatio { .. })
    }
}

/// Queries of one rod, answered together: natural frequencies are solved once.
#[derive(Debug, Clone, PartialEq)]
pub struct Queries {
    parameterisation: Parameterisation,
    queries: Vec<Query>,
    modes: usize,
}

impl Queries {
    /// `None` if a mode order is zero or above [`MAX_MODES`], or a quantity or strain is asked of a section without it.
    pub fn new(parameterisation: Parameterisation, queries: Vec<Query>) -> Option<Self> {
        let can = |query: &Query| match *query {
            Query::Frequency { order, .. }
            | Query::FrequencyRatio { order, .. }
            | Query::AmplitudeRatio { order, .. } => (1..=MAX_MODES).contains(&order),
            Query::StrainRatio { order, .. } => {
                (1..=MAX_MODES).contains(&order) && parameterisation.height(&[1.0; 8]).is_some()
            }
            Query::Quantity(quantity) => parameterisation.index(quantity).is_some(),
            Query::Deflection { .. } => true,
        };
        queries.iter().all(can).then(|| Self {
            parameterisation,
            modes: queries.iter().map(Query::order).max().unwrap_or(0),
            queries,
        })
    }

    /// The queries, in the order of their answers.
    pub fn all(&self) -> &[Query] {
        &self.queries
    }

    /// Answers of the rod `theta`, one per query.
    ///
    /// # Errors
    /// The parameters are not those of a beam.
    pub fn answers(&self, theta: &[f64], out: &mut [f64]) -> Result<(), OutsideRange> {
        let beam = self.parameterisation.beam(theta);
        let mut free = [0.0; MAX_MODES];
        exact::frequencies(&beam, &mut free[..self.modes])?;
        for (query, out) in self.queries.iter().zip(out) {
            *out = self.answer(query, theta, &beam, &free)?;
        }
        Ok(())
    }

    fn answer(&self, query: &Query, theta: &[f64], beam: &Beam, free: &[f64]) -> Result<f64, OutsideRange> {
        let shape = |order: usize| Shape::unscaled(beam, free[order - 1]);
        Ok(match *query {
            Query::Frequency { order, mass: None } => free[order - 1],
            Query::Frequency {
                order,
                mass: Some(mass),
            } => receptance::loaded_frequency(beam, &free[..order], mass)?,
            Query::FrequencyRatio { order, mass } => {
                receptance::loaded_frequency(beam, &free[..order], mass)? / free[order - 1]
            }
            Query::Deflection { load, read_at } => receptance::deflection(beam, load, read_at)?,
            Query::StrainRatio {
                order,
                strain_at,
                read_at,
            } => {
                let shape = shape(order);
                let height = self.parameterisation.height(theta).unwrap_or(f64::NAN);
                -0.5 * height * shape.derivatives(strain_at).1 / shape.at(read_at)
            }
            Query::AmplitudeRatio {
                order,
                at,
                reference_at,
            } => {
                let shape = shape(order);
                shape.at(at) / shape.at(reference_at)
            }
            Query::Quantity(quantity) => self
                .parameterisation
                .index(quantity)
                .map_or(f64::NAN, |i| theta[i]),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rod::beam::Section;
    use crate::rod::beam::dense::Elements;
    use crate::rod::prior::RodPrior;

    fn answers(theta: &[f64], queries: Vec<Query>) -> Vec<f64> {
        let queries = Queries::new(Parameterisation::new(Section::Square), queries).unwrap();
        let mut out = vec![0.0; queries.all().len()];
        queries.answers(theta, &mut out).unwrap();
        out
    }

    #[test]
    fn a_hinged_rod_has_the_answers_of_a_sine() {
        let mut theta = RodPrior::todi().centre();
        (theta[4], theta[5]) = (0.0, 0.0);
        let sine = |order: usize, x: f64| (order as f64 * std::f64::consts::PI * x).sin();
        for order in 1..=3 {
            let found = answers(
                &theta,
                vec![
                    Query::AmplitudeRatio {
                        order,
                        at: 0.1,
                        reference_at: 0.4,
                    },
                    Query::StrainRatio {
                        order,
                        strain_at: 0.15,
                        read_at: 0.4,
                    },
                ],
            );
            let wave = order as f64 * std::f64::consts::PI / 14.0;
            let ratio = sine(order, 0.1) / sine(order, 0.4);
            let strain = 0.035 * wave * wave * sine(order, 0.15) / sine(order, 0.4);
            // Roundings.
            assert!((found[0] / ratio - 1.0).abs() < 1e-9, "{order} {found:?} {ratio}");
            assert!(
                (found[1] / strain - 1.0).abs() < 1e-9,
                "{order} {found:?} {strain}"
            );
        }
    }

    #[test]
    fn shapes_and_strains_are_those_of_finite_elements() {
        let theta = RodPrior::todi().centre();
        let beam = Parameterisation::new(Section::Square).beam(&theta);
        for (order, mode) in (1..).zip(Elements::new(&beam, 100).modes(3)) {
            let found = answers(
                &theta,
                vec![
                    Query::AmplitudeRatio {
                        order,
                        at: 0.1,
                        reference_at: 0.4,
                    },
                    Query::StrainRatio {
                        order,
                        strain_at: 0.2,
                        read_at: 0.1,
                    },
                ],
            );
            // Elements: (n pi / 100)^4 / 1440 of the frequency, a little more of the shape.
            let ratio = mode.at(0.1) / mode.at(0.4);
            assert!(
                (found[0] / ratio - 1.0).abs() < 1e-5,
                "{order} {} {ratio}",
                found[0]
            );
            // Curvature by differences: (n pi / 100)^2 / 6, at most 1.5e-3.
            let strain = -0.035 * mode.curvature(0.2) / mode.at(0.1);
            assert!(
                (found[1] / strain - 1.0).abs() < 2e-3,
                "{order} {} {strain}",
                found[1]
            );
        }
    }
}
