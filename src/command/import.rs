//! `tirante import`: measurements of other programs to a recording.

use super::progress::Watched;
use super::{BadArguments, print};
use crate::config::Config;
use crate::import::{
    self, Asked, DateOrder, ImportError, Plan, Signal, TimeUnit, Timing, Wanted, csv, mat, uff, wav,
};
use crate::record::{RodChannels, Timestamp, Unit};
use crate::sink::{Encoding, Layout, RecordingWriter, WriterOptions};
use anyhow::Context;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Makes a recording (MCAP) of a measurement in CSV, UFF58, WAV or MATLAB format. Every sample is kept to the bit; what the
/// file does not say (unit, rate, start) must be said, nothing is guessed. Without `--out` it shows what is in the file.
///
/// On stdout it prints what it wrote, as the lines a configuration needs to read it.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  tirante import laser.csv --out laser.mcap
  tirante import laser.csv --delimiter ';' --decimal-comma --time Datum,Uhrzeit --channel 'Weg 1=/nave-3/displacement' --out laser.mcap
  tirante import laser.uff --config site.toml --channel 1=/nave-3/displacement --out laser.mcap
  tirante import laser.wav --full-scale 2.5 --unit mm --start 2026-03-01T06:00:00Z --out laser.mcap
  tirante import laser.mat --rate 200 --unit um --start 2026-03-01T06:00:00Z --out laser.mcap
  tirante import laser.csv                 what is in it

The whole story is in docs/imports.md.")]
pub struct Args {
    /// The measurement.
    #[arg(value_name = "FILE")]
    pub path: PathBuf,
    /// The recording to write (MCAP).
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// The configuration that will read it: units, fields and rates must be those it says.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// The format, if the file's ending does not say it.
    #[arg(long, value_enum)]
    pub format: Option<Format>,
    /// A channel wanted, by name or number; any number of times, all without it.
    #[arg(long = "channel", value_name = "SOURCE[=TOPIC][,UNIT]", value_parser = Wanted::parse)]
    pub channels: Vec<Wanted>,
    /// The unit of channels whose unit the file does not say.
    #[arg(long, value_parser = unit)]
    pub unit: Option<Unit>,
    /// The sample rate in Hz, if the file does not say it; checked if it does.
    #[arg(long, value_name = "HZ", value_parser = positive)]
    pub rate: Option<f64>,
    /// The time of the first sample, if the file does not say it.
    #[arg(long, value_name = "TIME", value_parser = time)]
    pub start: Option<Timestamp>,
    /// How far times without an offset of their own are ahead of UTC.
    #[arg(long, value_name = "+HH:MM", value_parser = import::utc_offset, default_value = "+00:00", allow_hyphen_values = true)]
    pub utc_offset: i32,
    /// Interpolates uneven stamps to this rate in Hz; without it they are refused.
    #[arg(long, value_name = "HZ", value_parser = positive, conflicts_with = "rate")]
    pub resample: Option<f64>,
    /// How messages are encoded.
    #[arg(long, value_enum, default_value_t = MessageEncoding::Protobuf)]
    pub encoding: MessageEncoding,
    /// Overwrite a file that exists.
    #[arg(long)]
    pub force: bool,

    /// CSV, MATLAB: where the stamps are (a column, two for day and time of day, a variable), or none.
    #[arg(long, value_name = "NAME[,NAME]|none", help_heading = "Tables and variables")]
    pub time: Option<String>,
    /// CSV, MATLAB: what numbers in the stamps count.
    #[arg(long, value_enum, help_heading = "Tables and variables")]
    pub time_unit: Option<TimeUnit>,
    /// CSV: what stands between columns: one character, tab or space (any number of blanks).
    #[arg(long, value_name = "CHARACTER", value_parser = delimiter, help_heading = "Tables and variables")]
    pub delimiter: Option<u8>,
    /// CSV: decimals stand behind a comma.
    #[arg(long, help_heading = "Tables and variables")]
    pub decimal_comma: bool,
    /// CSV: lines before the first row of data.
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(0..=190), help_heading = "Tables and variables")]
    pub head_lines: Option<u16>,
    /// CSV: how dates such as 03/04/2026 are meant.
    #[arg(long, value_enum, help_heading = "Tables and variables")]
    pub dates: Option<DateOrder>,
    /// WAV: the value at full scale, in --unit.
    #[arg(long, value_name = "VALUE", value_parser = positive, help_heading = "Tables and variables")]
    pub full_scale: Option<f64>,
}

