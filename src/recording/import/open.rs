//! Opens a file of any format as a recording, without writing one.

use super::agree::time_units;
use super::choose::for_rods;
use super::contents::{How, read};
use super::format::{Format, Kind, LOOKED_AT, kind};
use super::order::Blocks;
use super::plan::{Plan, Planned};
use super::{ImportError, Signal, Timing, ramp};
use crate::read::contents::{Content, contents};
use crate::read::folder::Span;
use crate::read::{Options, Recording, SourceError};
use crate::write::{Encoding, Layout};
use std::fs::File;
use std::io::Read;
use std::path::Path;
use tirante_analysis::signal::record::{
    Channel, RecordSettings, RodChannels, RodId, TimeSource, Timestamp, Unit,
};

/// Rods whose records are read from a file.
#[derive(Debug, Clone, Copy)]
pub struct Whose<'a> {
    /// Rods, with the channels of their samples.
    pub rods: &'a [RodChannels],
    /// True if the user named this configuration for this file: then the only channel of motion is that of
    /// the only rod, whatever its name.
    pub is_meant: bool,
    /// True if a file without a start begins in 1970; otherwise a missing start is an error.
    pub any_start: bool,
}

/// A file with every channel as a rod of its own.
pub struct Opened {
    /// Records of the file; the rod of each is the topic of its channel.
    pub recording: Recording,
    /// Channels of motion, in the order of the file.
    pub channels: Vec<Seen>,
    /// Items left out, one sentence each.
    pub notes: Vec<String>,
}

/// A channel of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    /// Topic, and name of the rod of its records.
    pub topic: String,
    /// Unit; `None` if unknown: the samples are then as in the file.
    pub unit: Option<Unit>,
    /// Unit as the file writes it, if it is not supported.
    pub foreign_unit: Option<String>,
    /// True if the file gives its start; otherwise times count from 1970.
    pub has_start: bool,
}

/// Opens a file of any format for configured rods. A recording is read as by [`Recording::open`], anything
/// else as by `import`.
///
/// # Errors
/// The file cannot be read, or lacks facts that were not given; the sentence names its content and the next
/// step.
pub fn open(
    path: &Path,
    how: &How,
    whose: Whose<'_>,
    settings: &RecordSettings,
    options: Options,
    watch: &dyn Fn(File, u64) -> Box<dyn Read>,
) -> Result<Recording, SourceError> {
    let Some((contents, bytes)) = foreign(path, how, watch)? else {
        if how.says_something() {
            return Err(refused(
                path,
                &ImportError::new(
                    "is a recording, which says all of itself: leave --rate, --unit, --start, --channel ... out",
                ),
            ));
        }
        return Recording::open(path, whose.rods, settings, options);
    };
    let refuse = |error: ImportError| refused(path, &error);
    if options.follow.is_some() {
        return Err(refuse(ImportError::new(
            "cannot be followed while it is written, only a recording (MCAP) can: leave --follow out",
        )));
    }
    contents.check_full_scale().map_err(refuse)?;
    let (plan, mut notes) = planned(path, contents.signals, how, whose).map_err(refuse)?;
    if plan.channels.iter().any(|planned| !planned.says_start) {
        notes.push(
            "the file does not say when it began, its times count from 1970 (--start says it)".to_owned(),
        );
    }
    notes.extend(interpolations(&plan));
    let mut rods = whose.rods.to_vec();
    for rod in &mut rods {
        for channel in rod.all_mut() {
            if let Some(planned) = plan
                .channels
                .iter()
                .find(|planned| planned.topic == channel.topic)
            {
                channel.unit = planned.unit;
                // Uneven stamps are the record's to measure.
                channel.fs_hz = channel
                    .fs_hz
                    .or(Some(planned.fs_hz).filter(|_| planned.says_rate));
            }
        }
    }
    let name = path.display().to_string();
    let mut recording = Recording::given(&name, Blocks::new(plan), bytes, &rods, settings);
    for note in contents
        .left_out
        .iter()
        .map(|what| format!("left out: {what}"))
        .chain(notes)
    {
        recording.note(format!("{name}: {note}"));
    }
    Ok(recording)
}

