//! Provisional baselines, each learned once.
//!
//! Until the early watch begins, every record is held against the baselines of the first two, three and four records, which stay the
//! same meanwhile. They follow from the state and are no part of it: after a restart they are learned again.

use super::plan::TrackPlan;
use crate::track::baseline::Baseline;
use crate::track::observation::Observation;
use crate::track::relative::Shift;
use std::collections::BTreeMap;

/// Provisional baselines by number of records.
#[derive(Clone, Default)]
pub(crate) struct Provisionals(BTreeMap<usize, Learned>);

/// A baseline, prepared for records, and what it was learned from.
#[derive(Clone)]
struct Learned {
    records: Vec<Observation>,
    segment: u32,
    /// `None` if the records make none.
    prepared: Option<(Baseline, Shift)>,
}

impl Provisionals {
    /// The baseline of some records of a segment; `None` if they make none.
    pub(crate) fn of(
        &mut self,
        plan: &TrackPlan,
        records: &[Observation],
        segment: u32,
    ) -> Option<&(Baseline, Shift)> {
        let is_theirs = |known: &Learned| known.segment == segment && known.records == records;
        if !self.0.get(&records.len()).is_some_and(is_theirs) {
            let learned = plan.learn(records, segment).ok();
            let known = Learned {
                records: records.to_vec(),
                segment,
                prepared: learned.map(|(baseline, _)| {
                    let shift = plan.shift(&baseline);
                    (baseline, shift)
                }),
            };
            self.0.insert(records.len(), known);
        }
        self.0.get(&records.len())?.prepared.as_ref()
    }

    /// The same for good: the others are no longer needed.
    pub(crate) fn take(
        &mut self,
        plan: &TrackPlan,
        records: &[Observation],
        segment: u32,
    ) -> Option<(Baseline, Shift)> {
        self.of(plan, records, segment)?;
        std::mem::take(&mut self.0).remove(&records.len())?.prepared
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::AnalysisSettings;
    use crate::inference::AbcSettings;
    use crate::rod::beam::forward::ForwardModel;
    use crate::rod::emulator::{ModelSettings, ReducedModel};
    use crate::rod::prior::RodPrior;
    use crate::signal::modes::ModeSettings;
    use crate::signal::record::{RodId, Timestamp};
    use crate::signal::spectrum::{PeakSettings, WelchSettings};
    use crate::track::observation::LogMode;
    use crate::track::settings::{AlarmSettings, TrackSettings};
    use std::sync::Arc;

    fn plan(model: &Arc<ReducedModel>) -> TrackPlan {
        let settings = AnalysisSettings {
            rod: RodId("rod".to_owned()),
            prior: RodPrior::todi(),
            discrepancy: vec![0.01; 3],
            welch: WelchSettings::default(),
            peaks: PeakSettings::default(),
            modes: ModeSettings::default(),
            tests: Vec::new(),
            sensors: Vec::new(),
            abc: AbcSettings::default(),
            model: ModelSettings::default(),
            seed: 1,
        };
        let (track, alarm) = (TrackSettings::default(), AlarmSettings::default());
        TrackPlan::new(&settings, model.clone(), track, alarm, String::new())
    }

    #[test]
    fn one_is_learned_once_and_anew_from_other_records() {
        let prior = RodPrior::todi();
        let model = Arc::new(ReducedModel::new(*prior.parameterisation()));
        let plan = plan(&model);
        let mut frequencies_hz = [0.0; 3];
        model.frequencies(&prior.centre(), &mut frequencies_hz).unwrap();
        let record = |hour: i64, change: f64| {
            let mode = |n: usize| LogMode {
                order: n + 1,
                log_frequency: frequencies_hz[n].ln() + change,
                log_sd: 1e-4,
            };
            let start = Timestamp::from_nanos(hour * 3_600_000_000_000);
            Observation::of_modes(start, (0..3).map(mode).collect())
        };
        let mut records = vec![record(0, 0.0), record(1, 1e-4), record(3, -1e-4)];
        let mut known = Provisionals::default();
        let mut learned = |records: &[Observation]| {
            let (baseline, _) = known.of(&plan, records, 1).unwrap();
            assert_eq!(baseline, &plan.learn(records, 1).unwrap().0);
            baseline.particles.as_ptr()
        };
        let first = learned(&records);
        learned(&records[..2]);
        assert_eq!(learned(&records), first);
        // A record that came late.
        records.insert(2, record(2, 2e-4));
        assert_ne!(learned(&records[..3]), first);
        let (baseline, _) = known.take(&plan, &records, 1).unwrap();
        assert_eq!(baseline, plan.learn(&records, 1).unwrap().0);
        assert!(known.0.is_empty());
    }
}
