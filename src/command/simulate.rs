//! `tirante simulate`: writes a recording of simulated rods, with the truth known.

use super::BadArguments;
use super::check::refuse;
use super::progress::Progress;
use super::{USAGE, print};
use crate::analysis::lab::synthesis::{Message, SimulatedRecord, Simulation, Synthesis, SynthesisError};
use crate::analysis::signal::record::{Channel, Unit};
use crate::config::{Config, SimulationConfig, read_text};
use crate::recording::atomic::AtomicFile;
use crate::recording::write::{ChannelId, ChannelSpec, Layout, RecordingWriter, SinkError, WriterOptions};
use anyhow::Context;
use rayon::prelude::*;
use serde_json::json;
use std::collections::BTreeMap;
use std::io::{Seek, Write};
use std::path::PathBuf;
use std::process::ExitCode;

/// Write recordings simulated from the beam model.
///
/// The configuration's section `[simulation]` describes rods, modes, damping, noise, temperature, loss of force and
/// faults. The same seed gives the same file to the byte.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  tirante simulate --config config/campaign.toml --out campaign.mcap \\
      --truth truth.jsonl")]
pub struct Args {
    /// Configuration; it needs a section `[simulation]`.
    #[arg(long, value_name = "FILE")]
    pub config: PathBuf,
    /// Recording to write (MCAP).
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Write the true state of the rods to this file, one JSON object per rod and record.
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,
    /// Seed; overrides the configuration's.
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Overwrite existing files.
    #[arg(long)]
    pub force: bool,
}

/// Runs the command.
///
/// # Errors
/// A file cannot be written.
pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let read = read_text(&args.config).and_then(|text| {
        Config::parse(&text, &args.config.display().to_string()).map(|config| (text, config))
    });
    let (text, config) = match read {
        Ok(read) => read,
        Err(error) => return Ok(refuse(&error)),
    };
    let Some(settings) = &config.simulation else {
        tell!(
            "{}: has no section [simulation]; config/campaign.toml shows one",
            args.config.display()
        );
        return Ok(ExitCode::from(USAGE));
    };
    if args.truth.as_ref() == Some(&args.out) {
        let both = BadArguments(format!(
            "--out and --truth are the same file, {}",
            args.out.display()
        ));
        return Err(both.into());
    }
    for path in std::iter::once(&args.out).chain(&args.truth) {
        let fault = match std::fs::metadata(path) {
            Err(_) => continue,
            // Moving a file over a device or a pipe would destroy it.
            Ok(kind) if !kind.is_file() => "exists and is not a regular file",
            Ok(_) if !args.force => "exists; --force overwrites it",
            Ok(_) => continue,
        };
        return Err(BadArguments(format!("{}: {fault}", path.display())).into());
    }
    let seed = args.seed.unwrap_or(config.seed);
    let options = WriterOptions {
        compression: settings.compression,
        ..WriterOptions::default()
    };
    let mut recording = Recording::new(RecordingWriter::create(&args.out, options)?, text, settings, seed)?;
    let mut truth = args
        .truth
        .as_deref()
        .map(|path| AtomicFile::create(path).with_context(|| format!("cannot write {}", path.display())))
        .transpose()?;
    let simulation = &settings.simulation;
    let synthesis = Synthesis::new(simulation, seed);
    let records = simulation.records as u64;
    let progress = Progress::new(records, "{wide_bar} {pos}/{len} records, {eta} left");
    let mut first = None;
    let mut last = None;
    for batch in batches(simulation) {
        let rods_of = |index| {
            (0..simulation.rods.len())
                .map(|rod| synthesis.record(rod, index))
                .collect()
        };
        let made: Result<Vec<Vec<SimulatedRecord>>, SynthesisError> =
            batch.into_par_iter().map(rods_of).collect();
        let made = match made {
            Ok(made) => made,
            Err(error) => {
                tell!("{}: {error}", args.config.display());
                return Ok(ExitCode::from(USAGE));
            }
        };
        for rods in made {
            recording.write(&rods)?;
            if let Some(file) = &mut truth {
                for rod in &rods {
                    writeln!(file, "{}", truth_line(rod, simulation, seed))?;
                }
            }
            progress.add(1, records);
            first.get_or_insert_with(|| summaries(&rods));
            last = Some(rods);
        }
    }
    drop(progress);
    let (samples, messages) = (recording.samples, recording.messages);
    recording.writer.save()?;
    if let Some(file) = truth {
        file.commit()?;
    }
    let mut text = format!(
        "{}: simulated, seed {seed}: {} x {} s at {} Hz of {}, {samples} samples in {messages} messages, {:.2} MB\n",
        args.out.display(),
        simulation.records,
        simulation.record_s,
        simulation.fs_hz,
        if let [_] = simulation.rods[..] {
            "one rod".to_owned()
        } else {
            format!("{} rods", simulation.rods.len())
        },
        std::fs::metadata(&args.out)?.len() as f64 * 1e-6
    );
    let last = last.as_deref().map(summaries).unwrap_or_default();
    for (first, last) in first.unwrap_or_default().iter().zip(&last) {
        text += &format!("  first {first}\n");
        if simulation.records > 1 {
            text += &format!("  last  {last}\n");
        }
    }
    print(text.as_bytes())
}

/// Batches of records made at once: enough for every thread, few enough for memory. The split does not
/// change the records.
fn batches(simulation: &Simulation) -> impl Iterator<Item = Vec<usize>> {
    let samples = simulation.samples().max(1) * simulation.rods.len().max(1);
    let together = (2_000_000 / samples).clamp(1, 4 * rayon::current_num_threads());
    let records = simulation.records;
    (0..records)
        .step_by(together)
        .map(move |begin| (begin..records.min(begin + together)).collect())
}

