//! Inference of one rod: planned once, then a pure function of observation and seed.

use super::abc::{self, Accepted};
use super::conflict::{self, Conflict};
use super::distance::{self, Target};
use super::joint::{Datum, DatumConflict, JointError};
use super::posterior::Posterior;
use super::prior_place::prior_place;
use super::sequential::{self, SequentialSettings};
use super::table::{LaterTable, NoiseTable, Statics, Table, Tables};
use super::variance_shares::{VarianceShares, log_mass_variance, variance_shares};
use super::{AbcSettings, Accept, Adjustment, Distance, Method, Noise, Observation, adjust, with_tests};
use crate::numerics::diagnostics;
use crate::rod::beam::forward::{ForwardModel, MAX_MODES};
use crate::rod::prior::RodPrior;
use crate::signal::record::Rejection;
use std::sync::{Arc, OnceLock};
use thiserror::Error;

/// Fewest accepted draws of a posterior; with fewer, its 2.5 % quantile is unreliable.
pub const MIN_ACCEPTED: usize = 50;

/// Largest share of draws without a model answer. The posterior treats such draws as impossible, so
/// at most this much of the prior is lost unnoticed.
pub const MAX_INVALID_SHARE: f64 = 0.001;

/// Fewest and most draws of a table.
pub const DRAWS: std::ops::RangeInclusive<usize> = 1_000..=50_000_000;

/// Reason why an inference cannot be planned.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PlanError {
    /// Prior and model have different quantities.
    #[error("the prior describes a {prior} section, the model a {model} section")]
    Section {
        /// The prior's section.
        prior: &'static str,
        /// The model's section.
        model: &'static str,
    },
    /// A prior is not a distribution.
    #[error("prior of {quantity}: {fault}")]
    Prior {
        /// The quantity's key.
        quantity: &'static str,
        /// Fault of the prior.
        fault: &'static str,
    },
    /// Every quantity has a fixed value.
    #[error("every quantity is fixed: nothing is left to infer")]
    NothingUncertain,
    /// More modes are asked for than the model gives, or none.
    #[error("{wanted} modes wanted; the model {model} gives 1 to {given}")]
    Modes {
        /// Number of modes asked for.
        wanted: usize,
        /// Name of the model.
        model: &'static str,
        /// Number of modes that the model gives.
        given: usize,
    },
    /// One discrepancy per mode is needed, each at least zero and below one.
    #[error("discrepancy {discrepancy:?}: one number from 0 to below 1 for each of {modes} modes is needed")]
    Discrepancy {
        /// Discrepancies as given.
        discrepancy: Vec<f64>,
        /// Number of modes.
        modes: usize,
    },
    /// Hardly any draw from the prior has natural frequencies.
    #[error("the prior allows almost no rod that can vibrate; check its values and units")]
    Unpredictable,
    /// The number of draws is out of range.
    #[error("{draws} draws: between {} and {} are possible", DRAWS.start(), DRAWS.end())]
    Draws {
        /// Number of draws as given.
        draws: usize,
    },
    /// The accepted share is not within 0 to 1, or accepts too few draws for a posterior.
    #[error(
        "accepting a share of {alpha} of {draws} draws: it must lie in (0, 1] and accept at least {MIN_ACCEPTED}"
    )]
    Quantile {
        /// Share as given.
        alpha: f64,
        /// Number of draws it is taken of.
        draws: usize,
    },
    /// The tolerance is not positive.
    #[error("tolerance epsilon = {epsilon}: it must be positive")]
    Epsilon {
        /// Tolerance as given.
        epsilon: f64,
    },
    /// Tests of the rod give no posterior.
    #[error("tests of the rod: {0}")]
    Tests(#[from] JointError),
    /// A sequence of populations draws from the independent priors, which tests have left.
    #[error(
        "abc.method = \"sequential\" does not go with [[rod.test]]: leave it out, tests bring a sequence of their own"
    )]
    SequentialTests,
    /// The fixed measurement error is negative or not a number.
    #[error("fixed measurement error {sd_hz} Hz: it must be zero or positive")]
    Noise {
        /// Standard deviation as given \[Hz\].
        sd_hz: f64,
    },
}

