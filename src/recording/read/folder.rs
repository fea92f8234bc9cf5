//! Expands paths of the command line to recordings, in the order of their data.

use super::SourceError;
use super::mcap::{Item, Message, Progress, Reader};
use super::verify::Trust;
use super::wire::Fields;
use crate::part;
use std::collections::{BTreeSet, HashMap};
use std::fs::{self, File};
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Expands folders to their `*.mcap` files (regular files only, not below) and puts all recordings in the
/// order of their first message; files without one come last, by name. Paths without a recording come
/// first, each with its reason: the others are still read.
pub fn recordings(paths: &[PathBuf]) -> Vec<Result<PathBuf, SourceError>> {
    let mut found = Vec::new();
    let mut failed = Vec::new();
    for path in paths {
        match expand(path) {
            Ok(files) => found.extend(files),
            Err(error) => failed.push(Err(error)),
        }
    }
    let mut timed: Vec<(u64, PathBuf)> = found
        .into_iter()
        .map(|path| (first_time_at(&path).unwrap_or(u64::MAX), path))
        .collect();
    timed.sort();
    timed.dedup();
    failed.extend(timed.into_iter().map(|(_, path)| Ok(path)));
    failed
}

/// Recordings of one path: itself, or those of a folder.
fn expand(path: &Path) -> Result<Vec<PathBuf>, SourceError> {
    let failed = |source| SourceError::Io {
        path: path.display().to_string(),
        source,
    };
    if !fs::metadata(path).map_err(failed)?.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let mut files = Vec::new();
    for entry in fs::read_dir(path).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let path = entry.path();
        let named = path
            .extension()
            .is_some_and(|extension| extension.eq_ignore_ascii_case("mcap"));
        // The entry's own type: links may lead out of the folder and are not followed.
        if named && entry.file_type().is_ok_and(|kind| kind.is_file()) {
            files.push(path);
        }
    }
    if files.is_empty() {
        return Err(SourceError::Empty {
            path: path.display().to_string(),
        });
    }
    Ok(files)
}

/// Number of records examined for the first message.
const LOOKED_AT: usize = 1000;

pub(super) fn first_time_at(path: &Path) -> Option<u64> {
    let file = open(path)?;
    // The first chunk of a part may hold nothing but the journal's own note, which has the time of its writing.
    match path.file_name().and_then(|name| part::number(name.to_str()?)) {
        Some(_) => times(&file).min(),
        None => first_time(&file),
    }
}

/// Time span and topics of a finished file's messages.
#[derive(Debug, Clone)]
pub struct Span {
    /// Earliest log time \[ns since 1970\].
    pub from: u64,
    /// The latest.
    pub to: u64,
    /// Topics that have messages.
    pub topics: BTreeSet<String>,
}

/// Times of the earliest and latest message of a finished file \[ns since 1970\], by the summary at its end.
pub fn times_by_summary(path: &Path) -> Option<(u64, u64)> {
    span_by_summary(&open(path)?).map(|span| (span.from, span.to))
}

/// Opens a regular file.
fn open(path: &Path) -> Option<File> {
    let is_file = fs::metadata(path).ok()?.is_file();
    is_file.then(|| File::open(path).ok()).flatten()
}

/// Longest summary that is read \[bytes\].
const MAX_SUMMARY: u64 = 16 << 20;

/// Longest file without a summary that is read for its span \[bytes\].
const MAX_READ: u64 = 1 << 30;

/// Span of a finished file, by its summary or by all messages; `None` if it has no message, or has no summary and is long.
pub(super) fn span_at(path: &Path) -> Option<Span> {
    let file = open(path)?;
    span_by_summary(&file).or_else(|| {
        let mut reader = SpanReader::begin(file)?;
        while reader.step() {}
        reader.into_span()
    })
}

/// Reads a finished file for its span, a step at a time: it was cut short, or its writer leaves the summary out.
pub struct SpanReader {
    reader: Reader<File>,
    topics: HashMap<u16, String>,
    used: BTreeSet<u16>,
    times: Option<(u64, u64)>,
}

impl SpanReader {
    /// Begins at the first byte; `None` if the file cannot be sought, or is longer than 1 GiB.
    pub fn begin(mut file: File) -> Option<Self> {
        file.seek(SeekFrom::Start(0)).ok()?;
        let length = file.metadata().ok()?.len();
        (length <= MAX_READ).then(|| Self {
            reader: Reader::new(file, Trust::Unverified, false),
            topics: HashMap::new(),
            used: BTreeSet::new(),
            times: None,
        })
    }

    /// Offset of the next step \[bytes\].
    pub fn offset(&self) -> u64 {
        self.reader.offset()
    }

