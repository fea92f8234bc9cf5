//! `tirante import`: converts measurements of other programs to a recording.

use super::foreign::{self, Foreign};
use super::{BadArguments, print};
use crate::analysis::signal::record::{RodChannels, Unit};
use crate::config::Config;
use crate::recording::import::{self, Contents, ImportError, Plan};
use crate::recording::write::{Encoding, Layout, RecordingWriter, WriterOptions};
use crate::site::hex::hex;
use anyhow::Context;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Convert a file of another program to a recording (MCAP).
///
/// Reads CSV, UFF58, WAV, MATLAB, LabVIEW (.lvm, .tdms) and NumPy. Every sample is kept to the bit. Unit, rate and
/// start are needed where the file does not contain them; nothing is guessed. Without `--out` it shows the
/// content of the file.
///
/// Prints the lines that a configuration needs to read the recording.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  tirante import laser.csv --out laser.mcap
  tirante import laser.csv --delimiter ';' --decimal-comma \\
      --time Datum,Uhrzeit --channel 'Weg 1=/nave-3/displacement' \\
      --out laser.mcap
  tirante import laser.uff --config site.toml \\
      --channel 1=/nave-3/displacement --out laser.mcap
  tirante import laser.wav --full-scale 2.5 --unit mm \\
      --start 2026-03-01T06:00:00Z --out laser.mcap
  tirante import laser.mat --rate 200 --unit um --start 2026-03-01T06:00:00Z \\
      --out laser.mcap
  tirante import hammer.tdms --channel 'Acc 3=/nave-3/acceleration' \\
      --out hammer.mcap
  tirante import camera.npy --rate 250 \\
      --channel '[7,:,1]=/nave-3/displacement,mm' \\
      --start 2026-03-01T06:00:00Z --out camera.mcap
  tirante import laser.csv                 # what is in it

`identify` and `replay` read these files as they are, with the same flags.

The whole story is in docs/imports.md.")]
pub struct Args {
    /// Measurement to read.
    #[arg(value_name = "FILE")]
    pub path: PathBuf,
    /// Recording to write (MCAP).
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Configuration that will read the recording: units, fields and rates must match it.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Encoding of messages.
    #[arg(long, value_enum, default_value_t = MessageEncoding::Protobuf)]
    pub encoding: MessageEncoding,
    /// Overwrite an existing file.
    #[arg(long)]
    pub force: bool,

    /// Facts missing in the file.
    #[command(flatten)]
    pub foreign: Foreign,
}

/// Encoding of messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum MessageEncoding {
    /// JSON.
    Json,
    /// Protobuf, with its description in the file.
    Protobuf,
    /// ROS 2.
    Cdr,
}

impl MessageEncoding {
    /// Encoding of the messages.
    pub fn encoding(self) -> Encoding {
        match self {
            Self::Json => Encoding::Json,
            Self::Protobuf => Encoding::Protobuf,
            Self::Cdr => Encoding::Ros2,
        }
    }
}

/// Runs the command.
///
/// # Errors
/// The file cannot be read or lacks facts, or the recording cannot be written.
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
    let how = args.foreign.how();
    let (file, bytes) = open(&args.path)?;
    let found = import::read(foreign::watch(file, bytes), &args.path, &how);
    let found = found.map_err(|error| refuse(&args.path, error))?;
    let found = found.ok_or_else(|| BadArguments(format!("{name}: is a recording already: replay it")))?;
    for what in &found.left_out {
        tell!("{name}: left out: {what}");
    }
    let Some(out) = &args.out else {
        return print(contents(&args.path, &found).as_bytes());
    };
    found
        .check_full_scale()
        .map_err(|error| refuse(&args.path, error))?;
    let asked = how.asked(&rods);
    let encoding = args.encoding.encoding();
    // A fault of the plan is a fault of the arguments.
    let plan = Plan::new(found.signals, &asked, encoding)
        .map_err(|error| BadArguments(format!("{name}: {error}")))?;
    let mut writer = RecordingWriter::create(out, WriterOptions::default())?;
    writer.metadata("tirante.import", facts(&args.path, &plan)?)?;
    let messages = import::write(&mut writer, &plan)?;
    writer.save()?;
    print(snippet(&args.path, out, &plan, messages).as_bytes())
}

/// Error of the file or of its options, with its name.
fn refuse(path: &Path, error: ImportError) -> anyhow::Error {
    let what = format!("{}: {error}", path.display());
    match error.is_unknown_format() {
        true => BadArguments(what).into(),
        false => anyhow::anyhow!(what),
    }
}

/// Opens a regular file and returns its size; anything else could block forever.
fn open(path: &Path) -> anyhow::Result<(File, u64)> {
    let refuse = |what: String| anyhow::anyhow!("{}: {what}", path.display());
    let unreadable = |error: std::io::Error| refuse(format!("cannot be read: {error}"));
    let kind = std::fs::metadata(path).map_err(unreadable)?;
    if !kind.is_file() {
        return Err(refuse("is not a regular file".to_owned()));
    }
    Ok((File::open(path).map_err(unreadable)?, kind.len()))
}

/// Refuses to overwrite without `force`, and to replace anything but a file.
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

/// Facts about the origin, for the recording; nothing of the machine or the day.
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
    let hash = hex(&hash.finalize());
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

/// Content of a file, for people.
fn contents(path: &Path, found: &Contents) -> String {
    let mut text = format!("{}: {}\n", path.display(), found.format.name());
    for signal in &found.signals {
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "  channel {}  {:?}  {}",
            signal.number,
            signal.name,
            import::describe(signal)
        );
    }
    text.push_str("--out FILE writes a recording.\n");
    text
}

/// Summary of the recording, as the lines that a configuration needs to read it.
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
        match (channel.interpolation(), channel.deviation_s) {
            (Some(interpolation), _) => {
                let _ = write!(text, ", {interpolation}");
            }
            (None, Some(0.0)) => text.push_str(", stamps exactly even"),
            (None, Some(deviation_s)) => {
                let _ = write!(text, ", stamps within {deviation_s:.2e} s of it");
            }
            (None, None) => {}
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
