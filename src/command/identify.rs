//! `tirante identify`: one recording, or frequencies measured elsewhere, to the posterior.

use super::campaign::{self, Became, Reading};
use super::draws::DrawsFile;
use super::findings;
use super::foreign::Foreign;
use super::listing::folded;
use super::progress::Progress;
use super::setup::{self, Setup};
use super::sketch::{self, When};
use super::tests_of_rod::{self, TestFlags, Tests};
use super::{BadArguments, WITH_LOSSES};
use crate::analysis::findings::{CERTAIN, Candidate};
use crate::analysis::identify::{Identification, Plan};
use crate::analysis::inference::Posterior;
use crate::analysis::numerics::diagnostics;
use crate::analysis::outcome::{Outcome, Rejected};
use crate::analysis::record_view::Snapshot;
use crate::analysis::rod::beam::Quantity;
use crate::analysis::rod::fixity::Fixity;
use crate::analysis::rod::prior::Prior;
use crate::analysis::signal::modes::Mode;
use crate::command::which_store::Output;
use crate::config::{Config, written};
use crate::site::analyse::{Analysed, Known};
use crate::site::prepared::{Plans, provenance};
use crate::site::record_row::RecordRow;
use crate::site::store::Position;
use anyhow::anyhow;
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

/// Standard error of a frequency given without one \[Hz\]: the paper's Sigma = 1e-3 Hz^2.
const DEFAULT_SD_HZ: f64 = 0.031_622_776_601_683_79;

/// Highest frequency accepted; no rod vibrates faster \[Hz\].
const HIGHEST_HZ: f64 = 1e5;

/// Compute the posterior of the axial force from one recording.
///
/// Frequencies measured elsewhere can be given instead. Prints prior and posterior of every uncertain
/// parameter. For a record that gives no force it prints the reason, every peak, and possible assignments of
/// the peaks, each with its probability and its force.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante identify recordings/todi-pull.mcap
  tirante identify laser.csv \\
      --config site.toml          # UFF, WAV, MATLAB, .lvm, .tdms alike
  tirante identify hammer.tdms --config site.toml --channel 'Acc 3'
  tirante identify camera.npy --config site.toml --rate 250 --channel '[7,:,1]'
  tirante identify --frequencies 4.492,9.288,13.252
  tirante identify --frequencies 4.492,-,13.252 \\
      --sd 0.005,-,0.01    # mode 2 not measured
  tirante identify --frequencies 4.492,9.288 --draws-out draws.csv
  tirante identify pull.mcap --load 300N@0.5L=1.1mm+-3%    # same day
  tirante identify bare.mcap --config site.toml \\
      --mass 5kg@0.3L --with-mass heavy.mcap
  tirante identify --frequencies 4.492,9.288 \\
      --measured side=70.1,70.4,69.9mm+-0.2mm")]
pub struct Args {
    /// Recordings (MCAP), folders of them, or files of other programs; all their records are identified. Files of one sensor each make
    /// one motion of a rod with several.
    #[arg(
        value_name = "PATH",
        required_unless_present = "frequencies",
        conflicts_with = "frequencies"
    )]
    pub paths: Vec<PathBuf>,

    /// Natural frequencies in Hz of modes 1, 2, ... up to 5, separated by commas; '-' where a mode was
    /// not measured.
    #[arg(long, value_name = "HZ,HZ,...", allow_hyphen_values = true)]
    pub frequencies: Option<String>,

    /// Standard errors of the frequencies in Hz: one for all, or one per frequency. Default: the paper's
    /// 0.0316 Hz.
    #[arg(
        long,
        value_name = "HZ[,HZ,...]",
        requires = "frequencies",
        allow_hyphen_values = true
    )]
    pub sd: Option<String>,

    /// Rod of the configuration; required if it has several.
    #[arg(long, value_name = "ID")]
    pub rod: Option<String>,

    /// Text or JSON.
    #[command(flatten)]
    pub output: Output,

    /// Write the posterior's draws to a file: .csv, .npy, or .parquet. Those of
    /// a second record go to NAME-2.csv, and so on.
    #[arg(long, value_name = "FILE", value_parser = DrawsFile::parse)]
    pub draws_out: Option<DrawsFile>,

    /// Draw a small plot at the end.
    #[arg(long, value_name = "WHEN", value_enum, default_value_t)]
    pub plot: When,

    /// Configuration of the run.
    #[command(flatten)]
    pub setup: Setup,

    /// Facts missing in another program's file.
    #[command(flatten)]
    pub foreign: Foreign,

    /// Tests of the rod.
    #[command(flatten)]
    pub tests: TestFlags,
}

