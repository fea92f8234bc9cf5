//! `tirante alarm prove`: simulated years of records through the real tracker, and how often it told something.

use crate::cache::{self, Cache};
use crate::command::progress::Progress;
use crate::command::setup::choose_rod;
use crate::command::{BadArguments, print};
use crate::config::{Config, Setting};
use crate::record::Timestamp;
use crate::synthesis::{Change, Climate, FrequencyErrors, Outcome, Thermal, Trial};
use crate::track::plan::YEAR_S;
use crate::track::{Kind, TrackPlan};
use anyhow::Context;
use rayon::prelude::*;
use serde::Serialize;
use statrs::function::beta::beta_reg;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;
use std::sync::Arc;

const DAY_S: f64 = 86_400.0;
const DAYS_PER_YEAR: f64 = YEAR_S / DAY_S;
/// 1 March 2025, 02:00 UTC: the first history's first record.
const START_NS: i64 = 1_740_794_400_000_000_000;

/// Simulate years of daily records, follow them with the real tracker, and print how often it alarmed beside what is stated.
///
/// Every history has a rod drawn from the prior, a static model discrepancy, weather of its own and another day of the year
/// to start on. Frequencies are the exact beam's with measurement errors; no waveform is made. The same seed gives the
/// same output at any number of threads.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante alarm prove --histories 400 --restraint 1
  tirante alarm prove --baseline 90 --autocorrelation 0.3 --json
  tirante alarm prove --change step:-0.05@100
  tirante alarm prove --change ramp:-0.02@30 --years 1.5")]
pub struct Args {
    /// The configuration; without it the built-in one: the paper's tie-rod at Todi.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Puts one key over the configuration, any number of times.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub settings: Vec<Setting>,
    /// The rod of the configuration; needed if it has several.
    #[arg(long, value_name = "ID")]
    pub rod: Option<String>,
    /// How many histories.
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub histories: u32,
    /// Years each is charted.
    #[arg(long, default_value_t = 1.0)]
    pub years: f64,
    /// Records, one a day, that make the baseline and teach the regression before anything is charted; by default as
    /// configured (track.baseline_records, track.learning_periods).
    #[arg(long, value_name = "RECORDS", value_parser = clap::value_parser!(u32).range(10..=10_000))]
    pub baseline: Option<u32>,
    /// Temperature from winter to summer [K].
    #[arg(long, value_name = "K", default_value_t = 15.0)]
    pub season: f64,
    /// Restraint of the ends: 0 free to expand, 1 rigid.
    #[arg(long, default_value_t = 1.0)]
    pub restraint: f64,
    /// Thermal lag of the rod [h].
    #[arg(long, value_name = "H", default_value_t = 2.0)]
    pub lag: f64,
    /// Fluctuation of the force from record to record that temperature does not explain, as a share of the force.
    #[arg(long, value_name = "SD", default_value_t = 0.0)]
    pub fluctuation: f64,
    /// Its correlation from record to record.
    #[arg(long, value_name = "RHO", default_value_t = 0.0)]
    pub autocorrelation: f64,
    /// Relative standard error of each natural frequency.
    #[arg(long, value_name = "SD", default_value_t = 0.001)]
    pub frequency_sd: f64,
    /// A true change of the force: `step:-0.05@100` is a loss of 5 % a hundred days after charting began,
    /// `ramp:-0.02@100` a loss of 2 % a year from then on.
    #[arg(long, value_name = "CHANGE")]
    pub change: Option<TrueChange>,
    /// Seed of the histories.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// One JSON object instead of the table.
    #[arg(long)]
    pub json: bool,
}

/// A change as typed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TrueChange {
    is_ramp: bool,
    /// Share of the force: at once, or in a year.
    relative: f64,
    /// Days from the first charted period.
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

impl Args {
    fn check(&self) -> Result<(), BadArguments> {
        let ranges = [
            ("--years", self.years, 0.01, 100.0),
            ("--season", self.season, 0.0, 60.0),
            ("--restraint", self.restraint, 0.0, 1.0),
            ("--lag", self.lag, 0.0, 72.0),
            ("--fluctuation", self.fluctuation, 0.0, 0.1),
            ("--autocorrelation", self.autocorrelation, -0.99, 0.99),
            ("--frequency-sd", self.frequency_sd, 1e-6, 0.1),
        ];
        for (name, value, low, high) in ranges {
            if !(low..=high).contains(&value) {
                return Err(BadArguments(format!(
                    "{name} {value}: must lie between {low} and {high}"
                )));
            }
        }
        if let Some(change) = self.change
            && change.start_d >= self.years * DAYS_PER_YEAR
        {
            return Err(BadArguments("--change begins after the last record".to_owned()));
        }
        if self.autocorrelation != 0.0 && self.fluctuation == 0.0 {
            let reason =
                "--autocorrelation needs a --fluctuation, 0.001 say: measurement errors are independent";
            return Err(BadArguments(reason.to_owned()));
        }
        Ok(())
    }
}

