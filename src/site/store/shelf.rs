//! States of rods whose settings were replaced: if the settings come back, so does the state.

use super::row::Row;
use super::state::{self, Failure, kept};
use super::{Reader, Store, StoreError, schema};
use crate::analysis::signal::record::RodId;
use crate::analysis::track::State;
use rusqlite::{Connection, OptionalExtension, TransactionBehavior};

/// Number of states with a baseline kept per rod, and of states that learn one: the latest ones. Those that learn never take
/// the place of a baseline.
const MOST: i64 = 8;

/// True of a shelved state that has no baseline yet.
const LEARNS: &str = "json_type(json, '$.segment.baseline') = 'null'";

/// A shelved state that may go on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shelved {
    /// Number of its segment.
    pub segment: u32,
    /// Key of its settings.
    pub key: String,
    /// True if its baseline is learned.
    pub has_baseline: bool,
    /// Number of records that wait for the baseline.
    pub learning: usize,
}

/// Condition of a shelved state that may go on: no later segment was opened on request, or because the clock had jumped. What
/// was learned before work on the rod is never compared with what comes after it.
const VALID: &str = "segment >= (SELECT coalesce(max(number), 0) FROM segment
    WHERE segment.rod = shelf.rod AND reason IN ('requested', 'clock'))";

impl Store {
    /// Shelves a state, for settings that may come back.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn shelve(&mut self, state: &State) -> Result<(), StoreError> {
        let mut bare = state.clone();
        bare.periods = Vec::new();
        let json = kept("state", &bare)?;
        let write = |connection: &mut Connection| -> rusqlite::Result<()> {
            let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
            let rod = &state.rod.0;
            transaction.execute(
                &format!(
                    "DELETE FROM shelf WHERE rod = ?1 AND (key = ?2 OR {LEARNS} = ?4 AND segment NOT IN
                        (SELECT segment FROM shelf WHERE rod = ?1 AND {LEARNS} = ?4 ORDER BY segment DESC LIMIT ?3))"
                ),
                (
                    rod,
                    &state.segment.key,
                    MOST - 1,
                    state.segment.baseline.is_none(),
                ),
            )?;
            Row::of("shelf")
                .with("rod", rod.clone())
                .with("segment", i64::from(state.segment.number))
                .with("key", state.segment.key.clone())
                .with("json", json)
                .upsert(&transaction, &["rod", "segment"])?;
            transaction.commit()
        };
        write(&mut self.reader.connection).map_err(|error| self.reader.fault(Failure::Sql(error)))
    }
}

impl Reader {
    /// Shelved states of a rod that may go on, ascending.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn shelved(&self, rod: &RodId) -> Result<Vec<Shelved>, StoreError> {
        let read = || -> rusqlite::Result<Vec<Shelved>> {
            // A store of an older format, which is only read.
            if !schema::has(&self.connection, "shelf")? {
                return Ok(Vec::new());
            }
            let sql = format!(
                "SELECT segment, key, {LEARNS}, coalesce(json_array_length(json, '$.learning'), 0)
                 FROM shelf WHERE rod = ? AND {VALID} ORDER BY segment"
            );
            let mut statement = self.connection.prepare_cached(&sql)?;
            let rows = statement.query_map([&rod.0], |row| {
                Ok(Shelved {
                    segment: row.get(0)?,
                    key: row.get(1)?,
                    has_baseline: !row.get::<_, bool>(2)?,
                    learning: usize::try_from(row.get::<_, u32>(3)?).unwrap_or_default(),
                })
            })?;
            rows.collect()
        };
        read().map_err(|error| self.fault(Failure::Sql(error)))
    }

    /// State of a rod under earlier settings, with the periods of its segment; none from before a requested baseline.
    ///
    /// # Errors
    /// It cannot be read, or not be understood.
    pub fn off_the_shelf(&self, rod: &RodId, key: &str) -> Result<Option<State>, StoreError> {
        let read = || -> Result<Option<State>, Failure> {
            let json: Option<String> = self
                .connection
                .prepare_cached(&format!(
                    "SELECT json FROM shelf WHERE rod = ? AND key = ? AND {VALID} ORDER BY segment DESC LIMIT 1"
                ))?
                .query_row((&rod.0, key), |row| row.get(0))
                .optional()?;
            let Some(json) = json else { return Ok(None) };
            let mut state: State = state::read(&rod.0, &json)?;
            state.periods = state::periods(&self.connection, rod, state.segment.number)?;
            Ok(Some(state))
        };
        read().map_err(|trouble| self.fault(trouble))
    }
}
