//! Turns a finished stretch into records, or into the reason why it is none.

use super::{Assembler, Event, MAX_SAMPLES, Short};
use crate::signal::record::error_code::{self, ErrorCode};
use crate::signal::record::onset::{self, UnderWay};
use crate::signal::record::timing::{self, Even, Stray, Stretch};
use crate::signal::record::{Cut, Envelope, Excitation, Flag, Record, Rejection, Timestamp, quality};
use std::ops::Range;

/// Most records that wait for their temperature.
const WAITING: usize = 4;
/// Fewest samples worth a rejection of their own.
const FEW: usize = 64;
/// Least jitter worth a flag.
const NOTABLE_JITTER: f64 = 0.05;

/// Clock and cut of a stretch.
#[derive(Clone, Copy)]
struct Clock {
    fs_hz: f64,
    /// Relative standard error of the rate.
    sd: f64,
    jitter: f64,
    stray: Stray,
    excitation: Option<Excitation>,
}

impl Assembler {
    /// Turns a stretch into events. `until` bounds the onsets that count \[ns\].
    pub(super) fn close(&mut self, stretch: Stretch, cut_short: bool, until: Option<i64>) {
        let (Some(&first), Some(&last)) = (stretch.times.first(), stretch.times.last()) else {
            return;
        };
        // The rest of the stretch was already there when this record was cut.
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
            // A window determines the end of a record, not the motion of its rod.
            Cut::Auto | Cut::Window { .. } => self.pieces(even, None, cut_short),
            Cut::File => self.pieces(even, Some(Excitation::Ambient), cut_short),
        }
        self.dropped = 0;
        self.stray = Stray::default();
    }

    /// Cuts free decays, one piece per onset.
    fn decays(&mut self, even: &Even, ratio: f64, length_s: f64, cut_short: bool, until: Option<i64>) {
        let total = even.samples.len();
        let mut filled = even.samples.clone();
        error_code::strike(&mut filled, even.fs_hz);
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
                // Before a pull it is only the usual motion of the rod.
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

    /// Splits at long holes and checks the pieces.
    fn pieces(&mut self, even: Even, excitation: Option<Excitation>, cut_short: bool) {
        let Even {
            start,
            fs_hz,
            mut samples,
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
        let codes = error_code::strike(&mut samples, fs_hz);
        let total = samples.len();
        let hole = (self.settings.max_gap_s * fs_hz).floor().max(0.0) as usize;
        let least = self.settings.min_duration_s * fs_hz;
        let spans = quality::spans(&samples, hole);
        let long = |span: &Range<usize>| span.len() as f64 >= least;
        if !spans.iter().any(long) {
            let missing = samples.iter().filter(|x| !x.is_finite()).count();
            let share = missing as f64 / total.max(1) as f64;
            let allowed = self.settings.max_missing;
            let lost = error_code::refusal(&codes, total, fs_hz, &self.settings)
                .filter(|_| total as f64 >= least)
                .or((share > allowed).then_some(Rejection::Missing { share, allowed }));
            if let Some(rejection) = lost {
                let waveform = Envelope::of(&samples, fs_hz);
                return self.refuse_piece(start, fs_hz, total, waveform, rejection);
            }
        }
        if let [span] = &spans[..]
            && span.len() == total
        {
            // The common case: nothing to cut off, nothing to copy.
            return self.piece(start, clock, samples, &codes, &codes, cut_short);
        }
        for (i, span) in spans.iter().enumerate() {
            let start = start.plus_seconds(span.start as f64 / fs_hz);
            let within = |range: Range<usize>| -> Vec<ErrorCode> {
                codes.iter().filter_map(|code| code.within(&range)).collect()
            };
            let before = i.checked_sub(1).map_or(0, |i| spans[i].end);
            let after = spans.get(i + 1).map_or(total, |next| next.start);
            let (inside, near) = (within(span.clone()), within(before..after));
            let is_short = cut_short && span.end == total;
            self.piece(
                start,
                clock,
                samples[span.clone()].to_vec(),
                &inside,
                &near,
                is_short,
            );
        }
    }

    /// Checks samples between long holes, with the error codes among them and those `near` it, holes at its ends included.
    fn piece(
        &mut self,
        start: Timestamp,
        clock: Clock,
        samples: Vec<f64>,
        codes: &[ErrorCode],
        near: &[ErrorCode],
        cut_short: bool,
    ) {
        let fs_hz = clock.fs_hz;
        let duration_s = samples.len() as f64 / fs_hz;
        // A hair less than asked for is a matter of rounding.
        if duration_s < self.settings.min_duration_s * (1.0 - 1e-9) {
            return self.too_short(start, duration_s);
        }
        // The checks repair data where possible; refused data are shown unchanged.
        let unchanged = samples.clone();
        let checked = match quality::check_struck(samples, codes, fs_hz, &self.settings) {
            Ok(checked) => checked,
            Err(rejection) => {
                let waveform = Envelope::of(&unchanged, fs_hz);
                return self.refuse_piece(start, fs_hz, unchanged.len(), waveform, rejection);
            }
        };
        let mut flags = checked.flags;
        flags.extend(near.iter().map(ErrorCode::flag));
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

    fn refuse_piece(
        &mut self,
        start: Timestamp,
        fs_hz: f64,
        samples: usize,
        waveform: Envelope,
        rejection: Rejection,
    ) {
        self.tell_short();
        self.tell(Event::Rejected {
            rod: self.rod.clone(),
            start: Some(start),
            duration_s: samples as f64 / fs_hz,
            fs_hz: Some(fs_hz),
            waveform: Some(waveform),
            rejection,
        });
    }

    /// Releases records whose temperature is known, or that waited long enough.
    pub(super) fn release(&mut self, all: bool) {
        while let Some(record) = self.waiting.front() {
            let end = record.start.plus_seconds(record.duration_s());
            let known = self
                .temperature
                .as_ref()
                .is_none_or(|readings| readings.reaches(end));
            let held: usize = self.waiting.iter().map(|record| record.samples.len()).sum();
            if !(all || known || self.waiting.len() > WAITING || held > MAX_SAMPLES) {
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

    /// Queues an event of the stretch that was cut last.
    pub(super) fn tell(&mut self, event: Event) {
        self.events.push((Timestamp::from_nanos(self.at), event));
    }

    pub(super) fn reject(&mut self, start: Option<Timestamp>, duration_s: f64, rejection: Rejection) {
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

    /// Notes a stretch too short for a record; a run of them is reported as one.
    fn too_short(&mut self, start: Timestamp, duration_s: f64) {
        let short = self.short.get_or_insert(Short {
            start,
            longest_s: 0.0,
            total_s: 0.0,
        });
        short.longest_s = short.longest_s.max(duration_s);
        short.total_s += duration_s;
    }

    pub(super) fn tell_short(&mut self) {
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
