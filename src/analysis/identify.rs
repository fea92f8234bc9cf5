//! A plan once per rod, then one pure `run` per record: displacement to axial force.

mod array;
mod ratios;

pub use array::{ArrayResult, Joint, LeftOut, Sensed, Sensor, Sensors};

use crate::inference::joint::{Datum, DatumConflict};
use crate::inference::{
    AbcSettings, Conflict, Inference, Marginal, Observation, PlanError, Posterior, Table, Tables, Tested,
    VarianceShares,
};
use crate::numerics::random;
use crate::rod::beam::forward::ForwardModel;
use crate::rod::emulator::ModelSettings;
use crate::rod::prior::RodPrior;
use crate::signal::modes::{Evidence, LabelPlan, Labels, ModalPlan, Mode, ModeSettings, Motion, Resonance};
use crate::signal::record::{Envelope, Flag, Reading, Record, Rejection, RodId, Timestamp};
use crate::signal::spectrum::{PeakSettings, Spectrum, WelchSettings};
use std::sync::Arc;

/// Version of the numbers: raised whenever the same record and configuration may give others.
pub const VERSION: u32 = 2;

/// Settings of the analysis of one rod.
#[derive(Debug, Clone, PartialEq)]
pub struct AnalysisSettings {
    /// Id of the rod.
    pub rod: RodId,
    /// Prior of the rod's quantities.
    pub prior: RodPrior,
    /// Relative model discrepancy per mode order (standard deviation of b_n / y_n), one entry per
    /// mode; zeros are the paper's setting.
    pub discrepancy: Vec<f64>,
    /// Settings of the spectral estimate.
    pub welch: WelchSettings,
    /// Criteria for a maximum to be a peak.
    pub peaks: PeakSettings,
    /// Modes searched for.
    pub modes: ModeSettings,
    /// Tests of the rod: their information about everything but the force applies to every record.
    pub tests: Vec<RodTest>,
    /// Its sensors, where it has several; empty otherwise.
    pub sensors: Vec<Sensor>,
    /// Settings of the inference of the force.
    pub abc: AbcSettings,
    /// Forward model of the natural frequencies.
    pub model: ModelSettings,
    /// Seed of the whole site; each record's seed follows from it, the rod and the record.
    pub seed: u64,
}

impl AnalysisSettings {
    /// Settings for frequencies measured elsewhere, the highest of order `highest`: the plan covers these, not
    /// the modes searched for in records.
    #[must_use]
    pub fn for_orders(mut self, highest: usize) -> Self {
        let last = self.discrepancy.last().copied().unwrap_or(0.0);
        self.modes.count = highest;
        self.discrepancy.resize(highest, last);
        self
    }
}

/// Tests of a rod at one moment.
#[derive(Debug, Clone, PartialEq)]
pub struct RodTest {
    /// Time of the test.
    pub time: Timestamp,
    /// Time around the test within which a record that begins has the test's force \[s\].
    pub pairs_within_s: f64,
    /// Measured data.
    pub data: Vec<Datum>,
}

impl AnalysisSettings {
    /// Band in which records are searched for the rod's peaks \[Hz\]; `None` if the prior holds no tensioned rod.
    pub fn band_hz(&self) -> Option<(f64, f64)> {
        let labels = LabelPlan::new(&self.prior, &self.discrepancy, self.modes.clone())?;
        Some(labels.band_hz())
    }
}

impl RodTest {
    fn is_of(&self, start: Timestamp) -> bool {
        start.seconds_since(self.time).abs() <= self.pairs_within_s
    }
}

/// Result of one record: modes, posterior and conflict.
#[derive(Debug, Clone, PartialEq)]
pub struct Identification {
    /// Id of the rod.
    pub rod: RodId,
    /// Time and data of the measurement; `None` for frequencies measured elsewhere.
    pub measurement: Option<Measurement>,
    /// The measured modes, ascending in order.
    pub modes: Vec<Mode>,
    /// Probability of the mode orders; `None` where the orders were given.
    pub labels: Option<Labels>,
    /// The absolute force, per record: a weighted sample of the rod's parameters.
    pub posterior: Posterior,
    /// Distance of the observed frequencies from everything the model can produce.
    pub conflict: Conflict,
    /// The sources of the force's variance; `None` where the posterior is too small a sample to tell.
    pub hangs_on: Option<VarianceShares>,
    /// Effect of the rod's tests on the posterior; `None` without tests.
    pub tested: Option<Tested>,
    /// Part that comes from several sensors; `None` for a rod with one.
    pub joint: Option<Joint>,
}

