//! Settings and prepared data of the tracking of one rod, besides its records.

use super::state::State;
use crate::identify::{AnalysisSettings, Plan};
use crate::inference::joint::Datum;
use crate::numerics::random;
use crate::rod::beam::forward::ForwardModel;
use crate::rod::prior::RodPrior;
use crate::signal::record::time::YEAR_S;
use crate::signal::record::{RodId, Timestamp};
use crate::track::alternatives::Alternatives;
use crate::track::baseline::{Baseline, BaselineFault};
use crate::track::drift::ThermalPrior;
use crate::track::drift::period;
use crate::track::drift::watch::Terms;
use crate::track::observation::Observation;
use crate::track::relative::Shift;
use crate::track::settings::{AlarmSettings, TemperatureUse, TrackSettings};
use std::sync::Arc;

/// Standard deviations of the static parameters allowed for by the bend of the ratio: they may be wrong
/// together.
const BEND_SD: f64 = 1.5;

/// Relative change of modulus times expansion per kelvin, a standard deviation about none: wrought iron and steel lose some
/// 3e-4 of their modulus and gain about twice that in expansion.
const MATERIAL_PER_K: f64 = 3e-4;

/// Prepared settings of one rod's fold.
pub struct TrackPlan {
    pub(crate) rod: RodId,
    pub(crate) track: TrackSettings,
    pub(crate) alarm: AlarmSettings,
    prior: RodPrior,
    model: Arc<dyn ForwardModel>,
    discrepancy: Vec<f64>,
    /// Data of the rod's tests, moment by moment.
    tests: Vec<Vec<Datum>>,
    key: String,
    seed: u64,
}

impl TrackPlan {
    /// Prepares a rod whose state is not kept between runs.
    pub fn of(plan: &Plan, track: TrackSettings, alarm: AlarmSettings) -> Self {
        Self::new(plan.settings(), plan.model(), track, alarm, String::new())
    }

    /// Prepares one rod. `key` is a hash of everything that determines the meaning of the rod's numbers.
    pub fn new(
        analysis: &AnalysisSettings,
        model: Arc<dyn ForwardModel>,
        track: TrackSettings,
        alarm: AlarmSettings,
        key: String,
    ) -> Self {
        let discrepancy = analysis
            .discrepancy
            .iter()
            .map(|stated| stated.max(track.discrepancy))
            .collect();
        Self {
            rod: analysis.rod.clone(),
            track,
            alarm,
            prior: analysis.prior.clone(),
            model,
            discrepancy,
            tests: analysis.tests.iter().map(|test| test.data.clone()).collect(),
            key,
            seed: analysis.seed,
        }
    }

    /// Id of the rod.
    pub fn rod(&self) -> &RodId {
        &self.rod
    }

    /// Hash of everything that determines the meaning of the rod's numbers.
    pub fn key(&self) -> &str {
        &self.key
    }

    /// Prior of the rod.
    pub fn prior(&self) -> &RodPrior {
        &self.prior
    }

    /// Name of the forward model.
    pub fn emulator(&self) -> &'static str {
        self.model.name()
    }

    /// Mean number of periods between false alarms: limit R of the drift watch.
    pub fn limit(&self) -> f64 {
        self.alarm.arl0_years * YEAR_S / self.track.period_s
    }

    /// State of a rod without records.
    pub(crate) fn blank(&self) -> State {
        State::new(self.rod.clone(), self.key.clone())
    }

    /// True if force is referred to one temperature.
    pub(crate) fn compensates(&self) -> bool {
        self.track.temperature == TemperatureUse::Compensate
    }

    /// The baseline of a segment from its first observations, with the reason why the rod's tests are left out of it, if they are: a rod that
    /// they contradict is watched without them.
    pub(crate) fn learn(
        &self,
        observations: &[Observation],
        segment: u32,
    ) -> Result<(Baseline, Option<BaselineFault>), BaselineFault> {
        let first = observations.first().map(|first| first.start);
        let seed = self.seed_of(b"baseline", segment, first);
        let (prior, model) = (&self.prior, self.model.as_ref());
        let baseline = Baseline::learn(
            observations,
            prior,
            model,
            &self.discrepancy,
            self.track.particles,
            seed,
        )?;
        Ok(
            match baseline.after(&self.tests, prior, &self.discrepancy, seed) {
                Ok(tested) => (tested, None),
                Err(fault) => (baseline, Some(fault)),
            },
        )
    }

    /// A baseline ready for records.
    pub(crate) fn shift(&self, baseline: &Baseline) -> Shift {
        Shift::new(baseline, self.model.as_ref())
    }

    /// Responses of the frequencies to changes of every kind, for a baseline's particles.
    pub(crate) fn alternatives(&self, baseline: &Baseline) -> Option<Alternatives> {
        Alternatives::new(&baseline.particles, self.model.as_ref(), &self.discrepancy)
    }

    /// The seed of one record's relative force.
    pub(crate) fn seed_of(&self, purpose: &[u8], segment: u32, time: Option<Timestamp>) -> u64 {
        random::seed(&[
            purpose,
            &self.seed.to_le_bytes(),
            self.rod.0.as_bytes(),
            &segment.to_le_bytes(),
            &time.map_or(0, Timestamp::as_nanos).to_le_bytes(),
        ])
    }

    /// Settings of the drift watch: beta = -kappa E A alpha / N_0 with a restraint kappa between 0 (free to
    /// expand) and 1 (fixed ends), and a curvature from material and static parameters.
    pub(crate) fn terms(&self, baseline: &Baseline, shift: &Shift, reference_c: Option<f64>) -> Terms {
        let parameterisation = self.prior.parameterisation();
        let width = parameterisation.len();
        let thetas = baseline.particles.chunks_exact(width);
        let count = thetas.len().max(1) as f64;
        let fixed_per_k = thetas
            .map(|theta| parameterisation.axial_rigidity(theta) * self.track.expansion_per_k / theta[0])
            .sum::<f64>()
            / count;
        let bend_per_k2 = BEND_SD * shift.bend().square * fixed_per_k * fixed_per_k;
        let thermal = ThermalPrior {
            slope_mean_per_k: -0.5 * fixed_per_k,
            slope_sd_per_k: 0.5 * fixed_per_k,
            curvature_sd_per_k2: (MATERIAL_PER_K * fixed_per_k).hypot(bend_per_k2),
            is_sparse: false,
        };
        Terms {
            limit: self.limit(),
            thermal: self.compensates().then_some(thermal),
            reference_c,
            learning_periods: self.track.learning_periods,
            commissioned_until: None,
            told_since: None,
        }
    }

    /// Start of the last period of commissioning \[d\], of a baseline that a change ended early.
    pub(crate) fn commissioned_until(&self, baseline: &Baseline) -> Option<f64> {
        let period_s = self.track.period_s;
        let last = period::start_of(period::index_of(baseline.last, period_s), period_s);
        (baseline.records < self.track.baseline_records).then(|| last.days())
    }
}