/// Runs the command.
///
/// # Errors
/// Bad arguments or configuration, a simulation that is impossible, or an output that cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    args.check()?;
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
    let model = cache::model(&analysis.model, &analysis.prior, &Cache::of_user(), &|_, _| ())?;
    let (track, alarm) = (config.track.clone(), config.alarm.clone());
    let learned = track.baseline_records.max(track.learning_periods);
    let charted = (args.years * DAYS_PER_YEAR).round() as usize;
    let plan = Arc::new(TrackPlan::new(
        analysis,
        model,
        track.clone(),
        alarm,
        String::from("proof"),
    ));
    let trial = Trial {
        prior: analysis.prior.clone(),
        discrepancy: (analysis.discrepancy.iter())
            .map(|stated| stated.max(track.discrepancy))
            .collect(),
        climate: Climate {
            mean_c: 14.0,
            season_k: 0.5 * args.season,
            warmest_day: 205.0,
            day_k: 3.0,
            warmest_hour: 14.0,
            weather_k: 2.0,
            weather_d: 3.0,
            noise_k: 0.1,
            every_s: 60.0,
            between_s: Some(3600.0),
        },
        thermal: Thermal {
            restraint: args.restraint,
            expansion_per_k: track.expansion_per_k,
            axial_rigidity_n: None,
            reference_c: None,
            lag_h: args.lag,
        },
        errors: FrequencyErrors {
            log_sd: args.frequency_sd,
            offsets: Vec::new(),
            fluctuation: args.fluctuation,
            autocorrelation: args.autocorrelation,
            missing: Vec::new(),
        },
        change: args.change.map(|change| Change {
            start_d: change.start_d,
            over_d: if change.is_ramp {
                charted as f64 - change.start_d
            } else {
                0.0
            },
            relative: if change.is_ramp {
                change.relative * (charted as f64 - change.start_d) / DAYS_PER_YEAR
            } else {
                change.relative
            },
        }),
        learned,
        charted,
        interval_s: DAY_S,
        start: Timestamp::from_nanos(START_NS),
    };
    let histories = args.histories as usize;
    let progress = Progress::new(
        histories as u64,
        "{wide_bar} {human_pos}/{human_len} histories, {eta} left",
    );
    let outcomes: Vec<Outcome> = (0..histories)
        .into_par_iter()
        .map(|index| {
            let outcome = trial.follow(&plan, index, histories, args.seed);
            progress.add(1, histories as u64);
            outcome
        })
        .collect::<Result<_, _>>()
        .context("no such history")?;
    drop(progress);
    let stated = charted as f64 / plan.limit();
    let proof = Proof::new(args, learned, charted, stated, &outcomes);
    if args.json {
        print(format!("{}\n", serde_json::to_string(&proof)?).as_bytes())
    } else {
        print(proof.table()?.as_bytes())
    }
}

/// Everything that is printed.
#[derive(Debug, Clone, Serialize)]
struct Proof {
    histories: usize,
    learned_periods: usize,
    charted_periods: usize,
    season_k: f64,
    restraint: f64,
    fluctuation: f64,
    autocorrelation: f64,
    frequency_sd: f64,
    seed: u64,
    change: Option<TrueChange>,
    /// Histories in which the rod was never followed; they count as without an alarm.
    never_monitored: usize,
    /// Rods drawn anew because they would have come near to slack.
    redrawn: u64,
    /// Probability of a false drift alarm in the time charted, as stated by `alarm design`.
    stated: f64,
    alarms: Vec<Rate>,
    found: Option<Found>,
}

/// How many histories raised a kind of alarm without a reason: at all, or before the change.
#[derive(Debug, Clone, Serialize)]
struct Rate {
    kind: Kind,
    histories: usize,
    rate: f64,
    /// 95 % interval of Clopper and Pearson.
    q025: f64,
    q975: f64,
}

/// How a true change was found.
#[derive(Debug, Clone, Serialize)]
struct Found {
    /// Histories without a false drift or not-axial alarm before the change.
    followed: usize,
    drift: usize,
    not_axial: usize,
    /// Days from the change to the record with which the drift was told.
    q10_d: Option<f64>,
    median_d: Option<f64>,
    q90_d: Option<f64>,
}

