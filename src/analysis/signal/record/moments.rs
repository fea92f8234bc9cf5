//! Records of a rod's sensors by moments: a fold over the sensors' own times.
//!
//! What begins first makes the moment, with what each other sensor has in common with half of the shorter, the longest part of several.
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

    /// What comes of a motion that has its moment: refused if it is a record.
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
mod tests {
    use super::*;
    use rand::rngs::ChaCha8Rng;
    use rand::{RngExt, SeedableRng};

    const WAIT_S: f64 = 3600.0;

    fn time(seconds: i64) -> Timestamp {
        Timestamp::from_nanos(seconds * 1_000_000_000)
    }

    /// A record of one sample a second, with a temperature that tells the sensor.
    fn record(sensor: usize, (from, to): (i64, i64)) -> Event {
        Event::Record(Record {
            rod: RodId::from("a"),
            start: time(from),
            fs_hz: 1.0,
            samples: vec![0.0; usize::try_from(to - from).unwrap()],
            temperature_c: Some(sensor as f64),
            readings: vec![Reading {
                time: time(from),
                celsius: sensor as f64,
            }],
            excitation: None,
            clock_sd: 0.0,
            flags: Vec::new(),
        })
    }

    fn refused((from, to): (i64, i64)) -> Event {
        Event::Rejected {
            rod: RodId::from("a"),
            start: Some(time(from)),
            duration_s: (to - from) as f64,
            fs_hz: None,
            waveform: None,
            rejection: Rejection::Clipped {
                share: 0.5,
                allowed: 0.1,
            },
        }
    }

    fn moments(sensors: usize) -> Moments {
        Moments::new(RodId::from("a"), sensors, WAIT_S)
    }

    /// A sensor's progress, as its assembler tells it: an event and, behind it, samples of the next from its end on.
    fn comes(moments: &mut Moments, sensor: usize, event: Event) -> Option<String> {
        let end = Span::of(&event).map_or(time(0), |span| span.end);
        let alone = moments.push(sensor, end, event);
        moments.note(sensor, end, end.plus_seconds(1.0));
        alone.map(|(_, moment)| shown(&moment))
    }

    fn shown(moment: &Moment) -> String {
        let seen = moment.seen.iter().map(|(sensor, event)| {
            let span = Span::of(event).map_or(0, |span| span.start.as_nanos() / 1_000_000_000);
            match event {
                Event::Record(_) => format!("{sensor}@{span}"),
                Event::Rejected { rejection, .. } => format!("{sensor}@{span}:{}", rejection.code()),
                _ => "?".to_owned(),
            }
        });
        let seen: Vec<String> = seen.collect();
        format!("{} -{:?}", seen.join(" "), moment.absent)
    }

    fn closed(moments: &mut Moments, all: bool) -> Vec<String> {
        std::iter::from_fn(|| moments.next(all).map(|(_, moment)| shown(&moment))).collect()
    }

    #[test]
    fn what_is_of_one_time_is_one_moment_whatever_is_read_first() {
        // Windows of three sensors at offsets of their own; the second has two holes, the third refuses one.
        let mut events: Vec<(usize, (i64, i64), bool)> = Vec::new();
        for i in 0..40 {
            events.push((0, (600 * i, 600 * i + 600), true));
            if i % 13 != 5 {
                events.push((1, (600 * i + 20, 600 * i + 610), true));
            }
            events.push((2, (600 * i - 30, 600 * i + 569), i != 7));
        }
        let run = |seed: u64| {
            let (mut rng, mut moments) = (ChaCha8Rng::seed_from_u64(seed), moments(3));
            let (mut left, mut found) = (events.clone(), Vec::new());
            left.sort_by_key(|(sensor, (_, end), _)| (*end, *sensor));
            while !left.is_empty() {
                // Any sensor may be ahead of the others by up to three records, and a restart may come at any time.
                let sensor = left[rng.random_range(0..left.len().min(4))].0;
                let at = left.iter().position(|(own, ..)| *own == sensor).unwrap();
                let (sensor, span, is_good) = left.remove(at);
                let event = if is_good {
                    record(sensor, span)
                } else {
                    refused(span)
                };
                assert_eq!(comes(&mut moments, sensor, event), None);
                if rng.random_bool(0.2) {
                    let saved = moments.save().unwrap();
                    moments = self::moments(3);
                    moments.resume(&saved).unwrap();
                }
                found.extend(closed(&mut moments, false));
            }
            found.extend(closed(&mut moments, true));
            found
        };
        let expected = run(0);
        assert_eq!(expected.len(), 40);
        assert_eq!(expected[3], "0@1800 1@1820 2@1770 -[]");
        assert_eq!(expected[5], "0@3000 2@2970 -[1]");
        assert_eq!(expected[7], "0@4200 1@4220 2@4170:clipped -[]");
        for seed in 1..60 {
            assert_eq!(run(seed), expected, "seed {seed}");
        }
    }

