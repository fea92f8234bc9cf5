//! Samples in, records out: one rod's stream cut into evenly sampled, checked records.
//!
//! Samples may come twice, late, with holes, or stamped by a clock that steps. What fits the running
//! stretch joins it; a few messages that do not are set aside, and if they persist they start a new stretch.
//! A finished stretch is put on an even axis, cut as configured and checked.

mod messages;
mod readings;
mod records;

use super::onset;
use super::temperature::Temperature;
use super::timing::{Stray, Stretch};
use super::{Cut, Event, Record, RecordSettings, Rejection, RodId, Timestamp};
use messages::Place;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Most samples in one record, whatever its length: its analysis takes up to a hundred bytes a sample.
pub const MAX_SAMPLES: usize = 1 << 20;

/// Most bytes of a stretch: that many samples, each with a stamp of its own. Where onsets are searched for, a
/// third: the search takes several times the stretch.
const MAX_BYTES: usize = 24 * MAX_SAMPLES;
const MAX_SEARCHED: usize = MAX_BYTES / 3;
/// Most bytes of messages that wait for a decision; beyond, fewer of them must suffice.
const MAX_ASIDE: usize = 4 << 20;

/// Furthest a late message may belong back \[messages\].
const LATE: usize = 64;
/// Wait of a window for late messages: this many messages, at most this long \[s\], but at least one message.
const LAG: usize = 32;
const LAG_S: f64 = 0.2;
type Message = (i64, Vec<f64>);

/// Cuts one rod's samples into records.
///
/// Its state between two messages survives a restart ([`Assembler::save`]).
#[derive(Debug, Serialize, Deserialize)]
pub struct Assembler {
    rod: RodId,
    /// Not saved: [`Assembler::resume`] takes them again.
    #[serde(skip)]
    settings: RecordSettings,
    declared_hz: Option<f64>,
    temperature: Option<Temperature>,
    /// First messages of a stretch, until the sample interval is known.
    warm: Vec<Message>,
    /// The running stretch and its sample interval \[ns\].
    open: Stretch,
    interval: Option<f64>,
    /// Scatter of a stamp, from the latest messages of the stretch \[ns\].
    wobble: f64,
    astray: Vec<Message>,
    /// Last message of the stretch, if it has overtaken others or was stamped late.
    ahead: Option<Ahead>,
    dropped: usize,
    /// Messages of the stretch whose stamps were already corrected.
    stray: Stray,
    /// Time up to which onsets were already reported \[ns\].
    seen_until: i64,
    onsets: usize,
    searched_s: f64,
    searched_from: Option<Timestamp>,
    /// True if samples come from data that could not be checked, and the latest stamp of one that did \[ns\].
    unverified: bool,
    unverified_until: i64,
    #[serde(with = "super::saved::records")]
    waiting: VecDeque<Record>,
    /// Completion time of each waiting record \[ns\].
    waiting_at: VecDeque<i64>,
    /// Latest stamp of the stretch that was cut last: the completion time of its events \[ns\].
    at: i64,
    /// True if the stream ended and nothing has come since.
    is_over: bool,
    /// A run of stretches too short for a record, reported as one.
    short: Option<Short>,
    samples: u64,
    /// Not saved: the caller takes them before [`Assembler::save`].
    #[serde(skip)]
    events: Vec<(Timestamp, Event)>,
}

/// A message before which others were inserted, because of their stamps.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Ahead {
    /// Stamp of the message \[ns\].
    time: i64,
    /// Stamp of the message before it \[ns\].
    behind: i64,
}

#[derive(Debug, Serialize, Deserialize)]
struct Short {
    start: Timestamp,
    longest_s: f64,
    total_s: f64,
}

impl Assembler {
    /// An assembler for one rod. `declared_hz` is the sample rate the configuration names, if any;
    /// `temperature` is true if readings will come.
    pub fn new(rod: RodId, settings: RecordSettings, declared_hz: Option<f64>, temperature: bool) -> Self {
        Self {
            rod,
            settings,
            declared_hz,
            temperature: temperature.then(Temperature::default),
            warm: Vec::new(),
            open: Stretch::default(),
            interval: None,
            wobble: 0.0,
            astray: Vec::new(),
            ahead: None,
            dropped: 0,
            stray: Stray::default(),
            seen_until: i64::MIN,
            onsets: 0,
            searched_s: 0.0,
            searched_from: None,
            unverified: false,
            unverified_until: i64::MIN,
            waiting: VecDeque::new(),
            waiting_at: VecDeque::new(),
            at: i64::MIN,
            is_over: false,
            short: None,
            samples: 0,
            events: Vec::new(),
        }
    }

