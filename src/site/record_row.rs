//! One record's result as a row, for the store, for programs and for every display. It is text only as a line
//! of JSON.

use crate::analysis::findings::{self, CERTAIN, Candidate, Doubt, Peak};
use crate::analysis::identify::{Identification, Sensors, VERSION};
use crate::analysis::inference::{Adjustment, Marginal, Posterior, Tested, VarianceShares};
use crate::analysis::outcome::{Outcome, Rejected, Tabulated};
use crate::analysis::rod::beam::Quantity;
use crate::analysis::signal::modes::{Mode, Motion};
use crate::analysis::signal::record::{Flag, Rejection, RodId, Timestamp};
use crate::analysis::track::alarm::change::Change;
use crate::analysis::track::alternatives::Explained;
use crate::analysis::track::{Interval, Kind, RodState, SetAside, Verdict, What, Witness};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeMap;

/// State of a rod whose force is not tracked.
const NOT_MONITORING: &str = "not-monitoring";

/// One record's result (design 5.1), in SI, with the unit as a suffix of the name. Written rows have every
/// field, in this order; fields that an older version did not write are absent when read.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct RecordRow {
    /// The rod.
    pub rod: RodId,
    /// Time of the first sample.
    pub start: Option<Timestamp>,
    /// Length \[s\].
    pub duration_s: Option<f64>,
    /// Sample rate \[Hz\].
    pub fs_hz: Option<f64>,
    /// Recognised motion.
    #[serde(default, deserialize_with = "tolerant")]
    pub excitation: Option<Motion>,
    /// Measured modes, ascending in order.
    #[serde(default)]
    pub modes: Vec<ModeRow>,
    /// Probability that all orders are right \[-\].
    pub label_probability: Option<f64>,
    /// Other possible assignments of the peaks, if the orders are not certain.
    #[serde(default, deserialize_with = "tolerant")]
    pub candidates: Vec<Candidate>,
    /// Peaks of a refused record; those of other records are in the snapshot.
    #[serde(default, deserialize_with = "tolerant")]
    pub peaks: Option<Vec<Peak>>,
    /// Axial force of the record alone \[N\].
    pub axial_force_n: Option<Marginal>,
    /// The other uncertain quantities of the posterior, by their keys.
    #[serde(default, deserialize_with = "tolerant")]
    pub parameters: BTreeMap<String, ParameterRow>,
    /// Tolerance of the accepted draws.
    pub epsilon: Option<f64>,
    /// Number of draws.
    pub draws: Option<usize>,
    /// Number of accepted draws.
    pub accepted: Option<usize>,
    /// Effective sample size.
    pub ess: Option<f64>,
    /// Distance of the frequencies from everything the model can produce \[standard deviations\].
    pub conflict: Option<f64>,
    /// Share of the prior that is farther out.
    pub prior_tail: Option<f64>,
    /// Adjustment of the accepted draws: `linear`, `none`, or `withheld` with the reason.
    pub adjustment: Option<String>,
    /// Sensitivities of the force.
    #[serde(default, deserialize_with = "tolerant")]
    pub hangs_on: Option<VarianceShares>,
    /// Effect of the rod's tests on the posterior.
    #[serde(default, deserialize_with = "tolerant")]
    pub tested: Option<Tested>,
    /// Force given the baseline, at the measured temperature \[N\].
    pub tracked_force_n: Option<Interval>,
    /// N_t / N_0 at the measured temperature.
    pub relative_force: Option<Interval>,
    /// p value of the change being axial.
    pub not_axial_p: Option<f64>,
    /// Temperature \[degC\].
    pub temperature_c: Option<f64>,
    /// Reference temperature \[degC\].
    pub reference_temperature_c: Option<f64>,
    /// Force given the baseline, at the reference temperature \[N\].
    pub force_at_reference_n: Option<Interval>,
    /// N_t / N_0 at the reference temperature.
    pub relative_force_at_reference: Option<Interval>,
    /// State of the rod after the record, [`RodState::code`].
    #[serde(default)]
    pub state: String,
    /// Reason why the rod is not followed, if it is not.
    pub state_reason: Option<String>,
    /// Segment the record belongs to.
    pub segment: Option<u32>,
    /// Reason why the record does not count, if it does not.
    pub set_aside: Option<SetAside>,
    /// Active alarms.
    #[serde(default, deserialize_with = "tolerant")]
    pub alarms: Vec<AlarmRow>,
    /// Alarm events of this record.
    #[serde(default, deserialize_with = "tolerant")]
    pub events: Vec<EventRow>,
    /// Remarks of the quality checks.
    #[serde(default, deserialize_with = "tolerant")]
    pub flags: Vec<Flag>,
    /// Sensors of the moment, of a rod with several: those used, and those left out with the reason.
    #[serde(
        default,
        deserialize_with = "tolerant",
        skip_serializing_if = "Option::is_none"
    )]
    pub sensors: Option<Sensors>,
    /// Reason why the record was refused, if it was.
    pub rejection: Option<RejectionRow>,
    /// Seed of the record's random numbers.
    pub seed: Option<u64>,
    /// Hash of the configuration.
    #[serde(default)]
    pub config: String,
    /// Version of the analysis, [`VERSION`].
    pub analysis_version: Option<u32>,
}

