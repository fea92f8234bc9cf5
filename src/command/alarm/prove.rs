//! `tirante alarm prove`: simulated years of whole sites through the real trackers, with the rates of their
//! alarms.

mod proof;

use crate::analysis::lab::synthesis::{Change, Outcome, Trial, World};
use crate::analysis::numerics::random;
use crate::analysis::signal::record::time::{DAY_S, YEAR_D};
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::TrackPlan;
use crate::command::progress::Progress;
use crate::command::setup::choose_rod;
use crate::command::which_store::Output;
use crate::command::{BadArguments, print};
use crate::config::{Config, Setting};
use crate::site::emulator_cache::{self, Cache};
use anyhow::Context;
use proof::Proof;
use rayon::prelude::*;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;
use std::sync::Arc;

/// 1 March 2025: the first midnight.
const START_NS: i64 = 1_740_787_200_000_000_000;

/// Simulate years of whole sites and count the alarms.
///
/// Every rod is followed with the real tracker; the counts are printed next to the guarantees. A site has
/// several rods drawn from the prior, each with a static model discrepancy, under common weather and one
/// thermometer. Frequencies are the exact beam's with measurement errors; no waveform is made. Worlds differ
/// in what makes tracking difficult; a thermometer that fails does so on day 100. The same seed gives the
/// same output at any number of threads.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante alarm prove --histories 200
  tirante alarm prove --world harsh,masonry-30d,mixed --histories 1000 \\
      --format json
  tirante alarm prove --world drifting-thermometer --rods 5
  tirante alarm prove --change step:-0.03@100 --rods 3
  tirante alarm prove --change ramp:-0.02@400 --years 2")]
pub struct Args {
    /// Configuration; default: the built-in one, the paper's tie-rod at Todi.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Override one configuration key; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub settings: Vec<Setting>,
    /// Rod whose prior all simulated rods are drawn from; required if the configuration has several.
    #[arg(long, value_name = "ID")]
    pub rod: Option<String>,
    /// Worlds to simulate, separated by commas; `all` for every one.
    #[arg(long, value_name = "NAMES", default_value = "benign", value_delimiter = ',')]
    pub world: Vec<String>,
    /// Number of rods of a site.
    #[arg(long, value_name = "COUNT", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=50))]
    pub rods: u32,
    /// Number of rods simulated in every world, rounded up to whole sites.
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub histories: u32,
    /// Years for which each rod is tracked after its baseline.
    #[arg(long, default_value_t = 1.0)]
    pub years: f64,
    /// Number of records, one a day, of the baseline and of learning; default: as configured
    /// (track.baseline_records, track.learning_periods).
    #[arg(long, value_name = "RECORDS", value_parser = clap::value_parser!(u32).range(10..=10_000))]
    pub baseline: Option<u32>,
    /// Override the world's temperature range from winter to summer [K].
    #[arg(long, value_name = "K")]
    pub season: Option<f64>,
    /// Override the world's slopes by a restraint of the ends: 0 free to expand, 1 rigid.
    #[arg(long)]
    pub restraint: Option<f64>,
    /// Override the world's thermal lag of the rods [h].
    #[arg(long, value_name = "H")]
    pub lag: Option<f64>,
    /// Override the world's fluctuation of the force that temperature does not explain, as a share of the
    /// force.
    #[arg(long, value_name = "SD")]
    pub fluctuation: Option<f64>,
    /// Override the world's memory of that fluctuation [d].
    #[arg(long, value_name = "D")]
    pub memory: Option<f64>,
    /// Relative standard error of each natural frequency.
    #[arg(long, value_name = "SD", default_value_t = 0.001)]
    pub frequency_sd: f64,
    /// True change of the force of the first rod of every site: `step:-0.05@100` is a loss of 5 % a hundred
    /// days after the first record, `ramp:-0.02@100` a loss of 2 % a year from then on.
    #[arg(long, value_name = "CHANGE")]
    pub change: Option<TrueChange>,
    /// Seed of the histories.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Text or JSON.
    #[command(flatten)]
    pub output: Output,
}

/// A change as typed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TrueChange {
    is_ramp: bool,
    /// Relative change of the force: at once, or in a year.
    relative: f64,
    /// Begin in days from the first record.
    start_d: f64,
}

impl FromStr for TrueChange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = || {
            let (shape, rest) = text.split_once(':')?;
            let (relative, day) = rest.split_once('@')?;
            let is_ramp = match shape {
                "step" => false,
                "ramp" => true,
                _ => return None,
            };
            let (relative, start_d): (f64, f64) = (relative.parse().ok()?, day.parse().ok()?);
            let sane = relative.abs() < 0.9 && relative != 0.0 && (0.0..1e5).contains(&start_d);
            sane.then_some(Self {
                is_ramp,
                relative,
                start_d,
            })
        };
        parsed().ok_or_else(|| format!("{text}: write step:-0.05@100 or ramp:-0.02@100"))
    }
}

impl TrueChange {
    /// The change in the form of the simulation, over `days` days.
    fn within(self, days: usize) -> Change {
        let left = days as f64 - self.start_d;
        let (over_d, relative) = if self.is_ramp {
            (left, self.relative * left / YEAR_D)
        } else {
            (0.0, self.relative)
        };
        Change {
            start_d: self.start_d,
            over_d,
            relative,
        }
    }
}

