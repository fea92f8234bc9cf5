//! `tirante completions`: prints a shell completion script.

use clap_complete::Shell;
use std::process::ExitCode;

/// Print a shell completion script.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  tirante completions bash \\
      > ~/.local/share/bash-completion/completions/tirante
  tirante completions fish > ~/.config/fish/completions/tirante.fish")]
pub struct Args {
    /// Shell of the script.
    pub shell: Shell,
}

/// Runs the command; `program` is the whole program's command line.
///
/// # Errors
/// Standard output cannot be written.
pub fn run(args: &Args, program: &mut clap::Command) -> anyhow::Result<ExitCode> {
    // Into memory first: the generator panics when its reader has gone.
    let mut script = Vec::new();
    clap_complete::generate(args.shell, program, "tirante", &mut script);
    super::print(&script)
}
