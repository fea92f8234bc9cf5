//! A record's frequencies together with tests of its rod: the joint posterior, beside that of the frequencies alone.

use super::joint::{Datum, DatumConflict, Joint, JointError, JointPosterior, JointSettings, Sampler};
use super::{Distance, Inference, Observation, Posterior, distance};
use crate::rod::prior::RodPrior;
use crate::rod::query::Query;
use crate::signal::record::Rejection;
use serde::{Deserialize, Serialize};

/// Conflict score above which frequencies enter with the tolerance of rejection: no beam has them, and the exact posterior of a model
/// that the data exclude has no meaning for the rod.
const CONTRADICTED: f64 = 4.0;

/// Scores of a datum against the others, in standard deviations, from which it is doubted, and from which no test is used: nobody looks
/// at each record that they would spoil. Of right ones the second is reached once in 16 000 times.
const DOUBTED: f64 = 3.0;
const REFUSED: f64 = 4.0;

/// The posterior of a rod by its tests, moment by moment, with the data that the others hardly allow.
///
/// # Errors
/// Tests that give no posterior, or contradict each other.
pub fn agreed(
    prior: &RodPrior,
    discrepancy: &[f64],
    tests: &[Vec<Datum>],
    seed: u64,
) -> Result<(JointPosterior, Vec<DatumConflict>), JointError> {
    let joint = Joint {
        prior,
        discrepancy,
        moments: tests,
        settings: JointSettings {
            // Every record draws from these particles.
            sample: 5 * JointSettings::default().sample,
            ..JointSettings::default()
        },
    };
    let found = joint.posterior(seed)?;
    let from = |score: f64| -> Vec<DatumConflict> {
        let conflicts = found.conflicts.iter();
        conflicts
            .filter(|conflict| conflict.score >= score)
            .cloned()
            .collect()
    };
    match from(REFUSED) {
        refused if refused.is_empty() => {
            let doubts = from(DOUBTED);
            Ok((found, doubts))
        }
        refused => Err(JointError::Conflict(refused)),
    }
}

/// Effect of tests on a posterior.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tested {
    /// Method by which the joint posterior was computed.
    pub sampler: Sampler,
    /// Number of populations after the draws from the prior.
    pub populations: usize,
    /// Mean of the force that the frequencies alone give \[N\]; `None` if they give none.
    pub alone_mean_n: Option<f64>,
    /// Its standard deviation \[N\].
    pub alone_sd_n: Option<f64>,
    /// Standard deviation added to every frequency because no beam has them \[Hz\]; `None` if one has.
    pub tolerance_hz: Option<f64>,
    /// Relative rise of the force that the largest deflection of a load test brings with it; the model leaves it out.
    pub stiffening: Option<f64>,
    /// Every datum against all others.
    pub conflicts: Vec<DatumConflict>,
    /// Modal amplitudes that sensors of the record measured against each other, among the data.
    #[serde(default)]
    pub shapes: Vec<SensorRatio>,
}

/// Modal amplitude at one sensor over that at another.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SensorRatio {
    /// Mode order from 1.
    pub order: usize,
    /// Place of the sensor, as a share of the length.
    pub at: f64,
    /// Place of the sensor that it is compared with.
    pub reference_at: f64,
    /// True for strain over displacement \[1/m\].
    pub is_strain: bool,
    /// Ratio with its sign.
    pub ratio: f64,
    /// Standard error without that of the gains.
    pub sd: f64,
}

impl SensorRatio {
    /// A datum of two sensors; `None` for another.
    pub fn of(datum: &Datum) -> Option<Self> {
        let (order, at, reference_at, is_strain) = match datum.query {
            Query::AmplitudeRatio {
                order,
                at,
                reference_at,
            } => (order, at, reference_at, false),
            Query::StrainRatio {
                order,
                strain_at,
                read_at,
            } => (order, strain_at, read_at, true),
            _ => return None,
        };
        Some(Self {
            order,
            at,
            reference_at,
            is_strain,
            ratio: datum.value,
            sd: datum.sd,
        })
    }
}

