//! Samples in, records out: one rod's stream cut into evenly sampled, checked records.
//!
//! Samples may come twice, late, with holes, or stamped by a clock that steps. What fits the running
//! stretch joins it; a few messages that do not are put aside, and when they go on not fitting they
//! start a new stretch. A finished stretch is put on an even axis, cut as configured and checked.

use super::clock;
use super::onset::{self, UnderWay};
use super::quality;
use super::temperature::Temperature;
use super::timing::{self, Even, Stray, Stretch};
use super::{Cut, Envelope, Excitation, Flag, Reading, Record, RecordSettings, Rejection, RodId, Timestamp};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// What becomes of a stretch of samples.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// A record.
    Record(Record),
    /// A stretch that is none.
    Rejected {
        /// The rod.
        rod: RodId,
        /// Time of its first sample, if it has a time.
        start: Option<Timestamp>,
        /// Its length \[s\].
        duration_s: f64,
        /// Its sample rate \[Hz\], if that could be told.
        fs_hz: Option<f64>,
        /// Its samples as the columns of a drawing, if it has any at even times.
        waveform: Option<Envelope>,
        /// Why it is no record.
        rejection: Rejection,
    },
    /// Temperatures no record left with, at the end of the stream.
    Readings {
        /// The rod.
        rod: RodId,
        /// Ascending in time.
        readings: Vec<Reading>,
    },
}

/// Most samples in one record, whatever its length; bounds memory.
pub const MAX_SAMPLES: usize = 1 << 22;

/// Messages that tell the sample interval.
const WARM: usize = 16;
/// Messages that do not fit before they start a new stretch.
const ASTRAY: usize = 3;
/// How far back a late message may belong, in messages.
const LATE: usize = 64;
/// Messages a window waits for late ones, and how long at most \[s\], but for one message at least.
const LAG: usize = 32;
const LAG_S: f64 = 0.2;
/// Records that wait for the temperature beside them.
const WAITING: usize = 4;
/// Samples too few to say why they are no record.
const FEW: usize = 64;
/// Jitter worth a flag.
const NOTABLE_JITTER: f64 = 0.05;
/// A message stamped further ahead than this many messages may have overtaken others; one less far is stamped late.
const AHEAD: f64 = 1.75;
/// Scatter of the stamps from which on messages stay in the order they came in, over the message interval.
const WOBBLY: f64 = 0.04;

type Message = (i64, Vec<f64>);

/// Cuts one rod's samples into records.
///
/// What it holds between two messages survives a restart ([`Assembler::save`]).
#[derive(Debug, Serialize, Deserialize)]
pub struct Assembler {
    rod: RodId,
    /// Not saved: whoever resumes gives them again.
    #[serde(skip)]
    settings: RecordSettings,
    declared_hz: Option<f64>,
    temperature: Option<Temperature>,
    /// The first messages of a stretch, while the sample interval is not known.
    warm: Vec<Message>,
    /// The running stretch and its sample interval \[ns\].
    open: Stretch,
    interval: Option<f64>,
    /// Scatter of a stamp, from the latest messages of the stretch \[ns\].
    wobble: f64,
    astray: Vec<Message>,
    /// The last message of the stretch, where it has overtaken others or was stamped late.
    ahead: Option<Ahead>,
    dropped: usize,
    /// Messages of the stretch whose stamps were set right already.
    stray: Stray,
    /// Onsets before this time were seen already \[ns\].
    seen_until: i64,
    onsets: usize,
    searched_s: f64,
    searched_from: Option<Timestamp>,
    /// Whether samples come from data that could not be checked, and the latest stamp of one that did \[ns\].
    unverified: bool,
    unverified_until: i64,
    #[serde(with = "super::saved::records")]
    waiting: VecDeque<Record>,
    /// When each of those that wait was complete.
    waiting_at: VecDeque<i64>,
    /// The latest stamp of the stretch that was cut last: when what came of it was complete \[ns\].
    at: i64,
    /// Whether the stream ended and nothing has come since.
    is_over: bool,
    /// A run of stretches too short for a record, told as one.
    short: Option<Short>,
    samples: u64,
    /// Not saved: whoever saves has taken them before.
    #[serde(skip)]
    events: Vec<(Timestamp, Event)>,
}