impl Args {
    /// Checks the arguments; returns the worlds to simulate.
    fn check(&self) -> Result<Vec<String>, BadArguments> {
        let ranges = [
            ("--years", Some(self.years), 0.01, 100.0),
            ("--season", self.season, 0.0, 60.0),
            ("--restraint", self.restraint, 0.0, 1.0),
            ("--lag", self.lag, 0.0, 72.0),
            ("--fluctuation", self.fluctuation, 0.0, 0.1),
            ("--memory", self.memory, 0.01, 1000.0),
            ("--frequency-sd", Some(self.frequency_sd), 1e-6, 0.1),
        ];
        for (name, value, low, high) in ranges {
            if let Some(value) = value.filter(|value| !(low..=high).contains(value)) {
                return Err(BadArguments(format!(
                    "{name} {value}: must lie between {low} and {high}"
                )));
            }
        }
        if self.world.iter().any(|name| name == "all") {
            return Ok(World::NAMES.map(String::from).to_vec());
        }
        match self
            .world
            .iter()
            .find(|name| !World::NAMES.contains(&name.as_str()))
        {
            Some(name) => Err(BadArguments(format!(
                "--world {name}: write {}, or all",
                World::NAMES.join(", ")
            ))),
            None => Ok(self.world.clone()),
        }
    }

    /// World of one site.
    fn world_of(&self, name: &str, index: u64) -> Option<World> {
        let seed = random::seed(&[b"world", &self.seed.to_le_bytes(), name.as_bytes()]);
        let mut world = World::named(name, &mut random::stream(seed, index))?;
        let pair = |value: f64| [value, value];
        world.season_k = self.season.unwrap_or(world.season_k);
        world.lag_h = self.lag.map_or(world.lag_h, pair);
        world.fluctuation = self.fluctuation.unwrap_or(world.fluctuation);
        world.memory_d = self.memory.unwrap_or(world.memory_d);
        if self.restraint.is_some() {
            world.slope_per_k = pair(-1.0);
        }
        Some(world)
    }
}

/// Runs the command.
///
/// # Errors
/// Bad arguments or configuration, a simulation that is impossible, or an output that cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let worlds = args.check()?;
    let mut config = Config::resolve(args.config.as_deref(), &args.settings)?;
    if let Some(baseline) = args.baseline {
        config.track.baseline_records = baseline as usize;
        config.track.learning_periods = baseline as usize;
    }
    if config.track.period_s != DAY_S {
        return Err(
            BadArguments("the proof has one record a day: track.period_h must be 24".to_owned()).into(),
        );
    }
    let rod = choose_rod(&config, args.rod.as_deref())?;
    let analysis = &rod.analysis;
    let model = emulator_cache::model(&analysis.model, &analysis.prior, &Cache::of_user(), &|_, _| ())?;
    let (track, alarm) = (config.track.clone(), config.alarm.clone());
    let learned = track.baseline_records.max(track.learning_periods);
    // One more, with which the last period closes.
    let days = learned + (args.years * YEAR_D).round() as usize + 1;
    if args.change.is_some_and(|change| change.start_d >= days as f64) {
        return Err(BadArguments("--change begins after the last record".to_owned()).into());
    }
    let plans: Vec<Arc<TrackPlan>> = (1..=args.rods)
        .map(|number| {
            let mut analysis = analysis.clone();
            analysis.rod = RodId(format!("rod-{number}"));
            // Tests of the real rod say nothing of the prior's rods that are simulated.
            analysis.tests.clear();
            let plan = TrackPlan::new(
                &analysis,
                model.clone(),
                track.clone(),
                alarm.clone(),
                String::from("proof"),
            );
            Arc::new(plan)
        })
        .collect();
    let trial = Trial {
        prior: analysis.prior.clone(),
        discrepancy: (analysis.discrepancy.iter())
            .map(|stated| stated.max(track.discrepancy))
            .collect(),
        frequency_sd: args.frequency_sd,
        restraint: args.restraint,
        expansion_per_k: track.expansion_per_k,
        change: args.change.map(|change| change.within(days)),
        baseline: track.baseline_records,
        days,
        midnight: Timestamp::from_nanos(START_NS),
    };
    let sites = u64::from(args.histories.div_ceil(args.rods));
    let all = sites * worlds.len() as u64;
    let progress = Progress::new(all, "{wide_bar} {human_pos}/{human_len} sites, {eta} left");
    let stated = plans
        .first()
        .map_or(1.0, |plan| (days as f64 / plan.limit()).min(1.0));
    let mut proofs = Vec::with_capacity(worlds.len());
    for name in &worlds {
        let outcomes: Vec<Vec<Outcome>> = (0..sites)
            .into_par_iter()
            .map(|index| {
                let world = args.world_of(name, index).context("no such world")?;
                let outcome = trial
                    .follow(&plans, &world, index, args.seed)
                    .context("no such site");
                progress.add(1, all);
                outcome
            })
            .collect::<Result<_, _>>()?;
        proofs.push(Proof::new(args, name, learned, days, stated, &outcomes));
    }
    drop(progress);
    let mut text = String::new();
    for (place, proof) in proofs.iter().enumerate() {
        if args.output.is_json() {
            writeln!(text, "{}", serde_json::to_string(proof)?)?;
        } else {
            if place > 0 {
                text.push('\n');
            }
            text.push_str(&proof.table()?);
        }
    }
    print(text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_are_read_or_refused() {
        let change = "ramp:-0.02@30".parse::<TrueChange>().unwrap();
        assert_eq!(
            change,
            TrueChange {
                is_ramp: true,
                relative: -0.02,
                start_d: 30.0
            }
        );
        // Half a year later a loss of 2 % a year is 1 %.
        let half = change.within(30 + 183);
        assert!((half.relative + 0.02 * 183.0 / 365.25).abs() < 1e-12 && half.over_d == 183.0);
        for text in [
            "",
            "step",
            "step:x@3",
            "jump:-0.05@3",
            "step:nan@3",
            "step:-2@3",
            "step:-0.1@-3",
        ] {
            assert!(text.parse::<TrueChange>().is_err(), "{text}");
        }
    }
}
