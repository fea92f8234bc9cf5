//! The parts of one journal, read as the one stream they are.
//!
//! Nothing is cut where a part ends: the next one continues, even after a part torn by a crash. Replay and
//! daemon both read a journal here, so they cut the same records.

use super::file::FileReader;
use super::in_order::InOrder;
use super::mcap::{Damage, Progress, Reader};
use super::route::{Listener, Ready, Router, Timed};
use super::source::{Source, Step};
use super::{Place, SourceError, Summary, TopicSummary, carry};
use crate::part;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::UNIX_EPOCH;
use tirante_analysis::signal::record::{Event, RecordSettings, RodChannels};
use tirante_analysis::track::ordered::Reached;

/// Result of a part that was read to its end.
#[derive(Debug)]
pub struct PartEnd {
    /// Number of the part.
    pub part: u32,
    /// Size of the part \[bytes\].
    pub size: u64,
    /// Time of its last change \[ns since 1970\].
    pub modified_ns: i64,
    /// Summary of the part, or the error that prevented reading.
    pub result: Result<Summary, SourceError>,
    /// Number of the next part, if there is one.
    pub next: Option<u32>,
}

/// Parts to read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Parts {
    /// These, ascending; the journal ends after the last.
    Given(Vec<u32>),
    /// All from this one on, of a journal that is still being written.
    From(u32),
}

/// Parts of one journal, read as one recording.
pub struct Series {
    folder: PathBuf,
    channels: Vec<RodChannels>,
    settings: RecordSettings,
    /// True if the journal is still written.
    live: bool,
    router: Router,
    queue: Ready,
    /// Parts to read; empty for a live journal.
    listed: Vec<u32>,
    open: Option<Open>,
    /// Part that was found missing, and the sentence about it, until it is asked for.
    lost: Option<(String, String)>,
    /// Number of the part read before, and of the next one.
    before: Option<u32>,
    next: Option<u32>,
}

/// The part that is being read.
struct Open {
    number: u32,
    /// Name in the store or given by the user.
    name: Arc<str>,
    /// The file and its reader.
    file: Result<(File, FileReader<File>), SourceError>,
    records: u64,
    damage: Option<String>,
    /// True if the part is at its end, as far as it is written.
    ended: bool,
    /// Number of the part after it, once seen; from then on this one no longer grows.
    successor: Option<u32>,
    size: u64,
    modified_ns: i64,
}

impl Series {
    /// Reads the parts in `folder`.
    pub fn new(folder: &Path, parts: Parts, channels: &[RodChannels], settings: &RecordSettings) -> Self {
        let (live, next, listed) = match parts {
            Parts::Given(parts) => (false, parts.first().copied(), parts),
            Parts::From(first) => (true, Some(first), Vec::new()),
        };
        Self {
            folder: folder.to_owned(),
            channels: channels.to_vec(),
            settings: settings.of_stream(),
            live,
            router: Router::new(channels, &settings.of_stream()),
            queue: Ready::default(),
            listed,
            open: None,
            lost: None,
            before: None,
            next,
        }
    }

    /// Restores samples that earlier parts left open; returns a sentence for each rod whose samples no longer
    /// fit.
    pub fn resume(&mut self, body: &[u8]) -> Vec<String> {
        let (router, lost) = carry::decode(body, &self.channels, &self.settings);
        self.renew(router);
        // The carry is the state after the part before the next one.
        self.before = self.next.and_then(|next| next.checked_sub(1));
        lost
    }

    /// Passes the samples read from now on to a listener, too.
    pub fn set_listener(&mut self, listener: Listener) {
        self.router.listener = Some(listener);
    }

    /// Samples open between two parts, for [`Series::resume`].
    ///
    /// # Errors
    /// They cannot be encoded, which no input brings about.
    pub fn carry(&self) -> Result<Vec<u8>, postcard::Error> {
        carry::encode(&self.router, &self.settings)
    }

