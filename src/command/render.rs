//! A record as one row of a table for people, and the alarms it raised under it.

use super::findings::probability;
use crate::analysis::findings::{CERTAIN, CONFLICT_SHOWN, PRIOR_TAIL_SHOWN, motion_mark};
use crate::analysis::identify::Identification;
use crate::analysis::inference::Conflict;
use crate::analysis::outcome::{Outcome, Tabulated};
use crate::analysis::rod::beam::Quantity;
use crate::analysis::signal::modes::{Mode, MotionKind};
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::{Alarm, SetAside, Verdict, What};
use std::fmt::Write;

/// Columns of one mode: `17.3085 ± 0.0065`.
const MODE_WIDTH: usize = 16;

/// Table of records: one line per record, columns for a fixed number of modes; three modes and a rod's name
/// of nine letters fit into 120 columns.
pub struct Table {
    modes: usize,
    rod_width: usize,
    /// Value of `--store`, to be repeated in commands.
    store: Option<String>,
    is_coloured: bool,
}

impl Table {
    /// A table for rods with these names, with columns for the first `modes` mode orders. `store`: the store
    /// in which alarms can be acknowledged. `is_coloured`: with escape sequences for a terminal.
    pub fn new<'a>(
        rods: impl Iterator<Item = &'a RodId>,
        modes: usize,
        store: Option<String>,
        is_coloured: bool,
    ) -> Self {
        let rod_width = rods
            .map(|rod| rod.0.chars().count())
            .max()
            .unwrap_or(0)
            .max("rod".len());
        Self {
            modes,
            rod_width,
            store,
            is_coloured,
        }
    }

    /// Two header lines of the table.
    pub fn header(&self) -> String {
        let mut line = format!("{:<width$}  {:<16}", "rod", "start (UTC)", width = self.rod_width);
        for order in 1..=self.modes {
            let _ = write!(line, "  {:>MODE_WIDTH$}", format!("mode {order} [Hz]"));
        }
        let _ = write!(line, "  {:>10}  {:>14}  state", "force [kN]", "change [%]");
        let rule = "-".repeat(line.chars().count() + "monitoring".len() - "state".len());
        format!("{line}\n{rule}")
    }

    /// One record, followed by lines for each alarm that was raised or cleared with it.
    pub fn row(&self, outcome: &Outcome, verdict: &Verdict) -> String {
        let mut row = self.record(outcome, verdict);
        for event in &verdict.events {
            match event.what {
                What::Raised => {
                    row.push('\n');
                    row += &self.raised(&event.alarm);
                }
                What::Cleared => {
                    let alarm = &event.alarm;
                    let _ = write!(
                        row,
                        "\n    over: {} of {}, alarm {}",
                        alarm.kind, alarm.rod, alarm.id
                    );
                }
                What::Repeated | What::Acknowledged => {}
            }
        }
        row
    }

    /// An alarm with advice.
    fn raised(&self, alarm: &Alarm) -> String {
        let what = format!("ALARM {} of {}: {}", alarm.kind, alarm.rod, alarm.message);
        let (bold, plain) = if self.is_coloured {
            ("\x1b[1;31m", "\x1b[0m")
        } else {
            ("", "")
        };
        let next = match &self.store {
            _ if !alarm.kind.is_latched() => "goes by itself when its cause is over".to_owned(),
            Some(store) => format!(
                "stands until somebody has looked: tirante ack {} --store {store}",
                alarm.id
            ),
            None => format!("alarm {}; without --store nothing remembers it", alarm.id),
        };
        format!("{bold}>>> {what}{plain}\n    {next}")
    }

    fn record(&self, outcome: &Outcome, verdict: &Verdict) -> String {
        match outcome {
            Outcome::Identified(identification) => self.identified(identification, verdict),
            Outcome::Tabulated(row) => self.tabulated(row, verdict),
            Outcome::Rejected(rejected) => {
                let mut line = self.opening(&rejected.rod, rejected.start);
                let rejection = &rejected.rejection;
                let _ = write!(line, "  rejected ({}): {rejection}", rejection.code());
                line
            }
        }
    }

    fn opening(&self, rod: &RodId, start: Option<Timestamp>) -> String {
        let start = start.map_or_else(|| "-".to_owned(), to_minutes);
        format!("{:<width$}  {start:<16}", rod.0, width = self.rod_width)
    }

    /// A row of a table of frequencies; its force is the tracked one.
    fn tabulated(&self, row: &Tabulated, verdict: &Verdict) -> String {
        let force = verdict.relative.as_ref().map(|relative| relative.force_n);
        let force = force.map(|force| (force.mean, force.sd));
        let mut line = self.opening(&row.rod, Some(row.start));
        line += &self.measured(&row.modes, force, verdict);
        line + &doubt(&row.conflict)
    }

    /// Modes, force (mean and standard deviation \[N\]), change and state.
    fn measured(&self, modes: &[Mode], force_n: Option<(f64, f64)>, verdict: &Verdict) -> String {
        let mut line = String::new();
        for order in 1..=self.modes {
            let mode = modes.iter().find(|mode| mode.order == order);
            let cell = mode.map_or_else(
                || "-".to_owned(),
                |mode| format!("{:.4} ± {:.4}", mode.frequency_hz, mode.sd_hz),
            );
            let _ = write!(line, "  {cell:>MODE_WIDTH$}");
        }
        let force = force_n.map_or_else(
            || "-".to_owned(),
            |(mean, sd)| format!("{:.0} ± {:.0}", kilo(mean), kilo(sd)),
        );
        let _ = write!(
            line,
            "  {force:>10}  {:>14}  {}",
            change(verdict),
            verdict.set_aside.map_or(verdict.state.code(), SetAside::code),
        );
        line
    }

    fn identified(&self, identification: &Identification, verdict: &Verdict) -> String {
        let measurement = identification.measurement.as_ref();
        let mut line = self.opening(&identification.rod, measurement.map(|m| m.start));
        let force = identification.posterior.marginal(Quantity::AxialForce);
        let force = force.map(|force| (force.mean, force.sd));
        line += &self.measured(&identification.modes, force, verdict);
        // Ambient vibration is the rule.
        let motion = measurement
            .map(|m| &m.motion)
            .filter(|m| m.kind != MotionKind::Ambient);
        if let Some(motion) = motion {
            let _ = write!(line, "  {}", motion_mark(motion));
        }
        let uncertain = identification.labels.as_ref().map(|labels| labels.probability);
        if let Some(p) = uncertain.filter(|probability| *probability < CERTAIN) {
            let _ = write!(line, "  ? orders {}", probability(p));
        }
        line += &doubt(&identification.conflict);
        for flag in measurement.map_or(&[][..], |m| &m.flags) {
            let _ = write!(line, "  [{flag}]");
        }
        line
    }
}