/// Runs the command.
///
/// # Errors
/// Bad arguments or configuration, or a recording that cannot be read at all.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    match &args.frequencies {
        Some(list) => from_frequencies(args, list),
        None => from_recordings(args),
    }
}

fn from_frequencies(args: &Args, list: &str) -> anyhow::Result<ExitCode> {
    let mut config = args.setup.load()?;
    let modes = modes_of(("--frequencies", list), ("--sd", args.sd.as_deref()))?;
    let rod = setup::choose_rod(&config, args.rod.as_deref())?
        .analysis
        .rod
        .clone();
    config.rods.retain(|candidate| candidate.analysis.rod == rod);
    let highest = modes.iter().map(|mode| mode.order).max().unwrap_or(0);
    for candidate in &mut config.rods {
        candidate.analysis = candidate.analysis.clone().for_orders(highest);
    }
    let plans = Arc::new(setup::plans(&config)?);
    let plan = plans
        .get(&rod)
        .ok_or_else(|| anyhow!("the rod {rod} has no plan"))?;
    let tests = tests_of(args, &config, plan)?;
    let found = match tests {
        None => plan.run_frequencies(modes),
        Some(tests) => plan.run_with(modes, &tests.data),
    };
    let code = found
        .as_ref()
        .map_or(ExitCode::from(WITH_LOSSES), |_| ExitCode::SUCCESS);
    let outcome = Outcome::of_frequencies(&rod, found);
    keep_draws(args, &outcome, 1)?;
    show(args, &config, &plans, &outcome)?;
    Ok(code)
}

fn from_recordings(args: &Args) -> anyhow::Result<ExitCode> {
    let mut config = args.setup.load()?;
    if let Some(id) = &args.rod {
        let rod = setup::choose_rod(&config, Some(id))?.analysis.rod.clone();
        config.rods.retain(|candidate| candidate.analysis.rod == rod);
    }
    let plans = Arc::new(setup::plans(&config)?);
    let known = Known::new();
    let reading = Reading::default();
    // Alone, a file may begin at any time.
    let others = args.foreign.among(&args.setup, args.paths.len() < 2);
    let tests = if args.tests.is_empty() {
        None
    } else {
        let rod = setup::choose_rod(&config, args.rod.as_deref())?
            .analysis
            .rod
            .clone();
        let plan = plans
            .get(&rod)
            .ok_or_else(|| anyhow!("the rod {rod} has no plan"))?;
        tests_of(args, &config, plan)?
    };
    let (mut forces, mut refused_with_tests) = (0, false);
    let on_event = |analysed: &Analysed, _: Option<Position<'_>>, _: Option<[u8; 32]>, bar: &Progress| {
        if let Analysed::Record(outcome) = analysed {
            let tested = tests
                .as_ref()
                .and_then(|tests| with_tests(outcome, &plans, tests));
            let outcome = tested.as_ref().unwrap_or(outcome);
            forces += usize::from(matches!(outcome, Outcome::Identified(_)));
            keep_draws(args, outcome, forces)?;
            // The record alone gave a force: the tally does not know that with the tests it gives none.
            refused_with_tests |= matches!(tested, Some(Outcome::Rejected(_)));
            bar.suspend(|| show(args, &config, &plans, outcome))?;
        }
        Ok(Became::New)
    };
    let tally = campaign::run(&args.paths, &config, &plans, &reading, others, &known, on_event)?;
    let code = campaign::conclude(tally);
    Ok(match refused_with_tests && code == ExitCode::SUCCESS {
        true => ExitCode::from(WITH_LOSSES),
        false => code,
    })
}

