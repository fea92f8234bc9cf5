//! The journal's thread: takes batches, closes chunks, makes them durable, notifies the senders.

mod unwritable;

use super::handle::{Batch, Closed, Command, End, Entry};
use super::output::{Channel, Output};
use super::streams::{Streams, is_named};
use super::{Around, Bell, JournalError};
use crate::config::settings::journal::JournalSettings;
use crate::recording::note::{Begins, State};
use crate::service::telemetry::Fault;
use crate::service::telemetry::owned::Owned;
use std::collections::HashMap;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};
use tokio::sync::{OwnedSemaphorePermit, oneshot, watch};

/// Time after its first data at which a chunk is closed.
const CHUNK_AFTER: Duration = Duration::from_millis(200);
/// Size at which a chunk is closed \[bytes\].
const CHUNK_BYTES: usize = 1 << 20;
/// Time after which written data is made durable.
const SYNC_AFTER: Duration = Duration::from_millis(800);
/// Interval between checks of the file that is written.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// Pause between two removals of old parts.
const CLEAN_EVERY: Duration = Duration::from_secs(60);

/// Subject of the journal's conditions.
const ABOUT: &str = "journal";

/// Everything that the thread works with.
pub(super) struct Writer {
    pub folder: PathBuf,
    pub journal: String,
    pub settings: JournalSettings,
    pub resume_s: f64,
    pub streams: Streams,
    /// The part being written; `None` while there was no room to begin one.
    pub output: Option<Output>,
    pub next: u32,
    pub around: Around,
    pub bell: Arc<Bell>,
    pub results_kept: Arc<AtomicU32>,
    pub stopping: Arc<AtomicBool>,
    pub state: Work,
}

/// Work in progress.
#[derive(Default)]
pub(super) struct Work {
    lines: HashMap<u64, LineState>,
    anonymous: u64,
    /// Bytes in the open chunk, and the time of the first.
    open_bytes: usize,
    open_since: Option<Instant>,
    rooms: Vec<OwnedSemaphorePermit>,
    /// Time since which written data is not durable.
    unsynced_since: Option<Instant>,
    ends: Vec<oneshot::Sender<()>>,
    /// File of the part that is written, and the time of its last check.
    owned: Option<Owned>,
    looked: Option<Instant>,
    /// Time of the last removal of old parts, and the last part with results in the store then.
    cleaned: Option<Instant>,
    cleaned_through: u32,
}

struct LineState {
    stream: String,
    /// Channels by their ids: the connection's own, and the one in a part of the journal.
    channels: HashMap<u16, (Channel, Option<(u32, u16)>)>,
    closed: watch::Sender<Option<Closed>>,
}

/// Reason why the thread ends.
enum Stop {
    Asked,
    Failed(JournalError),
}

impl Writer {
    /// Works until stopped; an error is final.
    pub fn run(&mut self, commands: &Receiver<Command>) -> Result<(), JournalError> {
        match self.work(commands) {
            Ok(()) | Err(Stop::Asked) => Ok(()),
            Err(Stop::Failed(error)) => Err(error),
        }
    }