/// The formats that are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// Text tables.
    Csv,
    /// Universal file format, dataset 58.
    Uff,
    /// Sound files.
    Wav,
    /// MATLAB, versions 5 to 7.
    Mat,
}

/// How messages can be encoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum MessageEncoding {
    /// JSON.
    Json,
    /// Protobuf, with its description in the file.
    Protobuf,
    /// ROS 2.
    Cdr,
}

fn unit(text: &str) -> Result<Unit, String> {
    Unit::as_written(text).ok_or_else(|| import::unknown_unit(text))
}

fn positive(text: &str) -> Result<f64, String> {
    let number = text
        .parse()
        .ok()
        .filter(|number: &f64| number.is_finite() && *number > 0.0);
    number.ok_or_else(|| "a positive number is expected".to_owned())
}

fn time(text: &str) -> Result<Timestamp, String> {
    let time = serde_json::from_value(serde_json::Value::String(text.to_owned()));
    time.map_err(|_| {
        "a time with its offset from UTC is expected: 2026-03-01T06:00:00Z, 2026-03-01T07:00:00+01:00"
            .to_owned()
    })
}

fn delimiter(text: &str) -> Result<u8, String> {
    match (text, text.as_bytes()) {
        ("tab" | "\\t", _) => Ok(b'\t'),
        ("space" | "blank", _) => Ok(b' '),
        (_, [byte]) if byte.is_ascii() && !byte.is_ascii_alphanumeric() && *byte != b'"' => Ok(*byte),
        _ => Err("one character such as ; or the words tab, space".to_owned()),
    }
}

/// Runs the command.
///
/// # Errors
/// The file cannot be read or does not say enough, or the recording cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let rods: Vec<RodChannels> = match &args.config {
        Some(path) => Config::load(path)?
            .rods
            .into_iter()
            .map(|rod| rod.channels)
            .collect(),
        None => Vec::new(),
    };
    if let Some(out) = &args.out {
        check_target(out, args.force)?;
    }
    let name = args.path.display();
    let format = format(args)?;
    let (signals, skipped) = read(args, format).map_err(|error| refuse(&args.path, error))?;
    for what in &skipped {
        tell!("{name}: left out: {what}");
    }
    let Some(out) = &args.out else {
        return print(contents(&args.path, &signals).as_bytes());
    };
    let asked = Asked {
        channels: &args.channels,
        unit: args.unit,
        rate_hz: args.rate,
        start: args.start,
        resample_hz: args.resample,
        rods: &rods,
    };
    let encoding = match args.encoding {
        MessageEncoding::Json => Encoding::Json,
        MessageEncoding::Protobuf => Encoding::Protobuf,
        MessageEncoding::Cdr => Encoding::Ros2,
    };
    // What a plan lacks or refuses is a matter of arguments.
    let plan =
        Plan::new(signals, &asked, encoding).map_err(|error| BadArguments(format!("{name}: {error}")))?;
    let mut writer = RecordingWriter::create(out, WriterOptions::default())?;
    writer.metadata("tirante.import", facts(&args.path, &plan)?)?;
    let messages = import::write(&mut writer, &plan)?;
    writer.save()?;
    print(snippet(&args.path, out, &plan, messages).as_bytes())
}

/// A fault of the file or of what is asked of it, with its name.
fn refuse(path: &Path, error: ImportError) -> anyhow::Error {
    anyhow::anyhow!("{}: {error}", path.display())
}

