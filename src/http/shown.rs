//! The store behind the page: one reader beside the writer, asked by one request at a time, and a bell that rings when
//! something was committed.

use crate::api::Days;
use crate::store::{Reader, StoreError};
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::watch;
use tokio::time;

/// How often the store is looked at.
const LOOK: Duration = Duration::from_millis(250);

/// A store that is shown.
pub struct Shown {
    path: PathBuf,
    open: Mutex<Option<Open>>,
    /// Counts what was committed since the server began to look.
    commits: watch::Sender<u64>,
}

/// The store as it is open now.
struct Open {
    reader: Reader,
    days: Days,
    /// Device and inode: a store that was damaged is moved aside and a new one begun in its place.
    file: (u64, u64),
}

impl Shown {
    /// The store at this path; it need not be there yet.
    pub fn new(path: &Path) -> Arc<Self> {
        Arc::new(Self {
            path: path.to_owned(),
            open: Mutex::new(None),
            commits: watch::Sender::new(0),
        })
    }

    /// Asks the store. It blocks: the runtime's blocking threads are the place for it.
    ///
    /// # Errors
    /// There is no store, it cannot be read, or a row is damaged.
    pub fn ask<T>(
        &self,
        question: impl FnOnce(&Reader, &Days) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        let mut place = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        let open = self.opened(&mut place)?;
        while open.days.take_up(&open.reader)? {}
        question(&open.reader, &open.days)
    }

    /// The open store, opened anew if another file took its place.
    fn opened<'o>(&self, place: &'o mut Option<Open>) -> Result<&'o mut Open, StoreError> {
        let file = fs::metadata(&self.path).map_or((0, 0), |file| (file.dev(), file.ino()));
        match place {
            Some(open) if open.file == file => {}
            _ => {
                *place = Some(Open {
                    reader: Reader::open(&self.path)?,
                    days: Days::default(),
                    file,
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

    /// Rings after each commit from now on.
    pub fn bell(&self) -> watch::Receiver<u64> {
        self.commits.subscribe()
    }

    /// Looks at the store until `stop` becomes true, rings, and takes up what is new while nobody waits for it.
    pub async fn watch(self: Arc<Self>, mut stop: watch::Receiver<bool>) {
        let mut version = None;
        loop {
            let shown = Arc::clone(&self);
            let look = move || {
                let mut place = shown.open.lock().unwrap_or_else(PoisonError::into_inner);
                let open = shown.opened(&mut place)?;
                // One batch at a time, so that a request does not wait for a whole new store.
                open.days.take_up(&open.reader)?;
                Ok::<_, StoreError>((open.file, open.reader.data_version()?))
            };
            let seen = match tokio::task::spawn_blocking(look).await {
                Ok(seen) => seen.ok(),
                Err(_) => None,
            };
            if seen.is_some() && seen != version {
                self.commits.send_modify(|commits| *commits += 1);
                version = seen;
            }
            tokio::select! {
                () = time::sleep(LOOK) => {}
                _ = stop.wait_for(|stop| *stop) => return,
            }
        }
    }
}
