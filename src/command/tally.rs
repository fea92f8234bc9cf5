//! Counts of a campaign: what became of its records and files, in words and as an exit code.

use super::WITH_LOSSES;
use super::campaign::Became;
use super::progress::Progress;
use super::topics::{Differences, Topics};
use crate::analysis::identify::{LeftOut, Sensors};
use crate::analysis::outcome::Outcome;
use crate::analysis::signal::record::{Rejection, RodId, Timestamp};
use crate::config::Config;
use crate::recording::read::{SourceError, Summary};
use crate::site::analyse::Analysed;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::{self, Display};
use std::process::ExitCode;

/// Reports the result of a campaign on stderr and returns the exit code.
pub fn conclude(tally: Option<Tally>) -> ExitCode {
    tally.map_or(ExitCode::SUCCESS, |tally| {
        tell!("{tally}");
        tally.exit_code()
    })
}

/// Result of a campaign.
#[derive(Debug, Default)]
pub struct Tally {
    identified: usize,
    rejected: BTreeMap<&'static str, usize>,
    repeated: usize,
    broken: usize,
    /// Events of which nothing is known but that the program broke on them.
    lost: usize,
    files: usize,
    unreadable: usize,
    with_losses: usize,
    /// Those files as they were named, and what is lost of each.
    damaged: Vec<(String, String)>,
    /// Records that a sensor was left out of, by rod and sensor.
    without: BTreeMap<(RodId, String), usize>,
    /// Sensors that each rod's latest record left out.
    out_now: BTreeMap<RodId, BTreeSet<String>>,
    topics: Topics,
    differences: Differences,
    /// Rods whose records overlap in time.
    overlapping: BTreeSet<RodId>,
}

impl Tally {
    /// Exit code: 0 good, 1 nothing could be read or the analysis failed, 3 rejected records or lost data.
    fn exit_code(&self) -> ExitCode {
        if self.broken > 0 || (self.files > 0 && self.unreadable == self.files) {
            ExitCode::FAILURE
        } else if !self.rejected.is_empty()
            || self.unreadable > 0
            || self.with_losses > 0
            || !self.without.is_empty()
            || !self.differences.misspelt.is_empty()
            || self.differences.is_all
            || !self.overlapping.is_empty()
        {
            ExitCode::from(WITH_LOSSES)
        } else {
            ExitCode::SUCCESS
        }
    }

    /// Counts an event.
    pub fn event(&mut self, analysed: &Analysed, became: &Became, bar: &Progress) {
        match (analysed, became) {
            (Analysed::Readings(..), _) => {}
            (Analysed::Record(outcome), Became::New) => self.count(outcome, bar),
            (Analysed::Record(_), Became::Late(late)) => self.count(late, bar),
            _ => self.repeated += 1,
        }
    }

    /// Counts a new record.
    fn count(&mut self, outcome: &Outcome, bar: &Progress) {
        if let Some(sensors) = outcome.sensors() {
            self.leave_out(outcome.rod(), outcome.start(), sensors, bar);
        }
        match outcome {
            Outcome::Identified(_) | Outcome::Tabulated(_) => self.identified += 1,
            Outcome::Rejected(rejected) if matches!(rejected.rejection, Rejection::Broken { .. }) => {
                self.broken += 1;
                bar.say(&format!("error: rod {}: {}", rejected.rod, rejected.rejection));
            }
            Outcome::Rejected(rejected) => {
                *self.rejected.entry(rejected.rejection.code()).or_default() += 1;
            }
        }
    }

    /// Counts the sensors that a record leaves out; one that the rod's record before had is told.
    fn leave_out(&mut self, rod: &RodId, start: Option<Timestamp>, sensors: &Sensors, bar: &Progress) {
        // What is refused of one sensor is no moment of the rod: that has a row of its own.
        if sensors.is_of_one() {
            return;
        }
        let before = self.out_now.remove(rod).unwrap_or_default();
        for LeftOut { sensor, why } in &sensors.left_out {
            *self.without.entry((rod.clone(), sensor.clone())).or_default() += 1;
            if !before.contains(sensor) {
                let from = start.map_or_else(String::new, |start| format!(", from {start} on"));
                bar.say(&format!(
                    "warning: rod {rod}{from}: sensor {sensor} left out: {why}"
                ));
            }
        }
        let out = sensors.left_out.iter().map(|out| out.sensor.clone());
        self.out_now.insert(rod.clone(), out.collect());
    }

    /// True if an event was lost: nothing is known of it.
    pub fn has_lost(&self) -> bool {
        self.lost > 0
    }

    /// Files that could not be read or lost data, as they were named, and what is lost of each.
    pub fn damaged(&self) -> &[(String, String)] {
        &self.damaged
    }

