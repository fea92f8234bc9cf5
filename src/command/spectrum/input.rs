//! Records of files, channel by channel, without a configuration or with one.

use crate::config::Config;
use crate::record::{Channel, Cut, Event, RecordSettings, RodChannels, RodId, TimeSource, Unit};
use crate::source::contents::{Content, contents};
use crate::source::{Options, Recording, SourceError, Summary};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Whose records are wanted.
pub(super) enum Wanted<'a> {
    /// Those of configured rods.
    Rods(&'a Config),
    /// Those of channels, all without names.
    Channels {
        /// Their topics.
        names: &'a [String],
        /// The field of their samples.
        field: Option<&'a str>,
        /// Their unit, where the file does not say it.
        unit: Option<Unit>,
        /// Their rate, where the file does not say it \[Hz\].
        rate_hz: Option<f64>,
    },
}

/// Where a record comes from.
#[derive(Debug, Clone)]
pub(super) struct Source {
    /// The file.
    pub file: Arc<str>,
    /// Its topic.
    pub channel: String,
    /// Its rod, if one is configured.
    pub rod: Option<RodId>,
    /// SI unit of its samples, if it is known.
    pub unit: Option<&'static str>,
}

/// One step of reading.
pub(super) enum Step {
    /// A record, or a stretch that is none.
    Event(Source, Event),
    /// A sentence that is no fault.
    Note(String),
    /// The end of a file, with what was wrong in it.
    Ended(Vec<String>),
    /// A file that cannot be looked at.
    Failed(String),
}

/// Samples an event holds in memory.
pub(super) fn samples(event: &Event) -> usize {
    match event {
        Event::Record(record) => record.samples.len(),
        _ => 1,
    }
}

/// A file that is open.
struct Open {
    recording: Box<Recording>,
    sources: BTreeMap<RodId, Source>,
}

/// The records of many files, one file after another.
pub(super) struct Inputs<'a> {
    files: std::vec::IntoIter<Result<PathBuf, SourceError>>,
    wanted: Wanted<'a>,
    done: Arc<AtomicU64>,
    bytes_of_closed: u64,
    open: Option<Open>,
    notes: Vec<String>,
}

impl<'a> Inputs<'a> {
    /// Reads `files` in their order; `done` counts the bytes.
    pub fn new(files: Vec<Result<PathBuf, SourceError>>, wanted: Wanted<'a>, done: Arc<AtomicU64>) -> Self {
        Self {
            files: files.into_iter(),
            wanted,
            done,
            bytes_of_closed: 0,
            open: None,
            notes: Vec::new(),
        }
    }

    fn open(&mut self, path: &Path) -> Result<Open, String> {
        let name = path.display().to_string();
        let file: Arc<str> = Arc::from(name.as_str());
        let source = |channels: &RodChannels, rod: Option<RodId>, unit: Option<Unit>| Source {
            file: Arc::clone(&file),
            channel: channels.displacement.topic.clone(),
            rod,
            unit: unit.map(Unit::si),
        };
        let (found, settings): (Vec<(RodChannels, Source)>, RecordSettings) = match &self.wanted {
            Wanted::Rods(config) => {
                let rods = config.rods.iter().map(|rod| {
                    let channels = &rod.channels;
                    let unit = Some(channels.displacement.unit);
                    (
                        channels.clone(),
                        source(channels, Some(channels.rod.clone()), unit),
                    )
                });
                (rods.collect(), config.record)
            }
            Wanted::Channels {
                names,
                field,
                unit,
                rate_hz,
            } => {
                let found = contents(path).map_err(|error| format!("{name}: {error}"))?;
                let chosen = chosen(&found, names).map_err(|why| format!("{name}: {why}"))?;
                let mut channels = Vec::new();
                for content in chosen {
                    match as_rod(content, *field, *unit, *rate_hz, !names.is_empty()) {
                        Ok((rod, unit)) => {
                            let source = source(&rod, None, unit);
                            channels.push((rod, source));
                        }
                        Err(why) => self.notes.push(format!("{name}: {why}")),
                    }
                }
                if channels.is_empty() {
                    let why = std::mem::take(&mut self.notes).join("; ");
                    return Err(match why.is_empty() {
                        true => format!("{name}: has no channel with messages"),
                        false => why,
                    });
                }
                (channels, lenient())
            }
        };
        let (rods, sources): (Vec<RodChannels>, Vec<Source>) = found.into_iter().unzip();
        let recording = Recording::open(path, &rods, &settings, Options::default());
        let ids = rods.into_iter().map(|rod| rod.rod);
        Ok(Open {
            recording: Box::new(recording.map_err(|error| error.to_string())?),
            sources: ids.zip(sources).collect(),
        })
    }