/// Channels of a file under the topics of the rods that read them, and notes on the assignments made.
fn planned(
    path: &Path,
    signals: Vec<Signal>,
    how: &How,
    whose: Whose<'_>,
) -> Result<(Plan, Vec<String>), ImportError> {
    let mut asked = how.asked(whose.rods);
    asked.start_else = whose.any_start.then_some(Timestamp::from_nanos(0));
    asked.keeps_stamps = true;
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let (chosen, notes) = for_rods(signals, &asked, whose.is_meant, &stem)?;
    Ok((Plan::to_read(chosen, &asked)?, notes))
}

/// Time span and topics of another program's file that holds some of the sensors of a rod with several, if it says when it began.
pub fn span(path: &Path, how: &How, whose: Whose<'_>) -> Option<Span> {
    let mut rods = whose.rods.iter().filter(|rod| rod.beside.is_some()).peekable();
    rods.peek()?;
    let (contents, _) = foreign(path, how, &|file, _| Box::new(file)).ok()??;
    let (plan, _) = planned(path, contents.signals, how, whose).ok()?;
    let is_read = |planned: &Planned| planned.says_start && !planned.stretches.is_empty();
    let is_sensor = |channel: &Channel| plan.channels.iter().any(|planned| planned.topic == channel.topic);
    if !plan.channels.iter().all(is_read) || !rods.flat_map(RodChannels::sensors).any(is_sensor) {
        return None;
    }
    let at = |time: Timestamp| u64::try_from(time.as_nanos()).ok();
    let stretches = || {
        let stretches = |planned: &Planned| (planned.fs_hz, planned.stretches.clone());
        let all = plan.channels.iter().map(stretches);
        all.flat_map(|(fs_hz, stretches)| stretches.into_iter().map(move |stretch| (fs_hz, stretch)))
    };
    Some(Span {
        from: at(stretches().map(|(_, (start, _))| start).min()?)?,
        to: at(stretches()
            .map(|(fs_hz, (start, samples))| start.plus_seconds(samples.len() as f64 / fs_hz))
            .max()?)?,
        topics: plan.channels.into_iter().map(|planned| planned.topic).collect(),
    })
}

/// Opens a file of any format without a configuration: every channel of motion is a rod of its own, named
/// after its topic. Units and start may be unknown.
///
/// # Errors
/// The file cannot be read, or neither it nor `how` gives a rate.
pub fn open_any(
    path: &Path,
    how: &How,
    settings: &RecordSettings,
    watch: &dyn Fn(File, u64) -> Box<dyn Read>,
) -> Result<Opened, SourceError> {
    let Some((plan, mut notes, bytes)) = of_anybody(path, how, watch)? else {
        return recorded(path, how, settings);
    };
    let mut seen = Vec::new();
    let mut rods = Vec::new();
    for planned in &plan.channels {
        if Unit::TEMPERATURE.contains(&planned.unit) {
            notes.push(format!("left out: {:?} is a temperature", planned.topic));
            continue;
        }
        let unit = Some(planned.unit).filter(|_| planned.says_unit);
        seen.push(Seen {
            topic: planned.topic.clone(),
            unit,
            foreign_unit: planned.written_unit.clone().filter(|_| unit.is_none()),
            has_start: planned.says_start,
        });
        let fs_hz = Some(planned.fs_hz).filter(|_| planned.says_rate);
        rods.push(rod(&planned.topic, "", planned.unit, fs_hz));
    }
    let name = path.display().to_string();
    Ok(Opened {
        recording: Recording::given(&name, Blocks::new(plan), bytes, &rods, settings),
        channels: seen,
        notes,
    })
}

/// Channels of a file of any format with the way to read them, as a basis for a configuration.
///
/// # Errors
/// As of [`open_any`].
pub fn topics(
    path: &Path,
    how: &How,
    watch: &dyn Fn(File, u64) -> Box<dyn Read>,
) -> Result<Vec<Content>, SourceError> {
    let Some((plan, ..)) = of_anybody(path, how, watch)? else {
        return contents(path).map_err(|source| SourceError::Io {
            path: path.display().to_string(),
            source,
        });
    };
    let content = |planned: &Planned| Content {
        topic: planned.topic.clone(),
        field: Ok(planned.field(plan.encoding).to_owned()),
        numbers: Vec::new(),
        stamp: None,
        unit: Some(planned.unit).filter(|_| planned.says_unit),
        array_fs_hz: Some(planned.fs_hz).filter(|_| matches!(planned.layout, Layout::Batch(_))),
    };
    Ok(plan.channels.iter().map(content).collect())
}