/// A mode and the fit of its peak.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ModeRow {
    /// Mode order, from 1.
    pub order: usize,
    /// Natural frequency \[Hz\].
    pub frequency_hz: f64,
    /// Standard error of the frequency \[Hz\].
    pub sd_hz: f64,
    /// Damping ratio \[-\].
    pub damping: Option<f64>,
    /// Standard normal score of the fit of its peak; `None` for a frequency measured elsewhere.
    pub misfit: Option<f64>,
}

/// An uncertain quantity other than the force.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ParameterRow {
    /// Mean, SI.
    pub mean: f64,
    /// Coefficient of variation.
    pub cv: f64,
}

/// Reason why a record was refused.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RejectionRow {
    /// Short name, [`Rejection::code`].
    pub code: String,
    /// Reason in one sentence.
    pub message: String,
    /// Reason with its numbers; `None` for a reason of another version.
    #[serde(flatten)]
    pub detail: Option<Rejection>,
}

/// An active alarm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AlarmRow {
    /// Id of the alarm.
    pub id: String,
    /// Kind of the alarm.
    pub kind: Kind,
    /// Time at which it was raised, in event time.
    pub raised: Timestamp,
    /// Time at which it was acknowledged, if it was.
    pub acknowledged: Option<Timestamp>,
    /// Time at which the condition ended, if it did.
    pub cleared: Option<Timestamp>,
    /// Message in one sentence.
    pub message: String,
    /// Onset, size and rate of a drift.
    pub change: Option<Change>,
    /// Evidence that raised a drift.
    pub witness: Option<Witness>,
    /// Kinds of change that may have moved the modes.
    pub alternatives: Option<Explained>,
}

/// An event of an alarm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EventRow {
    /// Kind of the event: raised, acknowledged, cleared or repeated.
    pub what: What,
    /// Time of the event, in event time.
    pub time: Timestamp,
    /// Id of the alarm.
    pub id: String,
    /// Kind of the alarm.
    pub kind: Kind,
}

/// Reads a field that decides nothing: if another version wrote it in another form, it counts as absent, and
/// the rest of the row is read.
fn tolerant<'de, D: Deserializer<'de>, T: DeserializeOwned + Default>(input: D) -> Result<T, D::Error> {
    let value = serde_json::Value::deserialize(input)?;
    Ok(serde_json::from_value(value).unwrap_or_default())
}

/// Adjustment of the accepted draws: `linear`, `none`, or `withheld` with the reason.
fn adjustment(posterior: &Posterior) -> String {
    match (posterior.adjustment, posterior.withheld) {
        (Adjustment::Linear, _) => "linear".to_owned(),
        (Adjustment::None, None) => "none".to_owned(),
        (Adjustment::None, Some(reason)) => format!("withheld: {reason}"),
    }
}

/// Modes, each with the misfit of its peak.
fn modes(identification: &Identification) -> Vec<ModeRow> {
    let resonances = identification
        .measurement
        .as_ref()
        .map_or(&[][..], |measurement| &measurement.resonances);
    identification
        .modes
        .iter()
        .map(|mode| {
            let nearest = findings::nearest(resonances, mode.frequency_hz);
            ModeRow::of(mode, nearest.map(|i| resonances[i].misfit))
        })
        .collect()
}