    fn work(&mut self, commands: &Receiver<Command>) -> Result<(), Stop> {
        self.begin_part()?;
        loop {
            self.around.beat.pass();
            self.look_at_files()?;
            match commands.recv_timeout(self.patience().min(LOOK_EVERY)) {
                Ok(command) => {
                    self.take(command)?;
                    // Commands already waiting go into the same chunk.
                    while self.state.open_bytes < CHUNK_BYTES
                        && let Ok(command) = commands.try_recv()
                    {
                        self.take(command)?;
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return self.close(),
            }
            self.look_at_clock()?;
        }
    }

    /// Time for which nothing has to be done.
    fn patience(&self) -> Duration {
        let until = |since: Option<Instant>, limit: Duration| {
            since.map_or(Duration::MAX, |since| limit.saturating_sub(since.elapsed()))
        };
        self.streams
            .patience(self.resume_s)
            .min(until(self.state.open_since, CHUNK_AFTER))
            .min(until(self.state.unsynced_since, SYNC_AFTER))
    }

    fn look_at_clock(&mut self) -> Result<(), Stop> {
        let is_due = |since: Option<Instant>, limit| since.is_some_and(|since| since.elapsed() >= limit);
        if self.state.open_bytes >= CHUNK_BYTES || is_due(self.state.open_since, CHUNK_AFTER) {
            self.flush()?;
        }
        if !self.state.ends.is_empty() || is_due(self.state.unsynced_since, SYNC_AFTER) {
            self.sync()?;
        }
        for stream in self.streams.expired(self.resume_s) {
            self.flush()?;
            if self.streams.end(&stream, State::Broken) {
                tracing::info!(stream, "was not taken up again; its record ends");
                self.mark_open(1);
                self.flush()?;
            }
        }
        let (part_bytes, part_s) = (self.settings.part_bytes, self.settings.part_s);
        if self
            .output
            .as_ref()
            .is_some_and(|output| output.is_due(part_bytes, part_s))
        {
            self.rotate()?;
        }
        let done = self.results_kept.load(Ordering::Relaxed);
        if done > self.state.cleaned_through
            || self
                .state
                .cleaned
                .is_none_or(|last| last.elapsed() >= CLEAN_EVERY)
        {
            self.state.cleaned = Some(Instant::now());
            self.state.cleaned_through = done;
            self.streams.forget();
            self.clean();
        }
        Ok(())
    }

    fn take(&mut self, command: Command) -> Result<(), Stop> {
        match command {
            Command::Connect {
                line,
                sender,
                durable,
                closed,
                begins_at,
            } => self.connect(line, sender, durable, closed, begins_at),
            Command::Batch { line, batch, room } => self.append(line, batch, room),
            Command::End { line, how, done } => self.end(line, how, done),
            Command::Rotate => self.rotate(),
            Command::Stop => {
                self.close()?;
                Err(Stop::Asked)
            }
        }
    }

    fn connect(
        &mut self,
        line: u64,
        sender: Option<String>,
        durable: watch::Sender<u64>,
        closed: watch::Sender<Option<Closed>>,
        begins_at: oneshot::Sender<u64>,
    ) -> Result<(), Stop> {
        let stream = sender.unwrap_or_else(|| {
            self.state.anonymous += 1;
            // The part's number makes it unique within the journal, restarts included.
            let part = self.output.as_ref().map_or(self.next, |output| output.number);
            format!("#{part}.{}", self.state.anonymous)
        });
        // The data that the stream continues must be durable.
        if is_named(&stream) && self.streams.messages(&stream) > 0 {
            self.flush()?;
            self.sync()?;
        }
        let messages = self.streams.messages(&stream);
        durable.send_replace(messages);
        if let Some(before) = self.streams.connect(&stream, line, durable)
            && let Some(before) = self.state.lines.remove(&before)
        {
            before.closed.send_replace(Some(Closed::TakenOver));
        }
        let state = LineState {
            stream,
            channels: HashMap::new(),
            closed,
        };
        self.state.lines.insert(line, state);
        // The asker may be gone; its line reports that.
        let _ = begins_at.send(messages);
        Ok(())
    }

    fn append(&mut self, line: u64, batch: Batch, room: OwnedSemaphorePermit) -> Result<(), Stop> {
        // A line that was taken over has no more effect.
        if !self.state.lines.contains_key(&line) {
            return Ok(());
        }
        let bytes: usize = batch.entries.iter().map(Entry::bytes).sum();
        if self.state.open_bytes > 0 && self.state.open_bytes + bytes > 4 * CHUNK_BYTES {
            self.flush()?;
        }
        if self
            .output
            .as_ref()
            .is_some_and(|output| !output.has_room(batch.entries.len()))
        {
            self.rotate()?;
        }
        self.state.rooms.push(room);
        self.put(line, batch).map_err(|source| self.failed(source))?;
        self.mark_open(bytes.max(1));
        Ok(())
    }

    fn put(&mut self, line: u64, batch: Batch) -> io::Result<()> {
        let (Some(output), Some(line)) = (&mut self.output, self.state.lines.get_mut(&line)) else {
            return Ok(());
        };
        for entry in batch.entries {
            match entry {
                Entry::Channel {
                    id,
                    topic,
                    encoding,
                    schema,
                } => {
                    let mut channel = Channel {
                        topic,
                        encoding,
                        schema,
                        twin: None,
                    };
                    let mut others = line.channels.iter().filter(|(other, _)| **other != id);
                    if others.any(|(_, (other, _))| *other == channel) {
                        channel.twin = Some(id);
                    }
                    line.channels.insert(id, (channel, None));
                }
                Entry::Message {
                    channel,
                    log_time,
                    publish_time,
                    data,
                } => {
                    let Some((channel, known)) = line.channels.get_mut(&channel) else {
                        self.around.health.fault(
                            Fault::Client,
                            format!("{}: a message before its channel", line.stream),
                        );
                        continue;
                    };
                    let id = match *known {
                        Some((part, id)) if part == output.number => id,
                        _ => {
                            let id = output.channel(&line.stream, channel)?;
                            *known = Some((output.number, id));
                            id
                        }
                    };
                    output.message(id, log_time, publish_time, &data)?;
                }
            }
        }
        self.streams.advance(&line.stream, batch.through);
        Ok(())
    }

    fn end(&mut self, line: u64, how: End, done: Option<oneshot::Sender<()>>) -> Result<(), Stop> {
        // The line is unknown if it was taken over; dropping `done` reports that.
        let Some(line) = self.state.lines.remove(&line) else {
            return Ok(());
        };
        let state = match how {
            End::Complete => State::Complete,
            End::Broken => State::Broken,
        };
        if how == End::Broken && is_named(&line.stream) {
            self.streams.leave(&line.stream);
        } else if self.streams.end(&line.stream, state) {
            // Nothing may come between a stream's data and its end.
            self.mark_open(1);
            self.flush()?;
        }
        self.state.ends.extend(done);
        Ok(())
    }

    fn mark_open(&mut self, bytes: usize) {
        self.state.open_bytes += bytes;
        self.state.open_since.get_or_insert_with(Instant::now);
    }

    /// Closes the open chunk and writes it to disk.
    fn flush(&mut self) -> Result<(), Stop> {
        if self.state.open_bytes == 0 {
            return Ok(());
        }
        self.state.open_bytes = 0;
        self.state.open_since = None;
        let note = self.streams.take_note();
        if let Some(output) = &mut self.output {
            output
                .close_chunk(&note)
                .map_err(|source| failed(&self.folder, source))?;
        }
        self.write_out()?;
        self.state.rooms.clear();
        Ok(())
    }

    /// Writes the bytes made to disk; waits while the disk is full.
    fn write_out(&mut self) -> Result<(), Stop> {
        loop {
            let Some(output) = &mut self.output else {
                return Ok(());
            };
            match output.write() {
                Ok(()) => {
                    self.state.unsynced_since.get_or_insert_with(Instant::now);
                    self.around.health.over(Fault::DiskFull, ABOUT);
                    self.bell.ring();
                    return Ok(());
                }
                Err(fault) if is_full(&fault) => self.wait_for_room()?,
                Err(fault) => return Err(self.failed(fault)),
            }
        }
    }

    /// Makes the written data durable and notifies reader and senders.
    fn sync(&mut self) -> Result<(), Stop> {
        self.flush()?;
        if let Some(output) = &mut self.output {
            output.sync().map_err(|source| failed(&self.folder, source))?;
        }
        self.state.unsynced_since = None;
        // What is acknowledged is in the file that has the part's name.
        self.state.looked = None;
        self.look_at_files()?;
        self.streams.publish();
        for done in self.state.ends.drain(..) {
            // The receiver may be gone.
            let _ = done.send(());
        }
        Ok(())
    }

    /// Closes the part and begins the next one.
    fn rotate(&mut self) -> Result<(), Stop> {
        self.close()?;
        self.output = None;
        self.begin_part()
    }

    /// Closes the part.
    fn close(&mut self) -> Result<(), Stop> {
        self.flush()?;
        if let Some(output) = &mut self.output {
            output.finish().map_err(|source| failed(&self.folder, source))?;
        }
        self.write_out()?;
        self.sync()
    }

    fn begin_part(&mut self) -> Result<(), Stop> {
        while self.output.is_none() {
            let note = self.first_note();
            match Output::create(&self.folder, self.next, &note) {
                Ok(output) => self.opened(output),
                Err(fault) if is_full(&fault) => self.wait_for_room()?,
                Err(fault) => return Err(self.failed(fault)),
            }
        }
        self.write_out()?;
        // So that the first entries of the part, such as ends of streams, are soon durable.
        self.sync()
    }

    /// Notes that a part was begun, with the first note in it.
    pub fn opened(&mut self, output: Output) {
        self.state.owned = output.owned();
        self.streams.take_note();
        self.next = self.next.saturating_add(1);
        self.output = Some(output);
    }

    /// First note of the next part.
    pub fn first_note(&self) -> crate::recording::note::Note {
        let mut note = self.streams.full_note();
        note.begins = Some(Begins {
            journal: self.journal.clone(),
            part: self.next,
        });
        note
    }

    fn failed(&self, source: io::Error) -> Stop {
        failed(&self.folder, source)
    }
}

fn failed(folder: &std::path::Path, source: io::Error) -> Stop {
    Stop::Failed(JournalError::Io {
        path: folder.to_owned(),
        source,
    })
}

/// True if there was no room: the only error of a disk that passes.
pub(super) fn is_full(fault: &io::Error) -> bool {
    matches!(
        fault.kind(),
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded
    )
}
