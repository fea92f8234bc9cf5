//! A record as one line: JSON for programs, a table for people.

use crate::analysis::{Identification, VERSION};
use crate::bayes::{Marginal, Posterior};
use crate::beam::Quantity;
use crate::modes::Mode;
use crate::outcome::Outcome;
use crate::record::{Flag, Rejection, RodId, Timestamp};
use crate::track::change::Change;
use crate::track::{Interval, Kind, RodState, SetAside, Verdict, What};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write;

/// From this many standard deviations on, people are told that model and data disagree.
pub const CONFLICT_SHOWN: f64 = 3.0;

/// Up to this share of the prior's own records as far out, people are told that the prior is doubtful.
pub const PRIOR_TAIL_SHOWN: f64 = 0.01;

/// The state of a rod whose force is not tracked.
const NOT_MONITORING: &str = "not-monitoring";

/// The fields other programs rely on; all are always present.
#[derive(Serialize)]
struct Line<'a> {
    rod: &'a RodId,
    start: Option<Timestamp>,
    duration_s: Option<f64>,
    fs_hz: Option<f64>,
    modes: &'a [Mode],
    axial_force_n: Option<Marginal>,
    parameters: BTreeMap<&'static str, Parameter>,
    epsilon: Option<f64>,
    draws: Option<usize>,
    accepted: Option<usize>,
    ess: Option<f64>,
    conflict: Option<f64>,
    prior_tail: Option<f64>,
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

#[derive(Serialize)]
struct Parameter {
    mean: f64,
    cv: f64,
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
}

/// What happened to an alarm with this record.
#[derive(Serialize)]
struct Told<'a> {
    what: What,
    time: Timestamp,
    id: &'a str,
    kind: Kind,
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
        Outcome::Rejected(rejected) => {
            line.start = rejected.start;
            line.duration_s = rejected.duration_s;
            line.fs_hz = rejected.fs_hz;
            line.rejection = Some(Reason {
                code: rejected.rejection.code(),
                message: rejected.rejection.to_string(),
                detail: &rejected.rejection,
            });
        }
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
            modes: &[],
            axial_force_n: None,
            parameters: BTreeMap::new(),
            epsilon: None,
            draws: None,
            accepted: None,
            ess: None,
            conflict: None,
            prior_tail: None,
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
        }
        self.modes = &identification.modes;
        self.axial_force_n = posterior.marginal(Quantity::AxialForce);
        self.parameters = parameters(posterior);
        self.epsilon = Some(posterior.epsilon);
        self.draws = Some(posterior.draws);
        self.accepted = Some(posterior.accepted);
        self.ess = Some(posterior.ess);
        self.conflict = Some(identification.conflict.score);
        self.prior_tail = Some(identification.conflict.prior_tail);
        self.seed = Some(posterior.seed);
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

/// The table for people: one line per record, columns for a fixed number of modes.
pub struct Table {
    modes: usize,
    rod_width: usize,
}

