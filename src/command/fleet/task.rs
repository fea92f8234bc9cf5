//! `tirante fleet task`: one site of a plan, as a task of any batch scheduler.

use super::super::again;
use super::super::campaign::{self, Became, Reading};
use super::super::foreign::Foreign;
use super::super::progress::Progress;
use super::super::setup::{self, GivenUp, Prepared};
use super::super::tally::Tally;
use super::super::{BadArguments, print};
use super::part::search;
use super::{place, refused, why};
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::site::analyse::Analysed;
use crate::site::driver;
use crate::site::fleet::part::{self, Parts};
use crate::site::fleet::task::{self as plan, Input, Task};
use crate::site::pictures::Pictures;
use crate::site::records::Others;
use crate::site::store::{Commit, Durability, FileMark, Position, Reader, Store, StoreError};
use anyhow::{Context, bail};
use std::env;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Variables that hold the array index: Slurm, Kubernetes Indexed Jobs, AWS Batch.
const INDICES: [&str; 3] = [
    "SLURM_ARRAY_TASK_ID",
    "JOB_COMPLETION_INDEX",
    "AWS_BATCH_JOB_ARRAY_INDEX",
];

/// Time between lines of progress in a job's log.
pub(super) const TOLD_EVERY: Duration = Duration::from_secs(60);

/// Run one task of a plan: what `replay --store` does, for one site.
///
/// The result is RESULTS/SITE/HASH.db, a store like any other (that of a part HASH.part-K-of-N, for the site's task), named by the hash of configuration, files and version
/// of the analysis. It appears when it is whole. Killed anywhere and run again, the task ends in the same result;
/// run once more, it checks the result and ends; one that is damaged is made anew.
///
/// Exit codes: 0 the result stands (rejected records are part of it), 1 try again, 2 another attempt ends the same way: plan
/// again or correct the arguments.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante fleet task plan.jsonl --index 3 --out results
  sbatch --array=0-99 config/fleet/slurm.sh plan.jsonl results
  tirante fleet task plan.jsonl --out /results --archive /archive \\
      --configs /configs --scratch /tmp

Without --index it is that of the scheduler: SLURM_ARRAY_TASK_ID,
JOB_COMPLETION_INDEX (Kubernetes) or AWS_BATCH_JOB_ARRAY_INDEX.")]
pub struct Args {
    /// Plan of `fleet plan`.
    #[arg(value_name = "PLAN")]
    pub plan: PathBuf,

    /// Index of the task, from 0; default: that of the scheduler.
    #[arg(long, value_name = "N")]
    pub index: Option<usize>,

    /// Folder of the results.
    #[arg(long, value_name = "RESULTS")]
    pub out: PathBuf,

    /// Folder for the store under way, on a disk of this machine: SQLite cannot work on a network file system.
    /// Default: beside the result.
    #[arg(long, value_name = "DIR")]
    pub scratch: Option<PathBuf>,

    /// The archive, if this machine has it elsewhere than the plan says.
    #[arg(long, value_name = "DIR")]
    pub archive: Option<PathBuf>,

    /// The configurations, if this machine has them elsewhere.
    #[arg(long, value_name = "DIR")]
    pub configs: Option<PathBuf>,

