//! `tirante spectrum`: shows every peak of a measurement, without a rod.

mod input;
mod look;

use super::foreign::Foreign;
use super::progress::Progress;
use super::sketch::{self, When};
use super::{BadArguments, WITH_LOSSES, findings};
use crate::analysis::findings::motion_said;
use crate::command::report_page;
use crate::command::report_page::view::SpectrumReport;
use crate::command::which_store::Output;
use crate::config::written::positive;
use crate::config::{Config, Setting};
use crate::recording::atomic::AtomicFile;
use crate::recording::{import, read};
use crate::site::ordered_map::{Limits, map_in_order};
use anyhow::Context;
use input::{Inputs, Step, Wanted};
use look::{Look, Looker};
use std::io::{self, Write};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;

/// Most samples of records in memory between reading and analysis (8 bytes each).
const SAMPLES_IN_FLIGHT: usize = 4 << 20;
/// Most records of a page.
const PAGE_RECORDS: usize = 100;

/// Show every peak of a measurement; no rod is needed.
///
/// Each peak comes with its frequency and standard error, damping, level, and probable nature. Every channel
/// of motion in the files is analysed.
///
/// With --config the records are those of the configured rods: the peaks then show the orders of their modes,
/// and the record's force is printed above them.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  tirante spectrum recordings/todi-pull.mcap
  tirante spectrum laser.mcap --topic /nave-3/displacement --band 2..40
  tirante spectrum laser.csv --unit mm             # any format of import
  tirante spectrum laser.mcap --html laser.html    # waveform and spectrum
  tirante spectrum /data/2026 --format json > peaks.jsonl
  tirante spectrum laser.mcap --config site.toml   # with the modes' orders
  tirante spectrum laser.mcap --config site.toml --set modes.count=1

What a peak is taken for:
  mode 2      with --config alone: the rod's second mode
  candidate   a resonance, which may be a mode; '2 x 4.492' if it is a
              multiple of another peak, as the modes of a taut rod
              nearly are
  doubtful    a resonance whose shape or level speaks against a mode
  tone        a pure sine: mains, a motor, a pump; harmonic: a multiple of
              a tone
  broad       wider than any rod vibrates (damping above 10 %); drift: the
              same at the low end

The level is the height of the fitted peak over the noise floor. Without --band,
peaks are looked for from 15 periods in the record up to 0.48 of the sample
rate.")]
pub struct Args {
    /// Recordings (MCAP), measurements in any format that `import` reads, or folders of recordings.
    #[arg(value_name = "FILE", required = true)]
    pub paths: Vec<PathBuf>,

    /// Channel of a recording by its topic; may be repeated; the same as --channel.
    #[arg(long, value_name = "NAME", conflicts_with = "config")]
    pub topic: Vec<String>,

    /// Field of a message that holds the samples, if it is not one of the usual ones; only for recordings.
    #[arg(long, value_name = "PATH", conflicts_with = "config")]
    pub field: Option<String>,

    /// Band searched for peaks in Hz; either end may be left out.
    #[arg(long, value_name = "LOW..HIGH")]
    pub band: Option<Band>,

    /// Configuration: use the records of its rods, with the orders of their modes.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,

    /// Override one key of --config; may be repeated: `--set modes.count=1`.
    #[arg(long = "set", value_name = "KEY=VALUE", requires = "config")]
    pub settings: Vec<Setting>,

    /// Text or JSON.
    #[command(flatten)]
    pub output: Output,

    /// Write a page with waveform, spectrum and peaks of every record, which needs no network.
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,

    /// Draw a small plot under each table.
    #[arg(long, value_name = "WHEN", value_enum, default_value_t)]
    pub plot: When,

    /// Facts missing in a file.
    #[command(flatten)]
    pub foreign: Foreign,
}

/// A band of frequencies, open where an end is left out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Band {
    /// Lower end \[Hz\].
    pub low_hz: Option<f64>,
    /// Upper end \[Hz\].
    pub high_hz: Option<f64>,
}

impl FromStr for Band {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected =
            || format!("'{text}' is no band: LOW..HIGH in Hz is expected, such as 2..40, 2.. or ..40");
        let (low, high) = text.split_once("..").ok_or_else(expected)?;
        let end = |text: &str| match text.trim() {
            "" => Ok(None),
            number => positive(number).map(Some).map_err(|_| expected()),
        };
        let band = Self {
            low_hz: end(low)?,
            high_hz: end(high)?,
        };
        match (band.low_hz, band.high_hz) {
            (Some(low), Some(high)) if low >= high => {
                Err(format!("{low}..{high}: the lower end comes first"))
            }
            _ => Ok(band),
        }
    }
}

