//! Views of single records, kept for the report: the first of each segment, the latest of each rod, and the
//! latest refused one.

use super::row::Row;
use super::state::{self, Failure};
use super::{Reader, StoreError};
use crate::analysis::record_view::Snapshot;
use crate::analysis::signal::record::{RodId, Timestamp};
use rusqlite::{Connection, OptionalExtension};

/// Number of the latest record's row; segments count from 1.
const LATEST: i64 = 0;
/// Number of the latest refused record's row.
const REFUSED: i64 = -1;

/// View of a record with its place.
#[derive(Clone, Copy)]
pub struct SnapshotRow<'a> {
    /// Id of the rod.
    pub rod: &'a RodId,
    /// Segment of the record.
    pub segment: u32,
    /// View of the record.
    pub snapshot: &'a Snapshot,
}

/// Views of one rod's records.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Snapshots {
    /// First record of the current segment.
    pub first: Option<Snapshot>,
    /// The latest record.
    pub latest: Option<Snapshot>,
    /// The latest refused record with samples.
    pub refused: Option<Snapshot>,
}

impl SnapshotRow<'_> {
    /// Writes the view as the first of its segment if there is none, and as the latest; that of a refused
    /// record only as the latest refused one.
    pub(super) fn write(&self, connection: &Connection) -> Result<(), Failure> {
        let json = serde_json::to_string(self.snapshot).map_err(|error| StoreError::NotStorable {
            what: format!("the snapshot of a record of rod {}", self.rod),
            detail: error.to_string(),
        })?;
        let row = |number: i64| {
            Row::of("snapshot")
                .with("rod", self.rod.0.clone())
                .with("number", number)
                .with("start_ns", self.snapshot.start.as_nanos())
                .with("json", json.clone())
        };
        if self.snapshot.rejection.is_some() {
            return Ok(row(REFUSED).upsert(connection, &["rod", "number"])?);
        }
        let segment = i64::from(self.segment);
        let has_first = connection
            .prepare_cached("SELECT 1 FROM snapshot WHERE rod = ? AND number = ?")?
            .exists((&self.rod.0, segment))?;
        if !has_first {
            row(segment).insert(connection)?;
        }
        Ok(row(LATEST).upsert(connection, &["rod", "number"])?)
    }
}

impl Reader {
    /// Views of the first record of the current segment, the latest record and the latest refused one of a
    /// rod.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn snapshots(&self, rod: &RodId) -> Result<Snapshots, StoreError> {
        let read = || -> Result<Snapshots, Failure> {
            let one = |sql: &str| -> Result<Option<Snapshot>, Failure> {
                let json: Option<String> = self
                    .connection
                    .prepare_cached(sql)?
                    .query_row([&rod.0], |row| row.get(0))
                    .optional()?;
                Ok(json.map(|json| state::read(&rod.0, &json)).transpose()?)
            };
            Ok(Snapshots {
                first: one(
                    "SELECT json FROM snapshot WHERE rod = ?1 AND number > 0
                     AND number = coalesce((SELECT segment FROM rod WHERE rod = ?1), number) ORDER BY number DESC LIMIT 1",
                )?,
                latest: one("SELECT json FROM snapshot WHERE rod = ? AND number = 0")?,
                refused: one("SELECT json FROM snapshot WHERE rod = ? AND number = -1")?,
            })
        };
        read().map_err(|failure| self.fault(failure))
    }

    /// Every view of a rod's records.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn all_snapshots(&self, rod: &RodId) -> Result<Vec<Snapshot>, StoreError> {
        let read = || -> Result<Vec<Snapshot>, Failure> {
            let mut statement = self
                .connection
                .prepare_cached("SELECT json FROM snapshot WHERE rod = ? ORDER BY number")?;
            let rows = statement.query_map([&rod.0], |row| row.get::<_, String>(0))?;
            rows.map(|json| Ok(state::read(&rod.0, &json?)?)).collect()
        };
        read().map_err(|failure| self.fault(failure))
    }

    /// Start of a rod's latest refused record with a view.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn refused_picture(&self, rod: &RodId) -> Result<Option<Timestamp>, StoreError> {
        let ask = || {
            self.connection
                .prepare_cached("SELECT start_ns FROM snapshot WHERE rod = ? AND number = ?")?
                .query_row((&rod.0, REFUSED), |row| row.get(0))
                .optional()
        };
        let start_ns = ask().map_err(|error| self.fault(Failure::Sql(error)))?;
        Ok(start_ns.map(Timestamp::from_nanos))
    }

    /// Every configuration of any record: hash, site, and the text with every default filled in.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn configs(&self) -> Result<Vec<[String; 3]>, StoreError> {
        let read = || -> rusqlite::Result<Vec<[String; 3]>> {
            let mut statement = self
                .connection
                .prepare("SELECT hash, site, effective FROM config ORDER BY hash")?;
            let rows = statement.query_map((), |row| Ok([row.get(0)?, row.get(1)?, row.get(2)?]))?;
            rows.collect()
        };
        read().map_err(|error| self.fault(Failure::Sql(error)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::record_view::{Curve, Reason};
    use crate::site::store::{Commit, Store};

    fn snapshot(second: i64) -> Snapshot {
        Snapshot {
            start: Timestamp::from_nanos(second * 1_000_000_000),
            duration_s: 60.0,
            fs_hz: 200.0,
            seed: "ff".to_owned(),
            waveform: None,
            curve: Curve {
                first_hz: 0.1,
                step_hz: 0.1,
                level_db: vec![-120.25, -119.5],
            },
            peaks: vec![],
            densities: vec![],
            hangs_on: None,
            motion: None,
            label_probability: None,
            candidates: vec![],
            rejection: None,
        }
    }

    #[test]
    fn the_first_of_the_segment_and_the_latest_are_kept() {
        let mut store = Store::in_memory().unwrap();
        let rod = RodId("north".to_owned());
        assert_eq!(store.snapshots(&rod).unwrap(), Snapshots::default());
        // A clock may have been wrong: the last to arrive counts.
        for (segment, second) in [(1, 100), (1, 200), (2, 400), (2, 300)] {
            let commit = Commit {
                snapshot: Some(SnapshotRow {
                    rod: &rod,
                    segment,
                    snapshot: &snapshot(second),
                }),
                ..Commit::default()
            };
            store.commit(&commit).unwrap();
        }
        let kept = store.snapshots(&rod).unwrap();
        assert_eq!(kept.first, Some(snapshot(400)));
        assert_eq!(kept.latest, Some(snapshot(300)));
        assert_eq!(kept.refused, None);
    }

    #[test]
    fn a_refused_record_is_kept_beside_them_and_only_the_latest() {
        let mut store = Store::in_memory().unwrap();
        let rod = RodId("north".to_owned());
        let refused = |second| Snapshot {
            rejection: Some(Reason {
                code: "no-label".to_owned(),
                message: "nothing is certain".to_owned(),
            }),
            ..snapshot(second)
        };
        for picture in [refused(50), snapshot(100), refused(200)] {
            let commit = Commit {
                snapshot: Some(SnapshotRow {
                    rod: &rod,
                    segment: 1,
                    snapshot: &picture,
                }),
                ..Commit::default()
            };
            store.commit(&commit).unwrap();
        }
        let kept = store.snapshots(&rod).unwrap();
        assert_eq!(
            (kept.first, kept.latest),
            (Some(snapshot(100)), Some(snapshot(100)))
        );
        assert_eq!(kept.refused, Some(refused(200)));
        let start = store.refused_picture(&rod).unwrap();
        assert_eq!(start, Some(Timestamp::from_nanos(200_000_000_000)));
    }
}
