//! Analyses the records of a store again with another configuration, without their samples: labels, inference and
//! tracking from the resonances that the store keeps.

use crate::analysis::identify::VERSION;
use crate::analysis::signal::record::RodId;
use crate::config::{Config, RodConfig};
use crate::site::analyse::{Analysed, Known};
use crate::site::ordered_map::{Limits, map_in_order};
use crate::site::prepared::Plans;
use crate::site::store::{FoundRow, Reader, StoreError};
use std::collections::VecDeque;
use std::fmt::Write;
use std::ops::ControlFlow;

/// Rows read at once.
const PAGE: usize = 256;

/// Reason why records cannot be analysed again from a store.
#[derive(Debug, thiserror::Error)]
pub enum ReanalysisError {
    /// The configuration asks for what only samples can tell.
    #[error("{0}")]
    NeedsSamples(String),
    /// The store cannot be read, or not be understood.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The analysis of a record panicked outside the plan.
    #[error("the program broke on one record ({0}), please report it")]
    Broken(String),
}

/// Checks that a configuration gives the same resonances as those the store keeps, so that labels, inference and
/// tracking from them equal a replay of the recordings.
///
/// # Errors
/// Everything that needs samples, by name; or the store cannot be read.
pub fn check(reader: &Reader, config: &Config) -> Result<(), ReanalysisError> {
    let mut reasons = Vec::new();
    if let Some((count, [rod, start, rejection])) = reader.without_findings()? {
        let why = match rejection.as_str() {
            "" => "it is older than store format 5, or from a table of frequencies".to_owned(),
            code => format!("it was refused as {code}"),
        };
        reasons.push(format!(
            "{count} of its records have no resonances in it, the first of rod {rod} at {start}: {why}"
        ));
    }
    let configs = reader.configs()?;
    for made in reader.made_with()? {
        if made.analysis_version != Some(VERSION) {
            let version = made
                .analysis_version
                .map_or("unknown".to_owned(), |version| version.to_string());
            reasons.push(format!(
                "it has records of analysis version {version}, and this program's is {VERSION}"
            ));
        }
        let before = configs.iter().find(|[hash, _, _]| *hash == made.config);
        let before = before.and_then(|[_, _, text]| Config::parse(text, "the store").ok());
        match before {
            Some(before) => reasons.extend(differences(&before, config)),
            None => reasons.push(format!(
                "its configuration {} cannot be read by this program",
                made.config
            )),
        }
    }
    reasons.dedup();
    if reasons.is_empty() {
        return Ok(());
    }
    let mut text = format!("{}: the recordings are needed:", reader.path().display());
    for reason in reasons {
        // Writing to a string cannot fail.
        let _ = write!(text, "\n  {reason}");
    }
    text += "\nReplay the recordings, or change nothing but priors, tests, inference, tracking and alarms.";
    Err(ReanalysisError::NeedsSamples(text))
}

/// Settings of cutting, checking and searching samples that differ, in words.
fn differences(before: &Config, after: &Config) -> Vec<String> {
    let mut reasons = Vec::new();
    if before.record != after.record {
        reasons.push("[record] cuts and checks samples, and differs".to_owned());
    }
    let (old_s, new_s) = (before.track.reorder_window_s, after.track.reorder_window_s);
    if old_s.to_bits() != new_s.to_bits() {
        reasons.push(format!(
            "track.reorder_window_s orders records, {old_s:?} -> {new_s:?}"
        ));
    }
    for rod in &after.rods {
        let id = &rod.analysis.rod;
        match before.rod(&id.0) {
            Some(known) => reasons.extend(differences_of_rod(known, rod)),
            None => reasons.push(format!("rod {id} is not in its configuration")),
        }
    }
    reasons
}

