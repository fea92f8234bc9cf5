//! Records of a rod's sensors by moments: a fold over the sensors' own times.
//!
//! The event that begins first makes the moment, with what each other sensor has in common with half of the shorter, the longest part of several.
//! It closes when every other sensor has a record that none still to come can surpass, or no sample left that could become one, or has
//! ended, or is further behind than the rod waits. So the moments follow from the sensors' histories, not from the progress of reading;
//! what lags beyond the wait is late, and said to be. A motion makes one moment: a further record of its time is late as well.

use super::{Event, Reading, Record, Rejection, RodId, Timestamp};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Least common part of two records of one moment, as a share of the shorter.
const COMMON: f64 = 0.5;
/// Most records in moments that are remembered, to know late ones by.
const REMEMBERED: usize = 4096;
/// Most events of a sensor that wait: beyond, a moment closes as it is. Only a clock that stands still brings so many about.
const WAITING: usize = 1024;

/// True if two records are of one motion, each given by its start and length \[s\].
pub fn is_one_motion(a: (Timestamp, f64), b: (Timestamp, f64)) -> bool {
    let span = |(start, duration_s): (Timestamp, f64)| Span {
        start,
        end: start.plus_seconds(duration_s),
    };
    span(a).common_s(span(b)).is_some()
}

/// One moment of a rod with several sensors.
#[derive(Debug, Clone, PartialEq)]
pub struct Moment {
    /// Id of the rod.
    pub rod: RodId,
    /// Records and refused stretches, at most one of a sensor, ascending in its number from 0. All records have the
    /// temperature of the first.
    pub seen: Vec<(usize, Event)>,
    /// Sensors that gave nothing.
    pub absent: Vec<usize>,
    /// True if it closed before they were waited for: what waits took too much memory.
    pub is_early: bool,
}

impl Moment {
    /// The records, each with the number of its sensor.
    pub fn records(&self) -> impl Iterator<Item = (usize, &Record)> {
        self.seen.iter().filter_map(|(sensor, event)| match event {
            Event::Record(record) => Some((*sensor, record)),
            _ => None,
        })
    }
}

/// Records of a rod's sensors on their way into moments.
#[derive(Debug, Serialize, Deserialize)]
pub struct Moments {
    rod: RodId,
    /// Furthest that a sensor may be behind another and is still waited for \[s\].
    #[serde(skip)]
    wait_s: f64,
    sensors: Vec<Sensor>,
    /// Spans of the latest records in moments.
    closed: VecDeque<Span>,
    /// Sensor whose record gave the latest moment's temperature.
    thermometer: usize,
    /// Time of the latest reading that was handed out: every lane has the rod's readings.
    read_until: Option<Timestamp>,
}

#[derive(Debug, Default, Serialize, Deserialize)]
struct Sensor {
    pieces: Vec<Piece>,
    /// No event still to come begins earlier, and none is complete earlier than `until`; both from the rod's first sample on.
    from: Option<Timestamp>,
    until: Option<Timestamp>,
    /// True if its stream ended, and nothing has come since.
    has_ended: bool,
}

/// An event with its span and the time at which it was complete.
#[derive(Debug, Serialize, Deserialize)]
struct Piece {
    span: Span,
    at: Timestamp,
    #[serde(with = "super::saved::event")]
    event: Event,
}

#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Span {
    start: Timestamp,
    end: Timestamp,
}

impl Span {
    /// Span of a record or a refused stretch; `None` for one of no length.
    fn of(event: &Event) -> Option<Self> {
        let (start, duration_s) = match event {
            Event::Record(record) => (record.start, record.duration_s()),
            Event::Rejected {
                start, duration_s, ..
            } => ((*start)?, *duration_s),
            Event::Readings { .. } | Event::Moment(_) => return None,
        };
        let end = start.plus_seconds(duration_s);
        (end > start).then_some(Self { start, end })
    }

