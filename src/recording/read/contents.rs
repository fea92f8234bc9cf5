//! Channels of a recording with the way to read them, as a basis for a configuration.

use super::decode::{Decoder, SchemaRef};
use super::definition::Definition;
use super::finished::Finished;
use super::mcap::{Item, Progress};
use std::collections::{BTreeMap, HashMap};
use std::io;
use std::path::Path;
use std::sync::Arc;
use tirante_analysis::signal::record::{TimeSource, Unit};

/// Messages examined per channel.
const ENOUGH: usize = 200;
/// Most messages read.
const MOST: u64 = 200_000;
/// Most message definitions examined.
const MOST_DEFINITIONS: usize = 256;
/// Fields that hold samples in our recordings and in the usual message types.
const FIELDS: [&str; 4] = ["value", "values", "data", "displacement"];

/// A rate with the seven digits a person reads.
pub fn rounded(fs_hz: f64) -> f64 {
    format!("{fs_hz:.6e}").parse().unwrap_or(fs_hz)
}

/// A channel of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct Content {
    /// Topic.
    pub topic: String,
    /// Field that holds its samples; if none was found, a description of the messages.
    pub field: Result<String, String>,
    /// Numeric fields, if none of the usual fields was found.
    pub numbers: Vec<String>,
    /// Field of the messages' own time, if they have one.
    pub stamp: Option<String>,
    /// Unit, if the channel gives it.
    pub unit: Option<Unit>,
    /// Sample rate of arrays \[Hz\], which need one.
    pub array_fs_hz: Option<f64>,
}

/// Decoders that may read the messages of a definition.
#[derive(Default, Clone)]
struct Readers {
    /// Fields that may hold the samples, with their decoders.
    decoders: Vec<(&'static str, Arc<Decoder>)>,
    rate: Option<Arc<Decoder>>,
    fault: String,
    definition: Arc<Definition>,
}

/// State of a channel during the examination.
#[derive(Default)]
struct Looked {
    topic: String,
    unit: Option<Unit>,
    decoders: Vec<(&'static str, Arc<Decoder>)>,
    rate: Option<Arc<Decoder>>,
    fault: String,
    definition: Arc<Definition>,
    numbers: Vec<String>,
    stamp: Option<String>,
    said_fs_hz: Option<f64>,
    stamps: Vec<u64>,
    samples: Vec<usize>,
    is_array: bool,
}

/// The channels of a recording that have messages, in the order of their topics. Only its beginning is read.
///
/// # Errors
/// It cannot be read, or is damaged in its beginning.
pub fn contents(path: &Path) -> io::Result<Vec<Content>> {
    let mut reader = Finished::open(path)?;
    let mut channels: BTreeMap<u16, Looked> = BTreeMap::new();
    let mut known: HashMap<(String, u16), Readers> = HashMap::new();
    let mut messages = 0;
    let is_cut = loop {
        let step = reader.step(&mut |item| match item {
            Item::Channel(id, channel, schema) => {
                let unit = channel.metadata("unit").and_then(Unit::as_written);
                let count = known.len();
                let readers = known
                    .entry((channel.encoding.clone(), channel.schema))
                    .or_insert_with(|| Readers::new(&channel.encoding, schema, count));
                channels.insert(id, Looked::new(&channel.topic, unit, readers.clone()));
            }
            Item::Message(message) => {
                messages += 1;
                if let Some(looked) = channels.get_mut(&message.channel) {
                    looked.message(message.log_time, message.data);
                }
            }
            Item::Unverified | Item::Hole(_) => {}
        });
        let progress = step.map_err(|damage| {
            io::Error::other(format!("damaged at byte {}: {}", damage.offset, damage.what))
        })?;
        if !matches!(progress, Progress::More) || messages > MOST {
            break matches!(progress, Progress::Truncated | Progress::Wait);
        }
    };
    if is_cut && messages == 0 {
        return Err(io::Error::other(
            "it ends before its first message is complete: the copy is cut short, or still being written",
        ));
    }
    let mut found: Vec<Content> = channels
        .into_values()
        .filter(|looked| !looked.stamps.is_empty())
        .map(Looked::found)
        .collect();
    found.sort_by(|a, b| a.topic.cmp(&b.topic));
    // Writers that begin anew give a topic a second channel.
    found.dedup_by(|later, first| later.topic == first.topic);
    Ok(found)
}

impl Readers {
    /// Readers of a definition; `count` were examined before.
    fn new(encoding: &str, schema: Option<SchemaRef<'_>>, count: usize) -> Self {
        let mut readers = Self {
            definition: Arc::new(Definition::of(encoding, schema)),
            ..Self::default()
        };
        if count >= MOST_DEFINITIONS {
            readers.fault = format!("more than {MOST_DEFINITIONS} message definitions");
            return readers;
        }
        let compile = |field: &str| Decoder::compile(encoding, schema, field, &TimeSource::Log).map(Arc::new);
        readers.rate = compile("fs_hz").ok();
        for field in FIELDS {
            match compile(field) {
                Ok(decoder) => readers.decoders.push((field, decoder)),
                Err(fault) => readers.fault = fault.to_string(),
            }
        }
        readers
    }
}

impl Looked {
    fn new(topic: &str, unit: Option<Unit>, readers: Readers) -> Self {
        let Readers {
            decoders,
            rate,
            fault,
            definition,
        } = readers;
        Self {
            topic: topic.to_owned(),
            unit,
            decoders,
            rate,
            fault,
            definition,
            ..Self::default()
        }
    }

