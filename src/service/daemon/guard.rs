//! Watches the store's files while the daemon writes them.

use crate::service::telemetry::owned::{Lost, Owned};
use crate::site::store::Head;
use std::path::{Path, PathBuf};

/// The store, its write-ahead log, and the log's index.
#[derive(Debug)]
pub struct Guard {
    store: Option<Owned>,
    head: Option<Head>,
    /// Log and index, known from the first commit on; they stay the same while the store is open. Requests of people come by the
    /// index: without it they are not seen.
    beside: [(PathBuf, Option<Owned>); 2],
}

impl Guard {
    /// Files of the store opened at `path`.
    pub fn of(path: &Path) -> Self {
        let beside = ["-wal", "-shm"].map(|suffix| {
            let mut name = path.as_os_str().to_owned();
            name.push(suffix);
            (PathBuf::from(name), None)
        });
        Self {
            store: Owned::of(path),
            head: None,
            beside,
        }
    }

    /// Checks them.
    ///
    /// # Errors
    /// First file that is no longer the one written, and the reason.
    pub fn look(&mut self) -> Result<(), (PathBuf, Lost)> {
        for (path, owned) in &mut self.beside {
            if owned.is_none() {
                *owned = Owned::of(path);
            }
            match owned.as_mut().map_or(Ok(()), Owned::look) {
                // SQLite itself shortens the log when its content is in the store.
                Ok(()) | Err(Lost::Truncated) => {}
                Err(lost) => return Err((path.clone(), lost)),
            }
        }
        let Some(store) = &mut self.store else {
            return Ok(());
        };
        store.look().map_err(|lost| (store.path().to_owned(), lost))?;
        if let Some(head) = Head::of(store.path()) {
            if self
                .head
                .as_ref()
                .is_some_and(|known| known.was_overwritten(&head))
            {
                return Err((store.path().to_owned(), Lost::Overwritten));
            }
            self.head = Some(head);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::site::clock;
    use crate::site::store::{ConditionEvent, Durability, Store};

    fn write(store: &mut Store, number: usize) {
        let detail = "x".repeat(2000 + number);
        let notice = ConditionEvent::raised("sink", &format!("sink {number}"), clock::now(), &detail);
        store.watch(&[notice], None).unwrap();
    }

    #[test]
    fn a_copy_over_the_store_is_noticed_and_sqlites_own_writes_are_none() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("site.db");
        let mut store = Store::open(&path, Durability::Full).unwrap();
        let mut guard = Guard::of(&path);
        // Several times the length at which the log is copied into the store.
        for number in 0..500 {
            write(&mut store, number);
            assert_eq!(guard.look(), Ok(()), "after {number} writes");
        }
        assert!(std::fs::metadata(&path).unwrap().len() > 1 << 19);
        let copy = folder.path().join("copy.db");
        std::fs::copy(&path, &copy).unwrap();
        for number in 500..1000 {
            write(&mut store, number);
            assert_eq!(guard.look(), Ok(()), "after {number} writes");
        }
        let whole = std::fs::read(&path).unwrap();
        std::fs::copy(&copy, &path).unwrap();
        let lost = guard.look().unwrap_err().1;
        assert!(matches!(lost, Lost::Overwritten | Lost::Truncated), "{lost:?}");
        std::fs::write(&path, &whole).unwrap();
        assert_eq!(guard.look(), Ok(()));
        // One that is longer, as a backup of a store whose content is in its log still.
        let mut longer = whole;
        longer[28..32].copy_from_slice(&u32::MAX.to_be_bytes());
        longer.extend([0; 8192]);
        std::fs::write(&path, &longer).unwrap();
        assert_eq!(guard.look().unwrap_err().1, Lost::Overwritten);
    }

    #[test]
    fn the_index_of_the_log_is_missed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("site.db");
        let mut store = Store::open(&path, Durability::Full).unwrap();
        let mut guard = Guard::of(&path);
        write(&mut store, 0);
        assert_eq!(guard.look(), Ok(()));
        let index = folder.path().join("site.db-shm");
        std::fs::remove_file(&index).unwrap();
        assert_eq!(guard.look(), Err((index, Lost::Removed)));
    }
}
