//! `tirante fleet`: many sites as a job array.

mod collect;
mod part;
mod place;
mod plan;
mod task;

use super::BadArguments;
use crate::site::fleet::task::TaskError;
use crate::site::store::StoreError;
use std::error::Error as _;
use std::path::Path;
use std::process::ExitCode;

/// Analyse an archive of many sites as a job array.
///
/// `fleet plan` makes one task a site, `fleet task` runs one of them under any batch scheduler, `fleet collect`
/// puts the results into one database. Tasks need nothing of each other, and a task that was killed is run again.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante fleet plan /archive --configs /configs --out plan.jsonl
  for i in $(seq 0 9); do
      tirante fleet task plan.jsonl --index $i --out results
  done
  tirante fleet collect plan.jsonl --results results --out fleet.db

Files for Slurm, Kubernetes and AWS Batch: config/fleet/.")]
pub struct Args {
    /// Step of the work.
    #[command(subcommand)]
    pub step: Step,
}

/// Steps of the work. Their help is that of their arguments: a comment on a variant would take its place.
#[derive(Debug, Clone, clap::Subcommand)]
#[allow(missing_docs, reason = "clap would show it instead of the long help")]
pub enum Step {
    Plan(plan::Args),
    Task(task::Args),
    Collect(collect::Args),
}

/// Runs the command.
///
/// # Errors
/// As the step.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    match &args.step {
        Step::Plan(args) => plan::run(args),
        Step::Task(args) => task::run(args),
        Step::Collect(args) => collect::run(args),
    }
}

/// Reason why a result is not used, without the next step for a store of one's own.
fn why(result: &Path, error: &StoreError) -> String {
    let name = result.display();
    match error {
        StoreError::Missing { .. } | StoreError::NoFolder { .. } => format!("no {name}"),
        StoreError::Damaged { detail, .. } => format!("{name} is damaged ({detail})"),
        StoreError::Foreign { what, .. } => format!("{name} is no result ({what})"),
        other => match other.source() {
            Some(cause) => format!("{other}: {cause}"),
            None => other.to_string(),
        },
    }
}

/// Exit code 2 for what another attempt would not mend.
fn refused(error: TaskError) -> anyhow::Error {
    match error {
        TaskError::Outdated(why) => BadArguments(why).into(),
        TaskError::Unreachable(_) => error.into(),
    }
}
