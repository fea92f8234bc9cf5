//! Opening the store for a daemon: replaces a damaged one, waits for a full disk.

use super::new_store;
use crate::service::telemetry::{Fault, Health};
use crate::site::baselines::{self, BaselineError};
use crate::site::clock;
use crate::site::prepared::Generation;
use crate::site::store::{self, ConditionEvent, Durability, Store, StoreError};
use crate::site::trackers::{self, Site};
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Interval between tries of a store that cannot be opened yet.
const LOOK: Duration = Duration::from_millis(250);
/// Longest wait for another process that has the store when the daemon starts.
const PATIENCE: Duration = Duration::from_secs(2);

/// Opens the store and resumes from it.
///
/// # Errors
/// As [`Store::open`] and [`Site::open`].
pub fn open_site(path: &Path, generation: &Generation, health: &Health) -> Result<Site, StoreError> {
    site_on(open_store(path, health)?, generation, health)
}

fn open_store(path: &Path, health: &Health) -> Result<Store, StoreError> {
    let mut store = Store::open(path, Durability::Full)?;
    if let Some(aside) = store.moved_aside() {
        let about = path.display().to_string();
        let detail = format!(
            "the store was damaged and is now {}; a new one is begun from the recordings and journal parts that are there; \
             acknowledgements and baselines asked for must be repeated",
            aside.display()
        );
        health.hold(Fault::StoreDamaged, &about, &detail);
        // In the new store before anything else: nothing there would show it after a kill.
        let notice = ConditionEvent::raised(Fault::StoreDamaged.code(), &about, clock::now(), &detail);
        store.watch(&[notice], None)?;
    }
    Ok(store)
}

fn site_on(mut store: Store, generation: &Generation, health: &Health) -> Result<Site, StoreError> {
    new_store::look(&mut store, &generation.config, health)?;
    let name = &generation.config.site;
    let others = trackers::others_in(&store, name)?;
    if !others.is_empty() {
        let others = others.join(", ");
        tracing::warn!(
            "{} holds records of {others}; those of {name} are added to it",
            store.path().display()
        );
    }
    let mut site = Site::open(
        generation.track_plans.iter().cloned(),
        store,
        generation.provenance(),
    )?;
    site.expect_rods(clock::now())?;
    warn_of_renewed(&site);
    Ok(site)
}

/// As [`open_site`] of the configuration's store, but waits while the disk is full, and briefly for another
/// process such as `tirante ack`. Meanwhile it keeps beside the store the line `pending` for the next daemon: no other thread may take the
/// lock.
///
/// # Errors
/// Another process holds the store, it cannot be opened, or the configuration would drop a baseline of a rod
/// that is not `given_up`.
pub fn open_patiently(
    generation: &Generation,
    health: &Health,
    given_up: &[String],
    pending: &Mutex<String>,
) -> Result<Site, BaselineError> {
    // A daemon's configuration names one.
    let path = generation.config.store.path.clone().unwrap_or_default();
    let about = path.display().to_string();
    let deadline = Instant::now() + PATIENCE;
    let open = || -> Result<Site, BaselineError> {
        let store = open_store(&path, health)?;
        baselines::guard(&store, &generation.config, given_up)?;
        Ok(site_on(store, generation, health)?)
    };
    loop {
        match open() {
            Ok(site) => {
                health.over(Fault::DiskFull, &about);
                return Ok(site);
            }
            Err(BaselineError::Store(StoreError::Held { .. })) if Instant::now() < deadline => {}
            Err(BaselineError::Store(error)) if error.is_disk_full() => {
                let detail = format_args!("{about}: no room on the disk ({error}); waiting for it");
                health.hold(Fault::DiskFull, &about, detail);
                let line = pending.lock().unwrap_or_else(PoisonError::into_inner);
                if *line != store::left(&path)
                    && let Some(reserved) = store::reserve(&path)
                {
                    reserved.tell(&line, "");
                }
            }
            Err(error) => return Err(error),
        }
        thread::sleep(LOOK);
    }
}

/// Logs the rods that begin a new segment or go on with an earlier one, and those that are no longer followed.
pub(super) fn warn_of_renewed(site: &Site) {
    for rod in site.unfollowed() {
        tracing::warn!(
            "{rod} is not in the configuration any more: no record of it is taken, and no alarm will come of it"
        );
    }
    for renewed in site.renewed() {
        match renewed.is_found {
            true => tracing::info!("{renewed}"),
            false => tracing::warn!("{renewed}"),
        }
    }
}
