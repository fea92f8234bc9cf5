//! The store behind the page: one reader beside the writer, used by one request at a time, and a bell that
//! rings after each commit.

use crate::service::api::Days;
use crate::site::store::{FileId, Reader, StoreError};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use thiserror::Error;
use tokio::sync::watch;
use tokio::time;

/// Interval between checks of the store.
const LOOK: Duration = Duration::from_millis(250);

/// Pause between two batches of records, so that requests come in between.
const BREATH: Duration = Duration::from_millis(1);

/// Most batches that a query reads itself before it answers that the store is being read: less than a tenth
/// of a second.
const BATCHES: usize = 8;

/// Reason why a query has no answer.
#[derive(Debug, Error)]
pub enum Unanswered {
    /// The records of years are being read after a start: some seconds for a million of them.
    #[error("the store is being read: {:.0} % of its records so far", 100.0 * .share)]
    Reading {
        /// Share of the records read so far, 0 to 1.
        share: f64,
    },
    /// The store cannot be read, or a row is damaged.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// A store that is shown.
pub struct Shown {
    path: PathBuf,
    open: Mutex<Option<Open>>,
    /// Number of commits since the server began to watch.
    commits: watch::Sender<u64>,
}

/// The open store.
struct Open {
    reader: Reader,
    days: Days,
}

impl Shown {
    /// The store at this path, which need not exist yet.
    pub fn new(path: &Path) -> Arc<Self> {
        Arc::new(Self {
            path: path.to_owned(),
            open: Mutex::new(None),
            commits: watch::Sender::new(0),
        })
    }

    /// Queries the store. It blocks, so call it on the runtime's blocking threads.
    ///
    /// # Errors
    /// There is no store, it cannot be read, a row is damaged, or too many records are new.
    pub fn ask<T>(
        &self,
        question: impl FnOnce(&Reader, &Days) -> Result<T, StoreError>,
    ) -> Result<T, Unanswered> {
        let mut place = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        let open = self.opened(&mut place)?;
        for _ in 0..BATCHES {
            if !open.days.take_up(&open.reader)? {
                break;
            }
        }
        // Days and answer are of one moment.
        let days = &mut open.days;
        open.reader.together(|reader| {
            if days.take_up(reader)? {
                let share = days.share(reader)?;
                if share < 1.0 {
                    return Ok(Err(Unanswered::Reading { share }));
                }
            }
            question(reader, days).map(Ok)
        })?
    }

    /// As [`Shown::ask`], for queries that need no daily sums: no records are read before the answer.
    ///
    /// # Errors
    /// There is no store, it cannot be read, or a row is damaged.
    pub fn read<T>(&self, question: impl FnOnce(&Reader) -> Result<T, StoreError>) -> Result<T, StoreError> {
        let mut place = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        self.opened(&mut place)?.reader.together(question)
    }

    /// The open store, opened anew if another file took its place.
    fn opened<'o>(&self, place: &'o mut Option<Open>) -> Result<&'o mut Open, StoreError> {
        match place {
            // A store that was damaged is moved aside and a new one begun in its place.
            Some(open) if open.reader.file() == FileId::of(&self.path) => {}
            _ => {
                *place = Some(Open {
                    reader: Reader::open(&self.path)?,
                    days: Days::default(),
                });
            }
        }
        match place {
            Some(open) => Ok(open),
            None => Err(StoreError::Missing {
                path: self.path.clone(),
            }),
        }
    }

    /// Channel that changes after each commit from now on.
    pub fn bell(&self) -> watch::Receiver<u64> {
        self.commits.subscribe()
    }

    /// Watches the store until `stop` becomes true, rings after commits, and reads new records while no
    /// request waits.
    pub async fn watch(self: Arc<Self>, mut stop: watch::Receiver<bool>) {
        let mut version = None;
        loop {
            let shown = Arc::clone(&self);
            let look = move || {
                let mut place = shown.open.lock().unwrap_or_else(PoisonError::into_inner);
                let open = shown.opened(&mut place)?;
                // One batch at a time, so that a request does not wait for a whole new store.
                let is_behind = open.days.take_up(&open.reader)?;
                Ok::<_, StoreError>((is_behind, (open.reader.file(), open.reader.data_version()?)))
            };
            let seen = tokio::task::spawn_blocking(look).await;
            let (is_behind, seen) = match seen {
                Ok(Ok((is_behind, seen))) => (is_behind, Some(seen)),
                Ok(Err(_)) | Err(_) => (false, None),
            };
            if seen.is_some() && seen != version {
                self.commits.send_modify(|commits| *commits += 1);
                version = seen;
            }
            tokio::select! {
                () = time::sleep(if is_behind { BREATH } else { LOOK }) => {}
                _ = stop.wait_for(|stop| *stop) => return,
            }
        }
    }
}
