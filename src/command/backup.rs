//! `tirante backup`: copies a store, while the daemon writes to it.

use super::which_store::WhichStore;
use crate::site::store::Reader;
use std::fs;
use std::path::PathBuf;
use std::process::ExitCode;

/// Copy a store, also while the daemon writes to it.
///
/// The copy is one file, checked row by row; it replaces an older copy of that name. Copying the files of a store
/// by other means while it is written gives a damaged copy.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Example:
  tirante backup --config /etc/tirante/tirante.toml /media/backup/site.sqlite")]
pub struct Args {
    /// File to write.
    #[arg(value_name = "FILE")]
    pub target: PathBuf,

    /// Store to copy.
    #[command(flatten)]
    pub which: WhichStore,
}

/// Runs the command.
///
/// # Errors
/// No store is named, it cannot be read, or the copy cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let reader = Reader::open(&args.which.path()?)?;
    if let Some(folder) = args
        .target
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty() && !folder.is_dir())
    {
        anyhow::bail!(
            "{}: the folder {} does not exist",
            args.target.display(),
            folder.display()
        );
    }
    reader.copy_to(&args.target)?;
    let bytes = fs::metadata(&args.target)?.len();
    let line = format!("{}: {bytes} bytes, checked\n", args.target.display());
    super::print(line.as_bytes())
}
