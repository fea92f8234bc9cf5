//! A record as one line: JSON for programs, a table for people.

use crate::analysis::{Identification, VERSION};
use crate::bayes::{Marginal, Posterior};
use crate::beam::Quantity;
use crate::modes::Mode;
use crate::record::{Flag, Rejection, RodId, Timestamp};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write;

/// From this many standard deviations on, people are told that model and data disagree.
pub const CONFLICT_SHOWN: f64 = 3.0;

/// Up to this share of the prior's own records as far out, people are told that the prior is doubtful.
pub const PRIOR_TAIL_SHOWN: f64 = 0.01;

/// The state of a rod whose force is not tracked.
const NOT_MONITORING: &str = "not-monitoring";

/// One record that was read: what came of it.
#[derive(Debug)]
pub enum Outcome {
    /// It gave a force.
    Identified(Box<Identification>),
    /// It gave none, for a stated reason.
    Rejected {
        /// The rod.
        rod: RodId,
        /// Time of the first sample, if it is known.
        start: Option<Timestamp>,
        /// Length \[s\].
        duration_s: Option<f64>,
        /// Sample rate \[Hz\], if it is known.
        fs_hz: Option<f64>,
        /// The reason.
        rejection: Rejection,
    },
}

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
    relative_force: Option<()>,
    not_axial_p: Option<f64>,
    temperature_c: Option<f64>,
    state: &'static str,
    alarms: [(); 0],
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

/// One JSON object without a line end (design 5.1): SI, the unit as a suffix, every field present.
pub fn json(outcome: &Outcome, config_hash: &str) -> String {
    let line = match outcome {
        Outcome::Identified(identification) => {
            let posterior = &identification.posterior;
            let measurement = identification.measurement.as_ref();
            Line {
                rod: &identification.rod,
                start: measurement.map(|m| m.start),
                duration_s: measurement.map(|m| m.duration_s),
                fs_hz: measurement.map(|m| m.fs_hz),
                modes: &identification.modes,
                axial_force_n: posterior.marginal(Quantity::AxialForce),
                parameters: parameters(posterior),
                epsilon: Some(posterior.epsilon),
                draws: Some(posterior.draws),
                accepted: Some(posterior.accepted),
                ess: Some(posterior.ess),
                conflict: Some(identification.conflict.score),
                prior_tail: Some(identification.conflict.prior_tail),
                relative_force: None,
                not_axial_p: None,
                temperature_c: measurement.and_then(|m| m.temperature_c),
                state: NOT_MONITORING,
                alarms: [],
                flags: measurement.map_or(&[], |m| &m.flags),
                rejection: None,
                seed: Some(posterior.seed),
                config: config_hash,
                analysis_version: VERSION,
            }
        }
        Outcome::Rejected {
            rod,
            start,
            duration_s,
            fs_hz,
            rejection,
        } => Line {
            rod,
            start: *start,
            duration_s: *duration_s,
            fs_hz: *fs_hz,
            modes: &[],
            axial_force_n: None,
            parameters: BTreeMap::new(),
            epsilon: None,
            draws: None,
            accepted: None,
            ess: None,
            conflict: None,
            prior_tail: None,
            relative_force: None,
            not_axial_p: None,
            temperature_c: None,
            state: NOT_MONITORING,
            alarms: [],
            flags: &[],
            rejection: Some(Reason {
                code: rejection.code(),
                message: rejection.to_string(),
                detail: rejection,
            }),
            seed: None,
            config: config_hash,
            analysis_version: VERSION,
        },
    };
    // A struct of numbers, strings and maps with string keys always serialises.
    serde_json::to_string(&line).unwrap_or_else(|error| format!("{{\"error\":\"{error}\"}}"))
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

    /// One record.
    pub fn row(&self, outcome: &Outcome) -> String {
        match outcome {
            Outcome::Identified(identification) => self.identified(identification),
            Outcome::Rejected {
                rod,
                start,
                duration_s,
                rejection,
                ..
            } => {
                let mut line = self.opening(rod, *start, *duration_s);
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

    fn identified(&self, identification: &Identification) -> String {
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
            "  {force:>17}  {interval:>13}  {:>8}",
            format!("{score:.1}{mark}")
        );
        for flag in measurement.map_or(&[][..], |m| &m.flags) {
            let _ = write!(line, "  [{flag}]");
        }
        line
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
