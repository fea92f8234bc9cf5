//! One measurement of a rod besides its records: the query, the value, its standard error, and the faults
//! that make it invalid.

use crate::rod::beam::forward::MAX_MODES;
use crate::rod::beam::receptance::stiffening;
use crate::rod::beam::{Parameterisation, Quantity};
use crate::rod::prior::RodPrior;
use crate::rod::query::{Queries, Query};
use thiserror::Error;

/// Heaviest credible added mass, in masses of the rod: above it the rod is the smaller part of the vibrating
/// mass.
const HEAVIEST: f64 = 20.0;

const KG_OF_LB: f64 = 0.453_592_37;

/// A measured value of a query, with a normal error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Datum {
    /// Measured query.
    pub query: Query,
    /// Value in the unit of the query.
    pub value: f64,
    /// Standard error in the same unit.
    pub sd: f64,
    /// Relative standard error that it has in common with all data of the same two sensors: their gains \[-\]. Only for
    /// [`Query::AmplitudeRatio`] and [`Query::StrainRatio`].
    pub gain_sd: f64,
}

/// Error that several data share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum SharedError {
    /// The model's discrepancy of a mode order.
    Order(usize),
    /// The gain of the sensor at the first place over that at the second; displacements, or strain over displacement.
    Gain {
        is_strain: bool,
        at: f64,
        reference_at: f64,
    },
}

/// Reason why a measurement is invalid.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum DatumFault {
    /// A place beyond the ends.
    #[error("{what}: place {place_m:.3} m lies outside the rod, which is {length_m:.3} m long")]
    Place {
        /// The datum.
        what: String,
        /// The place \[m\].
        place_m: f64,
        /// Free length \[m\].
        length_m: f64,
    },
    /// A place on a support, where nothing moves.
    #[error("{what}: a place on a support says nothing, the rod does not move there")]
    Support {
        /// The datum.
        what: String,
    },
    /// A deflection against its load, or another value of a sign it cannot have.
    #[error(
        "{what}: the value {value} has the wrong sign; a rod gives way in the direction of its load, so write both positive"
    )]
    Sign {
        /// The datum.
        what: String,
        /// As given.
        value: f64,
    },
    /// An invalid standard error.
    #[error("{what}: standard error {sd}; it must be positive and smaller than the value")]
    Error {
        /// The datum.
        what: String,
        /// As given.
        sd: f64,
    },
    /// An invalid mass.
    #[error(
        "{what}: {mass_kg} kg on a rod of about {rod_kg:.0} kg; more than 0 and at most {HEAVIEST} times the rod's are possible"
    )]
    Mass {
        /// The datum.
        what: String,
        /// As given \[kg\].
        mass_kg: f64,
        /// The rod's mass at the centre of its prior \[kg\].
        rod_kg: f64,
    },
    /// A frequency ratio above one.
    #[error(
        "{what}: a mass lowers frequencies or leaves them, the ratio {value} is above 1: was it given upside down?"
    )]
    Ratio {
        /// The datum.
        what: String,
        /// As given.
        value: f64,
    },
    /// A mode order, quantity or strain the rod does not have.
    #[error(
        "{what}: not for this rod; mode orders run from 1 to {MAX_MODES}, strain needs a section with a height, and a quantity must be one of the section's"
    )]
    Query {
        /// The datum.
        what: String,
    },
}

impl Query {
    /// In words, with its units.
    pub fn said(&self) -> String {
        match self {
            Self::Frequency { order, mass: None } => format!("frequency of mode {order}"),
            Self::Frequency {
                order,
                mass: Some(mass),
            } => format!(
                "frequency of mode {order} with {} kg at {:.3} l",
                mass.mass_kg, mass.at
            ),
            Self::FrequencyRatio { order, mass } => format!(
                "frequency ratio of mode {order} with {} kg at {:.3} l",
                mass.mass_kg, mass.at
            ),
            Self::Deflection { load, read_at } => format!(
                "deflection at {read_at:.3} l under {} N at {:.3} l",
                load.force_n, load.at
            ),
            Self::StrainRatio {
                order,
                strain_at,
                read_at,
            } => format!("strain at {strain_at:.3} l over displacement at {read_at:.3} l in mode {order}"),
            Self::AmplitudeRatio {
                order,
                at,
                reference_at,
            } => format!("amplitude at {at:.3} l over that at {reference_at:.3} l in mode {order}"),
            Self::Quantity(quantity) => quantity.key().to_owned(),
        }
    }
}

impl Datum {
    /// A frequency of a record without an added mass.
    pub fn frequency(order: usize, frequency_hz: f64, sd_hz: f64) -> Self {
        Self {
            query: Query::Frequency { order, mass: None },
            value: frequency_hz,
            sd: sd_hz,
            gain_sd: 0.0,
        }
    }