/// Writes the draws of the run's `number`-th force, if asked for.
fn keep_draws(args: &Args, outcome: &Outcome, number: usize) -> anyhow::Result<()> {
    match (&args.draws_out, outcome) {
        (Some(file), Outcome::Identified(found)) => file.write(&found.posterior, number),
        _ => Ok(()),
    }
}

/// The tests given, those of a record with a mass included; `None` without any.
fn tests_of(args: &Args, config: &Config, plan: &Plan) -> anyhow::Result<Option<Tests>> {
    if args.tests.is_empty() {
        return Ok(None);
    }
    let prior = &plan.settings().prior;
    let mut tests = args.tests.read(prior)?;
    if let Some(list) = &args.tests.mass_frequencies {
        let modes = modes_of(
            ("--mass-frequencies", list),
            ("--mass-sd", args.tests.mass_sd.as_deref()),
        )?;
        tests.add_loaded(&modes, prior)?;
    }
    if let Some(path) = &args.tests.with_mass {
        let (mut loaded, mut refusals) = (Vec::new(), Vec::new());
        let config = tests.with_room(config, plan);
        let plans = Arc::new(setup::plans(&config)?);
        let others = args.foreign.among(&args.setup, true);
        let paths = std::slice::from_ref(path);
        let on_event = |analysed: &Analysed, _: Option<Position<'_>>, _: Option<[u8; 32]>, _: &Progress| {
            if let Analysed::Record(outcome) = analysed {
                match outcome.as_ref() {
                    Outcome::Identified(found) => loaded.push(found.modes.clone()),
                    Outcome::Rejected(refused) => refusals.push(refused.rejection.to_string()),
                    Outcome::Tabulated(_) => {}
                }
            }
            Ok(Became::New)
        };
        let tally = campaign::run(
            paths,
            &config,
            &plans,
            &Reading::default(),
            others,
            &Known::new(),
            on_event,
        )?;
        if let Some(tally) = tally {
            tell!("--with-mass {}: {tally}", path.display());
        }
        if loaded.is_empty() {
            let message = format!(
                "--with-mass {}: no record of it gives frequencies: {}",
                path.display(),
                refusals.first().map_or("it has none of the rod", String::as_str)
            );
            return Err(BadArguments(message).into());
        }
        tests.add_loaded(&mean_modes(&loaded), prior)?;
    }
    Ok(Some(tests))
}

/// Modes of several records of one moment: weighted means, with the scatter between the records where it is larger than their errors.
fn mean_modes(records: &[Vec<Mode>]) -> Vec<Mode> {
    let mut orders: Vec<usize> = records.iter().flatten().map(|mode| mode.order).collect();
    orders.sort_unstable();
    orders.dedup();
    let mean = |order: usize| {
        let seen: Vec<&Mode> = records
            .iter()
            .flatten()
            .filter(|mode| mode.order == order)
            .collect();
        let weight = |mode: &&Mode| mode.sd_hz.powi(-2);
        let weights: f64 = seen.iter().map(weight).sum();
        let frequency_hz = seen
            .iter()
            .map(|mode| weight(mode) * mode.frequency_hz)
            .sum::<f64>()
            / weights;
        let chi_square: f64 = seen
            .iter()
            .map(|mode| weight(mode) * (mode.frequency_hz - frequency_hz).powi(2))
            .sum();
        let scatter = chi_square / (seen.len() - 1).max(1) as f64;
        let sd_hz = (scatter.max(1.0) / weights).sqrt();
        let first = seen.first().copied()?;
        Some(Mode {
            frequency_hz,
            sd_hz,
            ..*first
        })
    };
    orders.into_iter().filter_map(mean).collect()
}

/// A record's outcome with the tests; `None` if the record alone gave no force.
fn with_tests(outcome: &Outcome, plans: &Plans, tests: &Tests) -> Option<Outcome> {
    let Outcome::Identified(found) = outcome else {
        return None;
    };
    let plan = plans.get(&found.rod)?;
    Some(match plan.tested(found, &tests.data) {
        Ok(tested) => Outcome::Identified(Box::new(tested)),
        Err(rejection) => Outcome::Rejected(Box::new(Rejected {
            measurement: found.measurement.clone().map(Box::new),
            labels: found.labels.clone(),
            sensors: found.joint.as_ref().map(|joint| joint.sensors.clone()),
            ..Rejected::of_identified(found, rejection)
        })),
    })
}

