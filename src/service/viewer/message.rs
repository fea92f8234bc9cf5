//! Records, their pictures and alarms as messages: `/tirante/ROD/force`, `modes`, `waveform`, `spectrum`, `signal`, and `/tirante/alarms` as
//! `foxglove.Log`, a schema that viewers support. Every message has the `timestamp` of the record's first
//! sample, or of the alarm.

use super::schema::{self, Type};
use crate::analysis::record_view::Snapshot;
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::{Alarm, AlarmEvent};
use crate::recording::write::Encoding;
use crate::site::record_row::RecordRow;
use serde_json::{Value as Json, json};
use std::fmt;

/// Level of a `foxglove.Log` that needs attention.
const WARNING: u8 = 3;
/// Level of one that is over or acknowledged.
const INFO: u8 = 2;

/// A stream of messages of one schema.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Topic {
    /// Axial force of each record of a rod, by itself and relative to the baseline; `null` for a rejected record.
    Force(RodId),
    /// Natural frequencies of each record of a rod.
    Modes(RodId),
    /// The samples of a record, as lowest and highest of even stretches.
    Waveform(RodId),
    /// The power spectral density of a record, with its peaks.
    Spectrum(RodId),
    /// Samples of a rod as they are read, one by one: of a daemon alone, and in no file.
    Signal(RodId),
    /// Alarms of all rods.
    Alarms,
}

/// One message.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    /// Topic of the message.
    pub topic: Topic,
    /// Time of the record's first sample, of the raising of the alarm, or of its event.
    pub time: Timestamp,
    /// Content of the message.
    pub body: Json,
}

impl Topic {
    /// Topics of a rod in a store.
    pub fn of_rod(rod: &RodId) -> [Self; 4] {
        [Self::Force, Self::Modes, Self::Waveform, Self::Spectrum].map(|topic| topic(rod.clone()))
    }

    /// The rod, if the topic is about one.
    pub fn rod(&self) -> Option<&RodId> {
        match self {
            Self::Force(rod)
            | Self::Modes(rod)
            | Self::Waveform(rod)
            | Self::Spectrum(rod)
            | Self::Signal(rod) => Some(rod),
            Self::Alarms => None,
        }
    }

    /// Type of its messages.
    pub fn kind(&self) -> &'static Type {
        match self {
            Self::Force(_) => &schema::FORCE,
            Self::Modes(_) => &schema::MODES,
            Self::Waveform(_) => &schema::WAVEFORM,
            Self::Spectrum(_) => &schema::SPECTRUM,
            Self::Signal(_) => &schema::SIGNAL,
            Self::Alarms => &schema::LOG,
        }
    }

    /// Schema of its messages: name, encoding by the MCAP registry, content.
    pub fn schema(&self, encoding: Encoding) -> (String, &'static str, Vec<u8>) {
        let package = match self {
            Self::Alarms => "foxglove",
            _ => "tirante",
        };
        schema::schema(self.kind(), package, encoding)
    }
}

/// Name of the topic, as viewers list it.
impl fmt::Display for Topic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Force(rod) => write!(f, "/tirante/{rod}/force"),
            Self::Modes(rod) => write!(f, "/tirante/{rod}/modes"),
            Self::Waveform(rod) => write!(f, "/tirante/{rod}/waveform"),
            Self::Spectrum(rod) => write!(f, "/tirante/{rod}/spectrum"),
            Self::Signal(rod) => write!(f, "/tirante/{rod}/signal"),
            Self::Alarms => f.write_str("/tirante/alarms"),
        }
    }
}

impl Message {
    /// Messages of a record: its force, and its modes if it has any. None for a record without a time.
    pub fn of_record(row: &RecordRow) -> Vec<Self> {
        let Some(time) = row.start else {
            return Vec::new();
        };
        let mut messages = vec![Self {
            topic: Topic::Force(row.rod.clone()),
            time,
            body: json!({"timestamp": stamp(time), "axial_force_n": row.axial_force_n, "tracked_force_n": row.tracked_force_n,
                "force_at_reference_n": row.force_at_reference_n, "relative_force": row.relative_force,
                "relative_force_at_reference": row.relative_force_at_reference, "temperature_c": row.temperature_c,
                "state": row.state, "set_aside": row.set_aside, "rejection": row.rejection, "excitation": row.excitation,
                "label_probability": row.label_probability, "candidates": row.candidates,
                "conflict": row.conflict, "prior_tail": row.prior_tail}),
        }];
        if !row.modes.is_empty() {
            messages.push(Self {
                topic: Topic::Modes(row.rod.clone()),
                time,
                body: json!({"timestamp": stamp(time), "modes": row.modes}),
            });
        }
        messages
    }