/// Prepared inference of one rod, for any number of records.
#[derive(Clone)]
pub struct Inference {
    prior: RodPrior,
    model: Arc<dyn ForwardModel>,
    discrepancy: Vec<f64>,
    settings: AbcSettings,
    table: Arc<LaterTable>,
    noise: NoiseTable,
    /// The table's rods are those that tests left.
    is_tested: bool,
    doubts: Vec<DatumConflict>,
    prior_mass: OnceLock<f64>,
}

impl Inference {
    /// Checks the settings and takes the table from `tables`, shared with equal rods; it is drawn when first
    /// needed.
    ///
    /// `discrepancy` holds the relative standard deviation of the model discrepancy, one entry for
    /// each of the mode orders 1 to `modes`.
    pub fn plan(
        prior: RodPrior,
        model: Arc<dyn ForwardModel>,
        discrepancy: Vec<f64>,
        settings: AbcSettings,
        modes: usize,
        tables: &Tables,
    ) -> Result<Self, PlanError> {
        check(&prior, model.as_ref(), &discrepancy, &settings, modes)?;
        let draws = match settings.method {
            Method::Rejection => settings.draws,
            // The sequence of populations draws for itself; the table serves the prior check alone.
            Method::Sequential => settings.draws.min(10_000),
        };
        Ok(Self {
            table: tables.simulated(&prior, &model, modes, draws, None),
            noise: tables.noise(draws, modes),
            prior,
            model,
            discrepancy,
            settings,
            is_tested: false,
            doubts: Vec::new(),
            prior_mass: OnceLock::new(),
        })
    }

    /// The same rod after tests, moment by moment: their information about everything but the force becomes
    /// the prior of every record.
    ///
    /// # Errors
    /// Tests that give no posterior or contradict each other, or a sequence of populations, which has no table.
    pub fn after(self, tests: &[Vec<Datum>], tables: &Tables) -> Result<Self, PlanError> {
        if tests.is_empty() {
            return Ok(self);
        }
        if self.settings.method == Method::Sequential {
            return Err(PlanError::SequentialTests);
        }
        let (found, doubts) = with_tests::agreed(&self.prior, &self.discrepancy, tests, tables.seed())?;
        let statics = Some(Arc::new(Statics::of(&found)));
        Ok(Self {
            table: tables.simulated(
                &self.prior,
                &self.model,
                self.table.modes(),
                self.settings.draws,
                statics,
            ),
            is_tested: true,
            doubts,
            ..self
        })
    }

    /// Data of the tests that the others hardly allow.
    pub fn doubts(&self) -> &[DatumConflict] {
        &self.doubts
    }

    /// Discrepancy that the generative model adds to the table's frequencies: none if tests have already
    /// included it.
    fn added_discrepancy(&self) -> Vec<f64> {
        match self.is_tested {
            true => vec![0.0; self.discrepancy.len()],
            false => self.discrepancy.clone(),
        }
    }

    /// Posterior given an observation. The same observation and seed give the same bits.
    ///
    /// Rejections: `NoLabel` for an observation that is none, `OutsideEmulator` for an order beyond the
    /// planned modes or a prior that reaches beyond the model's range, `NothingAccepted` for fewer than
    /// [`MIN_ACCEPTED`] accepted draws.
    pub fn run(&self, observation: &Observation, seed: u64) -> Result<Posterior, Rejection> {
        let target = self.target(observation)?;
        let table = self.table();
        let invalid = table.invalid();
        if invalid as f64 > MAX_INVALID_SHARE * table.draws() as f64 {
            return Err(Rejection::OutsideEmulator {
                detail: format!(
                    "{invalid} of {} draws of the prior lie outside the range of the model {}, at most {} % may: narrow the priors, or \
                     set emulator.model = \"exact\"",
                    table.draws(),
                    self.model.name(),
                    MAX_INVALID_SHARE * 100.0
                ),
            });
        }
        match self.settings.method {
            Method::Rejection => self.reject(&target, seed),
            Method::Sequential => self.sequence(&target, seed),
        }
    }