fn show(args: &Args, config: &Config, plans: &Plans, outcome: &Outcome) -> io::Result<()> {
    let text = match outcome {
        _ if args.output.is_json() => RecordRow::of(outcome, None, &provenance(config)).to_json()? + "\n",
        Outcome::Identified(identification) => match plans.get(&identification.rod) {
            Some(plan) => {
                describe(plan, identification)
                    + &plot(args, || Snapshot::of(&plan.settings().prior, identification))
            }
            None => String::new(),
        },
        // Rows of tables do not come here.
        Outcome::Tabulated(_) => String::new(),
        Outcome::Rejected(rejected) => {
            findings::refused(rejected) + &plot(args, || Snapshot::of_rejected(rejected))
        }
    };
    let text = if args.output.is_json() {
        text
    } else {
        folded(&text)
    };
    io::stdout().lock().write_all(text.as_bytes())
}

/// Small plot of a record's spectrum, if wanted and there is a spectrum.
fn plot(args: &Args, picture: impl FnOnce() -> Option<Snapshot>) -> String {
    let width = args.plot.width();
    let drawn = width.and_then(|width| Some(sketch::spectrum(&picture()?, width)));
    match drawn {
        Some(plot) if !plot.is_empty() => format!("\n{plot}"),
        _ => String::new(),
    }
}

/// Prior and posterior of every uncertain parameter, with remarks on their reliability.
fn describe(plan: &Plan, identification: &Identification) -> String {
    let mut text = String::new();
    let mut line = |content: String| {
        text.push_str(content.trim_end());
        text.push('\n');
    };
    line(identification.rod.to_string());
    if let Some(measurement) = &identification.measurement {
        findings::opening(measurement).into_iter().for_each(&mut line);
    }
    if let Some(labels) = &identification.labels {
        line(format!(
            "  orders of the modes right with a probability of {}",
            findings::probability(labels.probability)
        ));
    }
    line(String::new());
    line("  mode   frequency [Hz]   standard error [Hz]   damping [%]".to_owned());
    for mode in &identification.modes {
        let damping = mode
            .damping
            .map_or_else(|| "-".to_owned(), |zeta| format!("{:.3}", zeta * 100.0));
        let decimals = findings::decimals(Some(mode.sd_hz)).max(4);
        line(format!(
            "  {:>4}   {:>14.decimals$}   {:>19.decimals$}   {damping:>11}",
            mode.order, mode.frequency_hz, mode.sd_hz
        ));
    }
    let uncertain = identification
        .labels
        .as_ref()
        .filter(|labels| labels.probability < CERTAIN && !labels.candidates.is_empty());
    if let Some(labels) = uncertain {
        line(String::new());
        findings::candidates(&Candidate::all(labels))
            .lines()
            .for_each(|candidate| line(candidate.to_owned()));
    }
    line(String::new());
    line(format!(
        "  {:<22} {:>10} {:>5}  {:>10} {:>5}  {:>9} {:>9}",
        "quantity", "prior mean", "CV", "posterior", "CV", "2.5 %", "97.5 %"
    ));
    let prior = &plan.settings().prior;
    for (quantity, before) in prior.parameterisation().quantities().iter().zip(prior.priors()) {
        let (mean, sd) = before.mean_and_sd();
        if before.is_fixed() {
            line(format!("  {:<22} {mean:>10.5}  fixed", quantity.key()));
        } else if let Prior::Fixity(fixity) = before {
            line(fixity_row(*quantity, fixity, &identification.posterior));
        } else if let Some(after) = identification.posterior.marginal(*quantity) {
            line(format!(
                "  {:<22} {:>10.4e} {:>5.3}  {:>10.4e} {:>5.3}  {:>9.4e} {:>9.4e}",
                quantity.key(),
                mean,
                sd / mean,
                after.mean,
                after.cv,
                after.q025,
                after.q975
            ));
        }
    }
    line(String::new());
    let posterior = &identification.posterior;
    line(format!(
        "  {} of {} draws accepted, epsilon {:.4}, effective sample size {:.0}",
        posterior.accepted, posterior.draws, posterior.epsilon, posterior.ess
    ));
    if let Some(reason) = posterior.withheld {
        line(format!("  ! regression adjustment withheld: {reason}"));
    }
    if let Some(tested) = &identification.tested {
        let force = posterior
            .mean(Quantity::AxialForce)
            .zip(posterior.sd(Quantity::AxialForce));
        let (mean, sd) = force.unwrap_or((f64::NAN, f64::NAN));
        line(String::new());
        tests_of_rod::described(tested, mean, sd)
            .into_iter()
            .for_each(&mut line);
        line(String::new());
    }
    let conflict = &identification.conflict;
    line(format!(
        "  conflict {:.1}: standard deviations from the nearest frequencies the model can produce",
        conflict.score
    ));
    let force = posterior.marginal(Quantity::AxialForce);
    findings::doubts(conflict, force.as_ref())
        .into_iter()
        .for_each(&mut line);
    if let Some(shares) = &identification.hangs_on {
        line(String::new());
        findings::hangs_on(shares)
            .lines()
            .for_each(|row| line(row.to_owned()));
    }
    text
}