    /// Number of threads that analyse records, besides the reader's; default: one per core.
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

/// Runs the command.
///
/// # Errors
/// No or several indices, a plan that no longer holds, files out of reach, a result that cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let index = index(args.index)?;
    let mut tasks = plan::read(&args.plan, Some(index)).map_err(refused)?;
    let Some(mut task) = tasks.pop() else {
        bail!("{}: no task {index}", args.plan.display());
    };
    if let Some(archive) = &args.archive {
        task.archive.clone_from(archive);
    }
    if let Some(configs) = &args.configs {
        task.configs.clone_from(configs);
    }
    let result = task.result_in(&args.out);
    let site = &task.site;
    if is_there(&format!("task {index}, site {site}"), &result)? {
        // Of a task that was killed behind its result, or of a part that came after it.
        part::remove(&args.out.join(site), &task.result);
        let line = format!(
            "task {index}, site {site}: {} is there already\n",
            result.display()
        );
        return print(line.as_bytes());
    }
    let folder = args.out.join(site);
    fs::create_dir_all(&folder).with_context(|| format!("--out {}", folder.display()))?;
    if let Some(part) = task.part {
        return search(&task, part, &folder, args.threads);
    }
    let scratch = args.scratch.as_deref().unwrap_or(&folder);
    fs::create_dir_all(scratch).with_context(|| format!("--scratch {}", scratch.display()))?;
    let work = scratch.join(format!(".{site}-{}.tmp", task.result));
    let begun = Instant::now();
    let parts = parts(&task, &folder);
    let (tally, marks) = analyse(&task, &work, &parts, args.threads)?;
    // A daemon may have gone on with the store meanwhile.
    if task.input == Input::Store
        && let Err(error) = task.check_files()
    {
        tidy(&work, &work);
        return Err(refused(error));
    }
    if tally.has_lost() {
        // What was lost would come behind what came after it.
        tidy(&work, &work);
        bail!(
            "task {index}, site {site}: {tally}: no result; run the task again, and report what breaks again"
        );
    }
    // Equal tasks end in equal bytes, however often they were killed: the log of a store tells of that, and its id is drawn.
    let id: String = task.result.chars().take(16).collect();
    let mut store = Store::open(&work, Durability::Replay)?;
    store.commit(&Commit {
        files: &marks,
        ..Commit::default()
    })?;
    store.restart_log(&id)?;
    drop(store);
    // One file, without what a write-ahead log leaves; checked row by row.
    let copy = scratch.join(format!(".{site}-{}.copy", task.result));
    let reader = Reader::open(&work)?;
    let (records, rejected) = reader.count_records()?;
    reader.copy_to(&copy)?;
    drop(reader);
    place::put(&copy, &result).with_context(|| format!("{}", result.display()))?;
    tidy(&work, &copy);
    let of_parts = match parts.used() {
        0 => String::new(),
        count => format!(", {count} searched in parts"),
    };
    drop(parts);
    part::remove(&folder, &task.result);
    let line = format!(
        "task {index}, site {site}: {records} records, {rejected} rejected{of_parts}{} in {}, {:.1} s\n",
        tally.losses(),
        result.display(),
        begun.elapsed().as_secs_f64()
    );
    print(line.as_bytes())
}

/// True if a result is in its place, checked to its last row as a collection checks it; one that is damaged is told, and
/// made anew.
fn is_there(of: &str, result: &Path) -> anyhow::Result<bool> {
    match Reader::open_whole(result) {
        Ok(_) => Ok(true),
        Err(StoreError::Missing { .. } | StoreError::NoFolder { .. }) => Ok(false),
        Err(error @ (StoreError::Damaged { .. } | StoreError::Foreign { .. })) => {
            tell!("warning: {of}: {}: it is made anew", why(result, &error));
            Ok(false)
        }
        Err(error @ StoreError::Newer { .. }) => Err(BadArguments(error.to_string()).into()),
        Err(error) => Err(error.into()),
    }
}

/// Index of the task: that given, or that of the one scheduler that says one.
fn index(given: Option<usize>) -> Result<usize, BadArguments> {
    if let Some(index) = given {
        return Ok(index);
    }
    let said: Vec<(&str, String)> = INDICES
        .iter()
        .filter_map(|name| env::var(name).ok().map(|value| (*name, value)))
        // Set and empty is what is left of a scheduler's variable that a script cleared.
        .filter(|(_, value)| !value.trim().is_empty())
        .collect();
    match said.as_slice() {
        [] => Err(BadArguments(format!(
            "which task? Say --index N, or run it as an array job: none of {} is set",
            INDICES.join(", ")
        ))),
        [(name, value)] => value.trim().parse().map_err(|_| {
            BadArguments(format!(
                "{name} is {value:?}, and a task's index is a number from 0"
            ))
        }),
        several => {
            let names: Vec<String> = several
                .iter()
                .map(|(name, value)| format!("{name}={value}"))
                .collect();
            Err(BadArguments(format!(
                "which task? {} are set together: say --index N",
                names.join(" and ")
            )))
        }
    }
}