    /// Distance of the observed frequencies from everything the beam can produce, and their place among the
    /// records of the prior. Rejects an invalid observation as [`Inference::run`] does.
    pub fn conflict(&self, observation: &Observation) -> Result<Conflict, Rejection> {
        check_observation(observation, self.table.modes())?;
        let target = Target::new(
            observation,
            &self.added_discrepancy(),
            self.settings.noise,
            Distance::Euclidean,
        )
        .ok_or_else(|| no_label(observation, "no finite weights"))?;
        let Observation {
            orders, frequency_hz, ..
        } = observation;
        let sd_hz: Vec<f64> = distance::error_sds(observation, self.settings.noise)
            .zip(orders.iter().zip(frequency_hz))
            .map(|(sd, (&order, frequency))| sd.hypot(self.discrepancy[order - 1] * frequency))
            .collect();
        let place = prior_place(&target, self.table(), &self.noise);
        let conflict::Nearest {
            score,
            nearest_hz,
            residuals,
        } = conflict::nearest(orders, frequency_hz, &sd_hz);
        Ok(Conflict {
            score,
            nearest_hz,
            residuals,
            violation: conflict::violation(orders, frequency_hz, &sd_hz),
            prior_tail: place.tail,
            prior_distance: place.distance,
            is_outside_prior: place.is_outside,
        })
    }

    /// Share of each source in the posterior's variance; `None` where the sample is too small.
    pub fn variance_shares(
        &self,
        observation: &Observation,
        posterior: &Posterior,
    ) -> Option<VarianceShares> {
        let measured: Vec<f64> = distance::error_sds(observation, self.settings.noise).collect();
        let modelled: Vec<f64> = observation
            .orders
            .iter()
            .zip(&observation.frequency_hz)
            .map(|(&order, frequency)| self.discrepancy.get(order - 1).copied().unwrap_or(0.0) * frequency)
            .collect();
        let larger = measured.iter().zip(&modelled).filter(|(e, b)| b > e).count();
        let sds: Vec<f64> = measured.iter().zip(&modelled).map(|(e, b)| e.hypot(*b)).collect();
        variance_shares(
            &self.prior,
            self.model.as_ref(),
            posterior,
            observation,
            &sds,
            2 * larger > sds.len(),
            *self.prior_mass.get_or_init(|| log_mass_variance(&self.prior)),
        )
    }

    /// Table of simulated draws; drawn now if it is not yet.
    pub fn table(&self) -> &Table {
        self.table.get()
    }

    /// The prior.
    pub fn prior(&self) -> &RodPrior {
        &self.prior
    }

    /// The forward model.
    pub fn model(&self) -> &Arc<dyn ForwardModel> {
        &self.model
    }

    /// Relative model discrepancy per mode order from the first.
    pub fn discrepancy(&self) -> &[f64] {
        &self.discrepancy
    }

    /// Settings of the inference.
    pub fn settings(&self) -> &AbcSettings {
        &self.settings
    }

    fn target(&self, observation: &Observation) -> Result<Target, Rejection> {
        check_observation(observation, self.table.modes())?;
        Target::new(
            observation,
            &self.added_discrepancy(),
            self.settings.noise,
            self.settings.distance,
        )
        .ok_or_else(|| {
            no_label(
                observation,
                "a Mahalanobis distance needs a standard error for every mode",
            )
        })
    }

    fn reject(&self, target: &Target, seed: u64) -> Result<Posterior, Rejection> {
        let table = self.table();
        let draws = table.draws();
        let shift = (seed % draws as u64) as usize;
        let accepted = abc::reject(target, table, &self.noise, shift, self.settings.accept);
        let weights = vec![1.0 / accepted.distances.len() as f64; accepted.distances.len()];
        self.posterior(target, accepted, weights, draws, table.invalid(), seed)
    }

    fn sequence(&self, target: &Target, seed: u64) -> Result<Posterior, Rejection> {
        let settings = SequentialSettings::from(&self.settings);
        let run = sequential::run(&self.prior, self.model.as_ref(), target, &settings, seed);
        let mut posterior =
            self.posterior(target, run.accepted, run.weights, run.draws, run.invalid, seed)?;
        posterior.stop = Some(run.stop);
        Ok(posterior)
    }

