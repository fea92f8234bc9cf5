//! A record as one row of a table for people.

use crate::analysis::Identification;
use crate::beam::Quantity;
use crate::outcome::Outcome;
use crate::record::{RodId, Timestamp};
use crate::track::{Interval, SetAside, Verdict, What};
use std::fmt::Write;

/// From this many standard deviations on, people are told that model and data disagree.
pub const CONFLICT_SHOWN: f64 = 3.0;

/// Up to this share of the prior's own records as far out, people are told that the prior is doubtful.
pub const PRIOR_TAIL_SHOWN: f64 = 0.01;

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
