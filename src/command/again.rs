//! Runs a store's records through the plans again, without their recordings; counted as a campaign's are.

use super::BadArguments;
use super::campaign::{Became, OnEvent, is_broken_pipe};
use super::progress::Progress;
use super::tally::Tally;
use crate::config::Config;
use crate::site::analyse::{Analysed, Known};
use crate::site::prepared::Plans;
use crate::site::reanalysis::{self, ReanalysisError};
use crate::site::store::Reader;
use std::fs;
use std::ops::ControlFlow;
use std::path::Path;

/// Opens the store to be read, after checking that `config` needs no samples and that its results go elsewhere.
///
/// # Errors
/// It is the store that is written, the configuration needs samples, or the store cannot be read.
pub fn open(from: &Path, into: Option<&Path>, config: &Config) -> anyhow::Result<Reader> {
    let into = into.or(config.store.path.as_deref());
    let is_itself = into.is_some_and(|into| {
        let whole = |path| fs::canonicalize(path).ok();
        whole(into).is_some() && whole(into) == whole(from)
    });
    if is_itself {
        let why = format!(
            "--from-store {}: the results would go into the same store; name another with --store",
            from.display()
        );
        return Err(BadArguments(why).into());
    }
    let reader = Reader::open(from)?;
    match reanalysis::check(&reader, config) {
        Ok(()) => Ok(reader),
        Err(ReanalysisError::NeedsSamples(why)) => Err(BadArguments(why).into()),
        Err(error) => Err(error.into()),
    }
}

/// Runs every record of a store through its rod's plan on `workers` threads and hands the results to `on_event` in the
/// order they were stored. `None` if the reader of stdout has seen enough.
///
/// # Errors
/// The store cannot be read, or `on_event` failed.
pub fn run(
    reader: Reader,
    plans: &Plans,
    workers: usize,
    known: &Known,
    mut on_event: impl OnEvent,
) -> anyhow::Result<Option<Tally>> {
    let all = reader.count_found()?;
    let bar = Progress::new(
        all,
        "{bar:40} {percent:>3} %  {human_pos} of {human_len} records, {eta} left",
    );
    let mut tally = Tally::default();
    let mut failure = None;
    reanalysis::run(reader, plans, known, workers, |analysed, before, done| {
        bar.set(done, all);
        let became = match analysed {
            Analysed::Known(..) => Ok(Became::Known),
            _ => on_event(analysed, None, before, &bar),
        };
        match became {
            Err(error) => {
                failure = Some(error);
                return ControlFlow::Break(());
            }
            Ok(became) => tally.event(analysed, &became, &bar),
        }
        ControlFlow::Continue(())
    })?;
    match failure {
        Some(error) if is_broken_pipe(&error) => Ok(None),
        Some(error) => Err(error),
        None => Ok(Some(tally)),
    }
}