impl Table {
    /// A table for rods with these names, with columns for the first `modes` mode orders.
    pub fn new<'a>(rods: impl Iterator<Item = &'a RodId>, modes: usize) -> Self {
        let rod_width = rods
            .map(|rod| rod.0.chars().count())
            .max()
            .unwrap_or(0)
            .max("rod".len());
        Self { modes, rod_width }
    }

    /// The two header lines.
    pub fn header(&self) -> String {
        let mut line = format!(
            "{:<width$}  {:<20}  {:>6}",
            "rod",
            "start (UTC)",
            "length",
            width = self.rod_width
        );
        for order in 1..=self.modes {
            let _ = write!(line, "  {:>18}", format!("mode {order} [Hz]"));
        }
        let _ = write!(
            line,
            "  {:>17}  {:>13}  {:>8}",
            "axial force [kN]", "95 % interval", "conflict"
        );
        let rule = "-".repeat(line.chars().count());
        format!("{line}\n{rule}")
    }

    /// One record, followed by a line for each alarm that was raised or cleared with it.
    pub fn row(&self, outcome: &Outcome, verdict: &Verdict) -> String {
        let mut row = self.record(outcome, verdict);
        for event in &verdict.events {
            let alarm = &event.alarm;
            let _ = match event.what {
                What::Raised => write!(
                    row,
                    "\n  ALARM {} {}: {}: {}",
                    alarm.id, alarm.rod, alarm.kind, alarm.message
                ),
                What::Cleared => write!(row, "\n  cleared {} {}: {}", alarm.id, alarm.rod, alarm.kind),
                What::Repeated | What::Acknowledged => Ok(()),
            };
        }
        row
    }

    fn record(&self, outcome: &Outcome, verdict: &Verdict) -> String {
        match outcome {
            Outcome::Identified(identification) => self.identified(identification, verdict),
            Outcome::Rejected(rejected) => {
                let mut line = self.opening(&rejected.rod, rejected.start, rejected.duration_s);
                let rejection = &rejected.rejection;
                let _ = write!(line, "  rejected ({}): {rejection}", rejection.code());
                line
            }
        }
    }

    fn opening(&self, rod: &RodId, start: Option<Timestamp>, duration_s: Option<f64>) -> String {
        let start = start.map_or_else(|| "-".to_owned(), to_seconds);
        let duration = duration_s.map_or_else(|| "-".to_owned(), |s| format!("{s:.0} s"));
        format!(
            "{:<width$}  {start:<20}  {duration:>6}",
            rod.0,
            width = self.rod_width
        )
    }

    fn identified(&self, identification: &Identification, verdict: &Verdict) -> String {
        let measurement = identification.measurement.as_ref();
        let mut line = self.opening(
            &identification.rod,
            measurement.map(|m| m.start),
            measurement.map(|m| m.duration_s),
        );
        for order in 1..=self.modes {
            let mode = identification.modes.iter().find(|mode| mode.order == order);
            let cell = mode.map_or_else(
                || "-".to_owned(),
                |mode| format!("{:.4} ± {:.4}", mode.frequency_hz, mode.sd_hz),
            );
            let _ = write!(line, "  {cell:>18}");
        }
        let (force, interval) = match identification.posterior.marginal(Quantity::AxialForce) {
            Some(force) => (
                format!(
                    "{:.0} ± {:.0} ({:.0} %)",
                    kilo(force.mean),
                    kilo(force.sd),
                    force.cv * 100.0
                ),
                format!("{:.0} to {:.0}", kilo(force.q025), kilo(force.q975)),
            ),
            None => ("-".to_owned(), "-".to_owned()),
        };
        let score = identification.conflict.score;
        let mark = match () {
            () if score >= CONFLICT_SHOWN => " !",
            () if identification.conflict.prior_tail <= PRIOR_TAIL_SHOWN => " ?",
            () => "",
        };
        let _ = write!(
            line,
            "  {force:>17}  {interval:>13}  {:>8}  {:>17}  {:<14}",
            format!("{score:.1}{mark}"),
            relative(verdict),
            verdict.set_aside.map_or(verdict.state.code(), SetAside::code),
        );
        for flag in measurement.map_or(&[][..], |m| &m.flags) {
            let _ = write!(line, "  [{flag}]");
        }
        line
    }
}

/// N_t / N_0 at the reference temperature, or, marked by a tilde, at the measured one.
fn relative(verdict: &Verdict) -> String {
    let show = |ratio: &Interval| format!("{:.4} ± {:.4}", ratio.mean, ratio.sd);
    match (&verdict.at_reference, &verdict.relative) {
        (Some(at_reference), _) => show(&at_reference.ratio),
        (None, Some(relative)) => format!("~{}", show(&relative.ratio)),
        (None, None) => "-".to_owned(),
    }
}

fn kilo(value: f64) -> f64 {
    value * 1e-3
}

/// `2026-03-01 06:00:00`: UTC, fractions of a second cut off.
fn to_seconds(time: Timestamp) -> String {
    let text = time.to_string();
    text.trim_end_matches('Z')
        .split('.')
        .next()
        .unwrap_or(&text)
        .replace('T', " ")
}
