//! `tirante fleet collect`: the results of all tasks in one database.

use super::super::progress::{Progress, size};
use super::super::{BadArguments, WITH_LOSSES, print};
use super::{refused, why};
use crate::site::fleet::collect::{Collected, Counts, into_one};
use crate::site::fleet::task::{self as plan, Task};
use crate::site::store::StoreError;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Put the results of all tasks into one database, and one Parquet file.
///
/// The database (SQLite) has the tables of each site's store with the column `site` in front: row by row what `replay`
/// writes for the site. The stores themselves stay as they are. Tasks whose result is missing or damaged are named, and
/// the exit code is 3; the others are collected all the same. Sites with damaged recordings are named; the table `task`
/// has their number in `damaged`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante fleet collect plan.jsonl --results results --out fleet.db
  tirante fleet collect plan.jsonl --results results --out fleet.db \\
      --parquet fleet.parquet --resonances resonances.parquet
  tirante history --store results/duomo/1f0c….db
  tirante report --store results/duomo/1f0c….db --out .")]
pub struct Args {
    /// Plan of `fleet plan`.
    #[arg(value_name = "PLAN")]
    pub plan: PathBuf,

    /// Folder of the results, as in `fleet task --out`.
    #[arg(long, value_name = "RESULTS")]
    pub results: PathBuf,

    /// Database to write; an older one of that name is replaced.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,

    /// Also write every record of every site as Parquet: the columns of `history --format parquet` after `site`.
    #[arg(long, value_name = "FILE")]
    pub parquet: Option<PathBuf>,

    /// Also write every resonance of every record, labelled or not, as Parquet, one row each.
    #[arg(long, value_name = "FILE")]
    pub resonances: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// The plan cannot be read, or the files cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let tasks = plan::read(&args.plan, None).map_err(refused)?;
    if let Some(task) = tasks.iter().find(|task| task.part.is_some()) {
        return Err(BadArguments(format!(
            "{}: a plan of parts (task {}, site {}): collect the plan of the sites, made without --split",
            args.plan.display(),
            task.index,
            task.site
        ))
        .into());
    }
    let count = tasks.len() as u64;
    let bar = Progress::new(count, "{bar:40} {human_pos} of {human_len} sites, {eta} left");
    let collected = into_one(&tasks, &args.results, &args.out, |done| {
        bar.set(done as u64, count);
    })?;
    let there: Vec<(&Task, &Counts)> = tasks
        .iter()
        .zip(&collected)
        .filter_map(|(task, found)| Some((task, found.as_ref().ok()?)))
        .collect();
    write_parquet(args, &there)?;
    drop(bar);
    let records: u64 = there.iter().map(|(_, counts)| counts.records).sum();
    let rejected: u64 = there.iter().map(|(_, counts)| counts.rejected).sum();
    let bytes = |path: &Path| fs::metadata(path).map_or(0, |data| data.len());
    let line = format!(
        "{}: {} of {} sites, {records} records, {rejected} rejected, {}\n",
        args.out.display(),
        there.len(),
        tasks.len(),
        size(bytes(&args.out))
    );
    for (task, found) in tasks.iter().zip(&collected) {
        tell_of(args, task, found);
    }
    print(line.as_bytes())?;
    Ok(match there.len() == tasks.len() {
        true => ExitCode::SUCCESS,
        false => ExitCode::from(WITH_LOSSES),
    })
}

/// Names a task without a result to use, with the command that makes it anew, and one whose recordings are damaged.
fn tell_of(args: &Args, task: &Task, found: &Collected) {
    let of = format!("task {}, site {}", task.index, task.site);
    match found {
        Ok(Counts {
            damaged: None | Some(0),
            ..
        }) => {}
        Ok(Counts {
            damaged: Some(count), ..
        }) => tell!(
            "lost data: {of}: {count} of {} files damaged or not read; which: tirante files --losses --store {}",
            task.files.len(),
            task.result_in(&args.results).display()
        ),
        Err(error) => {
            let word = match error {
                StoreError::Missing { .. } | StoreError::NoFolder { .. } => "missing",
                _ => "left out",
            };
            tell!(
                "{word}: {of}: {}; run: tirante fleet task {} --index {} --out {}",
                why(&task.result_in(&args.results), error),
                args.plan.display(),
                task.index,
                args.results.display()
            );
        }
    }
}

fn write_parquet(args: &Args, tasks: &[(&Task, &Counts)]) -> anyhow::Result<()> {
    use super::super::parquet;
    use crate::recording::atomic::AtomicFile;
    use anyhow::Context;

    let stores: Vec<(String, PathBuf)> = tasks
        .iter()
        .map(|(task, _)| (task.site.clone(), task.result_in(&args.results)))
        .collect();
    for (path, is_of_records) in [(&args.parquet, true), (&args.resonances, false)] {
        let Some(path) = path else { continue };
        let mut file = AtomicFile::create(path).with_context(|| path.display().to_string())?;
        match is_of_records {
            true => parquet::write_sites(&stores, &mut file)?,
            false => parquet::write_resonances(&stores, &mut file)?,
        }
        file.commit().with_context(|| path.display().to_string())?;
    }
    Ok(())
}