    #[test]
    fn a_sensor_that_dies_is_waited_for_once_and_its_late_records_are_named() {
        let mut moments = moments(2);
        let mut found = Vec::new();
        for i in 0..12 {
            let span = (600 * i, 600 * i + 600);
            comes(&mut moments, 0, record(0, span));
            if i < 2 {
                comes(&mut moments, 1, record(1, span));
            }
            found.push(closed(&mut moments, false).len());
        }
        // The second was heard until 1201 s: it is more than an hour behind from 4801 s on.
        assert_eq!(found, [1, 1, 0, 0, 0, 0, 0, 0, 7, 1, 1, 1]);
        let late = comes(&mut moments, 1, record(1, (1800, 2400)));
        assert_eq!(late.as_deref(), Some("1@1800:late-sensor -[]"));
        // What nobody had at that time is no less worth for being late.
        assert_eq!(comes(&mut moments, 1, record(1, (-5000, -4400))), None);
        // It goes on beside the other.
        comes(&mut moments, 1, record(1, (7200, 7800)));
        comes(&mut moments, 0, record(0, (7200, 7800)));
        assert_eq!(closed(&mut moments, false), ["1@-5000 -[0]", "0@7200 1@7200 -[]"]);
    }

    #[test]
    fn one_that_never_comes_is_behind_from_the_first_sample_on() {
        let mut moments = moments(2);
        comes(&mut moments, 1, record(1, (0, 1800)));
        assert!(closed(&mut moments, false).is_empty() && moments.is_waiting());
        comes(&mut moments, 1, record(1, (1800, 3600)));
        assert_eq!(closed(&mut moments, false), ["1@0 -[0]", "1@1800 -[0]"]);
        // One that ended is not waited for.
        let mut moments = self::moments(2);
        comes(&mut moments, 0, record(0, (0, 600)));
        moments.end(0);
        comes(&mut moments, 1, record(1, (100, 500)));
        comes(&mut moments, 1, record(1, (500, 1000)));
        assert_eq!(closed(&mut moments, false), ["0@0 1@100 -[]", "1@500 -[0]"]);
        comes(&mut moments, 0, record(0, (900, 1500)));
        comes(&mut moments, 1, record(1, (1000, 1400)));
        assert_eq!(closed(&mut moments, false), ["0@900 1@1000 -[]"]);
    }

    #[test]
    fn a_refused_stretch_belongs_to_the_record_beside_it_or_is_told_alone() {
        let mut moments = moments(2);
        // Ten seconds that are too short, before the record of the same sensor.
        comes(&mut moments, 1, refused((-1, 9)));
        comes(&mut moments, 1, record(1, (12, 600)));
        comes(&mut moments, 0, record(0, (0, 600)));
        comes(&mut moments, 0, record(0, (600, 1200)));
        comes(&mut moments, 1, record(1, (600, 1200)));
        let found = closed(&mut moments, false);
        assert_eq!(found, ["0@0 1@12 -[]", "1@-1:clipped -[]", "0@600 1@600 -[]"]);
        // Both are refused.
        comes(&mut moments, 0, refused((1200, 1800)));
        comes(&mut moments, 1, refused((1201, 1801)));
        assert_eq!(closed(&mut moments, false), ["0@1200:clipped 1@1201:clipped -[]"]);
        // One of no length has no moment.
        let alone = comes(&mut moments, 0, refused((1800, 1800)));
        assert_eq!(alone.as_deref(), Some("0@0:clipped -[]"));
    }