    /// Ends every open record between two parts, and continues with other channels and settings.
    pub fn change(
        &mut self,
        channels: &[RodChannels],
        settings: &RecordSettings,
        end: &PartEnd,
    ) -> Vec<(Event, Place)> {
        self.router.finish(true, None, &mut self.queue);
        channels.clone_into(&mut self.channels);
        self.settings = settings.of_stream();
        self.begin_anew();
        let name: Arc<str> = Arc::from(part::mark_name(end.part));
        self.queue
            .take()
            .map(|timed| timed.at_place(Arc::clone(&name), end.size, 0))
            .collect()
    }

    /// Times up to which each rod has been read.
    pub fn reached(&self) -> Reached {
        self.router.reached()
    }

    /// Log time of the latest message that a rod took \[ns\].
    pub fn at(&self) -> Option<u64> {
        self.router.at()
    }

    /// Bytes of samples not yet in a record, and of messages that wait.
    pub fn held(&self) -> usize {
        self.router.held() + self.router.ahead_bytes()
    }

    /// Sets the bytes of samples beyond which records end early.
    pub fn bound(&mut self, most: usize) {
        self.router.bound(most);
    }

    /// Bytes of samples in events that wait to be taken.
    pub fn ready_bytes(&self) -> usize {
        self.queue.bytes()
    }

    /// Number of the current part, if no more of it can be read: only another part brings data again.
    pub fn stuck_in(&self) -> Option<u32> {
        let open = self.open.as_ref()?;
        (open.ended && open.damage.is_some()).then_some(open.number)
    }

    /// File name of a part that was found missing since the last call, and a sentence about it.
    pub fn take_lost(&mut self) -> Option<(String, String)> {
        self.lost.take()
    }

    /// Topics of the part that is read, as far as it is.
    pub fn topics(&self) -> impl Iterator<Item = (&str, &TopicSummary)> {
        self.router.topics()
    }

    /// Number of bytes read of the open part.
    pub fn bytes_read(&self) -> u64 {
        self.open.as_ref().map_or(0, |open| open.read())
    }

    fn event(&mut self, timed: Timed) -> Step<Box<PartEnd>> {
        let (file, bytes, records) = match &mut self.open {
            Some(open) => {
                open.records += timed.records();
                (Arc::clone(&open.name), open.read(), open.records)
            }
            // Events at the very end belong to the part that was read last.
            None => (Arc::from(self.name(self.before.unwrap_or_default())), 0, 0),
        };
        let (event, place) = timed.at_place(file, bytes, records);
        Step::Event(event, place)
    }

    /// Handles damage: the rest of the open part is lost, and records end there.
    fn lose(&mut self) {
        let damage = self.open.as_ref().and_then(|open| open.damage.clone());
        self.router.finish(true, damage.as_deref(), &mut self.queue);
        self.begin_anew();
    }

    fn begin_anew(&mut self) {
        let journal = self.router.journal.take();
        let holes = self.router.take_holes();
        self.renew(Router::new(&self.channels, &self.settings));
        self.router.journal = journal;
        // Of the part under way: they are told at its end.
        self.router.keep_holes(holes);
    }

    /// Takes another router; the listener stays.
    fn renew(&mut self, router: Router) {
        let listener = self.router.listener.take();
        self.router = router;
        self.router.listener = listener;
    }

    fn name(&self, part: u32) -> String {
        if self.live {
            part::mark_name(part)
        } else {
            part::path(&self.folder, part).display().to_string()
        }
    }

    /// Number of the next existing part after `number`.
    fn later(&self, number: u32) -> Option<u32> {
        let next = number.checked_add(1)?;
        let is_there = |part: &u32| part::path(&self.folder, *part).is_file();
        let after = |parts: &[u32]| {
            parts
                .iter()
                .copied()
                .find(|part| *part > number && is_there(part))
        };
        if !self.live {
            return after(&self.listed);
        }
        if is_there(&next) {
            return Some(next);
        }
        // It may have been removed before it was read, while others were begun. A folder that cannot be read has none.
        let later = after(&part::list(&self.folder).unwrap_or_default())?;
        // It may have been begun since it was looked for.
        Some(if is_there(&next) { next } else { later })
    }

