//! `tirante alarm design`: limits, false-alarm rate, delays and the smallest change that is found.

use crate::bayes::RodPrior;
use crate::beam::Exact;
use crate::command::setup::choose_rod;
use crate::command::{BadArguments, print};
use crate::config::{Config, Setting};
use crate::forward::ForwardModel;
use crate::random;
use crate::track::chart::{Design, YEAR_S};
use crate::track::run_length::{Delays, Departure, FOUND, delays, detectable, survival};
use crate::track::{arl, settings::AlarmSettings};
use serde::Serialize;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

/// Periods learned before the change.
const LEARNED: [usize; 3] = [30, 90, 365];
/// Changes of the force at once, and in a year.
const STEPS: [f64; 4] = [-0.01, -0.02, -0.05, -0.10];
const RAMPS: [f64; 3] = [-0.01, -0.02, -0.05];
/// Time within which a step counts as found, and a ramp \[s\].
const MONTH_S: f64 = 30.0 * 86_400.0;
/// Delays are followed for so many years.
const HORIZON_YEARS: f64 = 3.0;
/// Draws from the prior for the range of slopes.
const DRAWS: usize = 400;

/// Print the charts' limits, the false-alarm rate, delays for steps and ramps, and the smallest change that is found.
///
/// Before commissioning the noise of a period follows from the frequencies' standard error and the rod's prior; once the
/// rod is followed, give the noise it learned.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante alarm design
  tirante alarm design --noise 0.003
  tirante alarm design --config config/campaign.toml --rod nave-3 --set alarm.arl0_years=20 --json")]
pub struct Args {
    /// The configuration; without it the built-in one: the paper's tie-rod at Todi.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Puts one key over the configuration, any number of times: `--set alarm.arl0_years=20`.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub settings: Vec<Setting>,
    /// The rod of the configuration; needed if it has several.
    #[arg(long, value_name = "ID")]
    pub rod: Option<String>,
    /// Relative standard error of one record's natural frequencies.
    #[arg(long, value_name = "SD", default_value_t = 0.001)]
    pub frequency_sd: f64,
    /// Records in a period.
    #[arg(long, value_name = "COUNT", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub records_per_period: u32,
    /// Noise of one period's relative force, as learned on the rod, instead of the one expected from the frequencies.
    #[arg(long, value_name = "SD", allow_negative_numbers = true)]
    pub noise: Option<f64>,
    /// One JSON object instead of the tables.
    #[arg(long)]
    pub json: bool,
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
    let promise = Promise::new(
        rod.analysis.rod.0.clone(),
        &config.alarm,
        config.track.period_s,
        expected,
        args.noise,
    );
    if args.json {
        print(format!("{}\n", serde_json::to_string(&promise)?).as_bytes())
    } else {
        print(promise.table()?.as_bytes())
    }
}

/// What the rod's prior says about a period's noise.
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

/// Everything that is printed.
#[derive(Debug, Clone, Serialize)]
struct Promise {
    rod: String,
    period_s: f64,
    expected: Expected,
    /// Noise of a period that delays are computed for, and whether it was learned.
    noise_sd: f64,
    noise_learned: bool,
    charts: [ChartLine; 2],
    arl0_periods: f64,
    arl0_years: f64,
    /// 1 - exp(-1 / arl0_years).
    false_alarm_probability_per_year: f64,
    /// From charts at zero, as the first year after learning begins.
    false_alarm_probability_first_year: f64,
    delays: Vec<DelayLine>,
    detectable: Vec<DetectableLine>,
}

#[derive(Debug, Clone, Serialize)]
struct ChartLine {
    name: &'static str,
    k: f64,
    h: f64,
    /// Mean time between false alarms of this chart alone.
    alone_years: f64,
}

#[derive(Debug, Clone, Serialize)]
struct DelayLine {
    #[serde(rename = "change")]
    shape: &'static str,
    /// Relative change of force: at once, or in a year.
    relative: f64,
    learned_periods: usize,
    #[serde(flatten)]
    delays: Delays,
}

#[derive(Debug, Clone, Serialize)]
struct DetectableLine {
    learned_periods: usize,
    /// Smallest loss at once that is found within 30 days with 90 % probability.
    step_within_30_days: Option<f64>,
    /// Smallest loss per year that is found within a year with 90 % probability.
    ramp_per_year_within_a_year: Option<f64>,
}

