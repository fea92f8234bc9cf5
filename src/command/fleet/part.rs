//! A task that is a part of a site: the search of a share of its records.

use super::super::campaign::Reading;
use super::super::{print, setup};
use super::task::TOLD_EVERY;
use super::{place, refused};
use crate::site::fleet::part::{self, Part};
use crate::site::fleet::task::Task;
use anyhow::Context;
use std::fs;
use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

/// Searches the records of a part of a site into its file in a folder.
///
/// # Errors
/// A plan that no longer holds, recordings out of reach, a file that cannot be written.
pub fn search(task: &Task, part: Part, folder: &Path, threads: Option<u16>) -> anyhow::Result<ExitCode> {
    let begun = Instant::now();
    let result = folder.join(part.name(&task.result));
    let of = format!(
        "task {}, site {}, part {} of {}",
        task.index,
        task.site,
        part.number + 1,
        part.of
    );
    if result.exists() {
        return print(format!("{of}: {} is there already\n", result.display()).as_bytes());
    }
    let config = task.config().map_err(refused)?;
    task.check_files().map_err(refused)?;
    let plans = setup::plans(&config)?;
    let reading = Reading {
        threads,
        follow: false,
    };
    let mut told = Instant::now();
    let tell = |count| {
        if told.elapsed() > TOLD_EVERY {
            told = Instant::now();
            tell!("{of}: {count} records");
        }
    };
    let (work, paths) = (place::under_way(&result)?, task.paths());
    let searched = part::search(part, &paths, &config, &plans, reading.workers(), &work, tell);
    let count = match searched {
        Ok(count) => count,
        Err(error) => {
            // The first error matters more than a failure to remove the file.
            let _ = fs::remove_file(&work);
            return Err(error).context(of);
        }
    };
    place::settle(&work, &result).with_context(|| result.display().to_string())?;
    let line = format!(
        "{of}: {count} records searched, {}, {:.1} s\n",
        result.display(),
        begun.elapsed().as_secs_f64()
    );
    print(line.as_bytes())
}
