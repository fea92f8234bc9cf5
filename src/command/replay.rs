//! `tirante replay`: recordings through the whole pipeline.

use super::BadArguments;
use super::campaign::{self, News, Reading};
use super::foreign::Foreign;
use super::progress::Progress;
use super::render::Table;
use super::report;
use super::setup::{self, GivenUp, Prepared, Setup};
use super::sketch::{self, When};
use super::status;
use super::which_store::Format;
use crate::analysis::outcome::Outcome;
use crate::analysis::record_view::Snapshot;
use crate::analysis::signal::record::RodId;
use crate::analysis::track::Verdict;
use crate::config::Config;
use crate::recording::atomic::AtomicFile;
use crate::service::viewer::{Message, ResultsWriter};
use crate::site::trackers::Taken;
use anyhow::Context;
use std::env;
use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Runs recordings through the whole pipeline: per record the natural frequencies, the axial force and its change
/// since the baseline, alarms as they are raised, and in the end how every rod stands.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante replay recordings/todi-pull.mcap
  tirante replay recordings/campaign-2025.mcap --config config/campaign.toml --store site.db --report .
  tirante replay recordings/todi-pull.mcap --results todi-results.mcap
  tirante replay /data/2026 --config site.toml --json > forces.jsonl
  tirante replay monday.csv tuesday.tdms --config site.toml --store site.db

The force (mean ± standard deviation) is what one record says by itself. The change is that of the force since
the rod's baseline, at the reference temperature; '~' marks one that is not compensated for temperature; '-'
stands while the baseline is learned. `! conflict` says by how many standard deviations the frequencies lie
outside everything the model can produce: the force may be wrong by more than it says. `? hardly in the prior`:
check length, section, material and expected force. Behind the state, `decay`, `decays` and `blow` say what motion was
recognised (nothing: ambient vibration), `? orders 0.93` that the orders of the modes are not certain: `tirante identify`
shows what else the peaks may be. --json has everything else.

Alarms are results, not failures: a replay that raises some still ends with 0 (or 3 with rejected records or
lost data). Ask `tirante status --format json` whether an alarm stands.")]
pub struct Args {
    /// MCAP recordings, folders of them, or files of other programs (CSV, UFF, WAV, MATLAB, LabVIEW, NumPy).
    #[arg(value_name = "PATH", required = true)]
    pub paths: Vec<PathBuf>,

    /// One JSON object per record on stdout instead of the table.
    #[arg(long)]
    pub json: bool,

    /// Keep results in this database (SQLite) and go on where it left off; over `[store] path` of the configuration. Without
    /// either, nothing is remembered after the replay.
    #[arg(long, value_name = "FILE")]
    pub store: Option<PathBuf>,

    /// Write the report into this folder in the end: one page per site, to open without a network.
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,

    /// Write what came of every record, its waveform and spectrum too, into this MCAP file, to be opened beside the recordings in
    /// Foxglove or Lichtblick. It must not be there yet; records the store had already are not in it.
    #[arg(long, value_name = "FILE")]
    pub results: Option<PathBuf>,

    /// How recordings are read.
    #[command(flatten)]
    pub reading: Reading,

    /// Whether a small plot is drawn in the end.
    #[arg(long, value_name = "WHEN", value_enum, default_value_t)]
    pub plot: When,

    /// The configuration.
    #[command(flatten)]
    pub setup: Setup,

    /// Baselines that may go.
    #[command(flatten)]
    pub given_up: GivenUp,

    /// What another program's file does not say.
    #[command(flatten)]
    pub foreign: Foreign,
}

