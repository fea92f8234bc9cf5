//! Serialisation of the records that wait inside an assembler, of the events that wait for other sensors, and of whole events.
//! Samples are written from where they are: a record may be large.

use super::Event;
use serde::{Deserialize, Serialize, Serializer};

/// An event in a form that another process of the same program reads; not an event of readings alone, which no analysis takes.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct SavedEvent(#[serde(deserialize_with = "event::deserialize")] pub Event);

/// An event to be written as a [`SavedEvent`].
#[derive(Debug, Clone, Copy)]
pub struct EventToSave<'a>(pub &'a Event);

impl Serialize for EventToSave<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        event::serialize(self.0, serializer)
    }
}

/// For `#[serde(with)]`: records as plain fields, flags as JSON because they carry their name inside.
pub(super) mod records {
    use crate::signal::record::{Excitation, Flag, Reading, Record, RodId, Timestamp};
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de, ser};
    use std::collections::VecDeque;

    #[derive(Serialize)]
    struct ToSave<'a> {
        rod: &'a RodId,
        start_ns: i64,
        fs_hz: f64,
        samples: &'a [f64],
        temperature_c: Option<f64>,
        readings: Vec<(i64, f64)>,
        excitation: Option<Excitation>,
        clock_sd: f64,
        flags: String,
    }

    /// The same, read back.
    #[derive(Deserialize)]
    struct Saved {
        rod: RodId,
        start_ns: i64,
        fs_hz: f64,
        samples: Vec<f64>,
        temperature_c: Option<f64>,
        readings: Vec<(i64, f64)>,
        excitation: Option<Excitation>,
        clock_sd: f64,
        flags: String,
    }

    pub fn serialize<'a, S: Serializer>(
        records: impl IntoIterator<Item = &'a Record>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        let saved = |record: &'a Record| {
            Ok(ToSave {
                rod: &record.rod,
                start_ns: record.start.as_nanos(),
                fs_hz: record.fs_hz,
                samples: &record.samples,
                temperature_c: record.temperature_c,
                readings: record
                    .readings
                    .iter()
                    .map(|reading| (reading.time.as_nanos(), reading.celsius))
                    .collect(),
                excitation: record.excitation,
                clock_sd: record.clock_sd,
                flags: serde_json::to_string(&record.flags).map_err(ser::Error::custom)?,
            })
        };
        let saved: Vec<ToSave<'_>> = records.into_iter().map(saved).collect::<Result<_, S::Error>>()?;
        saved.serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<VecDeque<Record>, D::Error> {
        let record = |saved: Saved| {
            let flags: Vec<Flag> = serde_json::from_str(&saved.flags).map_err(de::Error::custom)?;
            Ok(Record {
                rod: saved.rod,
                start: Timestamp::from_nanos(saved.start_ns),
                fs_hz: saved.fs_hz,
                samples: saved.samples,
                temperature_c: saved.temperature_c,
                readings: saved
                    .readings
                    .into_iter()
                    .map(|(nanos, celsius)| Reading {
                        time: Timestamp::from_nanos(nanos),
                        celsius,
                    })
                    .collect(),
                excitation: saved.excitation,
                clock_sd: saved.clock_sd,
                flags,
            })
        };
        let saved = Vec::<Saved>::deserialize(deserializer)?;
        saved.into_iter().map(record).collect()
    }
}

/// For `#[serde(with)]`: a record, a refused stretch, or a moment of several sensors.
pub(super) mod event {
    use super::{EventToSave, SavedEvent};
    use crate::signal::record::{Envelope, Event, Moment, Record, RodId, Timestamp};
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de, ser};
    use std::collections::VecDeque;

    /// One record as a list of one.
    struct One<'a>(&'a Record);

    impl Serialize for One<'_> {
        fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
            super::records::serialize([self.0], serializer)
        }
    }

    #[derive(Serialize)]
    enum ToSave<'a> {
        Record(One<'a>),
        Rejected {
            rod: &'a RodId,
            start_ns: Option<i64>,
            duration_s: f64,
            fs_hz: Option<f64>,
            waveform: &'a Option<Envelope>,
            rejection: String,
        },
        Moment {
            rod: &'a RodId,
            seen: Vec<(usize, EventToSave<'a>)>,
            absent: &'a [usize],
            is_early: bool,
        },
    }

    /// The same, read back.
    #[derive(Deserialize)]
    enum Saved {
        Record(#[serde(with = "super::records")] VecDeque<Record>),
        Rejected {
            rod: RodId,
            start_ns: Option<i64>,
            duration_s: f64,
            fs_hz: Option<f64>,
            waveform: Option<Envelope>,
            rejection: String,
        },
        Moment {
            rod: RodId,
            seen: Vec<(usize, SavedEvent)>,
            absent: Vec<usize>,
            is_early: bool,
        },
    }

    pub fn serialize<S: Serializer>(event: &Event, serializer: S) -> Result<S::Ok, S::Error> {
        let saved = match event {
            Event::Record(record) => ToSave::Record(One(record)),
            Event::Rejected {
                rod,
                start,
                duration_s,
                fs_hz,
                waveform,
                rejection,
            } => ToSave::Rejected {
                rod,
                start_ns: start.map(Timestamp::as_nanos),
                duration_s: *duration_s,
                fs_hz: *fs_hz,
                waveform,
                rejection: serde_json::to_string(rejection).map_err(ser::Error::custom)?,
            },
            Event::Moment(moment) => ToSave::Moment {
                rod: &moment.rod,
                seen: moment
                    .seen
                    .iter()
                    .map(|(sensor, event)| (*sensor, EventToSave(event)))
                    .collect(),
                absent: &moment.absent,
                is_early: moment.is_early,
            },
            Event::Readings { .. } => {
                return Err(ser::Error::custom("readings alone are not analysed"));
            }
        };
        saved.serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Event, D::Error> {
        Ok(match Saved::deserialize(deserializer)? {
            Saved::Record(mut record) => {
                let record = record.pop_front();
                Event::Record(record.ok_or_else(|| de::Error::custom("no record"))?)
            }
            Saved::Rejected {
                rod,
                start_ns,
                duration_s,
                fs_hz,
                waveform,
                rejection,
            } => Event::Rejected {
                rod,
                start: start_ns.map(Timestamp::from_nanos),
                duration_s,
                fs_hz,
                waveform,
                rejection: serde_json::from_str(&rejection).map_err(de::Error::custom)?,
            },
            Saved::Moment {
                rod,
                seen,
                absent,
                is_early,
            } => Event::Moment(Moment {
                rod,
                seen: seen
                    .into_iter()
                    .map(|(sensor, SavedEvent(event))| (sensor, event))
                    .collect(),
                absent,
                is_early,
            }),
        })
    }
}