    /// Length in common \[s\], if it is half of the shorter.
    fn common_s(self, other: Self) -> Option<f64> {
        let common_s = self.end.min(other.end).seconds_since(self.start.max(other.start));
        let shorter_s = self.length_s().min(other.length_s());
        (common_s >= COMMON * shorter_s).then_some(common_s)
    }

    fn length_s(self) -> f64 {
        self.end.seconds_since(self.start)
    }
}

impl Piece {
    fn is_record(&self) -> bool {
        matches!(self.event, Event::Record(_))
    }
}

impl Moments {
    /// No records yet of `sensors` sensors; one that is more than `wait_s` behind another is not waited for \[s\].
    pub fn new(rod: RodId, sensors: usize, wait_s: f64) -> Self {
        Self {
            rod,
            wait_s,
            sensors: (0..sensors).map(|_| Sensor::default()).collect(),
            closed: VecDeque::new(),
            thermometer: 0,
            read_until: None,
        }
    }

    /// Its state, for [`Moments::resume`].
    ///
    /// # Errors
    /// It cannot be encoded, which no input brings about.
    pub fn save(&self) -> Result<Vec<u8>, postcard::Error> {
        postcard::to_stdvec(self)
    }

    /// Continues from a saved state with the same number of sensors.
    ///
    /// # Errors
    /// The bytes are no such state: nothing is changed.
    pub fn resume(&mut self, saved: &[u8]) -> Result<(), postcard::Error> {
        let state: Self = postcard::from_bytes(saved)?;
        if state.sensors.len() != self.sensors.len() {
            return Err(postcard::Error::DeserializeBadEncoding);
        }
        *self = Self {
            wait_s: self.wait_s,
            ..state
        };
        Ok(())
    }

    /// Notes the progress of a sensor: no event still to come begins before `from`, or is complete before `until`.
    pub fn note(&mut self, sensor: usize, from: Timestamp, until: Timestamp) {
        self.begin(from);
        if let Some(sensor) = self.sensors.get_mut(sensor) {
            (sensor.from, sensor.until) = (Some(from), Some(until));
            sensor.has_ended = false;
        }
    }

    /// Notes that a sensor's stream ended: it is not waited for.
    pub fn end(&mut self, sensor: usize) {
        if let Some(sensor) = self.sensors.get_mut(sensor) {
            sensor.has_ended = true;
        }
    }

    /// True if progress matters: something waits, or nothing was noted yet.
    pub fn is_waiting(&self) -> bool {
        let mut sensors = self.sensors.iter();
        sensors.any(|sensor| !sensor.pieces.is_empty() || sensor.until.is_none())
    }

    /// Notes the readings that a sensor brings between records; true if they go on where the latest moment's end.
    pub fn takes_readings(&mut self, sensor: usize, readings: &[Reading]) -> bool {
        let is_its = self.thermometer == sensor;
        if is_its {
            self.read_until = readings.last().map(|last| last.time).or(self.read_until);
        }
        is_its
    }

    /// Takes an event of a sensor, complete at a time; returns it as a moment of its own if it cannot wait for others.
    pub fn push(&mut self, sensor: usize, at: Timestamp, event: Event) -> Option<(Timestamp, Moment)> {
        let Some(span) = Span::of(&event) else {
            return Some((at, self.alone(sensor, event)));
        };
        if self.has_closed(span) {
            return Some((at, self.late(sensor, event)));
        }
        self.begin(span.start);
        let own = self.sensors.get_mut(sensor)?;
        own.until = own.until.max(Some(at));
        own.pieces.push(Piece { span, at, event });
        None
    }

    /// The next moment, complete at a time, if it is closed; with `all`, because nothing more comes.
    pub fn next(&mut self, all: bool) -> Option<(Timestamp, Moment)> {
        self.closed_or(all, false)
    }

