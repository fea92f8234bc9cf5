//! `tirante hub key`: draws an NKEY.

use crate::command::print;
use anyhow::Context;
use nkeys::KeyPair;
use std::fs::OpenOptions;
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::PathBuf;
use std::process::ExitCode;

/// Draw a key: its seed into a file, its public part to stdout.
///
/// The seed is the login of a site or of the hub at the NATS server. The server's configuration names the public part
/// alone. A present file is not replaced. With `--commands` it is no login, but signs commands to the sites whose `[forward] command_key` is
/// its public part.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:
  tirante hub key todi.nk        # prints U…, for `nkey:` of the server's users
  tirante hub key --commands commands.nk   # prints O…, for `command_key` of sites")]
pub struct Args {
    /// File for the seed; only its owner may read it.
    #[arg(value_name = "FILE")]
    pub file: PathBuf,

    /// Draw a key of commands.
    #[arg(long)]
    pub commands: bool,
}

/// Runs the command.
///
/// # Errors
/// The file is there, or cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let pair = if args.commands {
        KeyPair::new_operator()
    } else {
        KeyPair::new_user()
    };
    let seed = pair.seed().context("drawing a key")?;
    let mut file = OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(0o600)
        .open(&args.file)
        .with_context(|| args.file.display().to_string())?;
    writeln!(file, "{seed}")?;
    file.sync_all()?;
    print(format!("{}\n", pair.public_key()).as_bytes())
}
