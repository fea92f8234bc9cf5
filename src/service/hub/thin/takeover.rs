//! Taking over of a site: its store on this machine, made from the centre's rows and the kept state.

use super::owned::WorkError;
use crate::service::hub::centre::{Centre, Position};
use crate::service::hub::copy::SiteCopy;
use crate::site::store::{Durability, Store};
use std::path::Path;

/// Makes the store of a site on this machine from what the database has, unless the site is lost meanwhile; returns the last message
/// and the last commit in it.
pub(super) fn fetch(
    centre: &mut Centre,
    site: &str,
    path: &Path,
    is_lost: &dyn Fn() -> bool,
) -> Result<(Position, i64), WorkError> {
    let Some(kept) = centre.kept(site)? else {
        // Made here, so that it can be read before its daemon has begun.
        drop(Store::open(path, Durability::Replay)?);
        return Ok((Position::default(), 0));
    };
    let history = centre.sites()?.remove(site).and_then(|state| {
        let history = state.history()?;
        Some((history.epoch.clone(), history.through))
    });
    let (epoch, through) = (kept.remainder.epoch.clone(), kept.remainder.through);
    let mut store = match &history {
        None if through == 0 => Store::open(path, Durability::Replay)?,
        Some(own) if *own == (epoch, through) => {
            let mut copy = SiteCopy::begin(centre, site, None, None, path)?;
            copy.renew(centre, is_lost)?;
            copy.into_store()
        }
        _ => {
            return Err(WorkError::Contradiction(format!(
                "the centre's rows of {site} end with {history:?}, and its kept state with commit {through} of store {}: rows of this \
                 site were written, or removed, by something else",
                kept.remainder.epoch
            )));
        }
    };
    store.take_up(kept.remainder)?;
    Ok((kept.position, through))
}
