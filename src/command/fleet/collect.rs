//! `tirante fleet collect`: the results of all tasks in one database.

use super::super::progress::{Progress, size};
use super::super::{BadArguments, WITH_LOSSES, print};
use super::refused;
use crate::site::fleet::collect::into_one;
use crate::site::fleet::task::{self as plan, Task};
use crate::site::store::Reader;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Put the results of all tasks into one database, and one Parquet file.
///
/// The database (SQLite) has the tables of each site's store with the column `site` in front: row by row what `replay`
/// writes for the site. The stores themselves stay as they are. Tasks without a result are named, and the exit code
/// is 3; the results that are there are collected all the same.
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
/// The plan or a result cannot be read, or the files cannot be written.
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
    let (there, missing): (Vec<&Task>, Vec<&Task>) = tasks
        .iter()
        .partition(|task| task.result_in(&args.results).is_file());
    let bar = Progress::new(
        there.len() as u64,
        "{bar:40} {human_pos} of {human_len} sites, {eta} left",
    );
    into_one(&there, &args.results, &args.out, |done| {
        bar.set(done as u64, there.len() as u64);
    })?;
    write_parquet(args, &there)?;
    drop(bar);
    let (mut records, mut rejected) = (0, 0);
    for task in &there {
        let counts = Reader::open(&task.result_in(&args.results))?.count_records()?;
        records += counts.0;
        rejected += counts.1;
    }
    let bytes = |path: &Path| fs::metadata(path).map_or(0, |data| data.len());
    let line = format!(
        "{}: {} of {} sites, {records} records, {rejected} rejected, {}\n",
        args.out.display(),
        there.len(),
        tasks.len(),
        size(bytes(&args.out))
    );
    for task in &missing {
        tell!(
            "missing: task {}, site {}: no {}; run: tirante fleet task {} --index {} --out {}",
            task.index,
            task.site,
            task.result_in(&args.results).display(),
            args.plan.display(),
            task.index,
            args.results.display()
        );
    }
    print(line.as_bytes())?;
    Ok(match missing.len() {
        0 => ExitCode::SUCCESS,
        _ => ExitCode::from(WITH_LOSSES),
    })
}

fn write_parquet(args: &Args, tasks: &[&Task]) -> anyhow::Result<()> {
    use super::super::parquet;
    use crate::recording::atomic::AtomicFile;
    use anyhow::Context;

    let stores: Vec<(String, PathBuf)> = tasks
        .iter()
        .map(|task| (task.site.clone(), task.result_in(&args.results)))
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