    /// Its state, NaN samples bit for bit, for [`Assembler::resume`]. Take the [events](Self::events) before.
    ///
    /// # Errors
    /// It cannot be encoded, which no input brings about.
    pub fn save(&self) -> Result<Vec<u8>, postcard::Error> {
        postcard::to_stdvec(self)
    }

    /// Resumes from a [saved](Self::save) state, with the settings it was saved with.
    ///
    /// # Errors
    /// The bytes are no saved assembler.
    pub fn resume(saved: &[u8], settings: RecordSettings) -> Result<Self, postcard::Error> {
        let assembler: Self = postcard::from_bytes(saved)?;
        Ok(Self {
            settings,
            ..assembler
        })
    }

    /// Starts again after [`Assembler::finish`], as for another file. With `keep_temperature` the readings
    /// are kept, since they come from elsewhere.
    pub fn renew(&mut self, keep_temperature: bool) {
        let temperature = self.temperature.take();
        let fresh = Self::new(
            self.rod.clone(),
            self.settings,
            self.declared_hz,
            temperature.is_some(),
        );
        let events = std::mem::take(&mut self.events);
        *self = Self { events, ..fresh };
        if keep_temperature {
            self.temperature = temperature;
        }
    }

    /// Samples taken so far.
    pub fn samples(&self) -> u64 {
        self.samples
    }

    /// Sets if samples from now on come from data that could not be checked.
    #[inline]
    pub fn set_unverified(&mut self, unverified: bool) {
        self.unverified = unverified;
    }

    /// Takes one message: the time of its first sample and its samples in SI; a value that is not finite
    /// counts as missing.
    #[inline]
    pub fn push(&mut self, time: Timestamp, values: &[f64]) {
        if values.is_empty() {
            return;
        }
        self.samples += values.len() as u64;
        self.is_over = false;
        let time = time.as_nanos();
        if self.unverified {
            self.unverified_until = self.unverified_until.max(time);
        }
        let is_simple = self.astray.is_empty() && self.ahead.is_none();
        if is_simple && matches!(self.place(time, values), Some(Place::Next)) {
            self.append(time, values);
            return;
        }
        let mut queue = VecDeque::from([(time, values.to_vec())]);
        while let Some(message) = queue.pop_front() {
            self.take(message, &mut queue);
        }
    }

    /// Bytes of samples not yet in a record, and of records that wait.
    pub fn held(&self) -> usize {
        let waiting = self.waiting.iter().map(|record| 8 * record.samples.len());
        self.open.bytes() + bytes_of(&self.warm) + bytes_of(&self.astray) + waiting.sum::<usize>()
    }

    /// Ends the stretch here to make room: the samples so far become a record.
    pub fn cut_off(&mut self) {
        if self.interval.is_none() {
            self.settle(false);
        } else {
            let seen_until = self.open.times.last().copied();
            let open = std::mem::take(&mut self.open);
            self.close(open, false, None);
            // The continued motion is not a decay that begins.
            self.seen_until = seen_until.unwrap_or(self.seen_until);
        }
        self.release(true);
    }

    /// Reports samples that were lost upstream, from `start` on if that is known.
    pub fn tell_lost(&mut self, start: Option<Timestamp>, duration_s: f64, rejection: Rejection) {
        let newest = self.open.times.last().copied();
        self.at = newest.map_or(self.at, |newest| newest.max(self.at));
        self.reject(start, duration_s, rejection);
    }

    /// Events so far, taken out.
    pub fn events(&mut self) -> impl Iterator<Item = Event> {
        self.timed_events().map(|(_, event)| event)
    }