/// What the stamps of a stretch said of its samples, and the cut of their motion.
#[derive(Clone, Copy)]
struct Clock {
    fs_hz: f64,
    /// Relative standard error of the rate.
    sd: f64,
    jitter: f64,
    stray: Stray,
    excitation: Option<Excitation>,
}

/// A message that others were put before, because of their stamps.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Ahead {
    /// Its stamp \[ns\].
    time: i64,
    /// The stamp of the message it came behind \[ns\].
    behind: i64,
}

#[derive(Debug, Serialize, Deserialize)]
struct Short {
    start: Timestamp,
    longest_s: f64,
    total_s: f64,
}

/// How one message relates to the running stretch.
enum Place {
    Next,
    Late(usize),
    /// Next, and the message before it was stamped late.
    Corrects,
    Duplicate,
    Astray,
}

impl Assembler {
    /// An assembler for one rod. `declared_hz` is the sample rate the configuration names, if any;
    /// `temperature` says whether readings will come.
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

    /// What it holds, NaN samples bit for bit, for [`Assembler::resume`]. Take the [events](Self::events) before.
    ///
    /// # Errors
    /// It cannot be encoded, which no input brings about.
    pub fn save(&self) -> Result<Vec<u8>, postcard::Error> {
        postcard::to_stdvec(self)
    }

    /// Goes on from what was [saved](Self::save), with the settings it was saved with.
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

    /// Begins anew after [`Assembler::finish`], as for another file. With `keep_temperature` the readings go on: they come
    /// from elsewhere.
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

    /// Says whether samples come from data that could not be checked from now on.
    #[inline]
    pub fn set_unverified(&mut self, unverified: bool) {
        self.unverified = unverified;
    }

    /// Takes one message: the time of its first sample and its samples in SI; one that is not finite
    /// is missing.
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

    /// Takes a temperature \[degC\].
    pub fn push_temperature(&mut self, time: Timestamp, celsius: f64) {
        if let Some(temperature) = &mut self.temperature {
            temperature.push(time, celsius);
        }
        self.release(false);
    }

    /// Temperature readings up to `until` that no record left with: between the last record and the end of the
    /// stream, or beside rejected stretches. None is handed out twice.
    pub fn leftover(&mut self, until: Timestamp) -> Vec<Reading> {
        self.temperature
            .as_mut()
            .map_or_else(Vec::new, |readings| readings.take(until))
    }

    /// What became of the samples so far.
    pub fn events(&mut self) -> impl Iterator<Item = Event> {
        self.timed_events().map(|(_, event)| event)
    }

