//! One file of the watched folder while it is read.

use super::listing::label;
use crate::analysis::signal::record::{RecordSettings, RodChannels};
use crate::recording::read::folder::first_time;
use crate::recording::read::series::modified_ns;
use crate::recording::read::{Recording, SourceError, Step, Tail};
use crate::service::daemon::steps::Guard;
use crate::service::daemon::supervision::Watch;
use crate::service::daemon::trial::Input;
use crate::service::telemetry::Health;
use std::convert::Infallible;
use std::ffi::{OsStr, OsString};
use std::fs::{File, Metadata};
use std::io::{Read, Seek, SeekFrom};
use std::os::unix::ffi::OsStringExt;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Size \[bytes\] and time of change \[ns since 1970\] of a file, to detect changes.
pub(super) type Stamp = (u64, i64);

/// Stamp of a file as it is now.
pub(super) fn stamp(data: &Metadata) -> Stamp {
    (data.len(), data.modified().map_or(0, modified_ns))
}

/// A file that is being read.
pub(super) struct Lane {
    pub(super) name: OsString,
    pub(super) label: Arc<str>,
    pub(super) recording: Recording,
    pub(super) guard: Guard,
    pub(super) input: Input,
    pub(super) file: File,
    pub(super) is_live: bool,
    /// Stamp when reading began, or when it was last seen to grow.
    pub(super) stamp: Stamp,
    pub(super) grew: Instant,
    /// True if another file has its name now.
    pub(super) is_replaced: bool,
    /// True if all of it that was there has been read once.
    pub(super) has_rested: bool,
    /// Log time of its first message \[ns since 1970\], once it has one.
    pub(super) begins: Option<u64>,
    /// True if it was read before and begins with what it went on with then, which is no other file's.
    pub(super) is_again: bool,
    /// Files that began before it and are read first; `None` before its first message.
    pub(super) elders: Option<Vec<OsString>>,
    /// True if a younger file waits until this one is read as far as it is.
    pub(super) is_behind: bool,
    /// Bytes in memory after its latest step.
    pub(super) held: usize,
}

impl Lane {
    /// Begins to read a file; `is_live` if it may still grow.
    pub(super) fn begin(
        folder: &Path,
        name: &OsStr,
        file: File,
        is_live: bool,
        channels: &[RodChannels],
        settings: &RecordSettings,
    ) -> Result<Self, SourceError> {
        let label = label(name);
        let failed = |source| SourceError::Io {
            path: label.clone(),
            source,
        };
        let stamp = stamp(&file.metadata().map_err(failed)?);
        let begins = first_time(&file);
        let input = file.try_clone().map_err(failed)?;
        let recording = Recording::begin(&label, input, channels, settings, is_live)?;
        Ok(Self {
            name: name.to_owned(),
            label: Arc::from(label),
            recording,
            guard: Guard::default(),
            input: Input::File {
                path: folder.join(name).into_os_string().into_vec(),
                is_live,
            },
            file,
            is_live,
            stamp,
            grew: Instant::now(),
            is_replaced: false,
            has_rested: false,
            begins,
            is_again: false,
            elders: None,
            is_behind: false,
            held: 0,
        })
    }

    /// Open samples of other files that it went on with.
    pub(super) fn taken(&self) -> &[Tail] {
        match self.is_again {
            true => &[],
            false => self.recording.taken(),
        }
    }

    /// Takes the open samples that it leaves to other files.
    pub(super) fn take_left(&mut self) -> Vec<Tail> {
        let mut left = self.recording.take_left();
        if self.is_again {
            // One that was discarded before its first record leaves what it began with.
            let began = self.recording.taken();
            let is_of_it = |left: &Tail, tail: &Tail| {
                (&left.rod, &left.file, left.to) == (&tail.rod, &tail.file, tail.to)
            };
            left.retain(|left| !began.iter().any(|tail| is_of_it(left, tail)));
        }
        left
    }

    /// Log time of its first message, by which it is known when it is read again; `None` if another file has its name or its place.
    pub(super) fn known_by(&self) -> Option<u64> {
        let begins = self.begins.filter(|_| !self.is_replaced);
        begins.filter(|begins| first_time(&self.file) == Some(*begins))
    }

    /// Takes the next step; `None` if the file must be looked up again.
    pub(super) fn step(
        &mut self,
        watch: &mut dyn Watch,
        settle: Duration,
        health: &Health,
    ) -> Option<Step<Infallible>> {
        let step = self.guard.poll(&mut self.recording, &self.input, watch, health);
        self.held = self.recording.held();
        match step {
            Step::Wait => {
                self.has_rested = true;
                self.is_behind = false;
                return self.wait(settle);
            }
            // A growing file was read as far as it is now; a finished one as it was when it was opened, so that
            // whatever came later is seen.
            Step::End if self.is_live => {
                if let Ok(data) = self.file.metadata()
                    && data.len() == self.recording.progress().read
                {
                    self.stamp = stamp(&data);
                }
            }
            _ => {}
        }
        Some(step)
    }

    /// Handles a file without data now: waits if it has grown lately.
    fn wait(&mut self, settle: Duration) -> Option<Step<Infallible>> {
        let Ok(data) = self.file.metadata() else {
            return Some(Step::Wait);
        };
        let now = stamp(&data);
        let shrank = now.0 < self.recording.progress().read;
        if now != self.stamp && !shrank {
            self.stamp = now;
            self.grew = Instant::now();
            if self.recording.is_in_doubt() && has_end(&self.file) {
                return None;
            }
        }
        if shrank || self.is_replaced || self.grew.elapsed() >= settle {
            // The apparently unfinished record is damage: read as a finished file, only that record is lost.
            if self.recording.is_in_doubt() && !shrank && !self.is_replaced {
                return None;
            }
            self.recording.give_up();
            return Some(Step::More);
        }
        Some(Step::Wait)
    }
}

/// True if a file has the end of a recording.
pub(super) fn has_end(file: &File) -> bool {
    let mut file = file;
    let mut end = [0u8; 8];
    let is_end = file
        .seek(SeekFrom::End(-8))
        .and_then(|at| {
            file.read_exact(&mut end)?;
            Ok(at > 8 && end == mcap::MAGIC)
        })
        .unwrap_or(false);
    // The next reader starts at the front.
    file.seek(SeekFrom::Start(0)).is_ok() && is_end
}
