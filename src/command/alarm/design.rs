//! `tirante alarm design`: false-alarm rate, delays by simulation of this rod, and the smallest change
//! detected.

use super::stiffer::Stiffer;
use crate::analysis::lab::synthesis::{Outlook, Told, Tried, World};
use crate::analysis::numerics::random;
use crate::analysis::rod::beam::Exact;
use crate::analysis::rod::beam::forward::ForwardModel;
use crate::analysis::rod::prior::RodPrior;
use crate::analysis::signal::record::time::{DAY_S, YEAR_S};
use crate::analysis::track::drift::ThermalPrior;
use crate::command::listing::folded;
use crate::command::setup::choose_rod;
use crate::command::which_store::Output;
use crate::command::{BadArguments, print};
use crate::config::{Config, Setting};
use rayon::prelude::*;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

/// Numbers of days learned before the change.
const LEARNED: [usize; 3] = [30, 90, 365];
/// Relative changes of the force: at once, and in a year.
const STEPS: [f64; 4] = [-0.01, -0.02, -0.05, -0.10];
const RAMPS: [f64; 3] = [-0.01, -0.02, -0.05];
/// Times for which the smallest detectable change is printed \[d\].
const WITHIN_D: [usize; 5] = [3, 30, 90, 180, 365];
/// Number of sites simulated for each time learned.
const SITES: u64 = 30;
/// Relative curvature of the slope with temperature \[1/K\]: modulus and expansion of iron.
const CURVATURE_PER_K: f64 = 3e-4;
/// Number of readings a day that resolve the day.
const DENSE: u32 = 6;
/// Number of draws from the prior for the range of slopes.
const DRAWS: usize = 400;

/// Print the false-alarm rate, the delays and the smallest change detected.
///
/// Delays for steps and ramps come from a simulation of this rod. Before commissioning the noise of a period
/// follows from the frequencies' standard error and the rod's prior; once the rod is followed, give the noise it
/// learned.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante alarm design
  tirante alarm design --noise 0.003
  tirante alarm design --config config/campaign.toml --rod nave-3 \\
      --set alarm.arl0_years=20 --format json")]
pub struct Args {
    /// Configuration; default: the built-in one, the paper's tie-rod at Todi.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Override one configuration key; may be repeated: `--set alarm.arl0_years=20`.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub settings: Vec<Setting>,
    /// Rod of the configuration; required if it has several.
    #[arg(long, value_name = "ID")]
    pub rod: Option<String>,
    /// Relative standard error of one record's natural frequencies.
    #[arg(long, value_name = "SD", default_value_t = 0.001)]
    pub frequency_sd: f64,
    /// Number of records in a period.
    #[arg(long, value_name = "COUNT", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub records_per_period: u32,
    /// Noise of one period's relative force, as learned on the rod; default: expected from the frequencies.
    #[arg(long, value_name = "SD", allow_negative_numbers = true)]
    pub noise: Option<f64>,
    /// World of the simulation, as in `alarm prove`; the slope with temperature is that of the rod, for any
    /// restraint.
    #[arg(long, value_name = "NAME", default_value = "benign")]
    pub world: String,
    /// Number of rods of the site: with three or more, the median of the others is used.
    #[arg(long, value_name = "COUNT", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=50))]
    pub rods: u32,
    /// Text or JSON.
    #[command(flatten)]
    pub output: Output,
}

/// Runs the command.
///
/// # Errors
/// Bad arguments or configuration, or an output that cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    for (name, value) in [
        ("--frequency-sd", Some(args.frequency_sd)),
        ("--noise", args.noise),
    ] {
        if let Some(value) = value.filter(|value| !(*value > 0.0 && *value < 1.0)) {
            return Err(BadArguments(format!("{name} {value}: must lie between 0 and 1")).into());
        }
    }
    let config = Config::resolve(args.config.as_deref(), &args.settings)?;
    let rod = choose_rod(&config, args.rod.as_deref())?;
    let prior = &rod.analysis.prior;
    let expected = Expected::of(prior, rod.analysis.modes.count, args)?;
    if config.track.period_s != DAY_S {
        return Err(BadArguments(
            "the simulation has one record a day: track.period_h must be 24".to_owned(),
        )
        .into());
    }
    let centre = prior.centre();
    let fixed_per_k =
        prior.parameterisation().axial_rigidity(&centre) * config.track.expansion_per_k / centre[0];
    let mut promise = Promise::new(args, rod.analysis.rod.0.clone(), &config, expected, fixed_per_k)?;
    promise.stiffer = Stiffer::of(rod, &config, rod.analysis.modes.count, args.frequency_sd);
    if args.output.is_json() {
        print(format!("{}\n", serde_json::to_string(&promise)?).as_bytes())
    } else {
        print(folded(&promise.table()?).as_bytes())
    }
}