/// Row of a support given by its fixity: its stiffness has no meaningful mean.
fn fixity_row(support: Quantity, fixity: &Fixity, posterior: &Posterior) -> String {
    let (mean, sd) = fixity.fixity_mean_and_sd();
    let name = match support {
        Quantity::SpringLeft => "fixity_left",
        _ => "fixity_right",
    };
    let values: Vec<f64> = posterior
        .values(support)
        .unwrap_or_default()
        .into_iter()
        .map(|stiffness| fixity.of(stiffness))
        .collect();
    let weights = &posterior.weights;
    let after = diagnostics::mean(&values, weights);
    let quantiles = diagnostics::quantiles(&values, weights, &[0.025, 0.975]);
    format!(
        "  {name:<22} {mean:>10.4} {:>5.3}  {after:>10.4} {:>5.3}  {:>9.4} {:>9.4}",
        sd / mean,
        diagnostics::sd(&values, weights) / after,
        quantiles[0],
        quantiles[1]
    )
}

/// Modes from the list of one flag, with the errors of another; says which error is assumed without it.
fn modes_of((flag, list): (&str, &str), (sd_flag, sd): (&str, Option<&str>)) -> anyhow::Result<Vec<Mode>> {
    let modes = parse_modes((flag, list), (sd_flag, sd))?;
    if sd.is_none() {
        tell!(
            "no {sd_flag}: every frequency of {flag} is taken with the paper's standard error of 0.0316 Hz"
        );
    }
    Ok(modes)
}

fn parse_modes((flag, list): (&str, &str), (sd_flag, sd): (&str, Option<&str>)) -> anyhow::Result<Vec<Mode>> {
    let frequencies = parse_list(flag, list)?;
    let sds = sd.map(|sd| parse_list(sd_flag, sd)).transpose()?;
    if let Some(sds) = &sds
        && sds.len() != 1
        && sds.len() != frequencies.len()
    {
        let message = format!(
            "{sd_flag} has {} entries, {flag} {}",
            sds.len(),
            frequencies.len()
        );
        return Err(BadArguments(message).into());
    }
    let mut modes: Vec<Mode> = Vec::new();
    for (index, frequency) in frequencies.iter().enumerate() {
        let Some(frequency_hz) = *frequency else { continue };
        let order = index + 1;
        let sd_hz = match sds.as_deref() {
            None => DEFAULT_SD_HZ,
            Some([one]) => one.ok_or_else(|| BadArguments(format!("{sd_flag}: '-' alone gives no error")))?,
            Some(list) => list[index].ok_or_else(|| {
                BadArguments(format!("{sd_flag}: mode {order} was measured, its error is '-'"))
            })?,
        };
        if modes
            .last()
            .is_some_and(|before| before.frequency_hz >= frequency_hz)
        {
            let message = format!("{flag}: mode {order} at {frequency_hz} Hz is not above the one before");
            return Err(BadArguments(message).into());
        }
        modes.push(Mode {
            order,
            frequency_hz,
            sd_hz,
            damping: None,
        });
    }
    if modes.is_empty() {
        return Err(BadArguments(format!("{flag}: no mode was measured")).into());
    }
    if let Some(mode) = modes.last()
        && mode.order > crate::analysis::rod::beam::forward::MAX_MODES
    {
        let message = format!(
            "{flag}: at most {} modes are used",
            crate::analysis::rod::beam::forward::MAX_MODES
        );
        return Err(BadArguments(message).into());
    }
    Ok(modes)
}