/// The record behind an identification.
#[derive(Debug, Clone, PartialEq)]
pub struct Measurement {
    /// The record's [identity](Record::identity): the same data, the same identity.
    pub identity: [u8; 32],
    /// Time of the first sample.
    pub start: Timestamp,
    /// Length of the record \[s\].
    pub duration_s: f64,
    /// Sample rate \[Hz\].
    pub fs_hz: f64,
    /// Mean temperature during the record \[degC\], if measured.
    pub temperature_c: Option<f64>,
    /// Temperature readings since the rod's previous record, ascending in time.
    pub readings: Vec<Reading>,
    /// Root mean square of the samples, SI of their unit.
    pub rms: f64,
    /// Envelope of the samples for drawing.
    pub waveform: Envelope,
    /// Faults noticed by the quality checks.
    pub flags: Vec<Flag>,
    /// Welch's spectrum of the record.
    pub spectrum: Spectrum,
    /// Every resonance and line found in the spectrum, labelled as a mode or not.
    pub resonances: Vec<Resonance>,
    /// Motion that was recognised.
    pub motion: Motion,
}

/// A record that gives no force, with the evidence found in it.
#[derive(Debug, Clone, PartialEq)]
pub struct Refusal {
    /// Reason of the rejection.
    pub rejection: Rejection,
    /// Spectrum and resonances, if it has any.
    pub measurement: Option<Box<Measurement>>,
    /// Assignments of its peaks to orders, if there are peaks.
    pub labels: Option<Labels>,
}

impl From<Rejection> for Refusal {
    fn from(rejection: Rejection) -> Self {
        Self {
            rejection,
            measurement: None,
            labels: None,
        }
    }
}

impl Measurement {
    /// Measurement of a record with its evidence.
    pub fn new(record: &Record, identity: [u8; 32], evidence: Evidence) -> Self {
        Self {
            identity,
            start: record.start,
            duration_s: record.duration_s(),
            fs_hz: record.fs_hz,
            temperature_c: record.temperature_c,
            readings: record.readings.clone(),
            rms: record.rms(),
            waveform: Envelope::of(&record.samples, record.fs_hz),
            flags: record.flags.clone(),
            spectrum: evidence.spectrum,
            resonances: evidence.resonances,
            motion: evidence.motion,
        }
    }
}

/// Prepared analysis of one rod: its pattern of modes and its simulated table.
pub struct Plan {
    settings: AnalysisSettings,
    modal: ModalPlan,
    inference: Inference,
}

impl Plan {
    /// Prepares one rod; `model` computes its frequencies, `tables` are shared between rods.
    ///
    /// # Errors
    /// Settings that contradict each other or exceed the model.
    pub fn new(
        settings: AnalysisSettings,
        model: Arc<dyn ForwardModel>,
        tables: &Tables,
    ) -> Result<Self, PlanError> {
        let (inference, (labels, ())) = rayon::join(
            || {
                Inference::plan(
                    settings.prior.clone(),
                    model,
                    settings.discrepancy.clone(),
                    settings.abc,
                    settings.modes.count,
                    tables,
                )
            },
            || {
                rayon::join(
                    || LabelPlan::new(&settings.prior, &settings.discrepancy, settings.modes.clone()),
                    || Conflict::prepare(settings.modes.count),
                )
            },
        );
        let tests: Vec<Vec<Datum>> = settings.tests.iter().map(|test| test.data.clone()).collect();
        let inference = inference?.after(&tests, tables)?;
        let labels = labels.ok_or(PlanError::Unpredictable)?;
        let modal = ModalPlan::new(settings.welch, settings.peaks, labels);
        Ok(Self {
            settings,
            modal,
            inference,
        })
    }

    /// Data of the rod's tests that the others hardly allow.
    pub fn doubts(&self) -> &[DatumConflict] {
        self.inference.doubts()
    }

    /// Draws the table of simulated draws now, not with the first record.
    pub fn table(&self) -> &Table {
        self.inference.table()
    }