impl Inference {
    /// The posterior of a rod given a record's frequencies (none for `None`), data of the same moment and data of other moments.
    ///
    /// # Errors
    /// As [`Inference::run`] for the frequencies as such, or the reason why the data give no posterior.
    pub fn run_with(
        &self,
        observation: Option<&Observation>,
        paired: &[Datum],
        others: &[Vec<Datum>],
        seed: u64,
    ) -> Result<(Posterior, Tested), Rejection> {
        let mut tolerance_hz = None;
        let mut alone = None;
        let mut now = Vec::new();
        if let Some(observation) = observation {
            let conflict = self.conflict(observation)?;
            alone = self.run(observation, seed).ok();
            if conflict.score > CONTRADICTED {
                tolerance_hz = self.tolerance(observation, alone.as_ref(), conflict.score);
            }
            let sds = distance::error_sds(observation, self.settings().noise);
            let measured = observation.orders.iter().zip(&observation.frequency_hz).zip(sds);
            now.extend(measured.map(|((&order, &f), sd)| {
                // A standard error of nothing is that of the table's own rounding.
                Datum::frequency(order, f, sd.hypot(tolerance_hz.unwrap_or(0.0)).max(1e-7 * f))
            }));
        }
        now.extend(paired);
        let mut moments = vec![now];
        moments.extend(others.iter().cloned());
        let joint = Joint {
            prior: self.prior(),
            discrepancy: self.discrepancy(),
            moments: &moments,
            settings: JointSettings::default(),
        };
        let found = joint.posterior(seed).map_err(|error| refusal(&error))?;
        let tested = self.tested(&found, alone, tolerance_hz, &moments);
        Ok((found.posterior, tested))
    }

    /// Rejection within epsilon is the exact posterior of a model with one more error of variance `epsilon^2 / (modes + 2)` (docs/abc.md):
    /// with it tests sharpen the posterior that the frequencies alone give, not another.
    fn tolerance(&self, observation: &Observation, alone: Option<&Posterior>, score: f64) -> Option<f64> {
        let modes = observation.modes() as f64;
        match (self.settings().distance, alone) {
            (Distance::Euclidean, Some(alone)) => Some(alone.epsilon / (modes + 2.0).sqrt()),
            _ => {
                let sds = distance::error_sds(observation, self.settings().noise);
                let largest = sds.fold(0.0, f64::max);
                Some(score * largest / modes.sqrt())
            }
        }
    }

    fn tested(
        &self,
        found: &JointPosterior,
        alone: Option<Posterior>,
        tolerance_hz: Option<f64>,
        moments: &[Vec<Datum>],
    ) -> Tested {
        use crate::rod::beam::Quantity::AxialForce;
        let parameterisation = self.prior().parameterisation();
        let centre: Vec<f64> = parameterisation
            .quantities()
            .iter()
            .map(|&quantity| found.posterior.mean(quantity).unwrap_or(f64::NAN))
            .collect();
        let length_m = parameterisation.beam(&centre).length_m;
        let strain = moments
            .iter()
            .flatten()
            .filter_map(|datum| datum.stiffening(length_m))
            .fold(None, |most: Option<f64>, strain| {
                Some(most.map_or(strain, |m| m.max(strain)))
            });
        Tested {
            sampler: found.sampler,
            populations: found.populations,
            alone_mean_n: alone.as_ref().and_then(|alone| alone.mean(AxialForce)),
            alone_sd_n: alone.as_ref().and_then(|alone| alone.sd(AxialForce)),
            tolerance_hz,
            stiffening: strain.map(|strain| strain * parameterisation.axial_rigidity(&centre) / centre[0]),
            conflicts: found.conflicts.clone(),
            shapes: Vec::new(),
        }
    }
}

/// Data that give no posterior, as the reason of a record that gives no force.
pub(super) fn refusal(error: &JointError) -> Rejection {
    Rejection::UnusableTest {
        detail: error.to_string(),
    }
}
