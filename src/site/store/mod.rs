//! Results kept on disk: SQLite in WAL mode, one transaction per record, or per group of records that came
//! together.
//!
//! A [`Store`] writes, one process at a time; a [`Reader`] reads beside it. Every row carries a checksum, and a
//! store whose content contradicts itself is moved aside, and neither written nor used. Nothing in the tables
//! of [results](Reader::dump) depends on the clock or on how often a run was interrupted. docs/store.md
//! describes tables and columns.

mod backup;
mod change;
mod columns;
mod command;
mod commit;
mod dump;
mod error;
mod file_id;
mod gathered;
mod head;
mod kinds;
mod listing;
mod lock;
mod open;
mod operation;
mod page;
mod points;
mod read;
mod relay;
mod remainder;
mod request;
mod resonance;
mod retention;
mod row;
mod schema;
mod sent;
mod shelf;
mod snapshot;
mod standing;
mod state;
mod vigil;

pub use change::{
    COPIED, Change, ChangedRow, Column, FORGOTTEN, FORMAT, Shape, ValueKind, is_intact, shapes,
};
pub use command::{Judged, command_id, latest_command, put_command};
pub use commit::{Commit, NewRecord, Position, RodRow};
pub use error::StoreError;
pub use file_id::FileId;
pub use head::Head;
pub use kinds::ColumnKind;
pub use listing::{Filter, Listing, WithoutLine};
pub use lock::Reserved;
pub use open::Durability;
pub use operation::{Carry, FileMark, FileState, News};
pub use page::{Line, Lines, Mark};
pub use points::{Modes, Point, Sampling};
pub use read::{Counts, Reader, Refusals};
pub use relay::{Reached, Relayed};
pub use remainder::Remainder;
pub use request::{Asked, Request};
pub use resonance::{FoundRow, Made};
pub use shelf::Shelved;
pub use snapshot::{SnapshotRow, Snapshots};
pub use standing::Standing;
pub use vigil::{ConditionEvent, Stretch};

use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::State;
use crate::analysis::track::alarm::Board;
use change::Changed;
use lock::Lock;
use rusqlite::{Connection, TransactionBehavior};
use state::{Failure, Kept};
use std::collections::{BTreeMap, HashMap, HashSet};
use std::ops::Deref;
use std::path::{Path, PathBuf};

/// A store open for writing.
pub struct Store {
    reader: Reader,
    known: HashMap<RodId, HashSet<[u8; 32]>>,
    kept: Kept,
    moved_aside: Option<PathBuf>,
    is_grouping: bool,
    lock: Option<Lock>,
}

/// A writer can read, too.
impl Deref for Store {
    type Target = Reader;

    fn deref(&self) -> &Reader {
        &self.reader
    }
}

/// Takes the lock of a closed store again; `None` while another process has it.
pub fn reserve(path: &Path) -> Option<Reserved> {
    let path = std::fs::canonicalize(path).ok()?;
    Lock::take(&path).ok().map(Reserved)
}

impl Store {
    /// Opens or creates the store at `path` for writing, and checks every row of it. A damaged one is moved
    /// aside ([`Store::moved_aside`]) and a new one created.
    ///
    /// # Errors
    /// Another process writes to it, it is another program's file or a newer format, or the file system refuses.
    pub fn open(path: &Path, durability: Durability) -> Result<Self, StoreError> {
        let opened = open::for_writing(path, durability)?;
        // Who holds the lock puts nothing else in its place.
        let file = FileId::of(&opened.path);
        Ok(Self {
            reader: Reader::over(opened.connection, opened.path, file),
            known: opened.known,
            kept: Kept::new(true),
            moved_aside: opened.moved_aside,
            is_grouping: false,
            lock: Some(opened.lock),
        })
    }

    /// A store in memory for one run: of the states, which nobody resumes from, it keeps the segments alone, and no view of a record is
    /// asked of it.
    ///
    /// # Errors
    /// There is no memory for it.
    pub fn transient() -> Result<Self, StoreError> {
        Ok(Self {
            kept: Kept::new(false),
            ..Self::in_memory()?
        })
    }

    /// A store in memory.
    ///
    /// # Errors
    /// There is no memory for it.
    pub fn in_memory() -> Result<Self, StoreError> {
        let path = PathBuf::from(":memory:");
        let connection = open::in_memory().map_err(|source| StoreError::Database {
            path: path.clone(),
            source,
        })?;
        Ok(Self {
            reader: Reader::over(connection, path, FileId::default()),
            known: HashMap::new(),
            kept: Kept::new(true),
            moved_aside: None,
            is_grouping: false,
            lock: None,
        })
    }

    /// True if it is [`Store::transient`].
    pub(crate) fn is_transient(&self) -> bool {
        !self.kept.is_resumable()
    }