/// Format of another program's file; `None` for a recording.
///
/// # Errors
/// The file cannot be read, or is of no format that is read.
pub fn format(path: &Path, how: &How) -> Result<Option<Format>, SourceError> {
    let failed = |source| SourceError::Io {
        path: path.display().to_string(),
        source,
    };
    let mut head = Vec::new();
    if std::fs::metadata(path).map_err(failed)?.is_file() {
        let file = File::open(path).map_err(failed)?;
        file.take(LOOKED_AT as u64)
            .read_to_end(&mut head)
            .map_err(failed)?;
    } else {
        return Err(SourceError::NotAFile {
            path: path.display().to_string(),
        });
    }
    match (how.format, kind(&head, path)) {
        (Some(format), _) => Ok(Some(format)),
        (None, Ok(Kind::Mcap)) => Ok(None),
        (None, Ok(Kind::Foreign(format))) => Ok(Some(format)),
        (None, Err(error)) => Err(refused(path, &error)),
    }
}

/// True if no channel of another program's file has a rate, by stamps or otherwise.
///
/// # Errors
/// As of [`open_any`].
pub fn lacks_rate(path: &Path, how: &How) -> Result<bool, SourceError> {
    let found = foreign(path, how, &|file, _| Box::new(file))?;
    Ok(how.rate_hz.is_none()
        && found.is_some_and(|(contents, _)| {
            let mut signals = contents.signals.iter();
            signals.all(|signal| signal.timing == Timing::Unknown)
        }))
}

/// Units that the times of another program's file may have, each with the rate of its motion, if the file does not say the unit and they
/// can hardly be seconds.
///
/// # Errors
/// As of [`open_any`].
pub fn lacks_time_unit(path: &Path, how: &How) -> Result<Option<String>, SourceError> {
    let found = foreign(path, how, &|file, _| Box::new(file))?;
    let signals = found.into_iter().flat_map(|(contents, _)| contents.signals);
    let is_motion = |signal: &Signal| {
        let unit = signal.unit.as_deref().and_then(Unit::as_written);
        !unit.is_some_and(|unit| Unit::TEMPERATURE.contains(&unit))
    };
    Ok(signals.filter(is_motion).find_map(|signal| match &signal.timing {
        Timing::Stamps(stamps) => time_units(stamps),
        _ => None,
    }))
}

/// Time of the first sample of another program's file, if the file gives it; `None` for a recording.
pub fn begins(path: &Path, how: &How) -> Option<Timestamp> {
    let (plan, ..) = of_anybody(path, how, &|file, _| Box::new(file)).ok()??;
    let known = plan.channels.iter().filter(|planned| planned.says_start);
    known
        .filter_map(|planned| Some(planned.stretches.first()?.0))
        .min()
}

/// Every channel of another program's file, the items left out, and its size in bytes; `None` if it is a
/// recording.
fn of_anybody(
    path: &Path,
    how: &How,
    watch: &dyn Fn(File, u64) -> Box<dyn Read>,
) -> Result<Option<(Plan, Vec<String>, u64)>, SourceError> {
    let Some((contents, bytes)) = foreign(path, how, watch)? else {
        return Ok(None);
    };
    let mut asked = how.asked(&[]);
    asked.start_else = Some(Timestamp::from_nanos(0));
    asked.any_unit = true;
    asked.keeps_stamps = true;
    let mut notes: Vec<String> = contents
        .left_out
        .iter()
        .map(|what| format!("left out: {what}"))
        .collect();
    let signals = without_ramps(contents.signals, how, &mut notes);
    let plan = Plan::new(signals, &asked, Encoding::Protobuf).map_err(|error| refused(path, &error))?;
    notes.extend(interpolations(&plan));
    Ok(Some((plan, notes, bytes)))
}