/// Noise of a period by the rod's prior.
#[derive(Debug, Clone, Serialize)]
struct Expected {
    /// d ln f_n / d ln N at the prior's centre.
    log_slopes: Vec<f64>,
    /// Relative standard error of a record's frequencies.
    frequency_sd: f64,
    records_per_period: u32,
    /// Standard error of delta = ln(N_t / N_0) of a period, at the prior's centre.
    delta_sd: f64,
    /// Its 5 % and 95 % quantiles over the prior.
    delta_sd_q05_q95: Option<[f64; 2]>,
}

impl Expected {
    fn of(prior: &RodPrior, modes: usize, args: &Args) -> anyhow::Result<Self> {
        let model = Exact::new(*prior.parameterisation());
        let record_sd = args.frequency_sd / f64::from(args.records_per_period).sqrt();
        // Weighted least squares of z_n = s_n delta + e_n.
        let delta_sd = |slopes: &[f64]| record_sd / slopes.iter().map(|s| s * s).sum::<f64>().sqrt();
        let mut slopes = vec![0.0; modes];
        model.log_slopes(&prior.centre(), &mut slopes)?;
        let at_centre = slopes.clone();
        let mut generator = random::stream(random::seed(&[b"alarm design"]), 0);
        let mut theta = vec![0.0; prior.parameterisation().len()];
        let mut over_prior = Vec::new();
        for _ in 0..DRAWS {
            prior.sample(&mut generator, &mut theta);
            if model.log_slopes(&theta, &mut slopes).is_ok() {
                over_prior.push(delta_sd(&slopes));
            }
        }
        over_prior.sort_by(f64::total_cmp);
        let quantile = |p: f64| over_prior.get((p * over_prior.len() as f64) as usize).copied();
        Ok(Self {
            delta_sd: delta_sd(&at_centre),
            delta_sd_q05_q95: quantile(0.05).zip(quantile(0.95)).map(|(low, high)| [low, high]),
            log_slopes: at_centre,
            frequency_sd: args.frequency_sd,
            records_per_period: args.records_per_period,
        })
    }
}

/// All figures printed.
#[derive(Debug, Clone, Serialize)]
struct Promise {
    rod: String,
    period_s: f64,
    expected: Expected,
    /// Noise of a period behind the delays, and true if it was learned.
    noise_sd: f64,
    noise_learned: bool,
    world: String,
    rods: u32,
    sites: u64,
    /// Limit R of the alarm: the mean number of periods between false alarms.
    arl0_periods: f64,
    arl0_years: f64,
    /// Largest probability of a false alarm in a year: number of periods over the limit.
    false_alarm_probability_per_year: f64,
    delays: Vec<DelayLine>,
    least: Vec<LeastLine>,
    /// Reading of a loss in a rod that is stiffer than its prior in everything.
    stiffer: Option<Stiffer>,
}

#[derive(Debug, Clone, Serialize)]
struct DelayLine {
    #[serde(rename = "change")]
    shape: &'static str,
    /// Relative change of force: at once, or in a year.
    relative: f64,
    learned_periods: usize,
    /// Share detected within 60 days (steps) or two years (ramps).
    found: f64,
    /// Days from the change to the record that raises the alarm.
    median_d: Option<f64>,
    q90_d: Option<f64>,
}