impl Promise {
    fn new(
        rod: String,
        alarm: &AlarmSettings,
        period_s: f64,
        expected: Expected,
        learned: Option<f64>,
    ) -> Self {
        let design = Design::of(alarm, period_s);
        let noise_sd = learned.unwrap_or(expected.delta_sd);
        let periods_per_year = YEAR_S / period_s;
        let year = (periods_per_year.round() as usize).max(1);
        let month = ((MONTH_S / period_s).floor() as usize).max(1);
        let horizon = (HORIZON_YEARS * periods_per_year).ceil() as usize;
        let seed = random::seed(&[b"alarm design delays"]);
        let step = |relative: f64| Departure::Step(libm::log1p(relative) / noise_sd);
        let ramp = |relative: f64| Departure::Ramp(libm::log1p(relative) / noise_sd / periods_per_year);
        let changes = (STEPS
            .map(|relative| ("step", relative, step(relative)))
            .into_iter())
        .chain(RAMPS.map(|relative| ("ramp", relative, ramp(relative))));
        let delays = changes.flat_map(|(shape, relative, change)| {
            LEARNED.map(|learned| DelayLine {
                shape,
                relative,
                learned_periods: learned,
                delays: delays(&design, change, learned, horizon, seed),
            })
        });
        // In units of a change by 1 / e: a loss of factor f is 1 - exp(-f). At most nearly everything.
        let loss = |factor: f64| -libm::expm1(-factor);
        let detectable = LEARNED.map(|learned| DetectableLine {
            learned_periods: learned,
            step_within_30_days: detectable(
                &design,
                Departure::Step(-1.0 / noise_sd),
                learned,
                month,
                3.0,
                seed,
            )
            .map(loss),
            ramp_per_year_within_a_year: detectable(
                &design,
                Departure::Ramp(-1.0 / noise_sd / periods_per_year),
                learned,
                year,
                3.0,
                seed,
            )
            .map(loss),
        });
        let line = |name, i: usize| {
            let chart = design.charts[i];
            let alone = arl::two_sided(chart.k, chart.h, 0.0);
            ChartLine {
                name,
                k: chart.k,
                h: chart.h,
                alone_years: alone / periods_per_year,
            }
        };
        let survivors = survival(&design, year, |_| 0.0, |_| 1.0);
        Self {
            charts: [line("steps", 0), line("ramps", 1)],
            arl0_periods: design.arl0_periods,
            arl0_years: alarm.arl0_years,
            false_alarm_probability_per_year: -libm::expm1(-1.0 / alarm.arl0_years),
            false_alarm_probability_first_year: 1.0 - survivors.last().copied().unwrap_or(1.0),
            delays: delays.collect(),
            detectable: detectable.into(),
            noise_sd,
            noise_learned: learned.is_some(),
            rod,
            period_s,
            expected,
        }
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
            "\nnoise taken for what follows: {:.3} % ({origin})\n",
            percent(self.noise_sd)
        )?;

        writeln!(
            out,
            "{:<8} {:>6} {:>8} {:>22}",
            "chart", "k [sd]", "h [sd]", "alone, false alarm in"
        )?;
        for chart in &self.charts {
            writeln!(
                out,
                "{:<8} {:>6} {:>8.3} {:>16.1} years",
                chart.name, chart.k, chart.h, chart.alone_years
            )?;
        }
        writeln!(
            out,
            "both together: one false alarm in {} years ({:.0} periods); probability {:.1} % in a year, {:.1} % in the first\n",
            self.arl0_years,
            self.arl0_periods,
            percent(self.false_alarm_probability_per_year),
            percent(self.false_alarm_probability_first_year),
        )?;

        writeln!(out, "time until a change is found: median (mean) [periods]")?;
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
                write!(out, " {:>20}", delay(&line.delays))?;
            }
        }
        writeln!(
            out,
            "\n\nsmallest loss found with {:.0} % probability (nothing else changes; a dash: none)",
            percent(FOUND)
        )?;
        let row = |name: &str, value: fn(&DetectableLine) -> Option<f64>| {
            let mut row = format!("{name:<18}");
            for line in &self.detectable {
                let text = value(line).map_or("-".to_owned(), |loss| format!("{:.2} %", percent(loss)));
                row.push_str(&format!(" {text:>20}"));
            }
            row
        };
        writeln!(out, "{}", row("step, in 30 d", |line| line.step_within_30_days))?;
        writeln!(
            out,
            "{}",
            row("ramp a year, in 1", |line| line.ramp_per_year_within_a_year)
        )?;
        Ok(out)
    }
}

/// Median and mean, or the share that is found at all.
fn delay(delays: &Delays) -> String {
    match (delays.median, delays.mean) {
        (Some(median), Some(mean)) if delays.found > 0.99 => format!("{median} ({mean:.1})"),
        (Some(median), _) => format!("{median} ({:.0} % found)", 100.0 * delays.found),
        _ => format!("{:.0} % found", 100.0 * delays.found),
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