/// A mark on frequencies that disagree with the model or the prior.
fn doubt(conflict: &Conflict) -> String {
    if conflict.score >= CONFLICT_SHOWN {
        format!("  ! conflict {:.1}", conflict.score)
    } else if conflict.prior_tail <= PRIOR_TAIL_SHOWN {
        "  ? hardly in the prior".to_owned()
    } else {
        String::new()
    }
}

/// Change since the baseline at the reference temperature, or, marked by a tilde, at the measured one.
fn change(verdict: &Verdict) -> String {
    match (&verdict.at_reference, &verdict.relative) {
        (Some(at_reference), _) => percent(at_reference.ratio.mean, at_reference.ratio.sd),
        (None, Some(relative)) => format!("~{}", percent(relative.ratio.mean, relative.ratio.sd)),
        (None, None) => "-".to_owned(),
    }
}

/// N_t / N_0 as a change in percent with its standard deviation: `-3.67 ± 0.19`.
pub fn percent(ratio: f64, sd: f64) -> String {
    format!("{} ± {:.2}", signed_percent(ratio), sd * 100.0)
}

/// N_t / N_0 as a change in percent: `-3.67`, `+0.12`, and no sign on what rounds to nothing.
pub fn signed_percent(ratio: f64) -> String {
    let text = format!("{:+.2}", (ratio - 1.0) * 100.0);
    if text.ends_with("0.00") && text.len() == 5 {
        text[1..].to_owned()
    } else {
        text
    }
}

fn kilo(value: f64) -> f64 {
    value * 1e-3
}

/// `2026-03-01 06:00`: UTC, cut off at the minute.
fn to_minutes(time: Timestamp) -> String {
    let text = time.to_string();
    let minutes = text
        .rsplit_once(':')
        .map_or(text.as_str(), |(minutes, _)| minutes);
    minutes.replace('T', " ")
}
