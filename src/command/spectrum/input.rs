//! Records of files, channel by channel, without a configuration or with one.

use crate::analysis::signal::record::{
    Channel, Cut, Event, RecordSettings, RodChannels, RodId, TimeSource, Unit,
};
use crate::command::foreign;
use crate::config::Config;
use crate::recording::import::{self, How, Opened, Whose};
use crate::recording::read::contents::{Content, contents};
use crate::recording::read::{Options, Recording, SourceError, Summary};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Selection of records and channels.
pub(super) struct Wanted<'a> {
    /// Configuration whose rods' records are used alone.
    pub config: Option<&'a Config>,
    /// Field of the samples in recordings.
    pub field: Option<&'a str>,
    /// Facts missing in the files, and the channels asked for.
    pub how: How,
}

/// Origin of a record.
#[derive(Debug, Clone)]
pub(super) struct Source {
    /// Path of the file.
    pub file: Arc<str>,
    /// Topic of the channel.
    pub channel: String,
    /// Rod, if one is configured.
    pub rod: Option<RodId>,
    /// SI unit of its samples, if known.
    pub unit: Option<&'static str>,
    /// Unit as the file writes it, if it is not supported.
    pub foreign_unit: Option<String>,
}

impl Source {
    fn new(path: &Path, topic: &str, unit: Option<Unit>) -> Self {
        Self {
            file: Arc::from(path.display().to_string()),
            channel: topic.to_owned(),
            rod: None,
            unit: unit.map(Unit::si),
            foreign_unit: None,
        }
    }
}

/// One step of reading.
#[expect(clippy::large_enum_variant, reason = "one at a time, handed on at once")]
pub(super) enum Step {
    /// A record, or a rejected stretch.
    Event(Source, Event),
    /// A note that is no fault.
    Note(String),
    /// The end of a file, with its faults.
    Ended(Vec<String>),
    /// A file that cannot be read.
    Failed(String),
}

/// Number of samples that an event holds in memory.
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

    fn open(&mut self, path: &Path) -> Result<Open, SourceError> {
        match self.wanted.config {
            Some(config) => self.open_for(config, path),
            None if is_recording(path) => self.open_recording(path),
            None => self.open_other(path),
        }
    }

    /// Opens a recording for configured rods.
    fn open_for(&self, config: &Config, path: &Path) -> Result<Open, SourceError> {
        let rods: Vec<RodChannels> = config
            .rods
            .iter()
            .map(|rod| rod.channels.clone().alone())
            .collect();
        let whose = Whose {
            rods: &rods,
            is_meant: true,
            any_start: true,
        };
        let how = &self.wanted.how;
        let recording = import::open(
            path,
            how,
            whose,
            &config.record,
            Options::default(),
            &foreign::watch,
        )?;
        let sources = rods.iter().map(|channels| {
            let source = Source {
                rod: Some(channels.rod.clone()),
                ..Source::new(
                    path,
                    &channels.displacement.topic,
                    Some(channels.displacement.unit),
                )
            };
            (channels.rod.clone(), source)
        });
        Ok(Open {
            recording: Box::new(recording),
            sources: sources.collect(),
        })
    }

    /// Opens every channel of a recording, or those asked for.
    fn open_recording(&mut self, path: &Path) -> Result<Open, SourceError> {
        let refused = |what: String| SourceError::Foreign {
            path: path.display().to_string(),
            what,
        };
        let found = contents(path).map_err(|source| SourceError::Io {
            path: path.display().to_string(),
            source,
        })?;
        let how = &self.wanted.how;
        let (mut rods, mut sources, mut notes) = (Vec::new(), BTreeMap::new(), Vec::new());
        for (content, wanted) in chosen(&found, &how.channels).map_err(refused)? {
            let unit = wanted.and_then(|wanted| wanted.unit).or(how.unit);
            match as_rod(content, self.wanted.field, unit, how.rate_hz, wanted.is_some()) {
                Ok((rod, unit)) => {
                    sources.insert(rod.rod.clone(), Source::new(path, &content.topic, unit));
                    rods.push(rod);
                }
                Err(why) => notes.push(why),
            }
        }
        if rods.is_empty() {
            return Err(refused(match notes.is_empty() {
                true => "it has no channel with messages".to_owned(),
                false => notes.join("; "),
            }));
        }
        self.note(path, notes);
        let recording = Recording::open(path, &rods, &lenient(), Options::default())?;
        Ok(Open {
            recording: Box::new(recording),
            sources,
        })
    }

    /// Opens every channel of another program's file, or those asked for.
    fn open_other(&mut self, path: &Path) -> Result<Open, SourceError> {
        let Opened {
            recording,
            channels,
            notes,
        } = import::open_any(path, &self.wanted.how, &lenient(), &foreign::watch)?;
        self.note(path, notes);
        let sources = channels.into_iter().map(|seen| {
            let source = Source {
                foreign_unit: seen.foreign_unit,
                ..Source::new(path, &seen.topic, seen.unit)
            };
            (RodId(seen.topic), source)
        });
        Ok(Open {
            recording: Box::new(recording),
            sources: sources.collect(),
        })
    }

    fn note(&mut self, path: &Path, notes: Vec<String>) {
        let name = path.display();
        self.notes
            .extend(notes.into_iter().map(|note| format!("{name}: {note}")));
    }

    /// Takes one step of the open file; `None` without a result.
    fn step(&mut self, mut open: Open) -> Option<Step> {
        let event = open.recording.next();
        let bytes = Recording::progress(&open.recording).read;
        self.done.store(self.bytes_of_closed + bytes, Ordering::Relaxed);
        let Some(event) = event else {
            self.bytes_of_closed += bytes;
            let summary = open.recording.summary();
            return Some(match summary.has_nothing() {
                true => Step::Failed(summary.absence().unwrap_or_default()),
                false => Step::Ended(faults(summary)),
            });
        };
        let step = open
            .sources
            .get(event.rod())
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
                Err(error) => return Some(Step::Failed(error.to_string())),
            }
        }
    }
}

