//! The journal's writer while it cannot write: it waits for the very file to be back, or for room on a full disk.

use super::{ABOUT, LOOK_EVERY, Stop, Writer};
use crate::service::journal::retention::{self, Applied};
use crate::service::telemetry::Fault;
use crate::service::telemetry::owned::Owned;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Pause before a full disk is tried again.
const RETRY: Duration = Duration::from_secs(1);

impl Writer {
    /// Waits while the file that is written is no longer the one with its name, or the store is lost: nothing
    /// is accepted or acknowledged then.
    pub(super) fn look_at_files(&mut self) -> Result<(), Stop> {
        if self
            .state
            .looked
            .is_some_and(|looked| looked.elapsed() < LOOK_EVERY)
            && !self.around.halted.load(Ordering::Relaxed)
        {
            return Ok(());
        }
        let mut is_lost = false;
        loop {
            let found = self.state.owned.as_mut().map_or(Ok(()), Owned::look);
            if let Err(what) = found {
                let path = self
                    .state
                    .owned
                    .as_ref()
                    .map(|owned| owned.path().display().to_string());
                let detail = format!(
                    "{} {what} while it was written: nothing is acknowledged. Bring the very file back and it goes on; or start \
                     the daemon anew: senders then send again what is missing, as far as they have it",
                    path.unwrap_or_default()
                );
                self.around.health.hold(Fault::Files, ABOUT, detail);
                is_lost = true;
            }
            if found.is_ok() && !self.around.halted.load(Ordering::Relaxed) {
                break;
            }
            if self.stopping.load(Ordering::Relaxed) {
                return Err(Stop::Asked);
            }
            self.around.beat.pass();
            std::thread::sleep(RETRY / 10);
        }
        if is_lost {
            self.around.health.over(Fault::Files, ABOUT);
        }
        self.state.looked = Some(Instant::now());
        Ok(())
    }

    /// Handles a full disk: nothing is acknowledged, nothing lost. Removes old parts and waits a
    /// little.
    pub(super) fn wait_for_room(&mut self) -> Result<(), Stop> {
        let folder = self.folder.display();
        let detail = format!("{folder}: no room for live data; senders wait until there is");
        self.around.health.hold(Fault::DiskFull, ABOUT, detail);
        self.clean();
        let since = Instant::now();
        while since.elapsed() < RETRY {
            if self.stopping.load(Ordering::Relaxed) {
                return Err(Stop::Asked);
            }
            self.around.beat.pass();
            std::thread::sleep(RETRY / 10);
        }
        Ok(())
    }

    pub(super) fn clean(&self) {
        let done = self.results_kept.load(Ordering::Relaxed);
        // The part that is written is never one whose results are all kept.
        match retention::apply(
            &self.folder,
            done.min(self.next.saturating_sub(2)),
            &self.settings,
            &self.around.vouch,
            self.around
                .copied
                .as_ref()
                .map(|copied| copied.load(Ordering::Relaxed)),
        ) {
            Ok(Applied { removed, waiting }) => {
                if removed > 0 {
                    tracing::info!(removed, "old parts of the journal were removed");
                }
                let health = &self.around.health;
                let waits_for_copy = waiting > 0 && self.around.copied.is_some();
                match &self.settings.backup_stamp {
                    stamp if waits_for_copy => health.hold(
                        Fault::Backup,
                        ABOUT,
                        format_args!(
                            "{waiting} parts of the journal may go and wait: the bucket does not have them yet{}",
                            if stamp.is_some() { ", or no backup has" } else { "" }
                        ),
                    ),
                    Some(stamp) if waiting > 0 => health.hold(
                        Fault::Backup,
                        ABOUT,
                        format_args!(
                            "{waiting} parts of the journal may go and wait for a backup: they were written after {}",
                            stamp.display()
                        ),
                    ),
                    _ => health.over(Fault::Backup, ABOUT),
                }
            }
            Err(fault) => {
                let detail = format!("{}: old parts cannot be removed: {fault}", self.folder.display());
                self.around.health.fault(Fault::Write, detail);
            }
        }
    }
}
