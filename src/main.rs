//! The `tirante` program: logging, dispatch, exit codes.

use clap::Parser;
use std::process::ExitCode;
use tirante::command;
use tirante::command::cli::Cli;

fn main() -> ExitCode {
    let cli = Cli::parse();
    cli.start_logging();
    match command::run(&cli.command) {
        Ok(code) => code,
        Err(error) => command::report(&error),
    }
}
