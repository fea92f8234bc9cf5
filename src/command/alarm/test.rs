//! `tirante alarm test`: sends a message to every sink, to check that alarms would arrive.

use crate::command::BadArguments;
use crate::config::settings::alert::SinkSettings;
use crate::config::{Config, Setting};
use crate::service::alert::{self, Message, Pace};
use crate::site::clock;
use std::path::PathBuf;
use std::process::ExitCode;

/// Send a test message to every sink of a configuration.
///
/// Exit code 0 if all have it, 1 if not. Run it as the user the daemon runs as, so that it reads the same password
/// files.
#[derive(Debug, Clone, clap::Args)]
pub struct Args {
    /// Configuration.
    #[arg(long, value_name = "FILE")]
    pub config: PathBuf,
    /// Test only this sink; may be repeated.
    #[arg(long = "sink", value_name = "ID")]
    pub sinks: Vec<String>,
    /// Override one configuration key; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub settings: Vec<Setting>,
}

/// Runs the command.
///
/// # Errors
/// A bad configuration, no sink, or no such sink.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let config = Config::resolve(Some(&args.config), &args.settings)?;
    let mut sinks = config.sinks.clone();
    sinks.push(SinkSettings::log());
    for id in &args.sinks {
        if !sinks.iter().any(|sink| sink.id == *id) {
            let known: Vec<&str> = sinks.iter().map(|sink| sink.id.as_str()).collect();
            return Err(BadArguments(format!(
                "{} has no sink \"{id}\", only {}",
                args.config.display(),
                known.join(", ")
            ))
            .into());
        }
    }
    let mut all_have_it = true;
    for settings in &sinks {
        if !args.sinks.is_empty() && !args.sinks.contains(&settings.id) {
            continue;
        }
        let message = Message::test(&config.site, &settings.id, clock::now());
        let mut sink = alert::open(settings, &config.site, Pace::default().deadline);
        let line = match sink.deliver(&message) {
            Ok(()) => format!("{}: delivered, id {}\n", settings.id, message.id),
            Err(failure) => {
                all_have_it = false;
                format!("{}: NOT delivered: {failure}\n", settings.id)
            }
        };
        // At once: the next sink may take ten seconds.
        crate::command::print(line.as_bytes())?;
    }
    Ok(if all_have_it {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}