impl Proof {
    fn new(args: &Args, learned: usize, charted: usize, stated: f64, outcomes: &[Outcome]) -> Self {
        let begin = args.change.map_or(f64::INFINITY, |change| change.start_d);
        let rate = |kind: Kind| {
            let is_false = |outcome: &&Outcome| {
                outcome
                    .raised
                    .iter()
                    .any(|(own, day)| *own == kind && *day < begin)
            };
            let count = outcomes.iter().filter(is_false).count();
            let (low, high) = clopper_pearson(count, outcomes.len());
            Rate {
                kind,
                histories: count,
                rate: count as f64 / outcomes.len() as f64,
                q025: low,
                q975: high,
            }
        };
        let found = args.change.map(|change| {
            let is_undisturbed = |outcome: &&Outcome| {
                !outcome
                    .raised
                    .iter()
                    .any(|(kind, day)| kind.is_latched() && *day < change.start_d)
            };
            let followed: Vec<&Outcome> = outcomes.iter().filter(is_undisturbed).collect();
            let first = |kind: Kind| {
                let of = move |outcome: &&Outcome| {
                    outcome
                        .raised
                        .iter()
                        .find(|(own, _)| *own == kind)
                        .map(|(_, day)| *day)
                };
                followed
                    .iter()
                    .filter_map(of)
                    .map(|day| day - change.start_d)
                    .collect::<Vec<f64>>()
            };
            let mut days = first(Kind::Drift);
            days.sort_by(f64::total_cmp);
            let rank = |p: f64| ((p * followed.len() as f64).ceil() as usize).saturating_sub(1);
            let quantile = |p: f64| days.get(rank(p)).copied();
            Found {
                drift: days.len(),
                not_axial: first(Kind::NotAxial).len(),
                q10_d: quantile(0.1),
                median_d: quantile(0.5),
                q90_d: quantile(0.9),
                followed: followed.len(),
            }
        });
        Self {
            histories: outcomes.len(),
            learned_periods: learned,
            charted_periods: charted,
            season_k: args.season,
            restraint: args.restraint,
            fluctuation: args.fluctuation,
            autocorrelation: args.autocorrelation,
            frequency_sd: args.frequency_sd,
            seed: args.seed,
            change: args.change,
            never_monitored: outcomes.iter().filter(|outcome| !outcome.monitored).count(),
            redrawn: outcomes.iter().map(|outcome| outcome.redrawn).sum(),
            stated,
            alarms: Kind::ALL.map(rate).into(),
            found,
        }
    }

    fn table(&self) -> Result<String, std::fmt::Error> {
        let mut out = String::new();
        let percent = |x: f64| 100.0 * x;
        writeln!(
            out,
            "{} histories, charted for {} days after {} learned; season {} K, restraint {}, frequencies {} %, fluctuation {} % \
             with correlation {}",
            self.histories,
            self.charted_periods,
            self.learned_periods,
            self.season_k,
            self.restraint,
            percent(self.frequency_sd),
            percent(self.fluctuation),
            self.autocorrelation,
        )?;
        writeln!(
            out,
            "{} never followed; {} rods drawn anew because they would have come near to slack",
            self.never_monitored, self.redrawn
        )?;
        let until = if self.change.is_some() {
            "before the change"
        } else {
            "nothing changed"
        };
        writeln!(
            out,
            "\n{:<17} {:>9} {:>8} {:>17}   {until}",
            "false alarms", "histories", "%", "95 % interval"
        )?;
        for rate in &self.alarms {
            let interval = format!("{:.1} to {:.1}", percent(rate.q025), percent(rate.q975));
            write!(
                out,
                "{:<17} {:>9} {:>8.1} {interval:>17}",
                rate.kind,
                rate.histories,
                percent(rate.rate)
            )?;
            if rate.kind == Kind::Drift && self.change.is_none() {
                write!(out, "   stated {:.1} %", percent(self.stated))?;
            }
            writeln!(out)?;
        }
        if let (Some(change), Some(found)) = (self.change, &self.found) {
            let days = |days: Option<f64>| days.map_or("never".to_owned(), |days| format!("{days:.0} d"));
            writeln!(
                out,
                "\n{} {} %{} on day {}: of {} histories drift told in {}, not-axial in {}; after {} (median), {} (10 %), {} (90 %)",
                if change.is_ramp { "ramp" } else { "step" },
                percent(change.relative),
                if change.is_ramp { " a year" } else { "" },
                change.start_d,
                found.followed,
                found.drift,
                found.not_axial,
                days(found.median_d),
                days(found.q10_d),
                days(found.q90_d),
            )?;
        }
        Ok(out)
    }
}

/// The exact 95 % interval of a probability of which `count` of `all` are known (Clopper and Pearson, 1934).
fn clopper_pearson(count: usize, all: usize) -> (f64, f64) {
    // P(at least count | p) = I_p(count, all - count + 1) is increasing in p.
    let solve = |count: usize, tail: f64| {
        let (a, b) = (count as f64, (all - count + 1) as f64);
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if beta_reg(a, b, middle) < tail {
                low = middle;
            } else {
                high = middle;
            }
        }
        0.5 * (low + high)
    };
    let low = if count == 0 { 0.0 } else { solve(count, 0.025) };
    let high = if count == all {
        1.0
    } else {
        solve(count + 1, 0.975)
    };
    (low, high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_are_those_of_clopper_and_pearson() {
        // scipy.stats.binomtest(k, n).proportion_ci(method="exact")
        for (count, all, low, high) in [
            (0, 50, 0.0, 0.0711217),
            (17, 200, 0.0502959, 0.1326052),
            (50, 50, 0.9288783, 1.0),
        ] {
            let (own_low, own_high) = clopper_pearson(count, all);
            assert!(
                (own_low - low).abs() < 1e-6 && (own_high - high).abs() < 1e-6,
                "{own_low} {own_high}"
            );
        }
    }

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
        for text in [
            "",
            "step",
            "step:-0.05",
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