/// Faults of a file, without the remark that its content could not be verified.
fn faults(summary: &Summary) -> Vec<String> {
    let summary = Summary {
        unverified: false,
        ..summary.clone()
    };
    summary.faults()
}

/// True if a file is a recording, by its first bytes or its name; other faults are reported when it is read.
fn is_recording(path: &Path) -> bool {
    let is_called_so = path
        .extension()
        .is_some_and(|ending| ending.eq_ignore_ascii_case("mcap"));
    let begins_so = || {
        // Before it is opened: opening a pipe would wait for its writer.
        let is_file = path.metadata().is_ok_and(|file| file.is_file());
        let mut head = [0; 5];
        is_file
            && File::open(path)
                .and_then(|mut file| file.read_exact(&mut head))
                .is_ok()
            && head == *b"\x89MCAP"
    };
    is_called_so || begins_so()
}

/// Channels asked for, among those present.
fn chosen<'c>(
    found: &'c [Content],
    wanted: &'c [import::Wanted],
) -> Result<Vec<(&'c Content, Option<&'c import::Wanted>)>, String> {
    if wanted.is_empty() {
        return Ok(found.iter().map(|content| (content, None)).collect());
    }
    let there: Vec<&str> = found.iter().map(|content| content.topic.as_str()).collect();
    wanted
        .iter()
        .map(
            |one| match found.iter().find(|content| content.topic == one.source) {
                Some(content) => Ok((content, Some(one))),
                None if there.is_empty() => {
                    Err(format!("no channel {}; it has none with messages", one.source))
                }
                None => Err(format!("no channel {}; it has {}", one.source, there.join(", "))),
            },
        )
        .collect()
}

/// A channel as a rod named after its topic, with its unit if known; otherwise the reason why it cannot be
/// used.
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
        // Without a unit the numbers are used unchanged: metres are not converted.
        unit: unit.unwrap_or(Unit::Metre),
        time: TimeSource::Log,
        fs_hz: rate_hz.or(content.array_fs_hz),
    };
    let rod = RodChannels {
        rod: RodId(topic.clone()),
        displacement,
        temperature: None,
        beside: None,
    };
    Ok((rod, unit))
}

/// Settings that accept records of any quality: faults that would refuse them elsewhere become flags.
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