    #[test]
    fn one_motion_makes_one_moment_whatever_is_read_first() {
        // The second sensor's record is in two pieces; it may be read far ahead of the first, or in step.
        for is_ahead in [false, true] {
            let mut moments = moments(2);
            let mut found = Vec::new();
            if !is_ahead {
                comes(&mut moments, 1, record(1, (0, 250)));
            }
            comes(&mut moments, 0, record(0, (0, 600)));
            if is_ahead {
                comes(&mut moments, 1, record(1, (0, 250)));
            }
            found.extend(closed(&mut moments, false));
            comes(&mut moments, 1, record(1, (255, 855)));
            found.extend(closed(&mut moments, false));
            comes(&mut moments, 0, record(0, (600, 1200)));
            comes(&mut moments, 1, record(1, (855, 1455)));
            found.extend(closed(&mut moments, false));
            assert_eq!(found, ["0@0 1@255 -[]", "1@0:late-sensor -[]", "0@600 1@855 -[]"]);
        }
    }

    #[test]
    fn older_data_are_taken_after_any_number_of_moments_without_a_sensor() {
        let mut moments = moments(2);
        for i in 0..2 * REMEMBERED as i64 {
            comes(&mut moments, 0, record(0, (600 * i, 600 * i + 600)));
            closed(&mut moments, false);
        }
        assert_eq!(comes(&mut moments, 0, record(0, (-6000, -5400))), None);
        assert_eq!(closed(&mut moments, true)[0], "0@-6000 -[1]");
    }

    #[test]
    fn whichever_record_leads_has_the_temperature_of_the_first() {
        let mut moments = moments(3);
        for sensor in [2, 1] {
            comes(&mut moments, sensor, record(sensor, (0, 600)));
        }
        let (_, moment) = moments.next(true).unwrap();
        let celsius: Vec<_> = moment
            .records()
            .map(|(_, record)| (record.temperature_c, record.readings[0].celsius))
            .collect();
        assert_eq!(celsius, [(Some(1.0), 1.0); 2]);
    }

    #[test]
    fn every_reading_is_handed_out_once_whichever_sensor_leads() {
        let mut moments = moments(2);
        let readings = |to: i64| -> Vec<Reading> {
            (0..to)
                .map(|s| Reading {
                    time: time(s),
                    celsius: 12.0,
                })
                .collect()
        };
        let mut given = Vec::new();
        let mut of_record = |moments: &mut Moments, sensor, span: (i64, i64)| {
            let mut event = record(sensor, span);
            if let Event::Record(record) = &mut event {
                record.readings = readings(span.1);
            }
            comes(moments, sensor, event);
            let (_, moment) = moments.next(true).unwrap();
            let (_, record) = moment.records().next().unwrap();
            given.extend(record.readings.iter().map(|reading| reading.time));
        };
        of_record(&mut moments, 0, (0, 100));
        // Between two records the lane that led brings what came since; then the other leads, whose lane has all of it.
        let since = readings(150).split_off(100);
        assert!(!moments.takes_readings(1, &since) && moments.takes_readings(0, &since));
        let saved = moments.save().unwrap();
        let mut moments = self::moments(2);
        moments.resume(&saved).unwrap();
        of_record(&mut moments, 1, (150, 300));
        let expected = (0..100).chain(150..300).map(time);
        assert_eq!(given, expected.collect::<Vec<_>>());
    }

    #[test]
    fn a_moment_that_closes_to_make_room_says_so() {
        let mut moments = moments(2);
        comes(&mut moments, 0, record(0, (0, 600)));
        assert!(moments.next(false).is_none());
        let (_, moment) = moments.release().unwrap();
        assert!(moment.is_early && moment.absent == [1]);
        // At the end of the data a sensor without a record has none.
        comes(&mut moments, 0, record(0, (600, 1200)));
        assert!(!moments.next(true).unwrap().1.is_early);
    }
}
