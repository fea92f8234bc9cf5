//! A record as one row of a table for people, and the alarms it raised under it.

use super::findings::probability;
use super::listing::{WIDTH, hanging};
use crate::analysis::findings::{CERTAIN, CONFLICT_SHOWN, PRIOR_TAIL_SHOWN, is_wide, motion_mark};
use crate::analysis::identify::Identification;
use crate::analysis::inference::Conflict;
use crate::analysis::outcome::{Outcome, Tabulated};
use crate::analysis::rod::beam::Quantity;
use crate::analysis::signal::modes::{Mode, MotionKind};
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::{Alarm, RodState, Verdict, What};
use std::fmt::Write;

/// Digits and columns of one frequency: `17.309`.
const MODE_WIDTH: usize = 6;

/// Columns of a force, `1234±123`, of a change, `-3.67±0.19`, and of a state, `learning`.
const FORCE_WIDTH: usize = 8;
const CHANGE_WIDTH: usize = 10;
const STATE_WIDTH: usize = 8;

/// Table of records within [`WIDTH`] columns: a line per record with as many modes as fit (three beside a rod's name of six
/// letters), and what finds no room below it.
pub struct Table {
    /// Number of modes in columns.
    modes: usize,
    rod_width: usize,
    /// Value of `--store`, to be repeated in commands.
    store: Option<String>,
    is_coloured: bool,
}

