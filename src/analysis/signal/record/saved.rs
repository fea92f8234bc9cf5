//! Serialisation of the records that wait inside an assembler, and of the events that wait for other sensors.

/// For `#[serde(with)]`: records as plain fields, flags as JSON because they carry their name inside.
pub(super) mod records {
    use crate::signal::record::{Excitation, Flag, Reading, Record, RodId, Timestamp};
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de, ser};
    use std::collections::VecDeque;

    #[derive(Serialize, Deserialize)]
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

    pub fn serialize<S: Serializer>(records: &VecDeque<Record>, serializer: S) -> Result<S::Ok, S::Error> {
        let saved = |record: &Record| {
            Ok(Saved {
                rod: record.rod.clone(),
                start_ns: record.start.as_nanos(),
                fs_hz: record.fs_hz,
                samples: record.samples.clone(),
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
        let saved: Vec<Saved> = records.iter().map(saved).collect::<Result<_, S::Error>>()?;
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

/// For `#[serde(with)]`: a record or a refused stretch.
pub(super) mod event {
    use crate::signal::record::{Envelope, Event, Record, RodId, Timestamp};
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de, ser};
    use std::collections::VecDeque;

    #[derive(Serialize, Deserialize)]
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
    }

    pub fn serialize<S: Serializer>(event: &Event, serializer: S) -> Result<S::Ok, S::Error> {
        let saved = match event {
            Event::Record(record) => Saved::Record(VecDeque::from([record.clone()])),
            Event::Rejected {
                rod,
                start,
                duration_s,
                fs_hz,
                waveform,
                rejection,
            } => Saved::Rejected {
                rod: rod.clone(),
                start_ns: start.map(Timestamp::as_nanos),
                duration_s: *duration_s,
                fs_hz: *fs_hz,
                waveform: waveform.clone(),
                rejection: serde_json::to_string(rejection).map_err(ser::Error::custom)?,
            },
            Event::Readings { .. } | Event::Moment(_) => {
                return Err(ser::Error::custom("no event of a single sensor"));
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
        })
    }
}
