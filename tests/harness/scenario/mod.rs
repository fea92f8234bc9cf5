//! A rod like the paper's over months, at the level of frequencies, through the real fold.
#![allow(dead_code, missing_docs)]

use std::path::Path;
use std::sync::Arc;
use tirante::analysis::identify::AnalysisSettings;
use tirante::analysis::lab::synthesis::{
    Change, FrequencyErrors, Measured, SimulatedRod, Simulation, history,
};
use tirante::analysis::rod::emulator::ReducedModel;
use tirante::analysis::track::{
    AlarmSettings, Input, Kind, Observation, TrackPlan, TrackSettings, Tracker, Verdict, What,
};
use tirante::config::Config;

pub const DAY_S: f64 = 86_400.0;

/// A rod like the paper's, a record a day, three modes at 0.1 %, weather and seasons.
pub struct Scenario {
    pub analysis: AnalysisSettings,
    pub simulation: Simulation,
    pub rod: SimulatedRod,
    pub errors: FrequencyErrors,
    pub track: TrackSettings,
    pub alarm: AlarmSettings,
}

impl Scenario {
    pub fn new(days: usize) -> Self {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/campaign.toml");
        let config = Config::load(&path).expect("the shipped configuration");
        let mut simulation = config.simulation.expect("it simulates").simulation;
        simulation.records = days;
        simulation.interval_s = DAY_S;
        let mut rod = simulation.rods[0].clone();
        rod.changes.clear();
        Self {
            analysis: config.rods[0].analysis.clone(),
            simulation,
            rod,
            errors: FrequencyErrors {
                log_sd: 1e-3,
                offsets: vec![0.006, -0.004, 0.008],
                fluctuation: 0.0,
                autocorrelation: 0.0,
                missing: Vec::new(),
            },
            track: TrackSettings::default(),
            alarm: AlarmSettings::default(),
        }
    }

    pub fn step(mut self, day: f64, relative: f64) -> Self {
        self.rod.changes.push(Change {
            start_d: day,
            over_d: 0.0,
            relative,
        });
        self
    }

    pub fn history(&self, seed: u64) -> Vec<Measured> {
        history(&self.simulation, &self.rod, &self.errors, seed).expect("a taut rod")
    }

    pub fn observations(&self, seed: u64) -> Vec<Observation> {
        self.history(seed)
            .into_iter()
            .map(|record| record.observation)
            .collect()
    }

    pub fn plan(&self, key: &str) -> Arc<TrackPlan> {
        Arc::new(TrackPlan::new(
            &self.analysis,
            Arc::new(ReducedModel::new(*self.analysis.prior.parameterisation())),
            self.track.clone(),
            self.alarm.clone(),
            key.to_owned(),
        ))
    }

    pub fn follow(&self, observations: &[Observation]) -> (Tracker, Vec<Verdict>) {
        let mut tracker = Tracker::new(self.plan("key"));
        let verdicts = follow_on(&mut tracker, observations);
        (tracker, verdicts)
    }
}

pub fn follow_on(tracker: &mut Tracker, observations: &[Observation]) -> Vec<Verdict> {
    observations
        .iter()
        .map(|observation| tracker.step(&Input::Identified(observation.clone()), &[]))
        .collect()
}

/// Alarms raised, with the number of the record.
pub fn raised(verdicts: &[Verdict]) -> Vec<(usize, Kind)> {
    told(verdicts, What::Raised)
}

pub fn told(verdicts: &[Verdict], what: What) -> Vec<(usize, Kind)> {
    let all = verdicts.iter().enumerate();
    all.flat_map(|(index, verdict)| {
        verdict
            .events
            .iter()
            .filter(|event| event.what == what)
            .map(move |event| (index, event.alarm.kind))
    })
    .collect()
}
