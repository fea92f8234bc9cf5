//! `tirante fleet plan`: one task a site, with its manifest.

use super::super::BadArguments;
use super::super::progress::size;
use crate::recording::atomic::AtomicFile;
use crate::site::fleet::identity::Thoroughness;
use crate::site::fleet::plan::{Wanted, plan};
use crate::site::fleet::task::Input;
use anyhow::Context;
use std::io::Write;
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

    /// Read every byte of every file.
    #[arg(long)]
    pub thorough: bool,
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
    let tasks = plan(&wanted).map_err(|faults| BadArguments(faults.join("\n")))?;
    let write = || -> std::io::Result<()> {
        let mut file = AtomicFile::create(&args.out)?;
        for task in &tasks {
            serde_json::to_writer(&mut file, task)?;
            file.write_all(b"\n")?;
        }
        file.commit()
    };
    write().with_context(|| format!("--out {}", args.out.display()))?;
    let files: usize = tasks.iter().map(|task| task.files.len()).sum();
    let bytes: u64 = tasks.iter().map(|task| task.bytes).sum();
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