    /// Settings the plan was made from.
    pub fn settings(&self) -> &AnalysisSettings {
        &self.settings
    }

    /// Forward model of the rod's frequencies.
    pub fn model(&self) -> Arc<dyn ForwardModel> {
        Arc::clone(self.inference.model())
    }

    /// Analyses one record to the posterior of its rod's axial force. A pure function of plan and
    /// record: the same record gives the same bits on any number of threads.
    ///
    /// # Errors
    /// The reason why the record gives no force, with its findings.
    pub fn run(&self, record: &Record) -> Result<Identification, Refusal> {
        let identity = record.identity();
        let measured = |evidence| Measurement::new(record, identity, evidence);
        let estimate = self.modal.identify(record).map_err(|found| Refusal {
            rejection: found.rejection,
            measurement: found.evidence.map(|evidence| Box::new(measured(*evidence))),
            labels: found.labels,
        })?;
        self.inferred(measured(estimate.evidence), estimate.modes, estimate.labels)
    }

    /// Analyses a record again from what its search found, without samples: labels and inference alone. Equal to
    /// [`Plan::run`] of the record if `measurement` was found in the same [band](Plan::band_hz) with the same settings
    /// of the search; its waveform and spectrum play no part.
    ///
    /// # Errors
    /// The reason why the record gives no force, with its findings.
    pub fn run_again(&self, measurement: Measurement) -> Result<Identification, Refusal> {
        let found = self.modal.label(
            &measurement.resonances,
            measurement.motion.kind,
            measurement.duration_s,
            measurement.fs_hz,
        );
        match found {
            Ok(found) => self.inferred(measurement, found.modes, found.labels),
            Err((rejection, labels)) => Err(Refusal {
                rejection,
                measurement: Some(Box::new(measurement)),
                labels,
            }),
        }
    }

    /// Searches a record for its resonances, whatever the labels and the force: the part of [`Plan::run`] that needs its samples.
    ///
    /// # Errors
    /// The reason why it cannot be searched.
    pub fn search(&self, record: &Record) -> Result<Evidence, Rejection> {
        let (low_hz, high_hz) = self.band_hz();
        self.modal.search().evidence(record, low_hz, high_hz)
    }

    /// Analyses a record whose search was done before, by a plan that searches as this one: its resonances and motion are those
    /// found then. Equal to [`Plan::run`] of the record.
    ///
    /// # Errors
    /// The reason why the record gives no force, with its findings.
    pub fn run_searched(
        &self,
        record: &Record,
        resonances: Vec<Resonance>,
        motion: Motion,
    ) -> Result<Identification, Refusal> {
        let (low_hz, high_hz) = self.band_hz();
        let spectrum = self.modal.search().spectrum(record, low_hz, high_hz)?;
        let evidence = Evidence {
            spectrum,
            resonances,
            motion,
        };
        self.run_again(Measurement::new(record, record.identity(), evidence))
    }

    /// Band in which records are searched for the rod's peaks \[Hz\].
    pub fn band_hz(&self) -> (f64, f64) {
        self.modal.labels().band_hz()
    }

    fn inferred(
        &self,
        measurement: Measurement,
        modes: Vec<Mode>,
        labels: Labels,
    ) -> Result<Identification, Refusal> {
        match self.infer(
            Some(measurement.start),
            modes,
            &[],
            self.seed_of(&measurement.identity),
        ) {
            Ok(identification) => Ok(Identification {
                measurement: Some(measurement),
                labels: Some(labels),
                ..identification
            }),
            Err(rejection) => Err(Refusal {
                rejection,
                measurement: Some(Box::new(measurement)),
                labels: Some(labels),
            }),
        }
    }

    /// Infers the posterior of the axial force from frequencies measured elsewhere. Equal frequencies and settings give
    /// equal bits.
    ///
    /// # Errors
    /// The reason why they give no force.
    pub fn run_frequencies(&self, modes: Vec<Mode>) -> Result<Identification, Rejection> {
        self.run_with(modes, &[])
    }