    fn open_next(&mut self) -> Step<Box<PartEnd>> {
        let Some(next) = self.next else {
            return Step::End;
        };
        let number = if part::path(&self.folder, next).is_file() {
            next
        } else {
            // Not there yet, or removed.
            match self.later(next) {
                Some(later) => later,
                None if self.live => return Step::Wait,
                None => {
                    self.next = None;
                    return Step::More;
                }
            }
        };
        let missing = self.before.filter(|before| before.checked_add(1) != Some(number));
        self.router.next_part();
        let mut open = Open::new(&self.folder, number, self.name(number), self.live);
        open.successor = self.later(number);
        if let Some(before) = missing {
            let name = part::file_name(before.saturating_add(1));
            let damage = format!(
                "{}: the part before it, {name}, is missing; records that were open end there",
                open.name
            );
            self.lost = Some((name, damage.clone()));
            open.damage = Some(damage);
            self.router.finish(true, None, &mut self.queue);
            self.begin_anew();
        }
        let is_unreadable = open.ended;
        self.open = Some(open);
        if is_unreadable {
            self.lose();
        }
        Step::More
    }

    /// Ends a part: hands it over once the next one exists, or ends the journal.
    fn end_part(&mut self) -> Step<Box<PartEnd>> {
        let Some(number) = self.open.as_ref().map(|open| open.number) else {
            return Step::End;
        };
        let next = self.later(number);
        if next.is_none() {
            if self.live {
                return Step::Wait;
            }
            self.next = None;
            // The data still open may have continued in the missing part.
            self.router.finish(true, None, &mut self.queue);
            self.begin_anew();
            if let Some(event) = self.queue.pop() {
                return self.event(event);
            }
        }
        let Some(open) = self.open.take() else {
            return Step::End;
        };
        self.before = Some(number);
        self.next = next;
        let mut summary = Summary {
            file: open.name.to_string(),
            messages: open.reader().map_or(0, Reader::messages),
            damage: open.damage,
            ..Summary::default()
        };
        self.router.summarise(&mut summary);
        // The topics of one part are not those of the whole journal.
        summary.missing.clear();
        summary.samples.clear();
        Step::File(Box::new(PartEnd {
            part: number,
            size: open.size,
            modified_ns: open.modified_ns,
            result: open.file.map(|_| summary),
            next,
        }))
    }
}

impl Source for Series {
    type File = Box<PartEnd>;

    fn poll(&mut self) -> Step<Box<PartEnd>> {
        if let Some(event) = self.queue.pop() {
            return self.event(event);
        }
        if self.open.is_none() {
            return self.open_next();
        }
        let Some(open) = &mut self.open else {
            return Step::End;
        };
        if open.ended {
            return self.end_part();
        }
        if self.router.waits() {
            self.router.go_on(u64::MAX);
            self.router.events(&mut self.queue);
            return match self.queue.pop() {
                Some(event) => self.event(event),
                None => Step::More,
            };
        }
        match open.step(&mut self.router) {
            Ok(Progress::More) => self.router.events(&mut self.queue),
            Ok(Progress::Complete) => open.ended = true,
            Ok(Progress::Wait | Progress::Truncated) => {
                if open.successor.is_some() || !self.live {
                    // The end was reached after the part behind it had been seen: it was torn.
                    open.ended = true;
                } else {
                    let number = open.number;
                    let Some(later) = self.later(number) else {
                        return Step::Wait;
                    };
                    // Data written before that part was begun may still be unread.
                    if let Some(open) = &mut self.open {
                        open.successor = Some(later);
                    }
                }
            }
            // After a power cut the end of a torn part may be blank.
            Err(_) if open.is_blank() => open.ended = true,
            Err(damage) => {
                open.fail(damage);
                self.lose();
            }
        }
        match self.queue.pop() {
            Some(event) => self.event(event),
            None => Step::More,
        }
    }

