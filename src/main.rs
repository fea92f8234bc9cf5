//! The `tirante` program: logging, dispatch, exit codes.

use clap::Parser;
use std::process::ExitCode;
use tirante::command;
use tirante::command::cli::Cli;

fn main() -> ExitCode {
    if let Some(code) = command::trial::asked(std::env::args_os()) {
        return code;
    }
    let cli = Cli::parse();
    cli.start_logging();
    match command::run(&cli.command) {
        Ok(code) => code,
        Err(error) => command::report(&error),
    }
}