/// Uncertain quantities other than the axial force.
fn parameters(posterior: &Posterior) -> BTreeMap<String, ParameterRow> {
    let quantities = posterior.parameterisation.quantities().iter();
    quantities
        .filter(|&&quantity| quantity != Quantity::AxialForce)
        .filter_map(|&quantity| {
            let (mean, cv) = (posterior.mean(quantity)?, posterior.cv(quantity)?);
            // A fixed quantity's spread is the rounding of its mean.
            (cv > 1e-9).then(|| (quantity.key().to_owned(), ParameterRow { mean, cv }))
        })
        .collect()
}

impl ModeRow {
    fn of(mode: &Mode, misfit: Option<f64>) -> Self {
        Self {
            order: mode.order,
            frequency_hz: mode.frequency_hz,
            sd_hz: mode.sd_hz,
            damping: mode.damping,
            misfit,
        }
    }
}

impl RecordRow {
    /// Reasons to doubt its force.
    pub fn doubts(&self) -> Vec<Doubt> {
        let interval = self.axial_force_n.map(|force| force.interval());
        Doubt::all(self.conflict, self.prior_tail, self.label_probability, interval)
    }

    /// Row of a record; without a `verdict` the force is not tracked.
    pub fn of(outcome: &Outcome, verdict: Option<&Verdict>, config_hash: &str) -> Self {
        let mut row = Self::new(outcome.rod(), config_hash);
        match outcome {
            Outcome::Identified(identification) => row.identified(identification),
            Outcome::Tabulated(tabulated) => row.tabulated(tabulated),
            Outcome::Rejected(rejected) => row.rejected(rejected),
        }
        row.sensors = outcome.sensors().cloned();
        if let Some(verdict) = verdict {
            row.tracked(verdict);
        }
        row
    }

    /// The row with what tracking made of the record.
    #[must_use]
    pub fn with_verdict(mut self, verdict: &Verdict) -> Self {
        self.tracked(verdict);
        self
    }

    /// Parses one JSON line.
    ///
    /// # Errors
    /// The line is not a record's row.
    pub fn parse(line: &str) -> serde_json::Result<Self> {
        serde_json::from_str(line)
    }

    /// Returns one JSON object without a line end.
    ///
    /// # Errors
    /// None: numbers, strings and maps with string keys always have a JSON form.
    pub fn to_json(&self) -> serde_json::Result<String> {
        serde_json::to_string(self)
    }

    /// Force given the baseline \[N\]: at the reference temperature if it is known.
    pub fn force_n(&self) -> Option<Interval> {
        self.force_at_reference_n.or(self.tracked_force_n)
    }

    /// N_t / N_0: at the reference temperature if it is known.
    pub fn ratio(&self) -> Option<Interval> {
        self.relative_force_at_reference.or(self.relative_force)
    }

    /// Row of a record of which nothing is known.
    pub fn new(rod: &RodId, config_hash: &str) -> Self {
        Self {
            rod: rod.clone(),
            state: NOT_MONITORING.to_owned(),
            config: config_hash.to_owned(),
            analysis_version: Some(VERSION),
            ..Self::default()
        }
    }

    fn identified(&mut self, identification: &Identification) {
        let posterior = &identification.posterior;
        if let Some(measurement) = &identification.measurement {
            self.start = Some(measurement.start);
            self.duration_s = Some(measurement.duration_s);
            self.fs_hz = Some(measurement.fs_hz);
            self.temperature_c = measurement.temperature_c;
            self.flags.clone_from(&measurement.flags);
            self.excitation = Some(measurement.motion.clone());
        }
        self.modes = modes(identification);
        if let Some(labels) = &identification.labels {
            self.label_probability = Some(labels.probability);
            if labels.probability < CERTAIN {
                self.candidates = Candidate::all(labels);
            }
        }
        self.axial_force_n = posterior.marginal(Quantity::AxialForce);
        self.parameters = parameters(posterior);
        self.epsilon = Some(posterior.epsilon);
        self.draws = Some(posterior.draws);
        self.accepted = Some(posterior.accepted);
        self.ess = Some(posterior.ess);
        self.conflict = Some(identification.conflict.score);
        self.prior_tail = Some(identification.conflict.prior_tail);
        self.adjustment = Some(adjustment(posterior));
        self.hangs_on.clone_from(&identification.hangs_on);
        self.tested.clone_from(&identification.tested);
        self.seed = Some(posterior.seed);
    }