/// A channel and the unit of its samples.
type Stream = (ChannelId, Unit);

/// The channels of one rod.
struct RodStreams {
    displacement: Stream,
    further: Vec<Stream>,
    /// `None` if there is no climate, or another rod writes the same thermometer.
    temperature: Option<Stream>,
}

/// The recording being written.
struct Recording<W: Write + Seek> {
    writer: RecordingWriter<W>,
    channels: Vec<RodStreams>,
    fs_hz: f64,
    record_s: f64,
    samples: u64,
    messages: u64,
}

impl<W: Write + Seek> Recording<W> {
    fn new(
        mut writer: RecordingWriter<W>,
        config: String,
        settings: &SimulationConfig,
        seed: u64,
    ) -> Result<Self, SinkError> {
        let facts = BTreeMap::from([
            ("simulated".to_owned(), "yes: no rod was measured".to_owned()),
            (
                "by".to_owned(),
                concat!("tirante simulate ", env!("CARGO_PKG_VERSION")).to_owned(),
            ),
            ("seed".to_owned(), seed.to_string()),
            ("config".to_owned(), config),
        ]);
        writer.metadata("tirante.simulation", facts)?;
        let simulation = &settings.simulation;
        let layout = match simulation.samples_per_message {
            0 | 1 => Layout::Sample,
            length => Layout::Batch(length),
        };
        let mut add = |channel: &Channel, layout| {
            let spec = ChannelSpec {
                topic: channel.topic.clone(),
                encoding: settings.encoding,
                layout,
                precision: settings.precision,
                unit: channel.unit,
            };
            writer.add_channel(spec).map(|id| (id, channel.unit))
        };
        let mut thermometers: Vec<&str> = Vec::new();
        let mut channels = Vec::new();
        for rod in &simulation.rods {
            let displacement = add(&rod.displacement, layout)?;
            let further = rod
                .further
                .iter()
                .map(|further| add(&further.channel, layout))
                .collect::<Result<_, _>>()?;
            let shown = rod.temperature.as_ref().filter(|channel| {
                simulation.climate.is_some() && !thermometers.contains(&channel.topic.as_str())
            });
            let temperature = match shown {
                Some(channel) => {
                    thermometers.push(&channel.topic);
                    Some(add(channel, Layout::Sample)?)
                }
                None => None,
            };
            channels.push(RodStreams {
                displacement,
                further,
                temperature,
            });
        }
        Ok(Self {
            writer,
            channels,
            fs_hz: simulation.fs_hz,
            record_s: simulation.record_s,
            samples: 0,
            messages: 0,
        })
    }

    /// Writes one record of every rod, the channels interleaved as a recorder would.
    fn write(&mut self, rods: &[SimulatedRecord]) -> Result<(), SinkError> {
        let mut sent: Vec<(f64, ChannelId, Unit, &Message)> = Vec::new();
        for (rod, streams) in rods.iter().zip(&self.channels) {
            let own = std::iter::once((streams.displacement, &rod.displacement));
            let further = streams.further.iter().copied().zip(&rod.further);
            for ((id, unit), messages) in own.chain(further) {
                // Stamps of displacement may be wrong on purpose: the place in the record is not.
                let step_s = self.record_s / messages.len() as f64;
                for (i, message) in messages.iter().enumerate() {
                    sent.push((i as f64 * step_s, id, unit, message));
                }
            }
            if let Some((id, unit)) = streams.temperature {
                let since = |message: &Message| message.stamp.seconds_since(rod.start);
                sent.extend(
                    rod.temperature
                        .iter()
                        .map(|message| (since(message), id, unit, message)),
                );
            }
        }
        // Stable sort: within a channel the order of sending stays, whatever the stamps.
        sent.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut values = Vec::new();
        for (_, id, unit, message) in sent {
            values.clear();
            values.extend(message.samples.iter().map(|value| in_unit(*value, unit)));
            self.writer
                .write_message(id, message.stamp, self.fs_hz, &values)?;
            self.messages += 1;
            self.samples += values.len() as u64;
        }
        Ok(())
    }
}

/// Converts an SI value (or degrees Celsius) to `unit`: the inverse of [`Unit::convert`], which is
/// affine.
fn in_unit(value: f64, unit: Unit) -> f64 {
    let (zero, one) = (unit.convert(0.0), unit.convert(1.0));
    (value - zero) / (one - zero)
}

/// True state of one rod during one record, as a JSON object.
fn truth_line(record: &SimulatedRecord, simulation: &Simulation, seed: u64) -> serde_json::Value {
    let truth = &record.truth;
    json!({
        "rod": record.rod,
        "record": record.number,
        "start": record.start,
        "duration_s": simulation.record_s,
        "axial_force_n": truth.axial_force_n,
        "relative_force": truth.relative_force,
        "air_c": truth.air_c,
        "rod_c": truth.rod_c,
        "frequency_hz": truth.frequency_hz,
        "seed": seed,
    })
}

fn summaries(rods: &[SimulatedRecord]) -> Vec<String> {
    let summary = |record: &SimulatedRecord| {
        let truth = &record.truth;
        let frequencies: Vec<String> = truth.frequency_hz.iter().map(|f| format!("{f:.3}")).collect();
        let force = truth
            .axial_force_n
            .map_or(String::new(), |force| format!(", {:.1} kN", force * 1e-3));
        let temperature = truth
            .rod_c
            .map_or(String::new(), |celsius| format!(", rod at {celsius:.1} degC"));
        format!(
            "{} {}: {} Hz{force}{temperature}",
            record.start,
            record.rod,
            frequencies.join(", ")
        )
    };
    rods.iter().map(summary).collect()
}
