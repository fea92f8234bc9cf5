//! A rod while its files are read: its samples, where they came from, and what a file gave.

use std::collections::VecDeque;
use std::sync::Arc;
use tirante_analysis::signal::record::{Assembler, Event, Moments, Rejection, RodChannels, Timestamp};

/// Error of a time that was computed from a length \[s\]: far below the interval of samples.
const ROUNDED_S: f64 = 1e-6;

/// Contents of a file for one rod.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Count {
    pub(super) messages: u64,
    pub(super) samples: u64,
}

/// A rod with one sensor, or one sensor of a rod with several: these are next to each other.
pub(in crate::read) struct Rod {
    /// Channels of the lane.
    pub(in crate::read) config: RodChannels,
    /// Number of its sensor, from 0.
    pub(in crate::read) sensor: usize,
    /// Moments of the rod's sensors, with the first of several.
    pub(in crate::read) moments: Option<Moments>,
    pub(in crate::read) assembler: Assembler,
    /// Indices of the streams of its last sample and of its last temperature.
    pub(super) fed_by: [Option<usize>; 2],
    /// True if it ever had samples.
    pub(in crate::read) is_followed: bool,
    pub(in crate::read) files: Files,
    /// Log time of its latest message with samples \[ns\].
    pub(in crate::read) to: u64,
    /// True if it had samples in the file that is read, with the first lane of the rod.
    pub(in crate::read) is_begun: bool,
    /// True if it had temperatures in it that the next file takes over, with the first lane of the rod.
    pub(in crate::read) is_warmed: bool,
    /// True if its samples and its readings come in one file, with the first lane of the rod.
    pub(in crate::read) is_together: bool,
    /// True if it went on with open samples of an earlier file, with the first lane of the rod.
    pub(in crate::read) is_continued: bool,
}

/// Most files of a rod that are remembered: beyond, a record waited for its temperature over as many files.
const FILES: usize = 16;

/// Latest files that gave a rod's samples, the latest first, each with the time of its first sample.
#[derive(Default)]
pub(in crate::read) struct Files(VecDeque<(Arc<str>, Timestamp)>);

impl Files {
    /// Notes samples of a file.
    #[inline]
    pub(in crate::read) fn note(&mut self, file: Option<&Arc<str>>, time: Timestamp) {
        if let Some(file) = file
            && !self
                .0
                .front()
                .is_some_and(|(latest, _)| Arc::ptr_eq(latest, file))
        {
            self.0.push_front((Arc::clone(file), time));
            self.0.truncate(FILES);
        }
    }

    /// The latest file.
    pub(super) fn latest(&self) -> Option<Arc<str>> {
        self.0.front().map(|(file, _)| Arc::clone(file))
    }

    /// The file that holds an event's last sample.
    pub(in crate::read) fn of(&self, event: &Event) -> Option<Arc<str>> {
        let end = match event {
            Event::Record(record) => {
                let last = record.samples.len().saturating_sub(1) as f64;
                Some(record.start.plus_seconds(last / record.fs_hz))
            }
            Event::Rejected {
                start, duration_s, ..
            } => start.map(|start| start.plus_seconds((duration_s - ROUNDED_S).max(0.0))),
            Event::Readings { .. } | Event::Moment(_) => None,
        };
        let has = |(_, from): &&(Arc<str>, Timestamp)| end.is_none_or(|end| *from <= end);
        let found = self.0.iter().find(has).or(self.0.back());
        found.map(|(file, _)| Arc::clone(file))
    }
}

impl Rod {
    /// True if it leaves what is open to the next file.
    pub(super) fn is_open(&self) -> bool {
        self.is_begun || self.is_warmed
    }

    /// Bytes of the records that wait for the rod's other sensors.
    pub(super) fn waiting(&self) -> usize {
        let waiting = self.moments.iter().flat_map(Moments::waiting);
        waiting.map(|event| 8 * event.samples()).sum()
    }

    /// Ends its stream.
    pub(super) fn finish(&mut self, count: Count, cut_short: bool, damage: Option<&str>) {
        self.assembler.finish(cut_short);
        self.assembler.tell_leftover();
        self.tell_nothing(count, damage);
    }

    /// Reports a file that gave nothing, or nothing more.
    pub(super) fn tell_nothing(&mut self, count: Count, damage: Option<&str>) {
        let rejection = match damage {
            Some(detail) if count.messages > 0 => Rejection::Damaged {
                detail: detail.to_owned(),
            },
            // Messages there were, samples none: one offered record that gave nothing.
            None if count.messages > 0 && count.samples == 0 => Rejection::Missing {
                share: 1.0,
                allowed: 0.0,
            },
            _ => return,
        };
        self.assembler.tell_nothing(rejection);
    }
}