    /// Messages of a record's view: its spectrum if it has one, and its waveform if that was kept, with the
    /// reason if it was refused. `unit` is the SI unit of the samples, if it is known.
    pub fn of_picture(rod: &RodId, picture: &Snapshot, unit: Option<&str>) -> Vec<Self> {
        let time = picture.start;
        let rejection = picture.rejection.as_ref().map(|reason| &reason.message);
        let waveform = picture.waveform.as_ref().map(|waveform| {
            let middle = |i| (i as f64 + 0.5) * waveform.step_s;
            let time_s: Vec<f64> = (0..waveform.low.len()).map(middle).collect();
            Self {
                topic: Topic::Waveform(rod.clone()),
                time,
                body: json!({"timestamp": stamp(time), "duration_s": picture.duration_s, "fs_hz": picture.fs_hz, "unit": unit,
                    "rejection": rejection, "time_s": time_s, "low": waveform.low, "high": waveform.high}),
            }
        });
        let curve = &picture.curve;
        let frequency_hz: Vec<f64> = (0..curve.level_db.len()).map(|i| curve.frequency_hz(i)).collect();
        let spectrum = Self {
            topic: Topic::Spectrum(rod.clone()),
            time,
            body: json!({"timestamp": stamp(time), "unit": unit.map(|unit| format!("dB re 1 ({unit})^2/Hz")),
                "rejection": rejection, "frequency_hz": frequency_hz, "level_db": curve.level_db, "peaks": picture.peaks}),
        };
        // Refused before there was a spectrum.
        let spectrum = Some(spectrum).filter(|_| !curve.level_db.is_empty());
        waveform.into_iter().chain(spectrum).collect()
    }

    /// Message of one sample, in an SI unit. The stamp is also where viewers look for the time of a plot.
    pub fn of_sample(rod: &RodId, time: Timestamp, value: f64, unit: &str) -> Self {
        let stamp = stamp(time);
        Self {
            topic: Topic::Signal(rod.clone()),
            time,
            body: json!({"timestamp": stamp, "header": {"stamp": stamp, "frame_id": rod}, "value": value, "unit": unit}),
        }
    }

    /// Message of an alarm event, at its time, with the words of the acknowledgement, if there are any.
    pub fn of_event(event: &AlarmEvent, words: Option<&str>) -> Self {
        Self {
            time: event.time,
            ..Self::of_alarm(&event.alarm, words)
        }
    }

    /// Message of an alarm in its present state, with the words of its acknowledgement, if there are any. They stand in its text:
    /// viewers know the fields of a `foxglove.Log`, and no others.
    pub fn of_alarm(alarm: &Alarm, words: Option<&str>) -> Self {
        let said = match (alarm.acknowledged, words) {
            (Some(time), Some(words)) => format!(" (acknowledged {time}, {words})"),
            (Some(time), None) => format!(" (acknowledged {time})"),
            (None, _) => String::new(),
        };
        let is_open = alarm.acknowledged.is_none() && !alarm.is_over();
        Self {
            topic: Topic::Alarms,
            time: alarm.raised,
            body: json!({
                "timestamp": stamp(alarm.raised),
                "level": if is_open { WARNING } else { INFO },
                "message": format!("{}: {}{said}", alarm.kind, alarm.message),
                "name": alarm.rod,
                "file": alarm.id,
                "line": 0,
            }),
        }
    }
}

/// Stamp in the form of viewers: whole seconds and nanoseconds.
fn stamp(time: Timestamp) -> Json {
    let nanos = time.as_nanos();
    json!({"sec": nanos.div_euclid(1_000_000_000), "nsec": nanos.rem_euclid(1_000_000_000)})
}