    /// Takes a step; false at the end. Where the file is damaged, its messages end for those as well that use them.
    pub fn step(&mut self) -> bool {
        let Self {
            reader,
            topics,
            used,
            times,
        } = self;
        let progress = reader.step(&mut |item| match item {
            Item::Channel(id, channel, _) => drop(topics.insert(id, channel.topic.clone())),
            Item::Message(Message {
                channel, log_time, ..
            }) => {
                let (from, to) = times.get_or_insert((log_time, log_time));
                (*from, *to) = (log_time.min(*from), log_time.max(*to));
                used.insert(channel);
            }
            Item::Unverified | Item::Hole(_) => {}
        });
        matches!(progress, Ok(Progress::More))
    }

    /// The span of what was read; `None` without a message.
    pub fn into_span(mut self) -> Option<Span> {
        self.topics.retain(|id, _| self.used.contains(id));
        self.times.map(|(from, to)| Span {
            from,
            to,
            topics: self.topics.into_values().collect(),
        })
    }
}

/// Span by the summary at the end of an open file; `None` without one.
pub fn span_by_summary(mut file: &File) -> Option<Span> {
    let mut end = [0u8; 37];
    let footer_at = file.seek(SeekFrom::End(-37)).ok()?;
    file.read_exact(&mut end).ok()?;
    let (footer, magic) = end.split_at(29);
    if magic != mcap::MAGIC || footer.first() != Some(&mcap::records::op::FOOTER) {
        return None;
    }
    let summary_at = Fields(&footer[9..]).u64().ok().filter(|at| *at > 0)?;
    let length = footer_at
        .checked_sub(summary_at)
        .filter(|length| *length <= MAX_SUMMARY)?;
    file.seek(SeekFrom::Start(summary_at)).ok()?;
    // Bounded by the limit above.
    let mut summary = vec![0u8; length as usize];
    file.read_exact(&mut summary).ok()?;
    span_of(&summary).ok()?
}

/// Span by the channels and statistics among the records of a summary.
fn span_of(summary: &[u8]) -> Result<Option<Span>, &'static str> {
    let (mut channels, mut times, mut used) = (Vec::new(), None, BTreeSet::new());
    let mut records = Fields(summary);
    while let Some((opcode, mut fields)) = records.record()? {
        match opcode {
            mcap::records::op::CHANNEL => {
                let (id, _schema) = (fields.u16()?, fields.u16()?);
                channels.push((id, fields.text()?.to_owned()));
            }
            mcap::records::op::STATISTICS => {
                let (messages, _schemas) = (fields.u64()?, fields.u16()?);
                // Channels, attachments, metadata and chunks.
                fields.bytes(16)?;
                times = Some((fields.u64()?, fields.u64()?)).filter(|_| messages > 0);
                let length = fields.u32()?;
                let mut counts = Fields(fields.bytes(u64::from(length))?);
                while !counts.0.is_empty() {
                    let (id, count) = (counts.u16()?, counts.u64()?);
                    used.extend(Some(id).filter(|_| count > 0));
                }
            }
            _ => {}
        }
    }
    channels.retain(|(id, _)| used.contains(id));
    Ok(times.filter(|_| !channels.is_empty()).map(|(from, to)| Span {
        from,
        to,
        topics: channels.into_iter().map(|(_, topic)| topic).collect(),
    }))
}

/// Log time of the first message \[ns since 1970\], from the first chunk's header or the message itself.
pub fn first_time(file: &File) -> Option<u64> {
    times(file).next()
}

/// Log times of the chunks and messages among the first [`LOOKED_AT`] records \[ns since 1970\]; of a chunk, its earliest.
fn times(file: &File) -> impl Iterator<Item = u64> {
    let mut file = BufReader::new(file);
    let mut has_begun = file.seek(SeekFrom::Start(8)).is_ok();
    let records = std::iter::from_fn(move || {
        let time = has_begun.then(|| record_time(&mut file)).flatten();
        has_begun = time.is_some();
        time
    });
    records.take(LOOKED_AT).flatten()
}

/// Log time of the next record, which is passed; `Some(None)` for a record that has none, `None` at the end.
fn record_time(file: &mut BufReader<&File>) -> Option<Option<u64>> {
    let mut head = [0u8; 9];
    file.read_exact(&mut head).ok()?;
    let mut fields = Fields(&head);
    let (opcode, length) = (fields.u8().ok()?, fields.u64().ok()?);
    let before = match opcode {
        mcap::records::op::CHUNK => 0,
        // Channel and sequence number come first.
        mcap::records::op::MESSAGE => 6,
        mcap::records::op::FOOTER => return None,
        _ => {
            file.seek_relative(i64::try_from(length).ok()?).ok()?;
            return Some(None);
        }
    };
    file.seek_relative(before).ok()?;
    let mut time = [0u8; 8];
    file.read_exact(&mut time).ok()?;
    let left = i64::try_from(length).ok()?.checked_sub(before + 8)?;
    file.seek_relative(left).ok()?;
    Some(Some(u64::from_le_bytes(time)))
}