    /// The same, each with its completion time: the latest stamp of the stretch it was cut from.
    pub fn timed_events(&mut self) -> std::vec::Drain<'_, (Timestamp, Event)> {
        self.events.drain(..)
    }

    /// Reports a rejection without samples.
    pub fn tell_nothing(&mut self, rejection: Rejection) {
        self.tell(Event::Rejected {
            rod: self.rod.clone(),
            start: None,
            duration_s: 0.0,
            fs_hz: None,
            waveform: None,
            rejection,
        });
    }

    /// Drops the samples not yet in a record and reports `rejection` for them. Readings are kept.
    pub fn refuse(&mut self, rejection: Rejection) {
        let times = self
            .open
            .times
            .iter()
            .chain(self.warm.iter().map(|(time, _)| time));
        let start = times.min().copied().map(Timestamp::from_nanos);
        let newest = self.open.times.last().or(self.warm.last().map(|(time, _)| time));
        self.at = newest.map_or(self.at, |&newest| newest.max(self.at));
        self.release(true);
        self.reject(start, 0.0, rejection);
        self.renew(true);
    }

    /// True if there are events to be taken.
    #[inline]
    pub fn has_events(&self) -> bool {
        !self.events.is_empty()
    }

    /// Lower bound of the completion times of all events still to come; `None` before the first sample and
    /// after the end of the stream. Decreases only if the samples' clock does.
    pub fn complete_until(&self) -> Option<Timestamp> {
        if self.samples == 0 || self.is_over {
            return None;
        }
        let open = self.open.times.last().copied();
        let warm = || self.warm.iter().map(|(time, _)| *time).min();
        let nanos = self.waiting_at.front().copied().or(open).or_else(warm);
        Some(Timestamp::from_nanos(
            nanos.unwrap_or_else(|| self.at.saturating_add(1)),
        ))
    }

    /// Earliest time of samples that are in no event yet, but for stretches too short: no event still to come begins before. `None` as for
    /// [`Assembler::complete_until`].
    pub fn pending_from(&self) -> Option<Timestamp> {
        if self.samples == 0 || self.is_over {
            return None;
        }
        let waiting = self.waiting.front().map(|record| record.start.as_nanos());
        let open = self.open.times.first().copied();
        let warm = self.warm.iter().map(|(time, _)| *time).min();
        let pending = waiting.into_iter().chain(open).chain(warm).min();
        Some(Timestamp::from_nanos(
            pending.unwrap_or_else(|| self.at.saturating_add(1)),
        ))
    }

    /// Ends the stream. With `cut_short`, the last record may be incomplete.
    pub fn finish(&mut self, cut_short: bool) {
        self.settle(cut_short);
        let astray = std::mem::take(&mut self.astray);
        if !astray.is_empty() {
            self.warm = astray;
            self.settle(cut_short);
        }
        // A record that waited for its temperature comes before what was noticed behind it.
        self.release(true);
        if self.onsets == 0
            && let Some(start) = self.searched_from
        {
            let duration_s = self.searched_s;
            self.reject(Some(start), duration_s, Rejection::NoOnset { duration_s });
        }
        self.tell_short();
        self.is_over = true;
    }

    /// Closes the open stretch.
    fn settle(&mut self, cut_short: bool) {
        if self.interval.is_none() && !self.warm.is_empty() {
            let mut queue = VecDeque::new();
            self.warmed(&mut queue);
            while let Some(message) = queue.pop_front() {
                self.take(message, &mut queue);
                if self.interval.is_none() && queue.is_empty() && !self.warm.is_empty() {
                    self.warmed(&mut queue);
                }
            }
        }
        self.cut_rest();
        let open = std::mem::take(&mut self.open);
        self.close(open, cut_short, None);
        self.seen_until = i64::MIN;
        self.interval = None;
    }

    /// Cuts the windows that were still waiting for late messages, and what the last message holds of further
    /// records.
    fn cut_rest(&mut self) {
        while let (Some(&start), Some(&last), Some(&size), Some(interval)) = (
            self.open.times.first(),
            self.open.times.last(),
            self.open.sizes.last(),
            self.interval,
        ) {
            let longest = self.longest_s(interval);
            let (length_s, due_s) = match self.settings.cut {
                Cut::Window { length_s } => {
                    let length_s = length_s.min(longest);
                    (length_s, length_s + 0.5e-9 * interval)
                }
                // A bit more than a whole record is no record of its own.
                Cut::Auto | Cut::File => (longest, 2.0 * longest),
                Cut::FreeDecay { .. } => return,
            };
            let span = (last.saturating_sub(start) as f64 + interval * f64::from(size)) * 1e-9;
            if span < due_s {
                return;
            }
            let before = self.open.values.len();
            self.cut_at(start, length_s, interval);
            if self.open.values.len() == before {
                return;
            }
        }
    }

    /// Adds the next message and cuts where a record is due.
    #[inline]
    fn append(&mut self, time: i64, values: &[f64]) {
        self.open.push(time, values);
        if self.open.times.len().is_multiple_of(LATE) {
            self.wobble = self.open.wobble(LATE, self.interval.unwrap_or(0.0));
        }
        let (Some(interval), Some(&start)) = (self.interval, self.open.times.first()) else {
            return;
        };
        let span = time.saturating_sub(start) as f64 * 1e-9;
        let message = interval * values.len() as f64 * 1e-9;
        let lag = (LAG as f64 * message).min(message.max(LAG_S));
        let longest = self.longest_s(interval);
        match self.settings.cut {
            Cut::Auto | Cut::File => self.cut_all(time, interval, longest, longest),
            Cut::Window { length_s } => {
                let length_s = length_s.min(longest);
                self.cut_all(time, interval, length_s, length_s + lag);
            }
            Cut::FreeDecay { length_s, .. } if span >= (4.0 * length_s).max(60.0) || self.is_full() => {
                let is_full = self.is_full();
                // Onsets near the end wait until their whole record is there, and the quiet before them.
                let until = time.saturating_sub(nanos((length_s + 1.0).min(0.5 * span)));
                let searched = self.open.clone();
                self.close(searched, false, Some(until));
                let quiet = nanos(onset::context(1e9 / interval) as f64 * interval * 1e-9);
                let kept_from = until.saturating_sub(quiet);
                // At rates so high that the quiet before an onset fills the stretch, half of it must do.
                let half = start.saturating_add(nanos(0.5 * span));
                let kept_from = if is_full { kept_from.max(half) } else { kept_from };
                self.open.split_front(kept_from, interval);
                self.seen_until = until;
            }
            Cut::FreeDecay { .. } => {}
        }
        // Constant stamps give no place for a cut.
        if self.is_full() {
            let open = std::mem::take(&mut self.open);
            self.close(open, false, None);
        }
    }

    /// Longest record at a sample interval \[s\].
    fn longest_s(&self, interval: f64) -> f64 {
        self.settings
            .max_duration_s
            .min(MAX_SAMPLES as f64 * interval * 1e-9)
    }

    /// True if the stretch takes all the memory that it may.
    fn is_full(&self) -> bool {
        let most = match self.settings.cut {
            Cut::FreeDecay { .. } => MAX_SEARCHED,
            Cut::Auto | Cut::File | Cut::Window { .. } => MAX_BYTES,
        };
        self.open.bytes() >= most
    }

    /// Cuts records of `length_s` while the message at `time`, the last one, begins more than `due_s` behind the
    /// stretch's start. A single message may fill several records.
    fn cut_all(&mut self, time: i64, interval: f64, length_s: f64, due_s: f64) {
        while let Some(&start) = self.open.times.first() {
            let span = time.saturating_sub(start) as f64 * 1e-9;
            let before = self.open.values.len();
            if span >= due_s {
                self.cut_at(start, length_s, interval);
            } else if self.is_full() {
                self.cut_at(start, span.min(length_s), interval);
            }
            if self.open.values.len() == before {
                return;
            }
        }
    }

    fn cut_at(&mut self, start: i64, seconds: f64, interval: f64) {
        let boundary = start.saturating_add(nanos(seconds - 0.5e-9 * interval));
        let front = self.open.split_front(boundary, interval);
        self.close(front, false, None);
    }
}

fn nanos(seconds: f64) -> i64 {
    (seconds * 1e9).round() as i64
}

/// Size of messages in memory \[bytes\].
fn bytes_of(messages: &[Message]) -> usize {
    messages
        .iter()
        .map(|(_, values)| size_of::<Message>() + 8 * values.len())
        .sum()
}