fn differences_of_rod(before: &RodConfig, after: &RodConfig) -> Vec<String> {
    let (old, new) = (&before.analysis, &after.analysis);
    let rod = &new.rod;
    let mut reasons = Vec::new();
    if before.channels != after.channels {
        reasons.push(format!(
            "rod {rod}: [rod.channel] or [rod.temperature] says what is read, and differs"
        ));
    }
    if after.channels.beside.is_some() {
        reasons.push(format!(
            "rod {rod}: has several sensors, and the store keeps the resonances of one"
        ));
    }
    if old.welch != new.welch || old.peaks != new.peaks {
        reasons.push(format!("rod {rod}: [spectrum] finds the peaks, and differs"));
    }
    if old.modes.masks != new.modes.masks {
        reasons.push(format!("rod {rod}: modes.masks leaves out peaks, and differs"));
    }
    match (old.band_hz(), new.band_hz()) {
        (Some(searched), Some(wanted)) if searched == wanted => {}
        (Some((low_hz, high_hz)), Some((new_low_hz, new_high_hz))) => reasons.push(format!(
            "rod {rod}: its samples were searched from {low_hz:.2} to {high_hz:.2} Hz, and the new prior asks for {new_low_hz:.2} to \
             {new_high_hz:.2} Hz; with `band_hz = [{low_hz:?}, {high_hz:?}]` in its [rod.modes] the band stays"
        )),
        _ => reasons.push(format!("rod {rod}: its prior holds no tensioned rod")),
    }
    reasons
}

/// Rows of a store's findings, a page at a time.
struct Rows {
    reader: Reader,
    page: VecDeque<FoundRow>,
    after: i64,
    is_over: bool,
}

impl Iterator for Rows {
    type Item = Result<FoundRow, StoreError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.page.is_empty() && !self.is_over {
            match self.reader.found(self.after, PAGE) {
                Ok(page) => {
                    self.is_over = page.len() < PAGE;
                    self.page = page.into();
                }
                Err(error) => {
                    self.is_over = true;
                    return Some(Err(error));
                }
            }
        }
        let row = self.page.pop_front()?;
        self.after = row.number;
        Some(Ok(row))
    }
}

/// An input of the fold, analysed again: the result, and for temperatures the record before them.
type Again = Result<Option<(Analysed, Option<[u8; 32]>)>, StoreError>;

/// Analyses all records of a store on `workers` threads and hands the results to `take` in the order of the fold that
/// wrote the store, with the number of inputs done; `take` may end the run. Records of rods without a plan are passed
/// over, and those of `known` are not analysed.
///
/// # Errors
/// The store cannot be read, or holds what this program does not understand.
pub fn run(
    reader: Reader,
    plans: &Plans,
    known: &Known,
    workers: usize,
    mut take: impl FnMut(&Analysed, Option<[u8; 32]>, u64) -> ControlFlow<()>,
) -> Result<(), ReanalysisError> {
    let rows = Rows {
        reader,
        page: VecDeque::new(),
        after: 0,
        is_over: false,
    };
    let limits = Limits {
        workers,
        weight: usize::MAX,
    };
    let mut failure = None;
    let mut done = 0;
    map_in_order(
        rows,
        limits,
        |_| 1,
        |row| again(row, plans, known),
        |results| {
            for result in results {
                done += 1;
                match result {
                    Ok(Ok(Some((analysed, before)))) => take(&analysed, before, done)?,
                    Ok(Ok(None)) => {}
                    Ok(Err(error)) => {
                        failure = Some(error.into());
                        return ControlFlow::Break(());
                    }
                    Err(panic) => {
                        failure = Some(ReanalysisError::Broken(panic));
                        return ControlFlow::Break(());
                    }
                }
            }
            ControlFlow::Continue(())
        },
    );
    failure.map_or(Ok(()), Err)
}

fn again(row: Result<FoundRow, StoreError>, plans: &Plans, known: &Known) -> Again {
    let FoundRow {
        rod, identity, found, ..
    } = row?;
    let Some(plan) = plans.get(&rod) else {
        return Ok(None);
    };
    if let Some(readings) = found.only_readings() {
        return Ok(Some((Analysed::Readings(rod, readings), identity)));
    }
    let Some(identity) = identity else {
        return Err(unreadable(&rod, "they belong to no record".to_owned()));
    };
    if known.get(&rod).is_some_and(|known| known.contains(&identity)) {
        return Ok(Some((Analysed::Known(rod, identity), None)));
    }
    let outcome = found
        .outcome(&rod, identity, plan)
        .map_err(|error| unreadable(&rod, error.to_string()))?;
    Ok(Some((Analysed::Record(Box::new(outcome)), None)))
}

fn unreadable(rod: &RodId, detail: String) -> StoreError {
    StoreError::Unreadable {
        what: format!("the resonances of a record of rod {rod}"),
        detail,
    }
}