    /// The same, each with the time at which it was complete: the latest stamp of the stretch it was cut from.
    pub fn timed_events(&mut self) -> std::vec::Drain<'_, (Timestamp, Event)> {
        self.events.drain(..)
    }

    /// Makes an event of the readings that no record left with, at the end of the stream.
    pub fn tell_leftover(&mut self) {
        let readings = self.leftover(Timestamp::MAX);
        if let Some(last) = readings.last() {
            let at = last.time.max(Timestamp::from_nanos(self.at));
            let rod = self.rod.clone();
            self.events.push((at, Event::Readings { rod, readings }));
        }
    }

    /// A rejection that stands for no samples.
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

    /// Forgets the samples that are no record yet: `rejection` stands for them. Readings go on.
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

    /// Whether there are events to be taken.
    #[inline]
    pub fn has_events(&self) -> bool {
        !self.events.is_empty()
    }

    /// A time before which no event will be complete that is still to come; `None` before the first sample and after the
    /// end of the stream. It goes back only with the clock of the samples.
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

    /// Ends the stream. With `cut_short`, the last record is one that may have gone on.
    pub fn finish(&mut self, cut_short: bool) {
        self.settle(cut_short);
        let astray = std::mem::take(&mut self.astray);
        if !astray.is_empty() {
            self.warm = astray;
            self.settle(cut_short);
        }
        if self.onsets == 0
            && let Some(start) = self.searched_from
        {
            let duration_s = self.searched_s;
            self.reject(Some(start), duration_s, Rejection::NoOnset { duration_s });
        }
        self.tell_short();
        self.release(true);
        self.is_over = true;
    }

    /// Closes what is open.
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

    /// Cuts the windows that were still waiting for late messages.
    fn cut_rest(&mut self) {
        let Cut::Window { length_s } = self.settings.cut else {
            return;
        };
        let length_s = length_s.min(self.settings.max_duration_s);
        while let (Some(&start), Some(&last), Some(&size), Some(interval)) = (
            self.open.times.first(),
            self.open.times.last(),
            self.open.sizes.last(),
            self.interval,
        ) {
            let span = (last.saturating_sub(start) as f64 + interval * f64::from(size)) * 1e-9;
            if span < length_s + 0.5e-9 * interval {
                return;
            }
            let before = self.open.values.len();
            self.cut_at(start, length_s, interval);
            if self.open.values.len() == before {
                return;
            }
        }
    }

    fn take(&mut self, (time, values): Message, queue: &mut VecDeque<Message>) {
        if self.interval.is_none() {
            self.warm.push((time, values));
            if self.warm.len() >= WARM {
                self.warmed(queue);
            }
            return;
        }
        self.untangle(time, values.len());
        self.adopt(time, values.len());
        match self.place(time, &values) {
            Some(Place::Next) => self.append(time, &values),
            Some(Place::Late(back)) => self.put_before(back, time, &values),
            Some(Place::Corrects) => {
                self.set_last_right();
                self.append(time, &values);
            }
            Some(Place::Duplicate) => {
                self.dropped += values.len();
                return;
            }
            Some(Place::Astray) | None => {
                self.astray.push((time, values));
                if self.astray.len() > ASTRAY {
                    self.cut_rest();
                    let open = std::mem::take(&mut self.open);
                    self.close(open, false, None);
                    self.seen_until = i64::MIN;
                    self.interval = None;
                    self.warm = std::mem::take(&mut self.astray);
                }
                return;
            }
        }
        // It fits: what was put aside may fit now, or was a slip of the clock.
        for (time, values) in std::mem::take(&mut self.astray) {
            match self.place(time, &values) {
                Some(Place::Next) => self.append(time, &values),
                Some(Place::Late(back)) => self.put_before(back, time, &values),
                _ => self.dropped += values.len(),
            }
        }
    }

    /// Puts a late message in its place, and notes if the one it comes before may be stamped late.
    fn put_before(&mut self, back: usize, time: i64, values: &[f64]) {
        if let [.., before, last] = self.open.times[..]
            && back == 1
            && self.ahead.is_none()
            && let Some(end) = self.end_of(self.open.times.len() - 2)
        {
            // Otherwise it fills the hole, and the last one was ahead by one.
            if time as f64 - end > 0.5 * self.unit(values.len()) {
                self.ahead = Some(Ahead {
                    time: last,
                    behind: before,
                });
            }
        }
        self.open.insert(back, time, values);
    }

    /// A message that came where the last one of the stretch stands by its stamp, and the hole that one left is still there:
    /// the last one was stamped late and goes back to where it came.
    fn untangle(&mut self, time: i64, samples: usize) {
        let (Some(ahead), Some(interval)) = (self.ahead, self.interval) else {
            return;
        };
        // A cut may have taken it away.
        let last = self.open.times.len().saturating_sub(1);
        let (true, Some(due)) = (
            self.open.times.last() == Some(&ahead.time),
            last.checked_sub(1).and_then(|at| self.end_of(at)),
        ) else {
            self.ahead = None;
            return;
        };
        let unit = self.unit(samples);
        let fits_before = time as f64 + unit <= ahead.time as f64 + 0.25 * unit;
        if fits_before {
            return;
        }
        self.ahead = None;
        let is_in_its_way = (time as f64 - due).abs() < 0.5 * unit;
        let known = &self.open.times[..last];
        let origin = known
            .iter()
            .rposition(|&time| time <= ahead.behind)
            .filter(|&at| known[at] == ahead.behind);
        let (true, Some(origin)) = (is_in_its_way, origin) else {
            return;
        };
        let (size, end) = (self.open.sizes[last], self.end_of(origin));
        let length = interval * f64::from(size);
        if let (Some(end), Some(&next)) = (end, known.get(origin + 1))
            && next as f64 - end > 0.5 * length
        {
            let values = self.open.pop();
            self.stray.count(ahead.time as f64 - end);
            self.open.insert(last - origin - 1, end.round() as i64, &values);
        }
    }

    /// Messages put aside, if this one comes where it would if they were in their place: they had wrong stamps.
    fn adopt(&mut self, time: i64, samples: usize) {
        let (false, Some(interval)) = (self.astray.is_empty(), self.interval) else {
            return;
        };
        let Some(end) = self
            .open
            .times
            .len()
            .checked_sub(1)
            .and_then(|last| self.end_of(last))
        else {
            return;
        };
        let aside: usize = self.astray.iter().map(|(_, values)| values.len()).sum();
        let due = end + interval * aside as f64;
        if (time as f64 - due).abs() > 0.25 * self.unit(samples) + 3.0 * self.wobble {
            return;
        }
        let mut right = end;
        for (stamp, values) in std::mem::take(&mut self.astray) {
            self.stray.count(stamp as f64 - right);
            self.append(right.round() as i64, &values);
            right += self.unit(values.len());
        }
    }

    /// Puts the last message's stamp where the one before it ends.
    fn set_last_right(&mut self) {
        let last = self.open.times.len().checked_sub(1);
        if let Some(last) = last
            && let Some(end) = last.checked_sub(1).and_then(|at| self.end_of(at))
        {
            self.stray.count(self.open.times[last] as f64 - end);
            self.open.times[last] = end.round() as i64;
        }
    }

    /// Where message `at` of the stretch ends \[ns\].
    fn end_of(&self, at: usize) -> Option<f64> {
        let (&time, &size) = (self.open.times.get(at)?, self.open.sizes.get(at)?);
        Some(time as f64 + self.unit(size as usize))
    }

    /// Length of so many samples \[ns\].
    fn unit(&self, samples: usize) -> f64 {
        self.interval.unwrap_or(0.0) * samples as f64
    }

    /// Enough messages to know the sample interval: hands them over as a new stretch.
    fn warmed(&mut self, queue: &mut VecDeque<Message>) {
        let warm = std::mem::take(&mut self.warm);
        let mut order: Vec<(i64, u32)> = warm
            .iter()
            .map(|(time, values)| (*time, values.len() as u32))
            .collect();
        order.sort_unstable();
        let (times, sizes): (Vec<i64>, Vec<u32>) = order.into_iter().unzip();
        let declared = self.declared_hz.map(|fs_hz| 1e9 / fs_hz);
        // Stamps that do not advance leave one nanosecond; the stretch is refused when it is closed.
        let interval = timing::interval(&times, &sizes).or(declared).unwrap_or(1.0);
        self.interval = Some(interval);
        let mut off: Vec<f64> = warm
            .windows(2)
            .map(|pair| {
                let length = interval * pair[0].1.len() as f64;
                (pair[1].0.saturating_sub(pair[0].0) as f64 - length).abs()
            })
            .collect();
        self.wobble = if off.len() < WARM / 2 {
            0.0
        } else {
            clock::GAUSSIAN * clock::median(&mut off) / std::f64::consts::SQRT_2
        };
        for message in warm.into_iter().rev() {
            queue.push_front(message);
        }
    }

    #[inline]
    fn place(&self, time: i64, values: &[f64]) -> Option<Place> {
        let interval = self.interval?;
        let (Some(&last), Some(&size)) = (self.open.times.last(), self.open.sizes.last()) else {
            return Some(Place::Next);
        };
        let length = interval * f64::from(size);
        let unit = interval * values.len() as f64;
        // Nanoseconds between the end of the last message and this one.
        let hole = time.saturating_sub(last) as f64 - length;
        // Batches may not overlap by much; single samples only have to advance.
        if time > last && (size == 1 || hole > -0.5 * length.max(unit) - 1.0) {
            let limit = (self.settings.max_gap_s * 1e9).max(0.5 * unit);
            return Some(if hole > limit { Place::Astray } else { Place::Next });
        }
        Some(self.place_late(time, values, interval))
    }

    /// A message from the past: late if there is a hole for it, known if it is there already, next if the stamps jump about or the
    /// last one was late.
    fn place_late(&self, time: i64, values: &[f64], interval: f64) -> Place {
        let open = &self.open;
        let count = open.times.len();
        let oldest = count.saturating_sub(LATE);
        let same = open.times[oldest..].iter().rposition(|&known| known == time);
        let at = oldest + same.unwrap_or_else(|| open.times[oldest..].partition_point(|&known| known < time));
        if same.is_some() {
            let younger: usize = open.sizes[at..].iter().map(|&size| size as usize).sum();
            let first = open.values.len() - younger;
            let known = open.values.get(first..first + open.sizes[at] as usize);
            let same = known.is_some_and(|known| {
                known.len() == values.len()
                    && known.iter().zip(values).all(|(a, b)| a.to_bits() == b.to_bits())
            });
            // What waited for the line is stamped at once.
            let waited = at + 1 == count && open.sizes[at] == 1 && values.len() == 1;
            return match (same, waited) {
                (true, _) => Place::Duplicate,
                (false, true) => Place::Next,
                (false, false) => Place::Astray,
            };
        }
        let unit = interval * values.len() as f64;
        let last = (count - 1, open.times[count - 1] as f64);
        let last_length = interval * f64::from(open.sizes[last.0]);
        // By as much as two stamps may differ.
        let early = last.1 + last_length - time as f64;
        if self.wobble > WOBBLY * last_length && early < 1.25 * last_length + 8.0 * self.wobble {
            return Place::Next;
        }
        if let Some(end) = last.0.checked_sub(1).and_then(|before| self.end_of(before)) {
            let due = end + last_length;
            let is_due = (time as f64 - due).abs() < 0.25 * unit + 3.0 * self.wobble;
            if is_due && last.1 > end && last.1 - end < AHEAD * last_length {
                return Place::Corrects;
            }
        }
        if at == oldest || at == count {
            return Place::Astray;
        }
        let end_before = open.times[at - 1] as f64 + interval * f64::from(open.sizes[at - 1]);
        let fits = time as f64 >= end_before - 0.25 * unit
            && time as f64 + unit <= open.times[at] as f64 + 0.25 * unit;
        if fits {
            Place::Late(count - at)
        } else {
            Place::Astray
        }
    }

    /// Adds the next message and cuts if it is time.
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
        let longest = self.settings.max_duration_s;
        let full = self.open.values.len() >= MAX_SAMPLES;
        match self.settings.cut {
            Cut::Auto | Cut::File if span >= longest || full => {
                self.cut_at(start, longest.min(span), interval)
            }
            Cut::Window { length_s } => {
                let length_s = length_s.min(longest);
                if span >= length_s + lag {
                    self.cut_at(start, length_s, interval);
                } else if full {
                    self.cut_at(start, span, interval);
                }
            }
            Cut::FreeDecay { length_s, .. } if span >= (4.0 * length_s).max(60.0) || full => {
                // Onsets near the end wait until their whole record is there, and the quiet before them.
                let until = time.saturating_sub(nanos((length_s + 1.0).min(0.5 * span)));
                let searched = self.open.clone();
                self.close(searched, false, Some(until));
                let quiet = nanos(onset::context(1e9 / interval) as f64 * interval * 1e-9);
                self.open.split_front(until.saturating_sub(quiet), interval);
                self.seen_until = until;
            }
            Cut::Auto | Cut::File | Cut::FreeDecay { .. } => {}
        }
    }

    fn cut_at(&mut self, start: i64, seconds: f64, interval: f64) {
        let boundary = start.saturating_add(nanos(seconds - 0.5e-9 * interval));
        let front = self.open.split_front(boundary, interval);
        self.close(front, false, None);
    }

    /// Turns a stretch into events. `until` bounds the onsets that count \[ns\].
    fn close(&mut self, stretch: Stretch, cut_short: bool, until: Option<i64>) {
        let (Some(&first), Some(&last)) = (stretch.times.first(), stretch.times.last()) else {
            return;
        };
        // What is left of the stretch was there when this was cut.
        self.at = self.open.times.last().map_or(last, |&newest| newest.max(last));
        let start = Timestamp::from_nanos(first);
        let span_s = Timestamp::from_nanos(last).seconds_since(start);
        let count = stretch.values.len();
        let even = match timing::even(stretch, self.declared_hz, &self.settings) {
            Ok(even) => even,
            // Whatever else is wrong with it, it is too short.
            Err(_) if span_s < self.settings.min_duration_s => return self.too_short(start, span_s),
            // A few samples strewn over a long time are no long record.
            Err(_) if count < FEW => {
                let duration_s = self.declared_hz.map_or(0.0, |fs_hz| count as f64 / fs_hz);
                return self.too_short(start, duration_s.min(span_s));
            }
            Err(rejection) => return self.reject(Some(start), span_s, rejection),
        };
        match self.settings.cut {
            Cut::FreeDecay { ratio, length_s } => self.decays(&even, ratio, length_s, cut_short, until),
            Cut::Auto => self.pieces(even, None, cut_short),
            Cut::File | Cut::Window { .. } => self.pieces(even, Some(Excitation::Ambient), cut_short),
        }
        self.dropped = 0;
        self.stray = Stray::default();
    }

    /// One piece an onset.
    fn decays(&mut self, even: &Even, ratio: f64, length_s: f64, cut_short: bool, until: Option<i64>) {
        let total = even.samples.len();
        let mut filled = even.samples.clone();
        quality::fill(&mut filled);
        let mut onsets: Vec<(usize, bool)> = onset::onsets(&filled, even.fs_hz, ratio)
            .into_iter()
            .map(|onset| (onset, true))
            .collect();
        // A decay that was under way when the stretch began; where the search goes on, the stretch began earlier.
        if self.seen_until == i64::MIN {
            let end = onsets.first().map_or(total, |&(onset, _)| onset);
            let end = end.min((length_s * even.fs_hz).round() as usize);
            let is_record = end as f64 >= self.settings.min_duration_s * even.fs_hz;
            match onset::under_way(&filled[..end], even.fs_hz, ratio) {
                UnderWay::Decays if is_record => onsets.insert(0, (0, true)),
                // Before a pull it is what moves the rod anyway.
                UnderWay::Perhaps if is_record && onsets.is_empty() => onsets.insert(0, (0, false)),
                _ => {}
            }
        }
        onsets.push((total, false));
        self.searched_s += total as f64 / even.fs_hz;
        self.searched_from.get_or_insert(even.start);
        for pair in onsets.windows(2) {
            let [(onset, is_sure), (next, _)] = *pair else {
                continue;
            };
            let start = even.start.plus_seconds(onset as f64 / even.fs_hz);
            let waits = until.is_some_and(|until| start.as_nanos() >= until);
            if start.as_nanos() < self.seen_until || waits {
                continue;
            }
            self.onsets += 1;
            let end = next.min(onset + (length_s * even.fs_hz).round() as usize);
            let decay = Even {
                start,
                samples: even.samples[onset..end].to_vec(),
                ..*even
            };
            let excitation = is_sure.then_some(Excitation::FreeDecay);
            self.pieces(decay, excitation, cut_short && end == total);
        }
    }

    /// Splits at long holes and checks what is left.
    fn pieces(&mut self, even: Even, excitation: Option<Excitation>, cut_short: bool) {
        let Even {
            start,
            fs_hz,
            samples,
            clock_sd,
            jitter,
            stray,
        } = even;
        let clock = Clock {
            fs_hz,
            sd: clock_sd,
            jitter,
            stray: stray.and(self.stray),
            excitation,
        };
        let total = samples.len();
        let hole = (self.settings.max_gap_s * fs_hz).floor().max(0.0) as usize;
        let least = self.settings.min_duration_s * fs_hz;
        let mut spans = quality::spans(&samples, hole);
        let long = |span: &std::ops::Range<usize>| span.len() as f64 >= least;
        if !spans.iter().any(long) {
            let missing = samples.iter().filter(|x| !x.is_finite()).count();
            let share = missing as f64 / total.max(1) as f64;
            let allowed = self.settings.max_missing;
            if share > allowed {
                let rejection = Rejection::Missing { share, allowed };
                return self.reject(Some(start), total as f64 / fs_hz, rejection);
            }
        }
        if let [span] = &spans[..]
            && span.len() == total
        {
            // The common case: nothing to cut off, nothing to copy.
            return self.piece(start, clock, samples, cut_short);
        }
        for span in spans.drain(..) {
            let start = start.plus_seconds(span.start as f64 / fs_hz);
            let last = span.end == total;
            self.piece(start, clock, samples[span].to_vec(), cut_short && last);
        }
    }

    fn piece(&mut self, start: Timestamp, clock: Clock, samples: Vec<f64>, cut_short: bool) {
        let fs_hz = clock.fs_hz;
        let duration_s = samples.len() as f64 / fs_hz;
        // A hair less than asked for is a matter of rounding.
        if duration_s < self.settings.min_duration_s * (1.0 - 1e-9) {
            return self.too_short(start, duration_s);
        }
        // The checks repair what they can: what they refuse is shown as it came.
        let waveform = Envelope::of(&samples, fs_hz);
        let checked = match quality::check(samples, fs_hz, &self.settings) {
            Ok(checked) => checked,
            Err(rejection) => {
                self.tell_short();
                return self.tell(Event::Rejected {
                    rod: self.rod.clone(),
                    start: Some(start),
                    duration_s,
                    fs_hz: Some(fs_hz),
                    waveform: Some(waveform),
                    rejection,
                });
            }
        };
        let mut flags = checked.flags;
        if self.dropped > 0 {
            flags.push(Flag::Dropped {
                samples: self.dropped,
            });
        }
        if clock.jitter > NOTABLE_JITTER {
            flags.push(Flag::Jitter { jitter: clock.jitter });
        }
        if clock.stray.messages > 0 {
            flags.push(Flag::LateStamps {
                messages: clock.stray.messages,
                worst_s: clock.stray.worst_s,
            });
        }
        if start.as_nanos() <= self.unverified_until {
            flags.push(Flag::Unverified);
        }
        if cut_short {
            flags.push(Flag::Truncated);
        }
        self.tell_short();
        self.waiting.push_back(Record {
            rod: self.rod.clone(),
            start,
            fs_hz,
            samples: checked.samples,
            temperature_c: None,
            readings: Vec::new(),
            excitation: clock.excitation,
            clock_sd: clock.sd,
            flags,
        });
        self.waiting_at.push_back(self.at);
        self.release(false);
    }

    /// Lets records go whose temperature is known, or that waited long enough.
    fn release(&mut self, all: bool) {
        while let Some(record) = self.waiting.front() {
            let end = record.start.plus_seconds(record.duration_s());
            let known = self
                .temperature
                .as_ref()
                .is_none_or(|readings| readings.reaches(end));
            let held: usize = self.waiting.iter().map(|record| record.samples.len()).sum();
            if !(all || known || self.waiting.len() > WAITING || held > MAX_SAMPLES / 4) {
                return;
            }
            let Some(mut record) = self.waiting.pop_front() else {
                return;
            };
            record.temperature_c = self
                .temperature
                .as_ref()
                .and_then(|readings| readings.mean(record.start, end));
            if let Some(readings) = &mut self.temperature {
                record.readings = readings.take(end);
            }
            let at = self.waiting_at.pop_front().unwrap_or(self.at);
            self.events
                .push((Timestamp::from_nanos(at), Event::Record(record)));
        }
    }

    /// Notes what came of the stretch that was cut last.
    fn tell(&mut self, event: Event) {
        self.events.push((Timestamp::from_nanos(self.at), event));
    }

    fn reject(&mut self, start: Option<Timestamp>, duration_s: f64, rejection: Rejection) {
        self.tell_short();
        self.tell(Event::Rejected {
            rod: self.rod.clone(),
            start,
            duration_s,
            fs_hz: None,
            waveform: None,
            rejection,
        });
    }

    /// Notes a stretch too short for a record; a run of them is told as one.
    fn too_short(&mut self, start: Timestamp, duration_s: f64) {
        let short = self.short.get_or_insert(Short {
            start,
            longest_s: 0.0,
            total_s: 0.0,
        });
        short.longest_s = short.longest_s.max(duration_s);
        short.total_s += duration_s;
    }

    fn tell_short(&mut self) {
        if let Some(short) = self.short.take() {
            self.tell(Event::Rejected {
                rod: self.rod.clone(),
                start: Some(short.start),
                duration_s: short.total_s,
                fs_hz: None,
                waveform: None,
                rejection: timing::too_short(short.longest_s, &self.settings),
            });
        }
    }
}

fn nanos(seconds: f64) -> i64 {
    (seconds * 1e9).round() as i64
}
