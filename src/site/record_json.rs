//! A record as one JSON line: what programs read and the store keeps.

use crate::analysis::findings::{self, CERTAIN, Candidate, Peak};
use crate::analysis::identify::{Identification, VERSION};
use crate::analysis::inference::{Adjustment, Marginal, Posterior, Tested, VarianceShares};
use crate::analysis::outcome::{Outcome, Rejected, Tabulated};
use crate::analysis::rod::beam::Quantity;
use crate::analysis::signal::modes::{Mode, Motion};
use crate::analysis::signal::record::{Flag, Rejection, RodId, Timestamp};
use crate::analysis::track::alarm::change::Change;
use crate::analysis::track::alternatives::Explained;
use crate::analysis::track::{Interval, Kind, RodState, SetAside, Verdict, What, Witness};
use serde::Serialize;
use std::collections::BTreeMap;

/// The state of a rod whose force is not tracked.
const NOT_MONITORING: &str = "not-monitoring";

/// The fields other programs rely on; all are always present.
#[derive(Serialize)]
struct Line<'a> {
    rod: &'a RodId,
    start: Option<Timestamp>,
    duration_s: Option<f64>,
    fs_hz: Option<f64>,
    excitation: Option<&'a Motion>,
    modes: Vec<LineMode>,
    label_probability: Option<f64>,
    candidates: Vec<Candidate>,
    /// Of a refused record, the peaks it has; of others they are in the picture.
    peaks: Option<Vec<Peak>>,
    axial_force_n: Option<Marginal>,
    parameters: BTreeMap<&'static str, Parameter>,
    epsilon: Option<f64>,
    draws: Option<usize>,
    accepted: Option<usize>,
    ess: Option<f64>,
    conflict: Option<f64>,
    prior_tail: Option<f64>,
    adjustment: Option<String>,
    hangs_on: Option<&'a VarianceShares>,
    tested: Option<&'a Tested>,
    tracked_force_n: Option<Interval>,
    relative_force: Option<Interval>,
    not_axial_p: Option<f64>,
    temperature_c: Option<f64>,
    reference_temperature_c: Option<f64>,
    force_at_reference_n: Option<Interval>,
    relative_force_at_reference: Option<Interval>,
    state: &'static str,
    state_reason: Option<&'a str>,
    segment: Option<u32>,
    set_aside: Option<SetAside>,
    alarms: Vec<Standing<'a>>,
    events: Vec<Told<'a>>,
    flags: &'a [Flag],
    rejection: Option<Reason<'a>>,
    seed: Option<u64>,
    config: &'a str,
    analysis_version: u32,
}

/// A mode, and how well its peak is one.
#[derive(Serialize)]
struct LineMode {
    #[serde(flatten)]
    mode: Mode,
    /// Standard normal score of the fit of its peak; `None` for a frequency measured elsewhere.
    misfit: Option<f64>,
}

#[derive(Serialize)]
struct Parameter {
    mean: f64,
    cv: f64,
}

/// What was done to the accepted draws: `linear`, `none`, or `withheld` with the reason.
fn adjustment(posterior: &Posterior) -> String {
    match (posterior.adjustment, posterior.withheld) {
        (Adjustment::Linear, _) => "linear".to_owned(),
        (Adjustment::None, None) => "none".to_owned(),
        (Adjustment::None, Some(reason)) => format!("withheld: {reason}"),
    }
}

#[derive(Serialize)]
struct Reason<'a> {
    code: &'static str,
    message: String,
    #[serde(flatten)]
    detail: &'a Rejection,
}

/// An alarm that stands.
#[derive(Serialize)]
struct Standing<'a> {
    id: &'a str,
    kind: Kind,
    raised: Timestamp,
    acknowledged: Option<Timestamp>,
    cleared: Option<Timestamp>,
    message: &'a str,
    change: Option<&'a Change>,
    witness: Option<Witness>,
    alternatives: Option<&'a Explained>,
}

/// What happened to an alarm with this record.
#[derive(Serialize)]
struct Told<'a> {
    what: What,
    time: Timestamp,
    id: &'a str,
    kind: Kind,
}

/// The modes, each with the misfit of its peak.
fn modes(identification: &Identification) -> Vec<LineMode> {
    let resonances = identification
        .measurement
        .as_ref()
        .map_or(&[][..], |measurement| &measurement.resonances);
    identification
        .modes
        .iter()
        .map(|&mode| LineMode {
            mode,
            misfit: findings::nearest(resonances, mode.frequency_hz).map(|i| resonances[i].misfit),
        })
        .collect()
}

/// The uncertain quantities besides the axial force.
fn parameters(posterior: &Posterior) -> BTreeMap<&'static str, Parameter> {
    let quantities = posterior.parameterisation.quantities().iter();
    quantities
        .filter(|&&quantity| quantity != Quantity::AxialForce)
        .filter_map(|&quantity| {
            // A fixed quantity's spread is the rounding of its mean.
            let marginal = posterior
                .marginal(quantity)
                .filter(|marginal| marginal.cv > 1e-9)?;
            Some((
                quantity.key(),
                Parameter {
                    mean: marginal.mean,
                    cv: marginal.cv,
                },
            ))
        })
        .collect()
}