/// Smallest changes detected within some days, by the posterior: medians over the sites.
#[derive(Debug, Clone, Serialize)]
struct LeastLine {
    learned_periods: usize,
    within_d: usize,
    step: Option<f64>,
    ramp_per_year: Option<f64>,
}

impl Promise {
    fn new(
        args: &Args,
        rod: String,
        config: &Config,
        expected: Expected,
        fixed_per_k: f64,
    ) -> anyhow::Result<Self> {
        let (alarm, period_s) = (&config.alarm, config.track.period_s);
        let noise_sd = args.noise.unwrap_or(expected.delta_sd);
        let limit = alarm.arl0_years * YEAR_S / period_s;
        let seed = random::seed(&[b"alarm design delays"]);
        let mut world = World::named(&args.world, &mut random::stream(seed, 0)).ok_or_else(|| {
            BadArguments(format!(
                "--world {}: write {}",
                args.world,
                World::NAMES.join(", ")
            ))
        })?;
        world.slope_per_k = [-fixed_per_k, 0.0];
        let outlook = Outlook {
            world,
            rods: args.rods as usize,
            noise_sd,
            thermal: ThermalPrior {
                slope_mean_per_k: -0.5 * fixed_per_k,
                slope_sd_per_k: 0.5 * fixed_per_k,
                curvature_sd_per_k2: CURVATURE_PER_K * fixed_per_k,
                is_sparse: world.readings_per_day < DENSE,
            },
            limit,
        };
        let tried = |is_ramp: bool| move |relative: f64| Tried { is_ramp, relative };
        let changes: Vec<Tried> = STEPS
            .map(tried(false))
            .into_iter()
            .chain(RAMPS.map(tried(true)))
            .collect();
        let sites: Vec<(usize, u64)> = LEARNED
            .iter()
            .flat_map(|&learned| (0..SITES).map(move |index| (learned, index)))
            .collect();
        let told: Vec<Told> = sites
            .par_iter()
            .map(|&(learned, index)| outlook.follow(learned, &changes, &WITHIN_D, index, seed))
            .collect();
        let of = |place: usize| &told[place * SITES as usize..(place + 1) * SITES as usize];
        let mut delays = Vec::new();
        for (at, change) in changes.iter().enumerate() {
            for (place, learned_periods) in LEARNED.into_iter().enumerate() {
                let found: Vec<Option<f64>> = of(place).iter().map(|told| told.delays_d[at]).collect();
                delays.push(DelayLine {
                    shape: if change.is_ramp { "ramp" } else { "step" },
                    relative: change.relative,
                    learned_periods,
                    found: found.iter().flatten().count() as f64 / SITES as f64,
                    median_d: quantile(&found, 0.5),
                    q90_d: quantile(&found, 0.9),
                });
            }
        }
        let mut least = Vec::new();
        for (place, learned_periods) in LEARNED.into_iter().enumerate() {
            for (at, within_d) in WITHIN_D.into_iter().enumerate() {
                let median = |of_told: fn(&Told) -> &Vec<Option<f64>>| {
                    quantile(
                        &of(place).iter().map(|told| of_told(told)[at]).collect::<Vec<_>>(),
                        0.5,
                    )
                };
                least.push(LeastLine {
                    learned_periods,
                    within_d,
                    step: median(|told| &told.steps),
                    ramp_per_year: median(|told| &told.ramps),
                });
            }
        }
        Ok(Self {
            rod,
            period_s,
            expected,
            noise_sd,
            noise_learned: args.noise.is_some(),
            world: args.world.clone(),
            rods: args.rods,
            sites: SITES,
            arl0_periods: limit,
            arl0_years: alarm.arl0_years,
            false_alarm_probability_per_year: alarm.arl0_years.recip().min(1.0),
            delays,
            least,
            stiffer: None,
        })
    }