    /// The next moment, whatever may still come of it: room is needed.
    pub fn release(&mut self) -> Option<(Timestamp, Moment)> {
        self.closed_or(false, true)
    }

    fn closed_or(&mut self, all: bool, is_forced: bool) -> Option<(Timestamp, Moment)> {
        let pieces = self.sensors.iter().enumerate().flat_map(|(sensor, own)| {
            let numbered = own.pieces.iter().enumerate();
            numbered.map(move |(i, piece)| (piece.span.start, sensor, i))
        });
        // A refused stretch beside a record of another sensor waits for that one's moment.
        let (_, sensor, i) = pieces
            .filter(|&(_, sensor, i)| {
                let piece = &self.sensors[sensor].pieces[i];
                piece.is_record() || !self.has_record_beside(sensor, piece.span)
            })
            .min()?;
        if self.has_closed(self.sensors[sensor].pieces[i].span) {
            let late = self.sensors[sensor].pieces.remove(i);
            return Some((late.at, self.late(sensor, late.event)));
        }
        let is_closed = all || self.is_closed(sensor, self.sensors[sensor].pieces[i].span);
        let is_full = || self.sensors.iter().any(|own| own.pieces.len() > WAITING);
        if !(is_closed || is_forced || is_full()) {
            return None;
        }
        let (at, moment) = self.take(sensor, i);
        let is_early = !is_closed && !moment.absent.is_empty();
        Some((at, Moment { is_early, ..moment }))
    }

    /// Events that wait.
    pub fn waiting(&self) -> impl Iterator<Item = &Event> {
        self.sensors
            .iter()
            .flat_map(|sensor| sensor.pieces.iter().map(|piece| &piece.event))
    }

    /// Earliest completion time of the moments still to come, but for those of sensors that are not waited for; `None` if no sensor
    /// is `alive`.
    pub fn complete_until(&self, is_alive: impl Fn(usize) -> bool) -> Option<Timestamp> {
        let waiting = self
            .sensors
            .iter()
            .flat_map(|sensor| sensor.pieces.iter().map(|piece| piece.at));
        let alive = self.sensors.iter().enumerate();
        let alive = alive.filter(|(number, sensor)| is_alive(*number) && !self.is_behind(sensor));
        waiting.chain(alive.filter_map(|(_, sensor)| sensor.until)).min()
    }

    /// A sensor that is not heard yet is behind from the rod's first sample on.
    fn begin(&mut self, first: Timestamp) {
        if self.sensors.iter().all(|sensor| sensor.until.is_none()) {
            for sensor in &mut self.sensors {
                (sensor.from, sensor.until) = (Some(first), Some(first));
            }
        }
    }

    fn has_record_beside(&self, sensor: usize, span: Span) -> bool {
        let others = self.sensors.iter().enumerate();
        let mut others = others
            .filter(|(other, _)| *other != sensor)
            .flat_map(|(_, other)| &other.pieces);
        others.any(|piece| piece.is_record() && piece.span.common_s(span).is_some())
    }

    /// True if most of a span, or of a record in a moment, is common to both.
    fn has_closed(&self, span: Span) -> bool {
        let is_of = |closed: &Span| {
            let shorter_s = closed.length_s().min(span.length_s());
            (closed.common_s(span)).is_some_and(|common_s| common_s > COMMON * shorter_s)
        };
        self.closed.iter().any(is_of)
    }

    fn is_behind(&self, sensor: &Sensor) -> bool {
        let newest = self.sensors.iter().filter_map(|sensor| sensor.until).max();
        newest
            .zip(sensor.until)
            .is_some_and(|(newest, until)| newest.seconds_since(until) > self.wait_s)
    }

