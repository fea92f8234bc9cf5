//! What a store holds as an MCAP file, to be opened beside the recordings in a robotics viewer (Foxglove, Lichtblick).
//!
//! Topics: `/tirante/ROD/force` and `/tirante/ROD/modes` per record, `/tirante/alarms` as `foxglove.Log`, the schema such viewers
//! know. Messages are JSON with a JSON schema each; their time is that of the record's first sample, or of the alarm.

use super::SinkError;
use crate::record::Timestamp;
use crate::track::Alarm;
use mcap::records::MessageHeader;
use serde::Deserialize;
use serde_json::{Value as Json, json};
use std::collections::BTreeMap;
use std::io::{BufWriter, Write};

/// Level of a `foxglove.Log` for something to be looked at.
const WARNING: u8 = 3;
/// Level for something that is over or known.
const INFO: u8 = 2;

/// Writes results, one record or alarm at a time, to anything that can be written; the same bytes for the same results.
pub struct ResultsWriter<W: Write> {
    mcap: mcap::Writer<mcap::write::NoSeek<BufWriter<W>>>,
    /// Channel ids by topic, with the next sequence number.
    channels: BTreeMap<String, (u16, u32)>,
}

/// The part of a record's line that is shown.
#[derive(Deserialize)]
struct Line {
    rod: String,
    start: Option<Timestamp>,
    #[serde(default)]
    modes: Vec<Json>,
    #[serde(flatten)]
    rest: serde_json::Map<String, Json>,
}

/// What a force message takes over from a line, as it stands there.
const FORCES: [&str; 9] = [
    "axial_force_n",
    "tracked_force_n",
    "force_at_reference_n",
    "relative_force",
    "relative_force_at_reference",
    "temperature_c",
    "state",
    "set_aside",
    "rejection",
];

impl<W: Write> ResultsWriter<W> {
    /// Begins a file.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn new(to: W) -> Result<Self, SinkError> {
        let options = mcap::WriteOptions::new()
            .library(concat!("tirante ", env!("CARGO_PKG_VERSION")))
            .disable_seeking(true)
            .compression_threads(0);
        let to = mcap::write::NoSeek::new(BufWriter::new(to));
        Ok(Self {
            mcap: options.create(to)?,
            channels: BTreeMap::new(),
        })
    }

    /// A record by its JSON line, as `history --format json` prints it. One without a time is left out.
    ///
    /// # Errors
    /// It is no such line, its time lies before 1970, or the file cannot be written.
    pub fn record(&mut self, line: &str) -> Result<(), SinkError> {
        let wrong = |_| SinkError::Samples("a record of the store is no JSON line");
        let line: Line = serde_json::from_str(line).map_err(wrong)?;
        let Some(start) = line.start else { return Ok(()) };
        let mut force = serde_json::Map::new();
        force.insert("timestamp".to_owned(), stamp(start));
        for name in FORCES {
            let value = line.rest.get(name).cloned().unwrap_or(Json::Null);
            force.insert(name.to_owned(), value);
        }
        self.write(
            &format!("/tirante/{}/force", line.rod),
            "tirante.Force",
            start,
            &Json::Object(force),
        )?;
        if !line.modes.is_empty() {
            let modes = json!({"timestamp": stamp(start), "modes": line.modes});
            self.write(
                &format!("/tirante/{}/modes", line.rod),
                "tirante.Modes",
                start,
                &modes,
            )?;
        }
        Ok(())
    }

    /// An alarm, at the time it was raised.
    ///
    /// # Errors
    /// Its time lies before 1970, or the file cannot be written.
    pub fn alarm(&mut self, alarm: &Alarm) -> Result<(), SinkError> {
        let is_open = alarm.acknowledged.is_none() && !alarm.is_over();
        let message = json!({
            "timestamp": stamp(alarm.raised),
            "level": if is_open { WARNING } else { INFO },
            "message": format!("{}: {}", alarm.kind, alarm.message),
            "name": alarm.rod,
            "file": alarm.id,
            "line": 0,
        });
        self.write("/tirante/alarms", "foxglove.Log", alarm.raised, &message)
    }

    fn write(&mut self, topic: &str, schema: &str, time: Timestamp, message: &Json) -> Result<(), SinkError> {
        let nanos = u64::try_from(time.as_nanos()).map_err(|_| SinkError::Time(time))?;
        if !self.channels.contains_key(topic) {
            let schema_id = self
                .mcap
                .add_schema(schema, "jsonschema", schema_of(schema).as_bytes())?;
            let id = self
                .mcap
                .add_channel(schema_id, topic, "json", &BTreeMap::new())?;
            self.channels.insert(topic.to_owned(), (id, 0));
        }
        let Some((channel_id, sequence)) = self.channels.get_mut(topic) else {
            return Err(SinkError::Channel);
        };
        let header = MessageHeader {
            channel_id: *channel_id,
            sequence: *sequence,
            log_time: nanos,
            publish_time: nanos,
        };
        *sequence = sequence.wrapping_add(1);
        self.mcap
            .write_to_known_channel(&header, message.to_string().as_bytes())?;
        Ok(())
    }

    /// Ends the file.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn finish(mut self) -> Result<(), SinkError> {
        self.mcap.finish()?;
        let flushed = self.mcap.into_inner().into_inner().flush();
        flushed.map_err(|source| SinkError::Io {
            path: "the results".to_owned(),
            source,
        })
    }
}

/// As viewers take it: whole seconds and the rest.
fn stamp(time: Timestamp) -> Json {
    let nanos = time.as_nanos();
    json!({"sec": nanos.div_euclid(1_000_000_000), "nsec": nanos.rem_euclid(1_000_000_000)})
}

/// The JSON schema of a message.
fn schema_of(name: &str) -> String {
    let time = json!({"type": "object", "title": "time", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}});
    let number = json!({"type": ["number", "null"]});
    let interval = json!({"type": ["object", "null"], "properties": {"mean": number, "sd": number, "q025": number, "q975": number}});
    let text = json!({"type": ["string", "null"]});
    let properties = match name {
        "foxglove.Log" => {
            json!({"timestamp": time, "level": {"type": "integer"}, "message": {"type": "string"},
            "name": {"type": "string"}, "file": {"type": "string"}, "line": {"type": "integer"}})
        }
        "tirante.Modes" => {
            json!({"timestamp": time, "modes": {"type": "array", "items": {"type": "object", "properties": {
            "order": {"type": "integer"}, "frequency_hz": number, "sd_hz": number, "damping": number}}}})
        }
        _ => {
            json!({"timestamp": time, "axial_force_n": interval, "tracked_force_n": interval, "force_at_reference_n": interval,
            "relative_force": interval, "relative_force_at_reference": interval, "temperature_c": number, "state": text,
            "set_aside": text, "rejection": {"type": ["object", "null"]}})
        }
    };
    json!({"title": name, "type": "object", "properties": properties}).to_string()
}