    /// A quantity read at several places of a rod that is not the same everywhere: the mean, with the error of the instrument and
    /// the scatter between the places. `None` for no reading.
    pub fn readings(quantity: Quantity, values: &[f64], instrument_sd: f64) -> Option<Self> {
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let scatter = values.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>();
        let between = match values.len() {
            0 => return None,
            1 => 0.0,
            _ => scatter / (count * (count - 1.0)),
        };
        Some(Self {
            query: Query::Quantity(quantity),
            value: mean,
            // The instrument's error is taken as its calibration: more readings do not average it away.
            sd: (instrument_sd * instrument_sd + between).sqrt(),
            gain_sd: 0.0,
        })
    }

    /// Refuses values that no rod of this prior can have, whatever its parameters.
    ///
    /// # Errors
    /// The fault, with the datum's name.
    pub fn check(&self, prior: &RodPrior) -> Result<(), DatumFault> {
        let what = self.query.said();
        let parameterisation = *prior.parameterisation();
        let beam = parameterisation.beam(&prior.centre());
        for place in self.query.places() {
            if !(0.0..=1.0).contains(&place) {
                let length_m = beam.length_m;
                let place_m = place * length_m;
                return Err(DatumFault::Place {
                    what,
                    place_m,
                    length_m,
                });
            }
        }
        // A strain gauge may sit at a support; loads, masses and displacement sensors must see motion.
        let moving: Vec<f64> = match self.query {
            Query::StrainRatio { read_at, .. } => vec![read_at],
            _ => self.query.places(),
        };
        if moving.iter().any(|place| *place == 0.0 || *place == 1.0) {
            return Err(DatumFault::Support { what });
        }
        let mass = match self.query {
            Query::Frequency { mass, .. } => mass,
            Query::FrequencyRatio { mass, .. } => Some(mass),
            _ => None,
        };
        if let Some(mass) = mass {
            let rod_kg = beam.mass_per_length_kg_m * beam.length_m;
            let mass_kg = mass.mass_kg;
            if !(mass_kg > 0.0 && mass_kg <= HEAVIEST * rod_kg) {
                return Err(DatumFault::Mass {
                    what,
                    mass_kg,
                    rod_kg,
                });
            }
        }
        let value = self.value;
        let is_against_load =
            matches!(self.query, Query::Deflection { load, .. } if load.force_n * value <= 0.0);
        if !value.is_finite() || is_against_load || (value <= 0.0 && !self.query.is_signed()) {
            return Err(DatumFault::Sign { what, value });
        }
        if let Query::FrequencyRatio { .. } = self.query
            && value - 4.0 * self.sd > 1.0
        {
            return Err(DatumFault::Ratio { what, value });
        }
        if !(self.sd > 0.0 && self.sd.is_finite() && (self.sd < value.abs() || self.query.is_signed())) {
            return Err(DatumFault::Error { what, sd: self.sd });
        }
        match Queries::new(parameterisation, vec![self.query]) {
            Some(_) => Ok(()),
            None => Err(DatumFault::Query { what }),
        }
    }

    /// Axial strain that the deflection of a load test adds to a rod whose ends do not move, at most; `None` for other data.
    pub fn stiffening(&self, length_m: f64) -> Option<f64> {
        match self.query {
            // The deflection under the load is the largest; read elsewhere it is scaled up as a triangle's.
            Query::Deflection { load, read_at } => {
                let share = match read_at < load.at {
                    true => read_at / load.at,
                    false => (1.0 - read_at) / (1.0 - load.at),
                };
                Some(stiffening(length_m, load.at, self.value / share))
            }
            _ => None,
        }
    }

    /// Slips whose true value `agrees`, joined by "or"; `None` if none does.
    pub(super) fn slips_where(&self, agrees: impl Fn(f64) -> bool) -> Option<String> {
        let slips = self.slips();
        let agreeing: Vec<&str> = slips
            .iter()
            .filter(|(value, _)| agrees(*value))
            .map(|(_, why)| *why)
            .collect();
        (!agreeing.is_empty()).then(|| agreeing.join(", or "))
    }

    /// True values that a common slip would have turned into the given value, with the slip's name.
    fn slips(&self) -> Vec<(f64, &'static str)> {
        let v = self.value;
        match self.query {
            Query::Deflection { .. } => vec![
                (v / 9.806_65, "if the load was given in kgf, not N"),
                (v * 9.806_65, "if the load is in N already, and was taken for kgf"),
                (v * 10.0, "if the deflection was in cm, not mm"),
                (v / 10.0, "if the deflection was in mm, not cm"),
                (
                    v / 1e3,
                    "if the load was given in kN, not N, or the deflection in um, not mm",
                ),
                (v * 1e3, "if the deflection was in m, not mm"),
            ],
            Query::AmplitudeRatio { .. } => vec![
                (1.0 / v, "if the two sensors were swapped"),
                (-v, "if one sensor was turned round"),
                (
                    -1.0 / v,
                    "if the two sensors were swapped and one was turned round",
                ),
            ],
            // A small mass lowers a frequency in proportion.
            Query::FrequencyRatio { .. } => vec![
                (1.0 / v, "if the ratio was given upside down"),
                (1.0 - (1.0 - v) / KG_OF_LB, "if the mass was in lb, not kg"),
                (1.0 - (1.0 - v) * KG_OF_LB, "if the mass was in kg, not lb"),
            ],
            Query::StrainRatio { .. } => vec![
                (v / 1e3, "if the displacement was in mm, not m"),
                (v * 1e3, "if the displacement was in m, not mm"),
                (v / 1e6, "if the strain was in microstrain"),
                (
                    -v,
                    "if the gauge was on the other face, or one sensor turned round",
                ),
                (v / 2.0, "if strain was taken between both faces"),
            ],
            Query::Quantity(_) | Query::Frequency { .. } => Vec::new(),
        }
    }