    /// Analyses frequencies measured elsewhere together with data of the same moment: tests, a record with a
    /// mass on the rod, direct measurements.
    ///
    /// # Errors
    /// The reason why they give no force.
    pub fn run_with(&self, modes: Vec<Mode>, data: &[Datum]) -> Result<Identification, Rejection> {
        // The seed of the frequencies alone: what these give without the data stands beside the result.
        let seed = self.seed_of(&identity_of(&modes));
        self.infer(None, modes, data, seed)
    }

    /// Analyses a record that gave a force, together with data of the same moment.
    ///
    /// # Errors
    /// The reason why they give no force.
    pub fn tested(&self, found: &Identification, data: &[Datum]) -> Result<Identification, Rejection> {
        let start = found.measurement.as_ref().map(|measurement| measurement.start);
        let modes = found.modes.clone();
        let seed = self.seed_of(&identity_of(&modes));
        let ratios = found.joint.as_ref().map_or(&[][..], |joint| &joint.ratios);
        Ok(Identification {
            measurement: found.measurement.clone(),
            labels: found.labels.clone(),
            joint: found.joint.clone(),
            ..self.infer_beside(start, modes, ratios, data, seed)?
        })
    }

    /// Distance of frequencies from everything the model can produce.
    ///
    /// # Errors
    /// No rod of the prior has them.
    pub fn conflict(&self, modes: &[Mode]) -> Result<Conflict, Rejection> {
        self.conflict_of(&observed(modes))
    }

    fn conflict_of(&self, observation: &Observation) -> Result<Conflict, Rejection> {
        let conflict = self.inference.conflict(observation)?;
        if conflict.is_outside_prior {
            return Err(Rejection::OutsidePrior {
                distance: conflict.prior_distance,
            });
        }
        Ok(conflict)
    }

    /// Posterior of a moment's frequencies, jointly with `data` and with tests of that moment, because all of them have one force;
    /// `None` for a moment that is not known.
    fn infer(
        &self,
        start: Option<Timestamp>,
        modes: Vec<Mode>,
        data: &[Datum],
        seed: u64,
    ) -> Result<Identification, Rejection> {
        let (now, others): (Vec<&RodTest>, Vec<&RodTest>) = self
            .settings
            .tests
            .iter()
            .partition(|test| start.is_some_and(|start| test.is_of(start)));
        let tests = now.iter().flat_map(|test| &test.data);
        let paired: Vec<Datum> = tests.chain(data).copied().collect();
        let observation = observed(&modes);
        let conflict = self.conflict_of(&observation)?;
        let (posterior, tested) = if paired.is_empty() {
            (self.inference.run(&observation, seed)?, None)
        } else {
            let others: Vec<Vec<Datum>> = others.iter().map(|test| test.data.clone()).collect();
            let (posterior, tested) = self
                .inference
                .run_with(Some(&observation), &paired, &others, seed)?;
            (posterior, Some(tested))
        };
        Ok(Identification {
            rod: self.settings.rod.clone(),
            measurement: None,
            modes,
            labels: None,
            hangs_on: self.inference.variance_shares(&observation, &posterior),
            posterior,
            conflict,
            tested,
            joint: None,
        })
    }

    fn seed_of(&self, identity: &[u8]) -> u64 {
        random::seed(&[
            &self.settings.seed.to_le_bytes(),
            self.settings.rod.0.as_bytes(),
            identity,
        ])
    }
}

impl Identification {
    /// Axial force \[N\]: the first of a rod's quantities, whatever its section.
    pub fn axial_force(&self) -> Marginal {
        self.posterior.marginal_at(0)
    }
}

/// Identity of frequencies without a record.
fn identity_of(modes: &[Mode]) -> Vec<u8> {
    let mut identity = Vec::with_capacity(modes.len() * 24);
    for mode in modes {
        identity.extend_from_slice(&(mode.order as u64).to_le_bytes());
        identity.extend_from_slice(&mode.frequency_hz.to_bits().to_le_bytes());
        identity.extend_from_slice(&mode.sd_hz.to_bits().to_le_bytes());
    }
    identity
}

/// Modes as the inference takes them.
fn observed(modes: &[Mode]) -> Observation {
    Observation {
        orders: modes.iter().map(|mode| mode.order).collect(),
        frequency_hz: modes.iter().map(|mode| mode.frequency_hz).collect(),
        sd_hz: modes.iter().map(|mode| mode.sd_hz).collect(),
    }
}
