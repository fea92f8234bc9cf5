//! `tirante check`: reports every fault of a configuration at once, or prints the effective one.

use super::progress::Progress;
use crate::analysis::inference;
use crate::analysis::track::settings::TemperatureUse;
use crate::config::settings::credential::CredentialPath;
use crate::config::{Config, ConfigError, RodConfig, Setting};
use crate::service::http::Access;
use crate::site::baselines::{self, Prospect};
use crate::site::clock;
use crate::site::store::Reader;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Check a configuration and report every fault.
///
/// Every fault comes with its key and line (exit code 2), files with secrets that others can read among them. Without a fault the configuration is printed with all
/// defaults filled in.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  tirante check config/todi.toml
  tirante check config/todi.toml --set abc.draws=1000000
  tirante check site.toml --against site.db")]
pub struct Args {
    /// Configuration; default: the built-in rod of the paper.
    #[arg(value_name = "FILE", conflicts_with = "config")]
    pub path: Option<PathBuf>,
    /// Configuration, as for the other commands.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Override one configuration key (KEY=VALUE); may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub settings: Vec<Setting>,
    /// Print only faults and set the exit code; no effective configuration.
    #[arg(long, short)]
    pub quiet: bool,
    /// Store to check against: prints for each of its rods if the baseline would be kept, and the reason if
    /// not. Exit code 3 if one would be lost.
    #[arg(long, value_name = "STORE")]
    pub against: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// Standard output cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let path = args.path.as_deref().or(args.config.as_deref());
    let config = Config::resolve(path, &args.settings);
    match config {
        Ok(config) => {
            if let Some(store) = &args.against {
                return against(&config, store, args.quiet);
            }
            for rod in &config.rods {
                if !args.quiet {
                    name_sensors(rod);
                    name_blindness(rod, &config);
                }
                doubt_dates(rod);
            }
            let contradict = config.rods.iter().filter(|rod| !agree(rod, config.seed));
            let is_contradicted = contradict.count() > 0;
            if !are_secrets_kept(&config) || is_contradicted {
                return Ok(ExitCode::from(super::USAGE));
            }
            if !args.quiet {
                return super::print(config.effective().as_bytes());
            }
            Ok(ExitCode::SUCCESS)
        }
        Err(error) => Ok(refuse(&error)),
    }
}

/// True if each file with a secret that is on this machine is one that the daemon will take; says so where it is not.
fn are_secrets_kept(config: &Config) -> bool {
    let is_here = |file: &CredentialPath| file.resolved().is_ok_and(|path| path.exists());
    let mut faults = Vec::new();
    if config.http.token_file.as_ref().is_some_and(is_here)
        && let Err(error) = Access::of(&config.http)
    {
        faults.push(error.to_string());
    }
    for sink in &config.sinks {
        if let Some(file) = sink.secret().filter(|file| is_here(file))
            && let Err(error) = file.read_line()
        {
            faults.push(format!("sink {}: {error}", sink.id));
        }
    }
    let others = [
        ("bucket", config.bucket.as_ref().map(|bucket| &bucket.credentials)),
        (
            "forward",
            config
                .forward
                .as_ref()
                .and_then(|forward| forward.nats.credentials.as_ref()),
        ),
    ];
    for (table, file) in others {
        if let Some(file) = file.filter(|file| is_here(file))
            && let Err(error) = file.read_private()
        {
            faults.push(format!("{table}.credentials: {error}"));
        }
    }
    for fault in &faults {
        tell!("{fault}");
    }
    faults.is_empty()
}

/// Warns of tests that are still to come: no record can be of their moment.
fn doubt_dates(rod: &RodConfig) {
    let latest = clock::latest_past(clock::now());
    for test in rod.analysis.tests.iter().filter(|test| test.time > latest) {
        let (rod, time) = (&rod.analysis.rod, test.time);
        tell!("warning: rod {rod}: a test is dated {time}, which is still to come: no record has its force");
    }
}

/// True if a rod's tests agree with each other and with its prior; says so where they do not.
fn agree(rod: &RodConfig, seed: u64) -> bool {
    let RodConfig { analysis, .. } = rod;
    if analysis.tests.is_empty() {
        return true;
    }
    let tests: Vec<_> = analysis.tests.iter().map(|test| test.data.clone()).collect();
    let sampling = || inference::agreed(&analysis.prior, &analysis.discrepancy, &tests, seed);
    match Progress::during(&format!("rod {}: its tests together", analysis.rod), sampling) {
        Ok((_, doubts)) => {
            for doubt in doubts {
                tell!("warning: rod {}: its tests hardly agree: {doubt}", analysis.rod);
            }
            true
        }
        Err(error) => {
            tell!("rod {}: tests of the rod: {error}", analysis.rod);
            false
        }
    }
}

/// Names the sensors that a rod with several expects, on stderr.
fn name_sensors(rod: &RodConfig) {
    let sensors = rod.analysis.sensors.iter();
    let named: Vec<String> = sensors
        .map(|sensor| format!("{} at {} l", sensor.name, sensor.at))
        .collect();
    if let (Some(beside), id) = (&rod.channels.beside, &rod.analysis.rod) {
        tell!(
            "rod {id}: {} sensors, identified jointly: {}; one is waited for up to {} h (track.reorder_window_h, a minute at least)",
            named.len(),
            named.join(", "),
            beside.wait_s / 3600.0
        );
    }
}

/// Says what is not told of a rod without a thermometer, on stderr.
fn name_blindness(rod: &RodConfig, config: &Config) {
    if rod.channels.temperature.is_none() && config.track.temperature == TemperatureUse::Compensate {
        tell!(
            "rod {}: no thermometer ([rod.temperature]): unless its tables bring a temperature, only sudden changes are told that are \
             larger than what the weather does from record to record, and no slow ones (docs/alarms.md); `tirante status` shows how large",
            rod.analysis.rod
        );
    }
}

/// Reports the effect of the configuration on the baselines of a store; only those that would be lost, if quiet.
fn against(config: &Config, store: &Path, is_quiet: bool) -> anyhow::Result<ExitCode> {
    let prospects = baselines::prospects(&Reader::open(store)?, config)?;
    let is_lost = |prospect: &Prospect| prospect.fate.is_loss();
    let told = prospects.iter().filter(|prospect| !is_quiet || is_lost(prospect));
    let lines: Vec<String> = told.map(|prospect| format!("{prospect}\n")).collect();
    super::print(lines.concat().as_bytes())?;
    Ok(if prospects.iter().any(is_lost) {
        ExitCode::from(super::WITH_LOSSES)
    } else {
        ExitCode::SUCCESS
    })
}

/// Reports the faults of a configuration on stderr; returns the exit code of bad arguments.
pub fn refuse(error: &ConfigError) -> ExitCode {
    tell!("{error}");
    if let ConfigError::Faults { origin, faults } = error {
        let plural = if faults.len() == 1 { "" } else { "s" };
        tell!("{origin}: {} fault{plural}", faults.len());
    }
    ExitCode::from(super::USAGE)
}
