//! `tirante replay`: runs recordings through the whole pipeline.

use super::BadArguments;
use super::again;
use super::campaign::{self, Became, Reading};
use super::foreign::Foreign;
use super::import::MessageEncoding;
use super::progress::Progress;
use super::render::Table;
use super::report;
use super::setup::{self, GivenUp, Prepared, Setup};
use super::sketch::{self, When};
use super::status;
use super::tally;
use super::which_store::{Format, Output};
use crate::analysis::outcome::Outcome;
use crate::analysis::record_view::Snapshot;
use crate::analysis::signal::record::RodId;
use crate::analysis::track::Verdict;
use crate::config::Config;
use crate::recording::atomic::AtomicFile;
use crate::recording::write::Encoding;
use crate::service::viewer::{Message, ResultsWriter};
use crate::site::analyse::Analysed;
use crate::site::driver;
use crate::site::pictures::Pictures;
use crate::site::record_row::RecordRow;
use crate::site::store::Position;
use crate::site::trackers::Taken;
use anyhow::Context;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Analyse recordings: frequencies, force, change, alarms.
///
/// Prints a line per record with its natural frequencies, its axial force and the change since the baseline; alarms
/// as they are raised; and the state of every rod at the end.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante replay recordings/todi-pull.mcap
  tirante replay recordings/campaign-2025.mcap --config config/campaign.toml \\
      --store site.db --report .
  tirante replay recordings/todi-pull.mcap --results todi-results.mcap
  tirante replay recordings/todi-pull.mcap --results todi-ros2.mcap \\
      --results-encoding cdr
  tirante replay /data/2026 --config site.toml --format json > forces.jsonl
  tirante replay --from-store site.db --config new-prior.toml --store new.db
  tirante replay monday.csv tuesday.tdms --config site.toml --store site.db

The force (mean ± standard deviation) is what one record says by itself. The
change is that of the force since the rod's baseline, at the reference
temperature; '~' marks one that is not compensated for temperature; '-' stands
while the baseline is learned. The state is empty for a rod that is monitored
and shows no alarm. `! conflict` says by how many standard deviations the
frequencies lie outside everything the model can produce: the force may be wrong
by more than it says. `! hardly in the prior`: check length, section, material
and expected force. Behind the state, `decay`, `decays` and `blow` say what
motion was recognised (nothing: ambient vibration), `? orders 0.93` that the
orders of the modes are not certain: `tirante identify` shows what else the
peaks may be. --format json has everything else, the errors of the frequencies
among them.

Alarms are results, not failures: a replay that raises some still ends with 0
(or 3 with rejected records or lost data). Ask `tirante status --format json`
whether an alarm stands.")]
pub struct Args {
    /// MCAP recordings, folders of them, or files of other programs (CSV, UFF, WAV, MATLAB, LabVIEW, NumPy).
    #[arg(
        value_name = "PATH",
        required_unless_present = "from_store",
        conflicts_with = "from_store"
    )]
    pub paths: Vec<PathBuf>,

    /// Analyse the records of this store again instead, without their recordings, from the resonances it
    /// keeps: equal to a replay of the recordings, in a fraction of the time. Priors, tests, inference,
    /// tracking and alarms may differ; what needs samples is refused by name. People's requests are not
    /// taken over.
    #[arg(long, value_name = "FILE", conflicts_with = "follow")]
    pub from_store: Option<PathBuf>,

    /// Text or JSON.
    #[command(flatten)]
    pub output: Output,

    /// Keep results in this database (SQLite) and resume from it; overrides `[store] path` of the
    /// configuration. Without either, nothing is kept after the replay.
    #[arg(long, value_name = "FILE")]
    pub store: Option<PathBuf>,

    /// Write the report into this folder at the end: one page per site that needs no network.
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,

    /// Write the results of every record, with waveform and spectrum, into this MCAP file, to open next to
    /// the recordings in Foxglove or Lichtblick. The file must not exist; records already in the store are
    /// not in it.
    #[arg(long, value_name = "FILE")]
    pub results: Option<PathBuf>,

    /// Encoding of the messages in --results.
    #[arg(long, value_name = "ENCODING", value_enum, default_value_t = MessageEncoding::Json, requires = "results")]
    pub results_encoding: MessageEncoding,

    /// Options for reading recordings.
    #[command(flatten)]
    pub reading: Reading,

    /// Draw a small plot at the end.
    #[arg(long, value_name = "WHEN", value_enum, default_value_t)]
    pub plot: When,

    /// Configuration of the run.
    #[command(flatten)]
    pub setup: Setup,

    /// Baselines that may be dropped.
    #[command(flatten)]
    pub given_up: GivenUp,

    /// Facts missing in another program's file.
    #[command(flatten)]
    pub foreign: Foreign,
}