/// Refuses to overwrite without being told, and to replace what is no file.
fn check_target(out: &Path, force: bool) -> Result<(), BadArguments> {
    match std::fs::metadata(out) {
        Ok(kind) if !kind.is_file() => Err(BadArguments(format!(
            "{}: exists and is not a regular file",
            out.display()
        ))),
        Ok(_) if !force => Err(BadArguments(format!(
            "{}: exists; --force overwrites it",
            out.display()
        ))),
        _ => Ok(()),
    }
}

fn format(args: &Args) -> Result<Format, BadArguments> {
    if let Some(format) = args.format {
        return Ok(format);
    }
    let ending = args
        .path
        .extension()
        .and_then(|ending| ending.to_str())
        .unwrap_or_default();
    match ending.to_lowercase().as_str() {
        "csv" | "txt" | "tsv" | "asc" | "dat" => Ok(Format::Csv),
        "uff" | "unv" | "uf" => Ok(Format::Uff),
        "wav" => Ok(Format::Wav),
        "mat" => Ok(Format::Mat),
        _ => Err(BadArguments(format!(
            "{}: the ending does not say the format: --format csv, uff, wav or mat does",
            args.path.display()
        ))),
    }
}

/// What is in the file, and what was left out.
fn read(args: &Args, format: Format) -> Result<(Vec<Signal>, Vec<String>), ImportError> {
    let file = open(&args.path).map_err(ImportError::new)?;
    let length = file.metadata().map_or(0, |file| file.len());
    let from = BufReader::with_capacity(1 << 16, Watched::new(file, length));
    let named: Option<Vec<String>> = args
        .time
        .as_ref()
        .map(|names| names.split(',').map(|name| name.trim().to_owned()).collect());
    let is_none = args.time.as_deref() == Some("none");
    match format {
        Format::Csv => {
            let table = csv::Table {
                delimiter: args.delimiter,
                decimal_comma: args.decimal_comma,
                head_lines: args.head_lines.map(usize::from),
                time: match named {
                    _ if is_none => csv::TimeColumn::None,
                    Some(names) => csv::TimeColumn::Named(names),
                    None => csv::TimeColumn::Found,
                },
                time_unit: args.time_unit,
                dates: args.dates,
                utc_offset_s: args.utc_offset,
                columns: args.channels.iter().map(|wanted| wanted.source.clone()).collect(),
            };
            Ok((csv::read(from, &table)?, Vec::new()))
        }
        Format::Uff => {
            let found = uff::read(from, args.utc_offset)?;
            Ok((found.signals, found.skipped))
        }
        Format::Wav => {
            let full_scale = match (args.full_scale, &args.out) {
                (Some(full_scale), _) => full_scale,
                (None, None) => 1.0,
                (None, Some(_)) => {
                    return Err(ImportError::new(
                        "a WAV file does not say what its numbers mean: --full-scale VALUE --unit UNIT says what full scale is",
                    ));
                }
            };
            Ok((wav::read(from, full_scale)?, Vec::new()))
        }
        Format::Mat => {
            let time = args.time.as_deref().filter(|_| !is_none);
            let found = mat::read(from, time, !is_none, args.time_unit.unwrap_or(TimeUnit::S))?;
            Ok((found.signals, found.skipped))
        }
    }
}

/// A regular file, opened; anything else could wait for ever.
fn open(path: &Path) -> Result<File, String> {
    let kind = std::fs::metadata(path).map_err(|error| format!("cannot be read: {error}"))?;
    if !kind.is_file() {
        return Err("is not a regular file".to_owned());
    }
    File::open(path).map_err(|error| format!("cannot be read: {error}"))
}