/// Runs the command.
///
/// # Errors
/// Bad arguments or configuration, or a page that cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    if let Some(page) = &args.html
        && args.paths.iter().any(|path| path == page)
    {
        return Err(BadArguments(format!("--html {}: is the file to be looked at", page.display())).into());
    }
    let resolve = |path| Config::resolve(Some(path), &args.settings);
    let config = args.config.as_deref().map(resolve).transpose()?;
    let looker = Looker::new(
        config.as_ref(),
        args.band.unwrap_or(Band {
            low_hz: None,
            high_hz: None,
        }),
    )?;
    let mut foreign = args.foreign.clone();
    let topics = args.topic.iter().map(|topic| import::Wanted {
        source: topic.clone(),
        topic: None,
        unit: None,
    });
    foreign.channels.extend(topics);
    let wanted = Wanted {
        config: config.as_ref(),
        field: args.field.as_deref(),
        how: foreign.how(),
    };
    let files = read::recordings(&args.paths);
    let (bar, total) = Progress::of_files(&files);
    let done = Arc::new(AtomicU64::new(0));
    let mut shown = Shown::new(args);
    let mut failure = None;
    map_in_order(
        Inputs::new(files, wanted, Arc::clone(&done)),
        Limits {
            workers: thread::available_parallelism().map_or(1, usize::from),
            weight: SAMPLES_IN_FLIGHT,
        },
        |step| match step {
            Step::Event(_, event) => input::samples(event),
            _ => 1,
        },
        |step| match step {
            Step::Event(channel, event) => Done::Look(looker.look(&channel, event)),
            Step::Note(note) => Done::Note(note),
            Step::Ended(faults) => Done::Ended(faults),
            Step::Failed(why) => Done::Failed(why),
        },
        |results| {
            bar.set(done.load(Ordering::Relaxed), total);
            for result in results {
                if let Err(error) = shown.take(result, &bar) {
                    failure = Some(error);
                    return ControlFlow::Break(());
                }
            }
            ControlFlow::Continue(())
        },
    );
    drop(bar);
    match failure {
        // The reader of stdout has closed it (`| head`); the page is still wanted.
        Some(error) if error.kind() != io::ErrorKind::BrokenPipe => return Err(error.into()),
        _ => {}
    }
    if let Some(page) = &args.html {
        shown.write_page(page)?;
    }
    Ok(shown.exit_code())
}

/// Result of a step.
enum Done {
    Look(Option<Box<Look>>),
    Note(String),
    Ended(Vec<String>),
    Failed(String),
}

/// Output of results, with counts of each kind.
struct Shown<'a> {
    args: &'a Args,
    page: Vec<SpectrumReport>,
    left_out: usize,
    looks: usize,
    refused: usize,
    faults: usize,
    failed: usize,
    broken: usize,
}

impl<'a> Shown<'a> {
    fn new(args: &'a Args) -> Self {
        Self {
            args,
            page: Vec::new(),
            left_out: 0,
            looks: 0,
            refused: 0,
            faults: 0,
            failed: 0,
            broken: 0,
        }
    }

    fn take(&mut self, result: Result<Done, String>, bar: &Progress) -> io::Result<()> {
        match result {
            Ok(Done::Look(None)) => {}
            Ok(Done::Look(Some(look))) => {
                bar.suspend(|| self.show(&look))?;
                self.looks += 1;
                self.refused += usize::from(look.rejection.is_some());
                if self.args.html.is_some() {
                    match self.page.len() < PAGE_RECORDS {
                        true => self.page.push(look.report()),
                        false => self.left_out += 1,
                    }
                }
            }
            Ok(Done::Note(note)) => bar.say(&note),
            Ok(Done::Ended(faults)) => {
                self.faults += faults.len();
                for fault in faults {
                    bar.say(&format!("warning: {fault}"));
                }
            }
            Ok(Done::Failed(why)) => {
                self.failed += 1;
                bar.say(&format!("error: {why}"));
            }
            Err(panic) => {
                self.broken += 1;
                bar.say(&format!(
                    "error: the program broke on one record, please report it ({panic})"
                ));
            }
        }
        Ok(())
    }