    /// Error that it shares with other data, the sign with which, and its relative standard deviation; `discrepancy` per mode order,
    /// the last for all above.
    pub(super) fn shared(&self, discrepancy: &[f64]) -> Option<(SharedError, f64, f64)> {
        let (group, sign, sd) = match self.query {
            Query::Frequency { order, .. } => {
                let sd = discrepancy.get(order - 1).or(discrepancy.last()).copied()?;
                (SharedError::Order(order), 1.0, sd)
            }
            Query::AmplitudeRatio { at, reference_at, .. } => {
                // One group for a pair, whichever of the two is the reference.
                let group = SharedError::Gain {
                    is_strain: false,
                    at: at.min(reference_at),
                    reference_at: at.max(reference_at),
                };
                (group, if at <= reference_at { 1.0 } else { -1.0 }, self.gain_sd)
            }
            Query::StrainRatio {
                strain_at, read_at, ..
            } => {
                let group = SharedError::Gain {
                    is_strain: true,
                    at: strain_at,
                    reference_at: read_at,
                };
                (group, 1.0, self.gain_sd)
            }
            Query::FrequencyRatio { .. } | Query::Deflection { .. } | Query::Quantity(_) => return None,
        };
        (sd > 0.0).then_some((group, sign, sd))
    }
}

/// Queries of data that passed [`Datum::check`].
pub(super) fn queries(parameterisation: Parameterisation, data: &[Datum]) -> Option<Queries> {
    Queries::new(parameterisation, data.iter().map(|datum| datum.query).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rod::beam::receptance::{PointLoad, PointMass};

    fn fault(query: Query, value: f64, sd: f64) -> String {
        let datum = Datum {
            query,
            value,
            sd,
            gain_sd: 0.0,
        };
        datum.check(&RodPrior::todi()).unwrap_err().to_string()
    }

    #[test]
    fn what_no_rod_can_show_is_refused_by_name() {
        let load = |at, read_at| Query::Deflection {
            load: PointLoad { force_n: 300.0, at },
            read_at,
        };
        let mass = |mass_kg, at| Query::FrequencyRatio {
            order: 1,
            mass: PointMass { mass_kg, at },
        };
        let beyond = fault(load(0.5, 1.08), 1e-3, 1e-5);
        assert!(
            beyond.contains("15.120 m lies outside the rod, which is 14.000 m"),
            "{beyond}"
        );
        assert!(fault(mass(20.0, -0.1), 0.95, 1e-3).contains("outside the rod"));
        assert!(fault(load(0.5, 0.0), 1e-3, 1e-5).contains("support"));
        assert!(fault(load(0.5, 0.5), -1.1e-3, 1e-5).contains("wrong sign"));
        assert!(fault(load(0.5, 0.5), 1.1e-3, 0.0).contains("standard error 0"));
        assert!(fault(mass(0.0, 0.3), 0.95, 1e-3).contains("0 kg"));
        assert!(fault(mass(2e4, 0.3), 0.95, 1e-3).contains("20000 kg on a rod of about 514 kg"));
        assert!(fault(mass(20.0, 0.3), 1.04, 1e-3).contains("upside down"));
        let shape = Query::AmplitudeRatio {
            order: 6,
            at: 0.1,
            reference_at: 0.4,
        };
        assert!(fault(shape, -0.5, 0.01).contains("mode orders"));
        assert!(fault(Query::Quantity(Quantity::Diameter), 0.05, 1e-4).contains("section"));
    }

    #[test]
    fn readings_at_several_places_carry_their_scatter() {
        let one = Datum::readings(Quantity::Side, &[0.07], 1e-4).unwrap();
        assert_eq!((one.value, one.sd), (0.07, 1e-4));
        let three = Datum::readings(Quantity::Side, &[0.070, 0.072, 0.071], 0.0).unwrap();
        // Standard error of three values one apart: 1 / sqrt(3).
        assert!((three.value - 0.071).abs() < 1e-12 && (three.sd - 1e-3 / 3f64.sqrt()).abs() < 1e-12);
        assert!(Datum::readings(Quantity::Side, &[], 1e-4).is_none());
    }
}