    fn position(&self) -> Option<(Arc<str>, u64)> {
        let open = self.open.as_ref()?;
        Some((Arc::clone(&open.name), open.offset()))
    }

    fn abandon(&mut self, why: &str) {
        if let Some(open) = &mut self.open
            && !open.ended
        {
            open.fail(Damage {
                offset: open.offset(),
                what: why.to_owned(),
            });
            self.lose();
        }
    }

    fn discard(&mut self, why: &str) {
        if let Some(open) = &mut self.open {
            open.fail(Damage {
                offset: open.offset(),
                what: why.to_owned(),
            });
            self.queue.clear();
            self.begin_anew();
        }
    }
}

impl Open {
    fn new(folder: &Path, number: u32, name: String, live: bool) -> Self {
        let path = part::path(folder, number);
        let file = File::open(&path)
            .and_then(|file| {
                // Only a part that is over has its checksum; it is right or there is damage.
                let reader = FileReader::checked(file.try_clone()?, live)?.passing_holes();
                Ok((file, reader))
            })
            .map_err(|source| SourceError::Io {
                path: path.display().to_string(),
                source,
            });
        let mut open = Self {
            number,
            name: Arc::from(name),
            ended: file.is_err(),
            file,
            records: 0,
            damage: None,
            successor: None,
            size: 0,
            modified_ns: 0,
        };
        open.look();
        open
    }

    /// Notes the size of the file and the time of its last change.
    fn look(&mut self) {
        if let Ok((file, _)) = &self.file
            && let Ok(data) = file.metadata()
        {
            self.size = data.len();
            self.modified_ns = data.modified().map_or(0, modified_ns);
        }
    }

    fn step(&mut self, router: &mut Router) -> Result<Progress, Damage> {
        let Ok((_, reader)) = &mut self.file else {
            return Ok(Progress::Complete);
        };
        let progress = reader.step(&mut |item| router.item(item));
        if !matches!(progress, Ok(Progress::More)) {
            self.look();
        }
        progress
    }

    /// Reader of the items, once the part's checksum is verified.
    fn reader(&self) -> Option<&Reader<InOrder<File>>> {
        self.file.as_ref().ok().and_then(|(_, reader)| reader.reader())
    }

    fn offset(&self) -> u64 {
        self.reader().map_or(0, Reader::offset)
    }

    fn read(&self) -> u64 {
        self.reader().map_or(0, Reader::bytes_read)
    }

    fn is_blank(&self) -> bool {
        match (&self.file, self.reader()) {
            (Ok((file, _)), Some(reader)) => is_blank(file, reader.offset()),
            _ => false,
        }
    }

    fn fail(&mut self, Damage { offset, what }: Damage) {
        self.ended = true;
        let damage = format!(
            "{}: at byte {offset}: {what}; nothing of this part from there on was used",
            self.name
        );
        self.damage = Some(damage);
    }
}

/// True if a file holds nothing but zeros from `from` on.
pub fn is_blank(file: &File, from: u64) -> bool {
    let mut offset = from;
    let mut buffer = vec![0u8; 1 << 16];
    loop {
        match file.read_at(&mut buffer, offset) {
            Ok(0) => return offset > from,
            Ok(count) if buffer[..count].iter().all(|byte| *byte == 0) => offset += count as u64,
            _ => return false,
        }
    }
}

/// File time in nanoseconds since 1970.
pub fn modified_ns(time: std::time::SystemTime) -> i64 {
    match time.duration_since(UNIX_EPOCH) {
        Ok(since) => i64::try_from(since.as_nanos()).unwrap_or(i64::MAX),
        Err(before) => i64::try_from(before.duration().as_nanos()).map_or(i64::MIN, |nanos| -nanos),
    }
}
