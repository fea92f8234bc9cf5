//! `tirante manual`: writes man pages and shell completions, for packages.

use anyhow::Context;
use clap_complete::Shell;
use std::fs;
use std::path::PathBuf;
use std::process::ExitCode;

/// Write man pages and shell completions into a folder.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder to write; created if missing, existing files are overwritten.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// Runs the command; `program` is the whole program's command line.
///
/// # Errors
/// A file cannot be written.
pub fn run(args: &Args, program: &clap::Command) -> anyhow::Result<ExitCode> {
    let folder = &args.out;
    let write = || -> std::io::Result<()> {
        fs::create_dir_all(folder)?;
        clap_mangen::generate_to(program.clone(), folder)?;
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            clap_complete::generate_to(shell, &mut program.clone(), "tirante", folder)?;
        }
        Ok(())
    };
    write().with_context(|| format!("{} cannot be written", folder.display()))?;
    Ok(ExitCode::SUCCESS)
}
