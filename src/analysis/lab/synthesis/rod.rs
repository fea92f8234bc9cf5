//! State of a simulated rod at a point in time: axial force, natural frequencies, mode shapes.

use super::Shape;
use super::climate::{Lagged, Weather};
use super::settings::{SimulatedRod, Simulation, Truth};
use crate::rod::beam::{OutsideRange, Parameterisation, Quantity, exact};
use crate::signal::record::time::DAY_S;
use crate::signal::record::{RodId, Timestamp};
use thiserror::Error;

/// Reason why a simulation is impossible.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SynthesisError {
    /// The rod goes slack.
    #[error(
        "rod {rod}: the axial force falls to {axial_force_n:.0} N at {time}, \
         but a tie-rod stays in tension; lower the restraint, the temperature range or the loss"
    )]
    Slack {
        /// Id of the rod.
        rod: RodId,
        /// Time of going slack.
        time: Timestamp,
        /// Axial force \[N\].
        axial_force_n: f64,
    },
    /// The beam has no natural frequencies.
    #[error("rod {rod}: {reason}")]
    Beam {
        /// Id of the rod.
        rod: RodId,
        /// Reason given by the beam model.
        reason: OutsideRange,
    },
    /// No mode lies in the sensor's band.
    #[error(
        "rod {rod}: its first natural frequency, {frequency_hz:.3} Hz, is not below half the sample rate of {fs_hz} Hz"
    )]
    Undersampled {
        /// Id of the rod.
        rod: RodId,
        /// Its first natural frequency \[Hz\].
        frequency_hz: f64,
        /// The sample rate \[Hz\].
        fs_hz: f64,
    },
}

/// State of a rod at a point in time.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// Axial force \[N\]; `None` for a rod given by its frequencies.
    pub axial_force_n: Option<f64>,
    /// Axial force over the truth's, without the effect of temperature: 1 until a change \[-\].
    pub relative_force: f64,
    /// Temperature of the air \[degC\], if there is a climate.
    pub air_c: Option<f64>,
    /// Temperature of the rod \[degC\], if there is a climate.
    pub rod_c: Option<f64>,
    /// Natural frequencies of the simulated modes \[Hz\].
    pub frequency_hz: Vec<f64>,
    /// Shapes of the modes.
    pub(super) shapes: Vec<Shape>,
}

/// A rod with the weather around it.
pub(super) struct Rod<'s> {
    pub(super) settings: &'s SimulatedRod,
    start: Timestamp,
    weather: Option<(&'s Weather, Lagged, f64)>,
}

impl<'s> Rod<'s> {
    pub(super) fn new(
        simulation: &Simulation,
        settings: &'s SimulatedRod,
        weather: Option<&'s Weather>,
    ) -> Self {
        let reference_c = settings
            .thermal
            .reference_c
            .or(simulation.climate.map(|climate| climate.mean_c));
        Self {
            settings,
            start: simulation.start,
            weather: weather.map(|weather| {
                (
                    weather,
                    weather.lagged(settings.thermal.lag_h),
                    reference_c.unwrap_or(0.0),
                )
            }),
        }
    }

    /// State at `time`, with a passing relative `fluctuation` of the force.
    ///
    /// N = N_0 (1 + sum of changes + fluctuation) - kappa E A alpha (T_rod - T_ref). An added mass M at x lowers each
    /// frequency by Rayleigh's quotient with the bare rod's shape,
    /// f' = f / sqrt(1 + M w(x)^2 / (m l mean(w^2))): right to first order in M over the modal mass.
    pub(super) fn at(&self, time: Timestamp, fluctuation: f64) -> Result<State, SynthesisError> {
        let days = time.seconds_since(self.start) / DAY_S;
        let relative_force = 1.0
            + self
                .settings
                .changes
                .iter()
                .map(|change| change.after(days))
                .sum::<f64>();
        let air_c = self.weather.as_ref().map(|(weather, ..)| weather.air_c(time));
        let rod_c = self
            .weather
            .as_ref()
            .map(|(weather, lagged, _)| weather.rod_c(lagged, time));
        let modes = self.settings.damping.len();
        let (axial_force_n, frequency_hz, shapes) = match &self.settings.truth {
            Truth::Frequencies(frequency_hz) => (
                None,
                frequency_hz.clone(),
                (1..=modes).map(Shape::sine).collect::<Vec<_>>(),
            ),
            Truth::Beam { section, theta } => {
                let mut beam = Parameterisation::new(*section).beam(theta);
                let thermal = self
                    .weather
                    .as_ref()
                    .zip(rod_c)
                    .map_or(0.0, |((_, _, reference_c), rod_c)| {
                        let thermal = &self.settings.thermal;
                        thermal.restraint
                            * self.axial_rigidity()
                            * thermal.expansion_per_k
                            * (rod_c - reference_c)
                    });
                let force = beam.axial_force_n * (relative_force + fluctuation) - thermal;
                if !(force.is_finite() && force > 0.0) {
                    let rod = self.settings.rod.clone();
                    return Err(SynthesisError::Slack {
                        rod,
                        time,
                        axial_force_n: force,
                    });
                }
                beam.axial_force_n = force;
                let mut frequency_hz = vec![0.0; modes];
                exact::frequencies(&beam, &mut frequency_hz).map_err(|reason| SynthesisError::Beam {
                    rod: self.settings.rod.clone(),
                    reason,
                })?;
                let shapes: Vec<Shape> = frequency_hz.iter().map(|f| Shape::of(&beam, *f)).collect();
                if let Some(added) = self.settings.added_mass.filter(|added| days >= added.start_d) {
                    let rod_mass = beam.mass_per_length_kg_m * beam.length_m;
                    for (f, shape) in frequency_hz.iter_mut().zip(&shapes) {
                        let w = shape.at(added.at);
                        *f /= (1.0 + added.mass_kg * w * w / (rod_mass * shape.mean_square())).sqrt();
                    }
                }
                (Some(force), frequency_hz, shapes)
            }
        };
        Ok(State {
            axial_force_n,
            relative_force,
            air_c,
            rod_c,
            frequency_hz,
            shapes,
        })
    }

    /// Axial rigidity E A \[N\]: as given, or from the truth's modulus and section; 0 if the section has
    /// none.
    fn axial_rigidity(&self) -> f64 {
        self.settings
            .thermal
            .axial_rigidity_n
            .unwrap_or_else(|| match &self.settings.truth {
                Truth::Beam { section, theta } => {
                    let parameterisation = Parameterisation::new(*section);
                    let value = |quantity| parameterisation.index(quantity).map(|i| theta[i]);
                    let modulus = value(Quantity::YoungsModulus).unwrap_or(0.0);
                    // Mass over density is the area, whatever the shape.
                    let mass = parameterisation.beam(theta).mass_per_length_kg_m;
                    value(Quantity::Density).map_or(0.0, |density| modulus * mass / density)
                }
                Truth::Frequencies(_) => 0.0,
            })
    }
}
