//! A new store beside a journal that filled another: told, because what people asked of the other is not in it, whether it was
//! lost or the path is mistyped. The start goes on: a lost store comes back unattended.

use super::live::folder_of;
use crate::analysis::signal::record::Timestamp;
use crate::config::Config;
use crate::recording::part;
use crate::service::telemetry::{Fault, Health};
use crate::site::clock;
use crate::site::store::{ConditionEvent, Store, StoreError};
use std::fs;
use std::path::Path;
use std::time::UNIX_EPOCH;

/// Tells of a store that no daemon has worked on, if parts of its journal are older. The notice is in the store before any
/// record, so a kill neither loses nor repeats it; it ends by itself, as nothing holds the condition.
///
/// # Errors
/// The store cannot be read or written.
pub(super) fn look(store: &mut Store, config: &Config, health: &Health) -> Result<(), StoreError> {
    let is_blank = store.stretches()?.is_empty() && store.last_record()? == 0 && store.latest_notice()? == 0;
    // One that replaces a damaged store is told as that.
    if !is_blank || store.moved_aside().is_some() {
        return Ok(());
    }
    let now = clock::now();
    let begun = store.expected()?.into_values().min().unwrap_or(now);
    let journal = folder_of(config, store.path());
    let older = older_than(&journal, begun);
    if older == 0 {
        return Ok(());
    }
    let about = store.path().display().to_string();
    let detail = format!(
        "the store {about} is new, but {older} parts of the journal {} are older: another store was filled from them, and was lost, or \
         [store] path is mistyped. The journal is read again and baselines are learned anew; acknowledgements and baselines that \
         were asked for in the other store are not in this one. Conditions that an earlier daemon told of the other (`files`) are \
         over",
        journal.display()
    );
    let notice = ConditionEvent::raised(Fault::StoreNew.code(), &about, now, &detail);
    store.watch(&[notice], None)?;
    health.fault(Fault::StoreNew, &detail);
    Ok(())
}

/// Number of a journal's parts written before a time; none of a folder that cannot be read, which is told elsewhere.
fn older_than(journal: &Path, time: Timestamp) -> usize {
    let parts = part::list(journal).unwrap_or_default();
    let is_older = |number: &u32| {
        let written = fs::metadata(part::path(journal, *number)).and_then(|data| data.modified());
        let since = written.ok().and_then(|at| at.duration_since(UNIX_EPOCH).ok());
        let nanos = since.and_then(|since| i64::try_from(since.as_nanos()).ok());
        nanos.is_some_and(|nanos| Timestamp::from_nanos(nanos) < time)
    };
    parts.iter().filter(|number| is_older(number)).count()
}