    /// One step of the open file; nothing where there is nothing to tell.
    fn step(&mut self, mut open: Open) -> Option<Step> {
        let event = open.recording.next();
        let bytes = Recording::position(&open.recording).read;
        self.done.store(self.bytes_of_closed + bytes, Ordering::Relaxed);
        let Some(event) = event else {
            self.bytes_of_closed += bytes;
            let summary = open.recording.summary();
            return Some(match summary.has_nothing() {
                true => Step::Failed(summary.absences().join("; ")),
                false => Step::Ended(faults(summary)),
            });
        };
        let rod = match &event {
            Event::Record(record) => &record.rod,
            Event::Rejected { rod, .. } | Event::Readings { rod, .. } => rod,
        };
        let step = open
            .sources
            .get(rod)
            .cloned()
            .map(|source| Step::Event(source, event));
        self.open = Some(open);
        step
    }
}

impl Iterator for Inputs<'_> {
    type Item = Step;

    fn next(&mut self) -> Option<Step> {
        loop {
            if let Some(note) = self.notes.pop() {
                return Some(Step::Note(note));
            }
            if let Some(open) = self.open.take() {
                if let Some(step) = self.step(open) {
                    return Some(step);
                }
                continue;
            }
            let path = match self.files.next()? {
                Ok(path) => path,
                Err(error) => return Some(Step::Failed(error.to_string())),
            };
            match self.open(&path) {
                Ok(open) => self.open = Some(open),
                Err(why) => return Some(Step::Failed(why)),
            }
        }
    }
}

/// What was wrong with a file. That nothing could be checked is no matter here.
fn faults(summary: &Summary) -> Vec<String> {
    let summary = Summary {
        unverified: false,
        ..summary.clone()
    };
    summary.faults()
}

/// The channels that are wanted of those there are.
fn chosen<'c>(found: &'c [Content], names: &[String]) -> Result<Vec<&'c Content>, String> {
    if names.is_empty() {
        return Ok(found.iter().collect());
    }
    let there: Vec<&str> = found.iter().map(|content| content.topic.as_str()).collect();
    names
        .iter()
        .map(|name| {
            let content = found.iter().find(|content| content.topic == *name);
            content.ok_or_else(|| match there.is_empty() {
                true => format!("no channel {name}; it has none with messages"),
                false => format!("no channel {name}; it has {}", there.join(", ")),
            })
        })
        .collect()
}

/// A channel as a rod called as its topic, with its unit if that is known; else the reason why it cannot be looked at.
fn as_rod(
    content: &Content,
    field: Option<&str>,
    unit: Option<Unit>,
    rate_hz: Option<f64>,
    is_asked_for: bool,
) -> Result<(RodChannels, Option<Unit>), String> {
    let topic = &content.topic;
    let field = match (field, &content.field) {
        (Some(field), _) => field.to_owned(),
        (None, Ok(field)) => field.clone(),
        (None, Err(fault)) => {
            return Err(format!(
                "topic {topic} is left out: none of the usual fields can be read ({fault}); --field PATH names the one that holds the samples"
            ));
        }
    };
    let unit = content.unit.or(unit);
    if !is_asked_for && content.unit.is_some_and(|unit| Unit::TEMPERATURE.contains(&unit)) {
        return Err(format!(
            "topic {topic} is left out: it holds temperatures (--topic {topic} asks for it)"
        ));
    }
    let displacement = Channel {
        topic: topic.clone(),
        field,
        // Without a unit the numbers are taken as they stand: metres are not converted.
        unit: unit.unwrap_or(Unit::Metre),
        time: TimeSource::Log,
        fs_hz: rate_hz.or(content.array_fs_hz),
    };
    let rod = RodChannels {
        rod: RodId(topic.clone()),
        displacement,
        temperature: None,
    };
    Ok((rod, unit))
}

/// Records to be looked at, whatever their quality: what would refuse them elsewhere is noticed.
fn lenient() -> RecordSettings {
    RecordSettings {
        cut: Cut::Auto,
        min_duration_s: 0.1,
        max_missing: 0.2,
        max_clipped: 1.0,
        max_held: 1.0,
        ..RecordSettings::default()
    }
}
