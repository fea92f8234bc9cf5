//! `tirante fleet plan`: one task a site, with its manifest.

use super::super::BadArguments;
use super::super::progress::size;
use crate::recording::atomic::AtomicFile;
use crate::site::fleet::identity::Thoroughness;
use crate::site::fleet::plan::{Wanted, parts, plan};
use crate::site::fleet::task::{Input, Task};
use anyhow::Context;
use std::fs;
use std::io::{ErrorKind, Write};
use std::path::PathBuf;
use std::process::ExitCode;

/// Make one task a site from an archive and its configurations.
///
/// The recordings of a site lie in ARCHIVE/SITE, at any depth (*.mcap); its configuration is DIR/SITE.toml. A folder
/// without a configuration and a configuration without a folder are refused. Each line of the plan is a task: the
/// files with size and identity, the hash of the configuration, the version of the analysis, the expected cost. The
/// costliest comes first.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante fleet plan /archive --configs /configs --out plan.jsonl
  tirante fleet plan /archive --configs /configs --out two.jsonl \\
      --site duomo --site badia
  tirante fleet plan results --from-stores --configs /new --out again.jsonl
  tirante fleet plan /archive --configs /configs --split 3600 \\
      --out parts.jsonl

A file is known by its size and the SHA-256 of its first and last 64 KiB
(`ends:`): a finished MCAP file ends with its statistics and checksums. Bytes
changed inside a file of the same size and the same ends are not noticed, but
with --thorough, which reads every byte (`sha256:`), now and before each task.")]
pub struct Args {
    /// Folder with one folder for each site.
    #[arg(value_name = "ARCHIVE")]
    pub archive: PathBuf,

    /// Folder with SITE.toml for each site.
    #[arg(long, value_name = "DIR")]
    pub configs: PathBuf,

    /// File to write.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,

    /// Only this site; may be repeated. Others are not looked at.
    #[arg(long = "site", value_name = "SITE")]
    pub sites: Vec<String>,

    /// The folders hold one store each (*.db, as `fleet task` writes it) instead of recordings: its records
    /// are analysed again without samples.
    #[arg(long)]
    pub from_stores: bool,

    /// Make tasks of parts instead, for each site that is expected to cost more than so many seconds of processor: each
    /// part searches a share of its records. Run them before the plan of the sites, with the same --out: the site's own
    /// task takes what the parts found, and its result is the same with and without them.
    #[arg(long, value_name = "SECONDS", conflicts_with = "from_stores", value_parser = seconds)]
    pub split: Option<f64>,

    /// Read every byte of every file.
    #[arg(long)]
    pub thorough: bool,
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err("a time in seconds above 0, such as 3600".to_owned()),
    }
}

/// Runs the command.
///
/// # Errors
/// Folders, files and configurations that do not fit, all of them; the plan cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let wanted = Wanted {
        archive: &args.archive,
        configs: &args.configs,
        sites: &args.sites,
        input: match args.from_stores {
            true => Input::Store,
            false => Input::Recordings,
        },
        thoroughness: match args.thorough {
            true => Thoroughness::Whole,
            false => Thoroughness::Ends,
        },
    };
    let mut tasks = plan(&wanted).map_err(|faults| BadArguments(faults.join("\n")))?;
    if let Some(longest_s) = args.split {
        let longest = tasks.first().map_or(0.0, |task| task.cost_s);
        tasks = parts(&tasks, longest_s);
        if tasks.is_empty() {
            // An older plan there would pass for this one.
            if let Err(error) = fs::remove_file(&args.out)
                && error.kind() != ErrorKind::NotFound
            {
                return Err(error).with_context(|| format!("--out {}", args.out.display()));
            }
            let line = format!(
                "no site is expected to cost more than {longest_s} s, the costliest {longest:.0} s: nothing to split, there is no {}\n",
                args.out.display()
            );
            return super::super::print(line.as_bytes());
        }
    }
    let write = || -> std::io::Result<()> {
        let mut file = AtomicFile::create(&args.out)?;
        for task in &tasks {
            serde_json::to_writer(&mut file, task)?;
            file.write_all(b"\n")?;
        }
        file.commit()
    };
    write().with_context(|| format!("--out {}", args.out.display()))?;
    // Parts of a site are told as one, as they read the same files.
    let is_first = |task: &&Task| task.part.is_none_or(|part| part.number == 0);
    let files: usize = tasks.iter().filter(is_first).map(|task| task.files.len()).sum();
    let bytes: u64 = tasks.iter().filter(is_first).map(|task| task.bytes).sum();
    let cost_h = tasks.iter().map(|task| task.cost_s).sum::<f64>() / 3600.0;
    let longest = tasks.first().map_or(0.0, |task| task.cost_s / 3600.0);
    let last = tasks.len().saturating_sub(1);
    let line = format!(
        "{}: {} tasks (index 0 to {last}), {files} files, {}; about {cost_h:.2} core-hours, the longest task {longest:.2}\n",
        args.out.display(),
        tasks.len(),
        size(bytes)
    );
    super::super::print(line.as_bytes())
}