/// One sentence for each channel that was interpolated.
fn interpolations(plan: &Plan) -> impl Iterator<Item = String> + '_ {
    plan.channels.iter().filter_map(|planned| {
        let interpolation = planned.interpolation()?;
        let (name, fs_hz, missing) = (&planned.name, planned.fs_hz, planned.missing());
        Some(format!(
            "{name:?} at {fs_hz} Hz: {interpolation}, {missing} samples missing"
        ))
    })
}

/// Opens a recording with every channel as a rod.
fn recorded(path: &Path, how: &How, settings: &RecordSettings) -> Result<Opened, SourceError> {
    let found = contents(path).map_err(|source| SourceError::Io {
        path: path.display().to_string(),
        source,
    })?;
    let mut opened = (Vec::new(), Vec::new(), Vec::new());
    let (rods, seen, notes) = &mut opened;
    for content in found {
        let wanted = how.channels.iter().find(|wanted| wanted.source == content.topic);
        if !how.channels.is_empty() && wanted.is_none() {
            continue;
        }
        let field = match content.field {
            Ok(field) => field,
            Err(fault) => {
                notes.push(format!("left out: {:?}: {fault}", content.topic));
                continue;
            }
        };
        let unit = content
            .unit
            .or(wanted.and_then(|wanted| wanted.unit))
            .or(how.unit);
        if unit.is_some_and(|unit| Unit::TEMPERATURE.contains(&unit)) {
            notes.push(format!("left out: {:?} is a temperature", content.topic));
            continue;
        }
        let fs_hz = content.array_fs_hz.or(how.rate_hz);
        rods.push(rod(&content.topic, &field, unit.unwrap_or(Unit::Metre), fs_hz));
        seen.push(Seen {
            topic: content.topic,
            unit,
            foreign_unit: None,
            has_start: true,
        });
    }
    let (rods, channels, notes) = opened;
    if rods.is_empty() {
        return Err(SourceError::Foreign {
            path: path.display().to_string(),
            what: match notes.is_empty() {
                true => "has no channel with messages".to_owned(),
                false => notes.join("; "),
            },
        });
    }
    Ok(Opened {
        recording: Recording::open(path, &rods, settings, Options::default())?,
        channels,
        notes,
    })
}

fn rod(topic: &str, field: &str, unit: Unit, fs_hz: Option<f64>) -> RodChannels {
    RodChannels {
        rod: RodId(topic.to_owned()),
        displacement: Channel {
            topic: topic.to_owned(),
            field: field.to_owned(),
            unit,
            time: TimeSource::Log,
            fs_hz,
        },
        temperature: None,
        beside: None,
    }
}

/// Content of another program's file, and its size in bytes; `None` if it is a recording.
fn foreign(
    path: &Path,
    how: &How,
    watch: &dyn Fn(File, u64) -> Box<dyn Read>,
) -> Result<Option<(super::Contents, u64)>, SourceError> {
    let name = || path.display().to_string();
    let failed = |source| SourceError::Io { path: name(), source };
    // Before it is opened: opening a pipe would wait for its writer.
    let kind = std::fs::metadata(path).map_err(failed)?;
    if !kind.is_file() {
        return Err(SourceError::NotAFile { path: name() });
    }
    let file = File::open(path).map_err(failed)?;
    let found = read(watch(file, kind.len()), path, how).map_err(|error| refused(path, &error))?;
    Ok(found.map(|contents| (contents, kind.len())))
}

fn refused(path: &Path, error: &ImportError) -> SourceError {
    SourceError::Foreign {
        path: path.display().to_string(),
        what: error.to_string(),
    }
}

/// Drops channels that are the time or count rows, unless a channel was asked for by name.
fn without_ramps(signals: Vec<Signal>, how: &How, notes: &mut Vec<String>) -> Vec<Signal> {
    if !how.channels.is_empty() || signals.len() < 2 {
        return signals;
    }
    let (counts, rest): (Vec<Signal>, Vec<Signal>) = signals.into_iter().partition(ramp::is_time);
    notes.extend(counts.iter().map(|signal| {
        format!(
            "left out: {} is the time, or rises as it does",
            super::asked::told(signal)
        )
    }));
    rest
}