    fn table(&self) -> Result<String, std::fmt::Error> {
        let mut out = String::new();
        let percent = |x: f64| 100.0 * x;
        let expected = &self.expected;
        writeln!(
            out,
            "rod {}, one statistic every {}",
            self.rod,
            duration(self.period_s)
        )?;
        let slopes: Vec<String> = expected.log_slopes.iter().map(|s| format!("{s:.3}")).collect();
        writeln!(
            out,
            "d ln f / d ln N at the prior's centre: {}; frequencies known to {:.3} % in {} record{} a period",
            slopes.join(", "),
            percent(expected.frequency_sd),
            expected.records_per_period,
            if expected.records_per_period == 1 { "" } else { "s" },
        )?;
        write!(
            out,
            "noise of ln(N_t / N_0) expected from that: {:.3} %",
            percent(expected.delta_sd)
        )?;
        if let Some([low, high]) = expected.delta_sd_q05_q95 {
            write!(
                out,
                " ({:.3} to {:.3} % over 90 % of the prior)",
                percent(low),
                percent(high)
            )?;
        }
        let origin = if self.noise_learned { "given" } else { "expected" };
        writeln!(
            out,
            "\nnoise taken for what follows: {:.3} % ({origin}); world {}, {} rod{} on the site, {} sites simulated\n",
            percent(self.noise_sd),
            self.world,
            self.rods,
            if self.rods == 1 { "" } else { "s" },
            self.sites,
        )?;
        writeln!(
            out,
            "alarm at R = {:.0} periods: at least {} years on average to a false alarm, probability at most {:.1} % in a year\n",
            self.arl0_periods,
            self.arl0_years,
            percent(self.false_alarm_probability_per_year),
        )?;
        writeln!(out, "days until a change is told: median (90 %)")?;
        write!(out, "{:<18}", "change of force")?;
        for learned in LEARNED {
            write!(out, " {:>20}", format!("after {learned} learned"))?;
        }
        for lines in self.delays.chunks(LEARNED.len()) {
            let Some(first) = lines.first() else { continue };
            let unit = if first.shape == "ramp" { "% a year" } else { "%" };
            write!(
                out,
                "\n{:<18}",
                format!("{} {} {unit}", first.shape, percent(first.relative))
            )?;
            for line in lines {
                write!(out, " {:>20}", delay(line))?;
            }
        }
        writeln!(
            out,
            "\n\nsmallest change told within so many days, as the posterior stands after learning"
        )?;
        write!(out, "{:<18}", "within")?;
        for learned in LEARNED {
            write!(out, " {:>20}", format!("after {learned} learned"))?;
        }
        for (at, within_d) in WITHIN_D.into_iter().enumerate() {
            write!(out, "\n{:<18}", format!("{within_d} d"))?;
            for place in 0..LEARNED.len() {
                let line = &self.least[place * WITHIN_D.len() + at];
                let text = |value: Option<f64>| {
                    value.map_or("-".to_owned(), |value| format!("{:.2}", percent(value)))
                };
                write!(
                    out,
                    " {:>20}",
                    format!("{} %, {} %/y", text(line.step), text(line.ramp_per_year))
                )?;
            }
        }
        writeln!(out)?;
        if let Some(stiffer) = &self.stiffer {
            writeln!(out, "\n{}", stiffer.sentence())?;
        }
        Ok(out)
    }
}

/// A quantile over all changes; `None` if it lies among those not detected.
fn quantile(values: &[Option<f64>], p: f64) -> Option<f64> {
    let mut sorted: Vec<f64> = values
        .iter()
        .map(|value| value.unwrap_or(f64::INFINITY))
        .collect();
    sorted.sort_by(f64::total_cmp);
    let rank = ((p * sorted.len() as f64).ceil() as usize).saturating_sub(1);
    sorted.get(rank).copied().filter(|value| value.is_finite())
}

/// Median and 90 % quantile, or the share detected.
fn delay(line: &DelayLine) -> String {
    let days = |days: Option<f64>| days.map_or("never".to_owned(), |days| format!("{:.0}", days.ceil()));
    if line.found < 1.0 {
        format!("{} ({:.0} % found)", days(line.median_d), 100.0 * line.found)
    } else {
        format!("{} ({})", days(line.median_d), days(line.q90_d))
    }
}

fn duration(seconds: f64) -> String {
    let hours = seconds / 3600.0;
    if hours == 24.0 {
        "day".to_owned()
    } else {
        format!("{hours} h")
    }
}