    fn show(&self, look: &Look) -> io::Result<()> {
        let text = match self.args.output.is_json() {
            true => look.json() + "\n",
            false => self.table(look),
        };
        let mut out = io::stdout().lock();
        out.write_all(text.as_bytes())?;
        out.flush()
    }

    fn table(&self, look: &Look) -> String {
        let mut text = if self.looks > 0 {
            "\n".to_owned()
        } else {
            String::new()
        };
        let mut line = |opening: &str, content: &str| text += &findings::wrapped(opening, content);
        line("", &look.heading());
        if let (Some(start), Some(fs_hz)) = (look.start, look.fs_hz) {
            line(
                "  ",
                &format!(
                    "record of {:.1} s at {fs_hz:.2} Hz, {}",
                    look.duration_s,
                    findings::began(start)
                ),
            );
        }
        if let Some(motion) = look.motion() {
            line("  ", &motion_said(motion));
        }
        for flag in &look.flags {
            line("  noticed: ", &flag.to_string());
        }
        if let Some((rejection, reason)) = look.rejection.as_ref().zip(look.reason()) {
            line("  ", &format!("refused ({}): {reason}", rejection.code()));
        }
        if let Some(force) = look.force() {
            line("  ", &format!("axial force {force}"));
        }
        for doubt in look.said_doubts() {
            let words = doubt.trim_start();
            line(&doubt[..doubt.len() - words.len()], words);
        }
        if let Some(probability) = look.label_probability() {
            line(
                "  ",
                &format!(
                    "orders of the modes right with a probability of {}",
                    findings::probability(probability)
                ),
            );
        }
        let Some(picture) = &look.picture else { return text };
        if let Some((low, high)) = look.band_hz {
            let count = match picture.peaks.len() {
                0 => "no peak stands above the noise".to_owned(),
                1 => "1 peak".to_owned(),
                count => format!("{count} peaks"),
            };
            line("  ", &format!("{count} between {low:.2} and {high:.2} Hz"));
        }
        if !picture.peaks.is_empty() {
            text += &format!("\n{}", findings::peaks(&picture.peaks));
        }
        if !picture.candidates.is_empty() {
            text += &format!("\n{}", findings::candidates(&picture.candidates));
        }
        if let Some(width) = self.args.plot.width() {
            let plot = sketch::spectrum(picture, width);
            if !plot.is_empty() {
                text += &format!("\n{plot}");
            }
        }
        text
    }

    fn write_page(&self, page: &Path) -> anyhow::Result<()> {
        let at = || format!("--html {}", page.display());
        let title = match &self.args.paths[..] {
            [only] => only
                .file_name()
                .unwrap_or(only.as_os_str())
                .to_string_lossy()
                .into_owned(),
            several => format!("{} files", several.len()),
        };
        let mut file = AtomicFile::create(page).with_context(at)?;
        let text = report_page::spectra(&title, &self.page, self.left_out);
        file.write_all(text.as_bytes()).with_context(at)?;
        file.commit().with_context(at)?;
        tell!("page: {}", page.display());
        Ok(())
    }

    /// Exit code: 0 good, 1 nothing could be read or the analysis failed, 3 refused records, unreadable files
    /// or lost data.
    fn exit_code(&self) -> ExitCode {
        if self.broken > 0 || self.looks == 0 {
            if self.looks == 0 && self.failed == 0 && self.broken == 0 {
                tell!("error: no samples in the channels that were looked at");
            }
            ExitCode::FAILURE
        } else if self.refused + self.failed + self.faults > 0 {
            ExitCode::from(WITH_LOSSES)
        } else {
            ExitCode::SUCCESS
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_band_may_be_open() {
        let band = |low_hz, high_hz| Ok(Band { low_hz, high_hz });
        assert_eq!("2..40".parse(), band(Some(2.0), Some(40.0)));
        assert_eq!("..40".parse(), band(None, Some(40.0)));
        assert_eq!("0.5..".parse(), band(Some(0.5), None));
        for wrong in ["2", "2-40", "40..2", "2..2", "a..b", "-1..3", "0..3", "1..inf"] {
            assert!(wrong.parse::<Band>().is_err(), "{wrong}");
        }
    }
}