    /// Losses in words that begin with a comma; empty without any.
    pub fn losses(&self) -> String {
        let mut text = String::new();
        for (count, what) in [
            (self.unreadable, "files that could not be read"),
            (self.with_losses, "files with lost data"),
            (
                self.differences.misspelt.len(),
                "topics that are most likely misspelt",
            ),
            (self.overlapping.len(), "rods whose records overlap in time"),
            (self.broken, "records that broke the analysis"),
        ] {
            if count > 0 {
                text += &format!(", {count} {what}");
            }
        }
        text
    }

    /// Counts a file and reports its faults; without `is_meant` the rod searched for was the built-in one.
    pub fn file(&mut self, result: &Result<Summary, SourceError>, is_meant: bool, bar: &Progress) {
        self.files += 1;
        let summary = match result {
            Ok(summary) => summary,
            Err(error) => {
                self.unreadable += 1;
                self.damaged.push((named(error), error.to_string()));
                return bar.say(&format!("error: {error}"));
            }
        };
        self.topics.take(summary);
        for note in &summary.notes {
            bar.say(note);
        }
        for fault in summary.faults() {
            bar.say(&format!("warning: {fault}"));
        }
        if summary.has_nothing() {
            self.unreadable += 1;
            let sentences = summary.sentences().join("; ");
            self.damaged.push((summary.file.clone(), sentences));
            if let Some(absence) = summary.absence() {
                bar.say(&format!("error: {absence}"));
            }
            if !is_meant {
                bar.say(
                    "no --config was given, so the built-in rod of the paper was looked for: `tirante measure FILE` asks for yours, \
                     `tirante init FILE` writes its configuration",
                );
            }
        } else {
            if summary.lost_data() {
                self.with_losses += 1;
                self.damaged
                    .push((summary.file.clone(), summary.faults().join("; ")));
            }
            if let Some(absence) = summary.absence() {
                tracing::info!("{absence}");
            }
        }
    }

    /// Counts an event of which nothing is known but that the program broke on it.
    pub fn lose(&mut self, panic: &str, bar: &Progress) {
        self.broken += 1;
        self.lost += 1;
        bar.say(&format!("error: the program broke on one event ({panic})"));
    }

    /// Counts a rod whose records overlap in time, as a sentence says.
    pub fn overlap(&mut self, rod: &RodId, sentence: &str, bar: &Progress) {
        bar.say(&format!("warning: {sentence}"));
        self.overlapping.insert(rod.clone());
    }

    /// Compares the topics of all files with those of a configuration.
    pub fn compare(&mut self, config: &Config, bar: &Progress) {
        self.differences = self.topics.compare(config);
        for sentence in &self.differences.misspelt {
            bar.say(&format!("warning: {sentence}"));
        }
    }
}

/// Name of a file that gave an error, as it was named; for one without a file its own words.
fn named(error: &SourceError) -> String {
    match error {
        SourceError::Io { path, .. }
        | SourceError::NotAFile { path }
        | SourceError::Foreign { path, .. }
        | SourceError::Empty { path } => path.clone(),
        SourceError::Field { .. } => error.to_string(),
    }
}

/// A number with its noun: `1 record`, `2 records`.
fn counted(number: usize, noun: &str) -> String {
    format!("{number} {noun}{}", if number == 1 { "" } else { "s" })
}

impl Display for Tally {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rejected: usize = self.rejected.values().sum();
        let records = self.identified + rejected + self.repeated + self.broken;
        write!(f, "{}", counted(records, "record"))?;
        if self.files > 0 {
            write!(f, " from {}", counted(self.files, "file"))?;
        }
        write!(f, ": {} identified", self.identified)?;
        if rejected > 0 {
            let reasons: Vec<String> = self
                .rejected
                .iter()
                .map(|(code, count)| format!("{count} {code}"))
                .collect();
            write!(f, ", {rejected} rejected ({})", reasons.join(", "))?;
        }
        if self.repeated > 0 {
            write!(
                f,
                ", {} left out (the same data as one before, or in the store)",
                self.repeated
            )?;
        }
        if self.broken > 0 {
            write!(f, ", {} broke the program (please report)", self.broken)?;
        }
        if self.unreadable > 0 {
            write!(f, ", {} could not be read", counted(self.unreadable, "file"))?;
        }
        if self.with_losses > 0 {
            write!(f, ", {} with lost data", counted(self.with_losses, "file"))?;
        }
        for ((rod, sensor), count) in &self.without {
            write!(f, ", {} of rod {rod} without {sensor}", counted(*count, "record"))?;
        }
        for rod in &self.overlapping {
            write!(f, ", overlapping records of rod {rod}")?;
        }
        match &self.differences.absent[..] {
            [] => {}
            [rod] => write!(f, ", nothing of rod {rod}")?,
            rods => write!(f, ", nothing of rods {}", rods.join(", "))?,
        }
        Ok(())
    }
}