/// Runs the command.
///
/// # Errors
/// Bad arguments or configuration, no recording at all, a store or an output that cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let config = args.setup.load()?;
    let from = args.from_store.as_deref();
    let from = from
        .map(|from| again::open(from, args.store.as_deref(), &config))
        .transpose()?;
    let Prepared { generation, mut site } = setup::site(
        config,
        args.store.as_deref(),
        &args.given_up,
        args.report.is_some(),
    )?;
    let (config, plans) = (&generation.config, &generation.plans);
    let modes = config
        .rods
        .iter()
        .map(|rod| rod.analysis.modes.count)
        .max()
        .unwrap_or(0);
    let rods: Vec<&RodId> = config.rods.iter().map(|rod| &rod.analysis.rod).collect();
    let store = args.store.as_deref().or(config.store.path.as_deref());
    let is_coloured = super::listing::is_coloured();
    let table = Table::new(
        rods.into_iter(),
        modes,
        store.map(|path| path.display().to_string()),
        is_coloured,
    );
    let known = site.store().all_known().clone();
    if let Some(from) = &from {
        site = site.without_samples(Pictures::of(from)?);
    }

    let encoding = args.results_encoding.encoding();
    let results = args
        .results
        .as_deref()
        .map(|path| Results::create(path, encoding));
    let mut results = results.transpose()?;
    let mut output = io::stdout().lock();
    let mut header_due = !args.output.is_json();
    let on_event =
        |analysed: &Analysed, place: Option<Position<'_>>, before: Option<[u8; 32]>, bar: &Progress| {
            let taken = site.take_event(analysed, place, before)?;
            let (Analysed::Record(outcome), Some(taken)) = (analysed, taken) else {
                return Ok(Became::Known);
            };
            let (outcome, Taken { row, verdict, .. }) = (taken.outcome(outcome), &taken);
            if let Some(results) = &mut results {
                results.add(config, outcome, row, verdict);
            }
            bar.suspend(|| {
                if header_due {
                    header_due = false;
                    writeln!(output, "{}\n{}", config.site, table.header())?;
                }
                let line = if args.output.is_json() {
                    row.to_json()?
                } else {
                    table.row(outcome, verdict)
                };
                writeln!(output, "{line}")
            })?;
            Ok(Became::of(Some(taken)))
        };
    let tally = match from {
        Some(from) => again::run(from, plans, args.reading.workers(), &known, on_event)?,
        None => campaign::run(
            &args.paths,
            config,
            plans,
            &args.reading,
            args.foreign.among(&args.setup, false),
            driver::knowing(&known),
            on_event,
        )?,
    };
    let has_seen_all = tally.is_some();
    let code = tally::conclude(tally);
    if has_seen_all {
        // Of a store without any record there is nothing to tell.
        if site.store().last_record()? > 0 {
            let standing = status::text(site.store(), None, Format::Table, None)?;
            tell!("{}", standing.trim_end());
        }
        if let Some(width) = args.plot.width().filter(|_| !args.output.is_json()) {
            for rod in site.store().rods()? {
                write!(
                    output,
                    "\n{}",
                    sketch::force(site.store(), &rod, sketch::MOST, width)?
                )?;
            }
        }
    }
    if let Some(folder) = &args.report {
        let page = report::write(site.store(), None, folder)?;
        tell!("report: {}", page.display());
    }
    // The last, so that a failure costs nothing else; it ends the program with 1.
    if let Some(results) = results {
        results.finish()?;
    }
    Ok(code)
}

/// MCAP file of results: it appears complete or not at all.
struct Results<'p> {
    writer: ResultsWriter<AtomicFile>,
    path: &'p Path,
    records: usize,
    /// First error; nothing is written after it, and the replay goes on.
    failure: Option<anyhow::Error>,
}

impl<'p> Results<'p> {
    fn create(path: &'p Path, encoding: Encoding) -> anyhow::Result<Self> {
        if path.exists() {
            let why = format!(
                "--results {}: exists, and holds what another replay wrote; name another file",
                path.display()
            );
            return Err(BadArguments(why).into());
        }
        let file = AtomicFile::create(path).with_context(|| format!("--results {}", path.display()))?;
        Ok(Self {
            writer: ResultsWriter::new(file, encoding)?,
            path,
            records: 0,
            failure: None,
        })
    }

    /// Adds the result of a record: its row, its snapshot, and alarm events at their times.
    fn add(&mut self, config: &Config, outcome: &Outcome, row: &RecordRow, verdict: &Verdict) {
        if self.failure.is_none() {
            match self.write(config, outcome, row, verdict) {
                Ok(()) => self.records += 1,
                Err(error) => self.failure = Some(error),
            }
        }
    }

    fn write(
        &mut self,
        config: &Config,
        outcome: &Outcome,
        row: &RecordRow,
        verdict: &Verdict,
    ) -> anyhow::Result<()> {
        let mut messages = Message::of_record(row);
        if let Some(rod) = config.rod(&outcome.rod().0)
            && let Some(picture) = Snapshot::of_outcome(&rod.analysis.prior, outcome)
        {
            let unit = rod.channels.displacement.unit.si();
            messages.extend(Message::of_picture(outcome.rod(), &picture, Some(unit)));
        }
        // A replay acknowledges nothing.
        messages.extend(verdict.events.iter().map(|event| Message::of_event(event, None)));
        for message in &messages {
            self.writer.write(message)?;
        }
        Ok(())
    }

    fn finish(self) -> anyhow::Result<()> {
        let Self {
            writer,
            path,
            records,
            failure,
        } = self;
        let whole = || -> anyhow::Result<()> {
            match failure {
                Some(failure) => Err(failure),
                None => Ok(writer.finish()?.commit()?),
            }
        };
        whole().with_context(|| format!("--results {}: not written", path.display()))?;
        tell!("results: {records} records in {}", path.display());
        Ok(())
    }
}