    /// Closes the store and keeps its lock, until the lock is dropped to open it again.
    pub fn reserve(self) -> Option<Reserved> {
        self.lock.map(Reserved)
    }

    /// Writes beside the store a line for the next daemon ([`left`]), and a text for those who cannot ask this
    /// one ([`told`]); empty if nothing is wrong. Needs no room on the disk.
    pub fn tell(&self, line: &str, text: &str) {
        if let Some(lock) = &self.lock {
            // Nothing can be done where even this is refused.
            let _ = lock.tell(line, text);
        }
    }

    /// Takes the lock anew if its file was removed or replaced; returns true if it had to.
    ///
    /// # Errors
    /// Another process has taken it meanwhile, or the file system refuses.
    pub fn keep_lock(&mut self) -> Result<bool, StoreError> {
        let path = &self.reader.path;
        self.lock.as_mut().map_or(Ok(false), |lock| lock.renew(path))
    }

    /// Path to which a damaged store was moved when this one was opened.
    pub fn moved_aside(&self) -> Option<&Path> {
        self.moved_aside.as_deref()
    }

    /// True if the store has this record already, under whatever file name it came.
    pub fn known(&self, rod: &RodId, identity: &[u8; 32]) -> bool {
        self.known.get(rod).is_some_and(|known| known.contains(identity))
    }

    /// Identities of every record in the store, for checking on other threads what is [known](Store::known).
    pub fn all_known(&self) -> &HashMap<RodId, HashSet<[u8; 32]>> {
        &self.known
    }

    /// Takes a configuration into force: `hash` as records refer to it, `effective` with every default filled in. It
    /// must be kept before the first record that names it.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn keep_config(&mut self, hash: &str, site: &str, effective: &str) -> Result<(), StoreError> {
        let connection = &self.reader.connection;
        let write = || -> rusqlite::Result<()> {
            let count: i64 =
                connection.query_row("SELECT count(*) FROM config WHERE hash = ?", [hash], |row| {
                    row.get(0)
                })?;
            if count > 0 {
                // One of before is in force again: the row in force is the last one.
                let last = "rowid = (SELECT max(rowid) FROM config)";
                let next = format!(
                    "UPDATE config SET rowid = (SELECT max(rowid) + 1 FROM config) WHERE hash = ? AND NOT {last}"
                );
                return connection.execute(&next, [hash]).map(|_| ());
            }
            // A savepoint: it may be called within a group.
            connection.execute_batch("SAVEPOINT config")?;
            let result = write_config(connection, hash, site, effective);
            let end = if result.is_ok() {
                ""
            } else {
                "ROLLBACK TO config; "
            };
            connection.execute_batch(&format!("{end}RELEASE config"))?;
            result
        };
        write().map_err(|error| self.reader.fault(Failure::Sql(error)))
    }

    /// State of every rod's fold, to resume from.
    ///
    /// # Errors
    /// It cannot be read, or not be understood.
    pub fn states(&mut self) -> Result<BTreeMap<RodId, State>, StoreError> {
        let states = self.reader.states()?;
        for state in states.values() {
            self.kept.trust(state);
        }
        Ok(states)
    }

    /// Makes all of `commit` durable, or nothing; within a [group](Store::begin_group) when that ends.
    ///
    /// # Errors
    /// A record that is [known](Store::known) already, a value that would not read back equal, or an error of
    /// the file system.
    pub fn commit(&mut self, commit: &Commit<'_>) -> Result<(), StoreError> {
        let result = self.try_commit(commit);
        if let Err(failure) = result {
            if let Some(rod) = &commit.rod {
                self.kept.distrust(&rod.state.rod);
            }
            return Err(self.reader.fault(failure));
        }
        if let Some(record) = &commit.record {
            let known = self.known.entry(record.row.rod.clone()).or_default();
            known.insert(record.identity);
        }
        Ok(())
    }

    fn try_commit(&mut self, commit: &Commit<'_>) -> Result<(), Failure> {
        if self.is_grouping {
            // A group that lost a part must not be committed: the rest is discarded with the connection.
            return commit.write(&self.reader.connection, &mut self.kept);
        }
        let transaction = self
            .reader
            .connection
            .transaction_with_behavior(TransactionBehavior::Immediate)?;
        commit.write(&transaction, &mut self.kept)?;
        transaction.commit()?;
        Ok(())
    }

    /// Begins a group: all [commits](Store::commit) from here on become durable, and visible to others, at
    /// once with [`Store::end_group`], at the cost of one. After an error within it the store must be closed:
    /// nothing of the group is kept then.
    ///
    /// # Errors
    /// Another process writes, or the file system refuses.
    pub fn begin_group(&mut self) -> Result<(), StoreError> {
        self.batch("BEGIN IMMEDIATE")?;
        self.is_grouping = true;
        Ok(())
    }

    /// Makes the whole group durable.
    ///
    /// # Errors
    /// The file system refuses; the store must be given up.
    pub fn end_group(&mut self) -> Result<(), StoreError> {
        self.is_grouping = false;
        self.batch("COMMIT")
    }

    fn batch(&self, words: &str) -> Result<(), StoreError> {
        let done = self.reader.connection.execute_batch(words);
        done.map_err(|error| self.reader.fault(Failure::Sql(error)))
    }

    /// Applies at once the waiting acknowledgements that come before any other request of their rod; returns
    /// the numbers of those applied and of the requests that still wait. `states` are those of [`Store::states`].
    ///
    /// # Errors
    /// They cannot be read or written.
    pub fn acknowledge_waiting(
        &mut self,
        states: &mut BTreeMap<RodId, State>,
    ) -> Result<(usize, usize), StoreError> {
        let (mut applied, mut still) = (0, 0);
        let unfollowed = self.reader.unfollowed()?;
        for (rod, state) in states.iter_mut() {
            let mut requests = self.reader.waiting(rod)?.into_iter().peekable();
            while let Some(Request {
                number,
                what: Asked::Acknowledge { alarm, .. },
                asked,
                ..
            }) = requests.next_if(|request| matches!(request.what, Asked::Acknowledge { .. }))
            {
                let mut board = Board::new(&state.rod, state.segment.number, &mut state.alarms);
                board.acknowledge(&alarm, asked);
                let events = board.into_events();
                let stands = match unfollowed.contains(rod) {
                    true => state::not_followed(),
                    false => state::standing_without_plan(state),
                };
                self.commit(&Commit {
                    rod: Some(RodRow {
                        state,
                        stands: &stands,
                        closed: &[],
                        events: &events,
                    }),
                    applied: Some(number),
                    ..Commit::default()
                })?;
                applied += 1;
            }
            still += requests.count();
        }
        Ok((applied, still))
    }

    /// Marks a rod that is no longer configured, and ends the conditions of its alarms, as no fold will; those that wait to
    /// be acknowledged stay until they are.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn retire(&mut self, state: &mut State) -> Result<(), StoreError> {
        let told = state.alarms.iter().map(|alarm| alarm.told).max();
        let mut board = Board::new(&state.rod, state.segment.number, &mut state.alarms);
        if let Some(told) = told {
            board.clear_all(state.latest.map_or(told, |latest| latest.max(told)));
        }
        let events = board.into_events();
        self.commit(&Commit {
            rod: Some(RodRow {
                state,
                stands: &state::not_followed(),
                closed: &[],
                events: &events,
            }),
            ..Commit::default()
        })
    }

    /// Appends a request to the queue; returns its number.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn request(&mut self, rod: &RodId, what: &Asked, asked: Timestamp) -> Result<i64, StoreError> {
        request::put(&self.reader.connection, rod, what, asked)
            .map_err(|error| self.reader.fault(Failure::Sql(error)))
    }
}

