//! A baseline of a rod with tests: particles of the joint posterior of baseline and tests.

use super::particles::{Population, Target};
use super::{Baseline, BaselineFault, stated};
use crate::inference::joint::{Datum, Joint, JointSettings};
use crate::numerics::random;
use crate::rod::beam::forward::ForwardModel;
use crate::rod::prior::RodPrior;

impl Baseline {
    /// The same with what tests told of the rod, moment by moment: everything but their forces. The model's discrepancy is shared by
    /// baseline and tests, as by all records.
    ///
    /// # Errors
    /// No rod has such frequencies and passes such tests.
    pub fn after(
        self,
        tests: &[Vec<Datum>],
        prior: &RodPrior,
        model: &dyn ForwardModel,
        discrepancy: &[f64],
        seed: u64,
    ) -> Result<Self, BaselineFault> {
        if tests.is_empty() {
            return Ok(self);
        }
        let mean = self.modes.iter().map(|mode| {
            let frequency_hz = libm::exp(mode.log_frequency);
            let sd_hz = frequency_hz * mode.log_sd.max(super::LEAST_LOG_SD);
            Datum::frequency(mode.order, frequency_hz, sd_hz)
        });
        let moments: Vec<Vec<Datum>> = std::iter::once(mean.collect())
            .chain(tests.iter().cloned())
            .collect();
        let joint = Joint {
            prior,
            discrepancy,
            moments: &moments,
            settings: JointSettings::default(),
        };
        let fault = |error: crate::inference::joint::JointError| BaselineFault::Tests(error.to_string());
        let found = joint.posterior_alone(seed).map_err(fault)?.posterior;
        let width = prior.parameterisation().len();
        let count = self.particles.len() / width;
        let mut generator = random::stream(random::seed(&[b"tested baseline", &seed.to_le_bytes()]), 0);
        let particles = random::systematic(&found.weights, count, &mut generator)
            .into_iter()
            .flat_map(|row| found.particles[row * width..][..width].iter().copied())
            .collect();
        let targets: Vec<Target> = self
            .modes
            .iter()
            .map(|mode| Target {
                order: mode.order,
                level: mode.log_frequency,
                variance: stated(discrepancy, mode.order).powi(2)
                    + mode.log_sd.max(super::LEAST_LOG_SD).powi(2),
            })
            .collect();
        let modes = self.modes.last().map_or(1, |mode| mode.order);
        let population = Population::of(particles, width, model, modes);
        Ok(Self {
            misfit: population.misfit(&targets),
            particles: population.thetas,
            ..self
        })
    }
}