/// What the recording says of its origin; nothing of the machine or the day.
fn facts(path: &Path, plan: &Plan) -> anyhow::Result<BTreeMap<String, String>> {
    let mut hash = Sha256::new();
    let mut file = File::open(path).with_context(|| path.display().to_string())?;
    let (mut bytes, mut block) = (0, vec![0; 1 << 16]);
    loop {
        let read = file
            .read(&mut block)
            .with_context(|| path.display().to_string())?;
        if read == 0 {
            break;
        }
        bytes += read as u64;
        hash.update(&block[..read]);
    }
    let hash: String = hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    let name = path
        .file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    let mut facts = BTreeMap::from([
        (
            "by".to_owned(),
            concat!("tirante import ", env!("CARGO_PKG_VERSION")).to_owned(),
        ),
        ("file".to_owned(), name),
        ("bytes".to_owned(), bytes.to_string()),
        ("sha256".to_owned(), hash),
    ]);
    for channel in &plan.channels {
        facts.insert(format!("name of {}", channel.topic), channel.name.clone());
        if let Some(unit) = &channel.written_unit {
            facts.insert(format!("unit of {}", channel.topic), unit.clone());
        }
        if channel.is_resampled {
            facts.insert(
                format!("resampled {}", channel.topic),
                format!("{} Hz", channel.fs_hz),
            );
        }
    }
    Ok(facts)
}

/// What is in a file, for people.
fn contents(path: &Path, signals: &[Signal]) -> String {
    let mut text = format!("{}:\n", path.display());
    for signal in signals {
        let when = match &signal.timing {
            Timing::Unknown => "rate and start not said (--rate, --time, --start)".to_owned(),
            Timing::Rate { fs_hz, start, .. } => match start {
                Some(start) => format!("{} Hz from {start}", import::rounded(*fs_hz)),
                None => format!("{} Hz, start not said (--start)", import::rounded(*fs_hz)),
            },
            Timing::Stamps(stamps) => match stamps.nanos.first() {
                Some(first) if stamps.absolute => format!("stamps from {}", Timestamp::from_nanos(*first)),
                _ => "stamps without a date (--start)".to_owned(),
            },
        };
        let unit = match signal.unit.as_deref() {
            None => "unit not said (--unit)".to_owned(),
            Some(written) => match Unit::as_written(written) {
                Some(unit) => unit.key().to_owned(),
                None => format!("unit {written:?}, none of ours (--unit)"),
            },
        };
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "  channel {}  {:?}  {} samples, {unit}, {when}",
            signal.number,
            signal.name,
            signal.values.len()
        );
    }
    text.push_str("--out FILE writes a recording.\n");
    text
}

/// What was written, as the lines a configuration needs to read it.
fn snippet(path: &Path, out: &Path, plan: &Plan, messages: u64) -> String {
    let mut text = format!("# {} -> {}: {messages} messages\n", path.display(), out.display());
    for channel in &plan.channels {
        let start = channel
            .stretches
            .first()
            .map(|(start, _)| start.to_string())
            .unwrap_or_default();
        let _ = write!(
            text,
            "#\n# {:?}: {} samples at {} Hz from {start}",
            channel.name,
            channel.values.len(),
            channel.fs_hz
        );
        let gaps = channel.stretches.len().saturating_sub(1);
        if gaps > 0 {
            let _ = write!(text, ", {gaps} gaps");
        }
        if channel.missing() > 0 {
            let _ = write!(text, ", {} missing", channel.missing());
        }
        match channel.deviation_s {
            Some(deviation_s) if channel.is_resampled => {
                let _ = write!(text, ", interpolated up to {deviation_s:.2e} s from a stamp");
            }
            Some(0.0) => text.push_str(", stamps exactly even"),
            Some(deviation_s) => {
                let _ = write!(text, ", stamps within {deviation_s:.2e} s of it");
            }
            None => {}
        }
        let is_temperature = Unit::TEMPERATURE.contains(&channel.unit);
        let section = if is_temperature {
            "rod.temperature"
        } else {
            "rod.channel"
        };
        let topic = toml::Value::String(channel.topic.clone());
        let _ = write!(
            text,
            "\n[{section}]\ntopic = {topic}\nfield = \"{}\"\nunit = \"{}\"\n",
            channel.field(plan.encoding),
            channel.unit.key()
        );
        if matches!(channel.layout, Layout::Batch(_)) {
            let _ = writeln!(text, "fs_hz = {:?}", channel.fs_hz);
        }
    }
    text
}
