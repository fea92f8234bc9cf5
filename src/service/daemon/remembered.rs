//! State of the sources in the store, from which reading goes on after a start.

use super::folder::{BEGUN_UNDER, KEPT_UNDER};
use crate::analysis::signal::record::{RecordSettings, RodChannels};
use crate::recording::part;
use crate::recording::read::series::modified_ns;
use crate::recording::read::{Parts, Series};
use crate::site::store::{self, Carry, FileMark, StoreError};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// Name under which the store keeps the journal's [`Carry`].
pub const JOURNAL: &str = "journal";

/// State of the sources in the store.
#[derive(Debug, Clone, Default)]
pub struct Remembered {
    /// Files read to their end.
    pub files: BTreeMap<String, FileMark>,
    /// State that the journal's read parts left open, kept under [`JOURNAL`].
    pub carry: Option<Carry>,
    /// Samples that the watched folder's files left open, or began with, a rod each.
    pub open: Vec<Carry>,
}

/// The journal from its first part that is not read to its end.
pub struct Resumed {
    /// Its parts, with the samples that earlier ones left open.
    pub series: Series,
    /// Last part that is read to its end.
    pub done: Option<u32>,
    /// A sentence for everything that could not be taken up.
    pub lost: Vec<String>,
}

impl Remembered {
    /// State in a store.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn of(store: &store::Reader) -> Result<Self, StoreError> {
        Ok(Self {
            files: store.files()?,
            carry: store.carry(JOURNAL)?,
            open: [store.carries(KEPT_UNDER)?, store.carries(BEGUN_UNDER)?].concat(),
        })
    }

    /// The journal in a folder, to be read from where its marks end.
    pub fn journal(&self, folder: &Path, channels: &[RodChannels], settings: &RecordSettings) -> Resumed {
        let (first, done) = first_part(folder, &self.files);
        let mut series = Series::new(folder, Parts::From(first), channels, settings);
        let lost = match &self.carry {
            None => Vec::new(),
            Some(carry) if carry.part == first => series.resume(&carry.body),
            Some(carry) => vec![format!(
                "the samples that were open before part {} of the journal do not fit part {first}; they are left out",
                carry.part
            )],
        };
        Resumed { series, done, lost }
    }
}

/// Number of the first part not yet read to its end, and of the last one that is.
fn first_part(folder: &Path, files: &BTreeMap<String, FileMark>) -> (u32, Option<u32>) {
    let parts = part::list(folder).unwrap_or_default();
    let is_done = |number: &u32| {
        let Some(mark) = files.get(&part::mark_name(*number)) else {
            return false;
        };
        // A journal that was begun anew has parts of the same names.
        fs::metadata(part::path(folder, *number)).is_ok_and(|data| {
            let modified = data.modified().map_or(0, modified_ns);
            (data.len(), modified) == (mark.size, mark.modified_ns)
        })
    };
    let last_done = parts.iter().copied().rev().find(is_done);
    let next = parts.iter().copied().find(|part| Some(*part) > last_done);
    (
        next.or_else(|| last_done.map(|part| part.saturating_add(1)))
            .unwrap_or(1),
        last_done,
    )
}