    fn message(&mut self, log_time: u64, data: &[u8]) {
        if self.stamps.len() >= ENOUGH {
            return;
        }
        self.stamps.push(log_time);
        let mut values = Vec::new();
        // The first message determines the field, because JSON has no schema.
        while let Some((_, decoder)) = self.decoders.first() {
            match decoder.decode(data, 0, &mut values) {
                Ok(decoded) => {
                    self.is_array |= decoded.array;
                    self.samples.push(decoded.samples);
                    break;
                }
                Err(fault) => {
                    self.fault = fault.to_string();
                    self.decoders.remove(0);
                }
            }
        }
        if self.stamps.len() == 1 {
            match self.decoders.first() {
                Some((field, _)) => self.stamp = self.definition.stamp(field, data, log_time),
                None => {
                    self.numbers = self.definition.numbers(data);
                    let first = self.numbers.first();
                    self.stamp = first.and_then(|field| self.definition.stamp(field, data, log_time));
                }
            }
        }
        if self.said_fs_hz.is_none()
            && let Some(rate) = &self.rate
            && rate.decode(data, 0, &mut values).is_ok()
        {
            self.said_fs_hz = values
                .first()
                .copied()
                .filter(|fs_hz| fs_hz.is_finite() && *fs_hz > 0.0);
        }
    }

    /// Sample rate by the stamps \[Hz\].
    fn measured_fs_hz(&self) -> Option<f64> {
        let (first, last) = (*self.stamps.first()?, *self.stamps.last()?);
        let before_last: usize = self.samples.iter().rev().skip(1).sum();
        let span_s = last.checked_sub(first).filter(|span| *span > 0)? as f64 * 1e-9;
        (before_last > 0).then(|| rounded(before_last as f64 / span_s))
    }

    fn found(self) -> Content {
        let array_fs_hz = match self.is_array {
            true => self.said_fs_hz.or_else(|| self.measured_fs_hz()),
            false => None,
        };
        Content {
            field: match self.decoders.first() {
                Some((field, _)) => Ok((*field).to_owned()),
                None => Err(self.fault),
            },
            topic: self.topic,
            numbers: self.numbers,
            stamp: self.stamp,
            unit: self.unit,
            array_fs_hz,
        }
    }
}