/// One JSON object without a line end (design 5.1): SI, the unit as a suffix, every field present. Without a
/// `verdict` the force is not tracked.
pub fn json(outcome: &Outcome, verdict: Option<&Verdict>, config_hash: &str) -> String {
    let mut line = Line::new(outcome.rod(), config_hash);
    match outcome {
        Outcome::Identified(identification) => line.identified(identification),
        Outcome::Tabulated(row) => line.tabulated(row),
        Outcome::Rejected(rejected) => line.rejected(rejected),
    }
    if let Some(verdict) = verdict {
        line.tracked(verdict);
    }
    // A struct of numbers, strings and maps with string keys always serialises.
    serde_json::to_string(&line).unwrap_or_else(|error| format!("{{\"error\":\"{error}\"}}"))
}

impl<'a> Line<'a> {
    /// A line about which nothing is known.
    fn new(rod: &'a RodId, config: &'a str) -> Self {
        Self {
            rod,
            start: None,
            duration_s: None,
            fs_hz: None,
            excitation: None,
            modes: Vec::new(),
            label_probability: None,
            candidates: Vec::new(),
            peaks: None,
            axial_force_n: None,
            parameters: BTreeMap::new(),
            epsilon: None,
            draws: None,
            accepted: None,
            ess: None,
            conflict: None,
            prior_tail: None,
            adjustment: None,
            hangs_on: None,
            tested: None,
            tracked_force_n: None,
            relative_force: None,
            not_axial_p: None,
            temperature_c: None,
            reference_temperature_c: None,
            force_at_reference_n: None,
            relative_force_at_reference: None,
            state: NOT_MONITORING,
            state_reason: None,
            segment: None,
            set_aside: None,
            alarms: Vec::new(),
            events: Vec::new(),
            flags: &[],
            rejection: None,
            seed: None,
            config,
            analysis_version: VERSION,
        }
    }

    fn identified(&mut self, identification: &'a Identification) {
        let posterior = &identification.posterior;
        if let Some(measurement) = &identification.measurement {
            self.start = Some(measurement.start);
            self.duration_s = Some(measurement.duration_s);
            self.fs_hz = Some(measurement.fs_hz);
            self.temperature_c = measurement.temperature_c;
            self.flags = &measurement.flags;
            self.excitation = Some(&measurement.motion);
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
        self.hangs_on = identification.hangs_on.as_ref();
        self.tested = identification.tested.as_ref();
        self.seed = Some(posterior.seed);
    }

    fn tabulated(&mut self, row: &'a Tabulated) {
        self.start = Some(row.start);
        self.duration_s = Some(row.duration_s).filter(|duration_s| *duration_s > 0.0);
        self.temperature_c = row.temperature_c;
        let unjudged = |&mode| LineMode { mode, misfit: None };
        self.modes = row.modes.iter().map(unjudged).collect();
        self.conflict = Some(row.conflict.score);
        self.prior_tail = Some(row.conflict.prior_tail);
    }

    fn rejected(&mut self, rejected: &'a Rejected) {
        self.start = rejected.start;
        self.duration_s = rejected.duration_s;
        self.fs_hz = rejected.fs_hz;
        self.rejection = Some(Reason {
            code: rejected.rejection.code(),
            message: rejected.rejection.to_string(),
            detail: &rejected.rejection,
        });
        self.candidates = rejected.labels.as_ref().map(Candidate::all).unwrap_or_default();
        if let Some(measurement) = &rejected.measurement {
            self.temperature_c = measurement.temperature_c;
            self.flags = &measurement.flags;
            self.excitation = Some(&measurement.motion);
            self.peaks = Some(findings::peaks(measurement, &[]));
        }
    }

    fn tracked(&mut self, verdict: &'a Verdict) {
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
        self.state = verdict.state.code();
        self.state_reason = match &verdict.state {
            RodState::NotMonitoring { reason } => Some(reason),
            _ => None,
        };
        self.segment = Some(verdict.segment);
        self.set_aside = verdict.set_aside;
        self.alarms = verdict
            .alarms
            .iter()
            .map(|alarm| Standing {
                id: &alarm.id,
                kind: alarm.kind,
                raised: alarm.raised,
                acknowledged: alarm.acknowledged,
                cleared: alarm.cleared,
                message: &alarm.message,
                change: alarm.change.as_ref(),
                witness: alarm.witness,
                alternatives: alarm.alternatives.as_ref(),
            })
            .collect();
        self.events = verdict
            .events
            .iter()
            .map(|event| Told {
                what: event.what,
                time: event.time,
                id: &event.alarm.id,
                kind: event.alarm.kind,
            })
            .collect();
    }
}