fn write_config(connection: &Connection, hash: &str, site: &str, effective: &str) -> rusqlite::Result<()> {
    row::Row::of("config")
        .with("hash", hash.to_owned())
        .with("site", site.to_owned())
        .with("effective", effective.to_owned())
        .insert(connection)?;
    let mut changed = Changed::default();
    changed.note("config", [hash.into()]);
    changed.write(connection)
}

/// True if a process writes the store at `path`; `None` if that is unknown.
pub fn is_held(path: &Path) -> Option<bool> {
    let path = std::fs::canonicalize(path).ok()?;
    lock::holder(&path).ok().map(|holder| holder.is_some())
}

/// Text of the process that writes the store at `path` ([`Store::tell`]); `None` if none does, or nothing is wrong.
pub fn told(path: &Path) -> Option<String> {
    // The store itself may be gone.
    lock::told(&std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned()))
}

/// Line that the last process to tell something left beside the store at `path` ([`Store::tell`]); empty if none.
pub fn left(path: &Path) -> String {
    lock::left(&std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned()))
}

/// Error if another process writes the store at `path`, so that it cannot be written now.
pub fn held(path: &Path) -> Option<StoreError> {
    let path = std::fs::canonicalize(path).ok()?;
    lock::holder(&path).ok().flatten()
}

/// Appends requests to a store that another process writes; returns their numbers.
///
/// # Errors
/// There is no such store, or it cannot be written.
pub fn request_of_writer(
    path: &Path,
    requests: &[(RodId, Asked)],
    asked: Timestamp,
) -> Result<Vec<i64>, StoreError> {
    let (connection, path) = open::beside_writer(path)?;
    requests
        .iter()
        .map(|(rod, what)| {
            request::put(&connection, rod, what, asked).map_err(|source| StoreError::Database {
                path: path.clone(),
                source,
            })
        })
        .collect()
}