    fn tabulated(&mut self, row: &Tabulated) {
        self.start = Some(row.start);
        self.duration_s = Some(row.duration_s).filter(|duration_s| *duration_s > 0.0);
        self.temperature_c = row.temperature_c;
        self.modes = row.modes.iter().map(|mode| ModeRow::of(mode, None)).collect();
        self.conflict = Some(row.conflict.score);
        self.prior_tail = Some(row.conflict.prior_tail);
    }

    fn rejected(&mut self, rejected: &Rejected) {
        self.start = rejected.start;
        self.duration_s = rejected.duration_s;
        self.fs_hz = rejected.fs_hz;
        self.rejection = Some(RejectionRow {
            code: rejected.rejection.code().to_owned(),
            message: rejected.rejection.to_string(),
            detail: Some(rejected.rejection.clone()),
        });
        self.candidates = rejected.labels.as_ref().map(Candidate::all).unwrap_or_default();
        if let Some(measurement) = &rejected.measurement {
            self.temperature_c = measurement.temperature_c;
            self.flags.clone_from(&measurement.flags);
            self.excitation = Some(measurement.motion.clone());
            self.peaks = Some(findings::peaks(measurement, &[]));
        }
    }

    fn tracked(&mut self, verdict: &Verdict) {
        if let Some(relative) = &verdict.relative {
            self.tracked_force_n = Some(relative.force_n);
            self.relative_force = Some(relative.ratio);
            self.not_axial_p = Some(relative.not_axial_p);
        }
        if let Some(at_reference) = &verdict.at_reference {
            self.reference_temperature_c = Some(at_reference.temperature_c);
            self.force_at_reference_n = Some(at_reference.force_n);
            self.relative_force_at_reference = Some(at_reference.ratio);
        }
        verdict.state.code().clone_into(&mut self.state);
        self.state_reason = match &verdict.state {
            RodState::NotMonitoring { reason } => Some(reason.clone()),
            _ => None,
        };
        self.segment = Some(verdict.segment);
        self.set_aside = verdict.set_aside;
        self.alarms = verdict
            .alarms
            .iter()
            .map(|alarm| AlarmRow {
                id: alarm.id.clone(),
                kind: alarm.kind,
                raised: alarm.raised,
                acknowledged: alarm.acknowledged,
                cleared: alarm.cleared,
                message: alarm.message.clone(),
                change: alarm.change.clone(),
                witness: alarm.witness,
                alternatives: alarm.alternatives.clone(),
            })
            .collect();
        self.events = verdict
            .events
            .iter()
            .map(|event| EventRow {
                what: event.what,
                time: event.time,
                id: event.alarm.id.clone(),
                kind: event.alarm.kind,
            })
            .collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(rejection: Rejection) -> RecordRow {
        let outcome = Outcome::Rejected(Box::new(Rejected {
            start: Some(Timestamp::from_nanos(1)),
            duration_s: Some(1.0),
            ..Rejected::new(RodId("r".to_owned()), rejection)
        }));
        RecordRow::of(&outcome, None, "0")
    }

    #[test]
    fn a_row_reads_back_with_numbers_that_json_does_not_have() {
        for rejection in [
            Rejection::NoOnset {
                duration_s: 0.1 + 0.2,
            },
            Rejection::Irregular {
                jitter: f64::INFINITY,
                allowed: 0.2,
            },
            Rejection::Damaged {
                detail: "a \"b\"".to_owned(),
            },
        ] {
            let line = refused(rejection).to_json().unwrap();
            assert_eq!(RecordRow::parse(&line).unwrap().to_json().unwrap(), line);
        }
    }

    #[test]
    fn rows_of_other_versions_are_read_as_far_as_they_are_understood() {
        let line = r#"{"rod":"r","rejection":{"code":"new","message":"why","reason":"new","x":1},"alarms":[{"id":1}],"flags":[7]}"#;
        let row = RecordRow::parse(line).unwrap();
        let rejection = row.rejection.unwrap();
        assert_eq!((rejection.code.as_str(), rejection.detail), ("new", None));
        assert!(row.alarms.is_empty() && row.flags.is_empty() && row.start.is_none());
        // A force is not read as far as it is understood.
        for force in [r#"{"mean":1}"#, r#"{"mean":null,"sd":1,"q025":1,"q975":1}"#] {
            assert!(RecordRow::parse(&format!(r#"{{"rod":"r","relative_force":{force}}}"#)).is_err());
        }
    }
}