    /// True if no other sensor can bring anything of a moment any more.
    fn is_closed(&self, sensor: usize, span: Span) -> bool {
        let others = self.sensors.iter().enumerate();
        others.filter(|(other, _)| *other != sensor).all(|(_, other)| {
            let records = other.pieces.iter().filter(|piece| piece.is_record());
            let best_s = records
                .filter_map(|piece| piece.span.common_s(span))
                .reduce(f64::max);
            // The most that a record still to come can have in common.
            let to_come_s = span
                .end
                .seconds_since(other.from.map_or(span.start, |from| from.max(span.start)));
            let has_its = best_s.is_some_and(|best_s| best_s >= to_come_s);
            let has_passed = other.from.is_some_and(|from| from >= span.end);
            has_its || has_passed || other.has_ended || self.is_behind(other)
        })
    }

    /// Takes the moment of a piece out.
    fn take(&mut self, sensor: usize, i: usize) -> (Timestamp, Moment) {
        let first = self.sensors[sensor].pieces.remove(i);
        let (span, has_record) = (first.span, first.is_record());
        let mut used = vec![span];
        let mut at = first.at;
        let mut seen = vec![(sensor, first.event)];
        for (other, own) in self.sensors.iter_mut().enumerate() {
            if other == sensor {
                continue;
            }
            // A record before a refused stretch, then what has most in common, then the earlier.
            let best = own
                .pieces
                .iter()
                .enumerate()
                .filter_map(|(i, piece)| {
                    let common_s = piece.span.common_s(span)?;
                    (has_record || !piece.is_record()).then_some((i, piece.is_record(), common_s))
                })
                .reduce(|best, next| match (next.1, next.2) > (best.1, best.2) {
                    true => next,
                    false => best,
                });
            if let Some((i, ..)) = best {
                let piece = own.pieces.remove(i);
                at = at.max(piece.at);
                used.extend(piece.is_record().then_some(piece.span));
                seen.push((other, piece.event));
            }
        }
        seen.sort_by_key(|(sensor, _)| *sensor);
        let is_absent = |sensor: &usize| seen.iter().all(|(seen, _)| seen != sensor);
        let absent = (0..self.sensors.len()).filter(is_absent).collect();
        if has_record {
            self.closed.extend(used);
            let surplus = self.closed.len().saturating_sub(REMEMBERED);
            self.closed.drain(..surplus);
        }
        let rod = self.rod.clone();
        let mut moment = Moment {
            rod,
            seen,
            absent,
            is_early: false,
        };
        self.share_temperature(&mut moment);
        (at, moment)
    }

    /// A later event of a motion that has its moment: refused if it is a record.
    fn late(&self, sensor: usize, event: Event) -> Moment {
        let event = match event {
            Event::Record(record) => Event::Rejected {
                start: Some(record.start),
                duration_s: record.duration_s(),
                fs_hz: Some(record.fs_hz),
                rod: record.rod,
                waveform: None,
                rejection: Rejection::LateSensor,
            },
            other => other,
        };
        self.alone(sensor, event)
    }

    fn alone(&self, sensor: usize, event: Event) -> Moment {
        Moment {
            rod: self.rod.clone(),
            seen: vec![(sensor, event)],
            absent: Vec::new(),
            is_early: false,
        }
    }

    /// Gives all records the temperature of the first, so that whichever leads has it.
    fn share_temperature(&mut self, moment: &mut Moment) {
        let mut records = moment.seen.iter_mut().filter_map(|(sensor, event)| match event {
            Event::Record(record) => Some((*sensor, record)),
            _ => None,
        });
        let Some((sensor, first)) = records.next() else {
            return;
        };
        // Of another lane, what the one before has handed out comes again; within a lane a clock may be set back.
        if self.thermometer != sensor {
            first
                .readings
                .retain(|reading| self.read_until.is_none_or(|until| reading.time > until));
        }
        self.thermometer = sensor;
        self.read_until = first.readings.last().map(|last| last.time).or(self.read_until);
        for (_, other) in records {
            other.temperature_c = first.temperature_c;
            other.readings.clone_from(&first.readings);
        }
    }
}

#[cfg(test)]
mod tests;