    fn posterior(
        &self,
        target: &Target,
        accepted: Accepted,
        mut weights: Vec<f64>,
        draws: usize,
        invalid: usize,
        seed: u64,
    ) -> Result<Posterior, Rejection> {
        let Accepted {
            mut particles,
            mut simulated,
            distances,
            epsilon,
        } = accepted;
        if distances.len() < MIN_ACCEPTED {
            return Err(Rejection::NothingAccepted {
                accepted: distances.len(),
                draws,
                epsilon,
                needed: MIN_ACCEPTED,
            });
        }
        let adjusted = (self.settings.adjustment == Adjustment::Linear).then(|| {
            for row in simulated.chunks_exact_mut(target.terms().len()) {
                for (y, term) in row.iter_mut().zip(target.terms()) {
                    *y -= f64::from(term.observed);
                }
            }
            adjust::linear(
                self.prior.priors(),
                &mut particles,
                &simulated,
                &distances,
                epsilon,
                &mut weights,
            )
        });
        Ok(Posterior {
            parameterisation: *self.prior.parameterisation(),
            accepted: distances.len(),
            ess: diagnostics::effective_sample_size(&weights),
            particles,
            weights,
            epsilon,
            draws,
            invalid,
            seed,
            method: self.settings.method,
            adjustment: match adjusted {
                Some(Ok(())) => Adjustment::Linear,
                _ => Adjustment::None,
            },
            withheld: adjusted.and_then(Result::err),
            stop: None,
        })
    }
}

pub(super) fn no_label(observation: &Observation, detail: &str) -> Rejection {
    Rejection::NoLabel {
        peaks: observation.frequency_hz.len(),
        detail: detail.to_string(),
    }
}

fn check_observation(observation: &Observation, modes: usize) -> Result<(), Rejection> {
    observation
        .check()
        .map_err(|error| no_label(observation, &error.to_string()))?;
    match observation.orders.iter().find(|&&order| order > modes) {
        Some(order) => Err(Rejection::OutsideEmulator {
            detail: format!("mode order {order} was observed, the plan holds {modes}: raise modes.count"),
        }),
        None => Ok(()),
    }
}

fn check(
    prior: &RodPrior,
    model: &dyn ForwardModel,
    discrepancy: &[f64],
    settings: &AbcSettings,
    modes: usize,
) -> Result<(), PlanError> {
    if prior.parameterisation() != model.parameterisation() {
        return Err(PlanError::Section {
            prior: prior.parameterisation().section().key(),
            model: model.parameterisation().section().key(),
        });
    }
    for (quantity, one) in prior.parameterisation().quantities().iter().zip(prior.priors()) {
        if let Some(fault) = one.fault() {
            return Err(PlanError::Prior {
                quantity: quantity.key(),
                fault,
            });
        }
    }
    if prior.priors().iter().all(crate::rod::prior::Prior::is_fixed) {
        return Err(PlanError::NothingUncertain);
    }
    if modes == 0 || modes > model.modes().min(MAX_MODES) {
        return Err(PlanError::Modes {
            wanted: modes,
            model: model.name(),
            given: model.modes().min(MAX_MODES),
        });
    }
    if discrepancy.len() != modes || discrepancy.iter().any(|d| !(0.0..1.0).contains(d)) {
        return Err(PlanError::Discrepancy {
            discrepancy: discrepancy.to_vec(),
            modes,
        });
    }
    let draws = settings.draws;
    if !DRAWS.contains(&draws) {
        return Err(PlanError::Draws { draws });
    }
    match settings.accept {
        Accept::Quantile(alpha)
            if !(alpha > 0.0 && alpha <= 1.0) || abc::count_of(alpha, draws) < MIN_ACCEPTED =>
        {
            return Err(PlanError::Quantile { alpha, draws });
        }
        Accept::Epsilon(epsilon) if !(epsilon > 0.0 && epsilon.is_finite()) => {
            return Err(PlanError::Epsilon { epsilon });
        }
        _ => {}
    }
    match settings.noise {
        Noise::Fixed(sd_hz) if !(sd_hz >= 0.0 && sd_hz.is_finite()) => Err(PlanError::Noise { sd_hz }),
        _ => Ok(()),
    }
}