impl Table {
    /// A table for rods with these names, with columns for at most the first `modes` mode orders. `store`: the store
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
        let others =
            rod_width + "  2026-03-01 06:00".len() + FORCE_WIDTH + CHANGE_WIDTH + STATE_WIDTH + 3 * 2;
        Self {
            modes: modes.min(WIDTH.saturating_sub(others) / (MODE_WIDTH + 2)),
            rod_width,
            store,
            is_coloured,
        }
    }

    /// Header lines of the table: names, units, a rule.
    pub fn header(&self) -> String {
        let row = |rod: &str, start: &str, modes: &[String], force: &str, change: &str, state: &str| {
            let mut line = format!("{rod:<width$}  {start:<16}", width = self.rod_width);
            for mode in modes {
                let _ = write!(line, "  {mode:>MODE_WIDTH$}");
            }
            line + &format!("  {force:>FORCE_WIDTH$}  {change:>CHANGE_WIDTH$}  {state:<STATE_WIDTH$}")
        };
        let modes: Vec<String> = (1..=self.modes).map(|order| format!("mode {order}")).collect();
        let names = row("rod", "start", &modes, "force", "change", "state");
        let units = row("", "UTC", &vec!["Hz".to_owned(); self.modes], "kN", "%", "");
        let rule = "-".repeat(names.chars().count());
        format!("{}\n{}\n{rule}", names.trim_end(), units.trim_end())
    }

    /// One record, followed by lines for each alarm that was raised or cleared with it.
    pub fn row(&self, outcome: &Outcome, verdict: &Verdict) -> String {
        let mut row = self.record(outcome, verdict);
        if verdict.state == RodState::Alarm {
            row = self.coloured("31", &row);
        }
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

    /// Lines in a colour, where there are colours.
    fn coloured(&self, colour: &str, lines: &str) -> String {
        if !self.is_coloured {
            return lines.to_owned();
        }
        let lines: Vec<String> = lines
            .lines()
            .map(|line| format!("\x1b[{colour}m{line}\x1b[0m"))
            .collect();
        lines.join("\n")
    }

    /// An alarm with advice; a command stands on a line of its own, to be copied.
    fn raised(&self, alarm: &Alarm) -> String {
        let what = format!(">>> ALARM {} of {}: {}", alarm.kind, alarm.rod, alarm.message);
        let next = match &self.store {
            _ if !alarm.kind.is_latched() => "goes by itself when its cause is over".to_owned(),
            Some(store) => format!(
                "stands until somebody has looked:\n    tirante ack {} --store {store}",
                alarm.id
            ),
            None => format!("alarm {}; without --store nothing remembers it", alarm.id),
        };
        let what = hanging(&what, 0, 4).join("\n");
        format!("{}\n    {next}", self.coloured("1;31", &what))
    }

    fn record(&self, outcome: &Outcome, verdict: &Verdict) -> String {
        match outcome {
            Outcome::Identified(identification) => self.identified(identification, verdict),
            Outcome::Tabulated(row) => self.tabulated(row, verdict),
            Outcome::Rejected(rejected) => {
                let line = self.opening(&rejected.rod, rejected.start);
                let rejection = &rejected.rejection;
                let words = format!("rejected ({}): {rejection}", rejection.code());
                let wrapped = hanging(&words, line.chars().count() + 2, 4).join("\n");
                format!("{line}  {}", wrapped.trim_start())
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
        let opening = self.opening(&row.rod, Some(row.start));
        self.measured(
            opening,
            &row.modes,
            force,
            verdict,
            doubt(&row.conflict).into_iter().collect(),
        )
    }

    /// Modes, force (mean and standard deviation \[N\]), change and state behind the opening of a line, then marks.
    fn measured(
        &self,
        mut line: String,
        modes: &[Mode],
        force_n: Option<(f64, f64)>,
        verdict: &Verdict,
        marks: Vec<String>,
    ) -> String {
        for order in 1..=self.modes {
            let mode = modes.iter().find(|mode| mode.order == order);
            let cell = mode.map_or_else(|| "-".to_owned(), |mode| frequency(mode.frequency_hz));
            let _ = write!(line, "  {cell:>MODE_WIDTH$}");
        }
        let force = force_n.map_or_else(
            || "-".to_owned(),
            |(mean, sd)| format!("{:.0}±{:.0}", kilo(mean), kilo(sd)),
        );
        let _ = write!(
            line,
            "  {force:>FORCE_WIDTH$}  {:>CHANGE_WIDTH$}",
            change(verdict)
        );
        // Most records are those of a rod that is monitored.
        let state = match verdict.set_aside {
            None if verdict.state == RodState::Monitoring => "",
            None => verdict.state.code(),
            Some(aside) => aside.code(),
        };
        let beyond = modes.iter().filter(|mode| mode.order > self.modes);
        let beyond = beyond.map(|mode| format!("mode {} {} Hz", mode.order, frequency(mode.frequency_hz)));
        let tail: Vec<String> = [state.to_owned()]
            .into_iter()
            .chain(marks)
            .chain(beyond)
            .filter(|words| !words.is_empty())
            .collect();
        let behind = format!("{line}  {}", tail.join("  "));
        if behind.trim_end().chars().count() <= WIDTH {
            return behind.trim_end().to_owned();
        }
        format!("{line}\n{}", hanging(&tail.join(", "), 4, 4).join("\n"))
    }

    fn identified(&self, identification: &Identification, verdict: &Verdict) -> String {
        let measurement = identification.measurement.as_ref();
        let opening = self.opening(&identification.rod, measurement.map(|m| m.start));
        let force = identification.posterior.marginal(Quantity::AxialForce);
        let mut marks = Vec::new();
        // Ambient vibration is the rule.
        let motion = measurement
            .map(|m| &m.motion)
            .filter(|m| m.kind != MotionKind::Ambient);
        marks.extend(motion.map(|motion| motion_mark(motion).to_owned()));
        let uncertain = identification.labels.as_ref().map(|labels| labels.probability);
        let uncertain = uncertain.filter(|probability| *probability < CERTAIN);
        marks.extend(uncertain.map(|p| format!("? orders {}", probability(p))));
        marks.extend(doubt(&identification.conflict));
        if force.is_some_and(|force| is_wide(force.interval())) {
            marks.push("? wide interval".to_owned());
        }
        marks.extend(
            measurement
                .iter()
                .flat_map(|m| &m.flags)
                .map(|flag| format!("[{flag}]")),
        );
        let force = force.map(|force| (force.mean, force.sd));
        self.measured(opening, &identification.modes, force, verdict, marks)
    }
}

/// A frequency \[Hz\] with five digits, at most as wide as its column from 0.001 Hz to 99 999 Hz.
fn frequency(hz: f64) -> String {
    let before = if hz < 10.0 {
        1
    } else {
        hz.log10().floor() as usize + 1
    };
    let after = 5_usize.saturating_sub(before);
    format!("{hz:.after$}")
}

/// A mark on frequencies that disagree with the model or the prior.
fn doubt(conflict: &Conflict) -> Option<String> {
    if conflict.score >= CONFLICT_SHOWN {
        Some(format!("! conflict {:.1}", conflict.score))
    } else if conflict.prior_tail <= PRIOR_TAIL_SHOWN {
        Some("! hardly in the prior".to_owned())
    } else {
        None
    }
}

/// Change since the baseline at the reference temperature, or, marked by a tilde, at the measured one.
fn change(verdict: &Verdict) -> String {
    let narrow = |ratio: f64, sd: f64| format!("{}±{:.2}", signed_percent(ratio), sd * 100.0);
    match (&verdict.at_reference, &verdict.relative) {
        (Some(at_reference), _) => narrow(at_reference.ratio.mean, at_reference.ratio.sd),
        (None, Some(relative)) => format!("~{}", narrow(relative.ratio.mean, relative.ratio.sd)),
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
