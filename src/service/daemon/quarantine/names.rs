//! Names of the steps that may end the program.

use crate::analysis::signal::record::Record;
use crate::service::daemon::places::Place;
use crate::site::hex::hex;

/// Name of a file's step that completes the data before a place that is set aside.
const END: &str = "end";

/// Analysis of a record.
pub fn record_step(record: &Record) -> String {
    format!("record {} of rod {}", hex(&record.identity()), record.rod)
}

/// All steps of a file together.
pub fn file_step(file: &str) -> String {
    format!("file {file}")
}

/// Step of a file at a place.
pub fn place_step(file: &str, place: Place) -> String {
    format!("{}{place}", begin_of_places(file))
}

/// Step that completes the data before a place of a file.
pub fn last_step(file: &str, offset: u64) -> String {
    format!("{}{offset}+{END}", begin_of_places(file))
}

/// Begin of the names of a file's steps.
pub(super) fn begin_of_places(file: &str) -> String {
    format!("{file}@")
}

/// File of a step, and true if the step completes the data before a place that is set aside.
pub(super) fn file_of(step: &str) -> Option<(&str, bool)> {
    let (file, place) = step.rsplit_once('@')?;
    place.split_once('+').map(|(_, taken)| (file, taken == END))
}