/// Runs the command.
///
/// # Errors
/// Bad arguments or configuration, no recording at all, a store or an output that cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let config = args.setup.load()?;
    let Prepared { generation, mut site } = setup::site(config, args.store.as_deref(), &args.given_up)?;
    let (config, plans) = (&generation.config, &generation.plans);
    let modes = config
        .rods
        .iter()
        .map(|rod| rod.analysis.modes.count)
        .max()
        .unwrap_or(0);
    let rods: Vec<&RodId> = config.rods.iter().map(|rod| &rod.analysis.rod).collect();
    let store = args.store.as_deref().or(config.store.path.as_deref());
    let is_coloured = io::stdout().is_terminal() && env::var_os("NO_COLOR").is_none_or(|set| set.is_empty());
    let table = Table::new(
        rods.into_iter(),
        modes,
        store.map(|path| path.display().to_string()),
        is_coloured,
    );
    let known = site.store().all_known().clone();

    let mut results = args.results.as_deref().map(Results::create).transpose()?;
    let mut output = io::stdout().lock();
    let mut header_due = !args.json;
    let on_news = |news: News<'_>, bar: &Progress| {
        let (outcome, place) = match news {
            News::Outcome(outcome, place) => (outcome, place),
            News::Readings { rod, readings, after } => {
                let is_new = site.take_readings(rod, readings, after)?;
                return Ok(if is_new {
                    campaign::Taken::New
                } else {
                    campaign::Taken::Known
                });
            }
        };
        let Some(Taken { line, verdict }) = site.take(outcome, Some(place))? else {
            return Ok(campaign::Taken::Known);
        };
        if let Some(results) = &mut results {
            results.add(config, outcome, &line, &verdict);
        }
        bar.suspend(|| {
            if header_due {
                header_due = false;
                writeln!(output, "{}\n{}", config.site, table.header())?;
            }
            let line = if args.json {
                line
            } else {
                table.row(outcome, &verdict)
            };
            writeln!(output, "{line}")
        })?;
        Ok(campaign::Taken::New)
    };
    let tally = campaign::run(
        &args.paths,
        config,
        plans,
        &args.reading,
        args.foreign.among(&args.setup, false),
        &known,
        on_news,
    )?;
    let has_seen_all = tally.is_some();
    let code = campaign::conclude(tally);
    if has_seen_all {
        let standing = status::text(site.store(), None, Format::Table)?;
        tell!("{}", standing.trim_end());
        if let Some(width) = args.plot.width().filter(|_| !args.json) {
            for rod in site.store().rods()? {
                write!(output, "\n{}", sketch::force(site.store(), &rod, width)?)?;
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

/// The MCAP file of results: it appears whole or not at all.
struct Results<'p> {
    writer: ResultsWriter<AtomicFile>,
    path: &'p Path,
    records: usize,
    /// What went wrong first; nothing is written after it, and the replay goes on.
    failure: Option<anyhow::Error>,
}

impl<'p> Results<'p> {
    fn create(path: &'p Path) -> anyhow::Result<Self> {
        if path.exists() {
            let why = format!(
                "--results {}: exists, and holds what another replay wrote; name another file",
                path.display()
            );
            return Err(BadArguments(why).into());
        }
        let file = AtomicFile::create(path).with_context(|| format!("--results {}", path.display()))?;
        Ok(Self {
            writer: ResultsWriter::new(file)?,
            path,
            records: 0,
            failure: None,
        })
    }

    /// What came of a record: line and picture, and news of alarms at the time they came.
    fn add(&mut self, config: &Config, outcome: &Outcome, line: &str, verdict: &Verdict) {
        if self.failure.is_none() {
            match self.write(config, outcome, line, verdict) {
                Ok(()) => self.records += 1,
                Err(error) => self.failure = Some(error),
            }
        }
    }

    fn write(
        &mut self,
        config: &Config,
        outcome: &Outcome,
        line: &str,
        verdict: &Verdict,
    ) -> anyhow::Result<()> {
        let mut messages = Message::of_record(line)?;
        if let Some(rod) = config.rod(&outcome.rod().0)
            && let Some(picture) = Snapshot::of_outcome(&rod.analysis.prior, outcome)
        {
            let unit = rod.channels.displacement.unit.si();
            messages.extend(Message::of_picture(outcome.rod(), &picture, Some(unit)));
        }
        messages.extend(verdict.events.iter().map(Message::of_event));
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