/// Analyses all files of a task into the store under way, which goes on from where an attempt before was killed; returns
/// what became of the files, too.
fn analyse(
    task: &Task,
    work: &Path,
    parts: &Parts,
    threads: Option<u16>,
) -> anyhow::Result<(Tally, Vec<FileMark>)> {
    let config = task.config().map_err(refused)?;
    task.check_files().map_err(refused)?;
    let paths = task.paths();
    let from = match (task.input, paths.as_slice()) {
        (Input::Recordings, _) => None,
        (Input::Store, [store]) => Some(again::open(store, Some(work), &config)?),
        (Input::Store, _) => {
            let why = format!(
                "site {}: one store is analysed again, and the plan has {}: plan again",
                task.site,
                paths.len()
            );
            return Err(BadArguments(why).into());
        }
    };
    let Prepared { generation, mut site } = setup::site(config, Some(work), &GivenUp::default(), false)?;
    let known = site.store().all_known().clone();
    if let Some(from) = &from {
        site = site.without_samples(Pictures::of(from)?);
    }
    // What was lost before the old store is lost to the new one.
    let marked = from.as_ref().map(Reader::files).transpose()?;
    let mut log = Log::of(task);
    let on_event =
        |analysed: &Analysed, place: Option<Position<'_>>, before: Option<[u8; 32]>, bar: &Progress| {
            let taken = site.take_event(analysed, place, before)?;
            if let (Some(taken), Analysed::Record(_)) = (&taken, analysed) {
                log.record(&taken.row.rod, taken.row.start, bar);
            }
            Ok(Became::of(taken))
        };
    let reading = Reading {
        threads,
        follow: false,
    };
    let tally = match from {
        Some(from) => again::run(from, &generation.plans, reading.workers(), &known, on_event)?,
        None => {
            let others = Others {
                how: Foreign::default().how(),
                is_meant: true,
                any_start: false,
                needs_all: true,
            };
            campaign::run(
                &paths,
                &generation.config,
                &generation.plans,
                &reading,
                others,
                |job| driver::work_by(job, &known, |plan, record| parts.run(plan, record)),
                on_event,
            )?
        }
    };
    // Nothing is written to stdout here that a reader could have seen enough of.
    let tally = tally.unwrap_or_default();
    let marks = match marked {
        Some(marked) => marked.into_values().collect(),
        None => task.marks(tally.damaged()),
    };
    Ok((tally, marks))
}

/// Parts of the task's search that are there; without them all records are searched here.
fn parts(task: &Task, folder: &Path) -> Parts {
    let of = format!("task {}, site {}", task.index, task.site);
    let passed_over = |path: &Path, why: &io::Error| {
        tell!(
            "warning: {}: {why}: its records are searched again",
            path.display()
        );
    };
    match Parts::open(folder, &task.result, passed_over) {
        Ok(parts) => {
            if parts.searched() > 0 {
                tell!("{of}: {} records were searched in parts", parts.searched());
            }
            parts
        }
        Err(why) => {
            let folder = folder.display();
            tell!(
                "warning: {of}: the parts in {folder} cannot be listed ({why}): all records are searched here"
            );
            Parts::default()
        }
    }
}

/// Removes the store under way and its companions. The result is in its place: what cannot be removed only takes room.
fn tidy(work: &Path, copy: &Path) {
    for ending in ["", "-wal", "-shm", ".lock"] {
        let mut name = work.as_os_str().to_owned();
        name.push(ending);
        let _ = fs::remove_file(PathBuf::from(name));
    }
    let _ = fs::remove_file(copy);
}

/// Lines of progress for a job's log.
struct Log<'a> {
    task: &'a Task,
    records: u64,
    told: Instant,
}

impl<'a> Log<'a> {
    fn of(task: &'a Task) -> Self {
        Self {
            task,
            records: 0,
            told: Instant::now(),
        }
    }

    fn record(&mut self, rod: &RodId, start: Option<Timestamp>, bar: &Progress) {
        self.records += 1;
        if self.told.elapsed() < TOLD_EVERY {
            return;
        }
        self.told = Instant::now();
        let at = start.map_or_else(String::new, |start| format!(" at {start}"));
        let share = match (start, self.task.span()) {
            (Some(start), Some((from, to))) if to > from => {
                let share = start.seconds_since(from) / to.seconds_since(from);
                format!("{:.0} % of the time span, ", 100.0 * share.clamp(0.0, 1.0))
            }
            _ => String::new(),
        };
        bar.say(&format!(
            "task {}, site {}: {share}{} records, rod {rod}{at}",
            self.task.index, self.task.site, self.records
        ));
    }
}
