//! The core while its store cannot be written: it waits for room on a full disk, or for the very file to be back.

use super::{Core, CoreError, Notice};
use crate::service::api::Monitoring;
use crate::service::daemon::guard::Guard;
use crate::service::daemon::opening::open_site;
use crate::service::telemetry::Fault;
use crate::site::clock;
use crate::site::store::{self, Reserved, StoreError};
use crate::site::trackers::Site;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::thread;
use std::time::{Duration, Instant};

/// Free space at which work resumes after the disk was full \[bytes\].
const ROOM: u64 = 8 << 20;
/// Interval between checks of a full disk.
const LOOK: Duration = Duration::from_millis(250);

impl Core {
    /// Runs `act` on site and store, and again from the beginning if the disk was full: the trackers in
    /// memory are then ahead of the store, so both are read anew from the disk. Records in the store are
    /// known by content, so none is taken twice.
    pub(super) fn durable<T>(
        &mut self,
        mut act: impl FnMut(&mut Site) -> Result<T, StoreError>,
    ) -> Result<T, CoreError> {
        let mut tries = 0;
        loop {
            let Some(site) = &mut self.site else {
                return Err(CoreError::Stopping);
            };
            match act(site) {
                Ok(value) => {
                    if tries > 0 {
                        self.health.over(Fault::DiskFull, &self.about());
                    }
                    return Ok(value);
                }
                Err(error) if error.is_disk_full() => self.wait_for_room(&error, tries)?,
                Err(error) => return Err(error.into()),
            }
            tries += 1;
        }
    }

    /// Closes trackers and store, and opens them again when there is room; waits longer after each failed
    /// try. The lock is kept meanwhile: this daemon is at work on the store.
    pub(super) fn wait_for_room(&mut self, error: &StoreError, tries: u32) -> Result<(), CoreError> {
        let about = self.about();
        let waits = format_args!(
            "{about}: no room on the disk ({error}); nothing is lost, work goes on when there is"
        );
        self.health.hold(Fault::DiskFull, &about, waits);
        let mut reserved = match self.site.take() {
            Some(site) => site.reserve(),
            None => store::reserve(&self.store),
        };
        let begun = Instant::now();
        let mut looks = 1 << tries.min(6);
        loop {
            if self.stopping.load(Ordering::Relaxed) {
                return Err(CoreError::Stopping);
            }
            (self.notify)(Notice::Alive);
            for notice in self.vigil.look() {
                (self.notify)(Notice::Untold(&notice));
            }
            self.tell(reserved.as_ref());
            thread::sleep(LOOK);
            looks -= 1;
            if looks > 0 {
                continue;
            }
            looks = 1;
            if room(&self.store) < ROOM {
                continue;
            }
            drop(reserved.take());
            match open_site(&self.store, &self.generation, &self.health) {
                // The reader does not know that the marks are gone: only a restart reads everything again.
                Ok(site) if site.store().moved_aside().is_some() => return Err(CoreError::Damaged),
                Ok(site) => {
                    self.guard = Guard::of(&self.store);
                    self.site = Some(site);
                    self.silence.forgive(begun.elapsed());
                    return Ok(());
                }
                // Somebody acknowledges an alarm meanwhile.
                Err(error @ StoreError::Held { .. }) => self.health.hold(Fault::DiskFull, &about, error),
                Err(error) if error.is_disk_full() => looks = 1 << 6,
                Err(error) => return Err(error.into()),
            }
            reserved = store::reserve(&self.store);
        }
    }

    /// Checks if the store is still the file that is written. If not, nothing is stored or acknowledged, and
    /// messages go past the store, until the same file is back or the daemon is restarted.
    pub(super) fn look_at_files(&mut self) -> Result<(), CoreError> {
        let begun = Instant::now();
        let mut is_lost = false;
        while let Err((path, what)) = self.guard.look() {
            self.halted.store(true, Ordering::Relaxed);
            let detail = format!(
                "{} {what} while it was written: nothing is kept or acknowledged. Bring the very file back and it goes on; or \
                 start the daemon anew: it begins a new store if there is none or it is damaged, and reads again what folder and \
                 journal hold",
                path.display()
            );
            self.health.hold(Fault::Files, &self.about(), detail);
            is_lost = true;
            if self.stopping.load(Ordering::Relaxed) {
                // Closing it would remove, by its name, a write-ahead log that may be another store's.
                std::mem::forget(self.site.take());
                return Err(CoreError::Stopping);
            }
            (self.notify)(Notice::Alive);
            for notice in self.vigil.look() {
                (self.notify)(Notice::Untold(&notice));
            }
            self.tell(None);
            thread::sleep(LOOK);
        }
        if is_lost {
            self.halted.store(false, Ordering::Relaxed);
            self.health.over(Fault::Files, &self.about());
            self.silence.forgive(begun.elapsed());
        }
        self.keep_lock()
    }

    /// Takes the lock of the store, whose files are in their place, anew if it was removed.
    fn keep_lock(&mut self) -> Result<(), CoreError> {
        let about = self.about();
        let detail = match self.site.as_mut().map_or(Ok(false), Site::keep_lock) {
            Ok(false) => return Ok(()),
            Ok(true) => format!(
                "the lock of {about} was removed, and is taken anew: look if another program wrote into the store"
            ),
            // There must be one writer.
            Err(error @ StoreError::Held { .. }) => return Err(error.into()),
            // The next tick tries again.
            Err(error) => format!("the lock of {about} was removed, and cannot be taken anew: {error}"),
        };
        self.health.fault(Fault::Files, detail);
        Ok(())
    }

    /// Tells those who can ask neither this daemon nor its store why nothing is stored, and the next daemon what the store does not
    /// have, by the lock: `reserved`, or the open store's.
    pub(super) fn tell(&mut self, reserved: Option<&Reserved>) {
        let text = Monitoring::past_the_store(&self.health.conditions(), clock::now());
        let pending = self.vigil.pending();
        let is_nothing = text.is_empty() && pending.is_empty();
        if is_nothing && !self.has_told {
            return;
        }
        self.has_told = !is_nothing;
        match (reserved, &self.site) {
            (Some(reserved), _) => reserved.tell(&pending, &text),
            (None, Some(site)) => site.store().tell(&pending, &text),
            (None, None) => {}
        }
    }
}

/// Free space on the disk of a file \[bytes\]; the maximum if unknown.
fn room(path: &Path) -> u64 {
    let folder = path.parent().unwrap_or(Path::new("."));
    rustix::fs::statvfs(folder).map_or(u64::MAX, |stat| stat.f_bavail.saturating_mul(stat.f_frsize))
}