fn parse_list(flag: &str, text: &str) -> anyhow::Result<Vec<Option<f64>>> {
    let entries = written::list(text).map_err(|why| BadArguments(format!("{flag}: {why}")))?;
    entries
        .into_iter()
        .map(|entry| match entry {
            "-" | "" => Ok(None),
            number => match written::decimal(number) {
                Err(why) if number.contains(',') => Err(BadArguments(format!("{flag}: {why}")).into()),
                Ok(value) if value > 0.0 && value <= HIGHEST_HZ => Ok(Some(value)),
                _ => Err(BadArguments(format!(
                    "{flag}: '{number}' is no number of hertz above 0 and up to {HIGHEST_HZ}"
                ))
                .into()),
            },
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn modes(frequencies: &str, sd: Option<&str>) -> anyhow::Result<Vec<Mode>> {
        parse_modes(("--frequencies", frequencies), ("--sd", sd))
    }

    #[test]
    fn missing_modes_keep_their_place() {
        let found = modes("4.492,-,13.252", Some("0.005,-,0.01")).unwrap();
        assert_eq!(found.iter().map(|mode| mode.order).collect::<Vec<_>>(), [1, 3]);
        assert_eq!(found[1].sd_hz, 0.01);
    }

    #[test]
    fn one_error_serves_all_and_none_is_the_papers() {
        let both = modes("4.5,9.3", Some("0.002")).unwrap();
        assert!(both.iter().all(|mode| mode.sd_hz == 0.002));
        let one = modes("4.5", None).unwrap();
        assert!((one[0].sd_hz.powi(2) - 1e-3).abs() < 1e-18);
    }

    #[test]
    fn nonsense_is_refused() {
        for (frequencies, sd) in [
            ("", None),
            ("-,-", None),
            ("4.5,abc", None),
            ("4.5,nan", None),
            ("-4.5", None),
            ("9.3,4.5", None),
            ("1,2,3,4,5,6", None),
            ("4.5,9.3", Some("0.1,0.1,0.1")),
            ("4.5,9.3", Some("0.1,-")),
            ("4.5", Some("-")),
            ("4.5", Some("0")),
            ("4,492", Some("0.1")),
            ("4,5", Some("0.1")),
            ("4.5", Some("0,01")),
        ] {
            assert!(modes(frequencies, sd).is_err(), "{frequencies} {sd:?}");
        }
    }

    #[test]
    fn a_fault_names_the_flag_it_stands_in() {
        for (frequencies, sd, flag) in [
            ("9.5,8.0", None, "--mass-frequencies: mode 2"),
            (
                "9.5,18.0",
                Some("0.1,0.1,0.1"),
                "--mass-sd has 3 entries, --mass-frequencies 2",
            ),
            ("9.5", Some("-"), "--mass-sd: "),
            ("9,5", None, "--mass-frequencies: a comma"),
            ("-", None, "--mass-frequencies: no mode"),
        ] {
            let said = parse_modes(("--mass-frequencies", frequencies), ("--mass-sd", sd));
            let said = said.unwrap_err().to_string();
            assert!(said.starts_with(flag), "{frequencies}: {said}");
        }
        let commas = modes("4,49; 9,28", None).unwrap();
        assert_eq!((commas[0].frequency_hz, commas[1].frequency_hz), (4.49, 9.28));
    }
}
