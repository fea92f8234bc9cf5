//! What one transaction puts in: a record, what it changed for its rod, and how far its source was read.

use super::StoreError;
use super::columns::COLUMNS;
use super::operation::{Carry, FileMark, write_carry, write_delivery, write_file};
use super::row::Row;
use super::snapshot::SnapshotRow;
use super::state::{self, Kept, Trouble, kept, plain};
use crate::analysis::outcome::Outcome;
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::{AlarmEvent, Period, RodState, State};
use rusqlite::{Connection, OptionalExtension};
use serde_json::Value as Json;

/// Everything that becomes durable at once.
#[derive(Clone, Copy, Default)]
pub struct Commit<'a> {
    /// The record; `None` for news without one: a clock that was looked at, a request that was applied, a
    /// configuration that opened a segment.
    pub record: Option<RecordRow<'a>>,
    /// What changed for the rod; `None` for a record that is not tracked.
    pub rod: Option<RodRow<'a>>,
    /// What the record looked like, for the report.
    pub snapshot: Option<SnapshotRow<'a>>,
    /// The request that was applied, by its number.
    pub applied: Option<i64>,
    /// How far its source has been read.
    pub source: Option<Position<'a>>,
    /// A file that was read to its end.
    pub file: Option<&'a FileMark>,
    /// What a journal leaves for its next part.
    pub carry: Option<&'a Carry>,
    /// A sink, and the number of the latest news it has.
    pub delivered: Option<(&'a str, i64)>,
}

/// A record, identified or rejected.
#[derive(Clone, Copy)]
pub struct RecordRow<'a> {
    /// What came of it.
    pub outcome: &'a Outcome,
    /// The JSON line as `replay --json` prints it, without its line end. The columns repeat what it says.
    pub line: &'a str,
    /// The forward model that answered.
    pub emulator: &'a str,
}

/// What changed for a rod.
#[derive(Clone, Copy)]
pub struct RodRow<'a> {
    /// What its fold remembers now.
    pub state: &'a State,
    /// How it stands now.
    pub stands: &'a RodState,
    /// Periods of the present segment that closed.
    pub closed: &'a [Period],
    /// What happened to alarms, in order.
    pub events: &'a [AlarmEvent],
}

/// How far a source has been read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Position<'a> {
    /// The source: a file's name.
    pub name: &'a str,
    /// Bytes read.
    pub bytes: u64,
    /// Records found.
    pub records: u64,
}

impl Commit<'_> {
    /// Puts everything into the tables of an open transaction.
    pub(super) fn write(&self, connection: &Connection, kept: &mut Kept) -> Result<(), Trouble> {
        if let Some(record) = &self.record {
            record.write(connection)?;
        }
        if let Some(rod) = &self.rod {
            let start = self.record.as_ref().and_then(|record| record.outcome.start());
            rod.write(connection, kept, start)?;
        }
        if let Some(snapshot) = &self.snapshot {
            snapshot.write(connection)?;
        }
        if let Some(number) = self.applied {
            super::request::mark_applied(connection, number)?;
        }
        if let Some(position) = &self.source {
            let count = |number: u64| i64::try_from(number).unwrap_or(i64::MAX);
            Row::of("source")
                .with("name", position.name.to_owned())
                .with("bytes", count(position.bytes))
                .with("records", count(position.records))
                .upsert(connection, &["name"])?;
        }
        if let Some(file) = self.file {
            write_file(connection, file)?;
        }
        if let Some(carry) = self.carry {
            write_carry(connection, carry)?;
        }
        if let Some((sink, through)) = self.delivered {
            write_delivery(connection, sink, through)?;
        }
        Ok(())
    }
}

impl RecordRow<'_> {
    fn write(&self, connection: &Connection) -> Result<(), Trouble> {
        let unkeepable = |detail: String| StoreError::Unkeepable {
            what: format!("a record of rod {}", self.outcome.rod()),
            detail,
        };
        let identity = self
            .outcome
            .identity()
            .ok_or_else(|| unkeepable("frequencies measured elsewhere are no record".to_owned()))?;
        let line: Json = serde_json::from_str(self.line).map_err(|error| unkeepable(error.to_string()))?;
        let id: i64 = connection
            .prepare_cached("SELECT coalesce(max(id), 0) + 1 FROM record")?
            .query_row((), |row| row.get(0))?;
        let rms = match self.outcome {
            Outcome::Identified(identification) => identification.measurement.as_ref().map(|m| m.rms),
            Outcome::Tabulated(row) => row.rms,
            Outcome::Rejected(_) => None,
        };
        let mut row = Row::of("record")
            .with("id", id)
            .with("rod", self.outcome.rod().0.clone())
            .with("identity", identity.to_vec())
            .with("start_ns", self.outcome.start().map(Timestamp::as_nanos));
        for column in &COLUMNS {
            row.put(column.name, column.of(&line));
        }
        row.with("rms", rms)
            .with("emulator", self.emulator.to_owned())
            .insert(connection)?;
        Row::of("line")
            .with("record", id)
            .with("json", self.line.to_owned())
            .insert(connection)?;
        let modes = match self.outcome {
            Outcome::Identified(identification) => &identification.modes[..],
            Outcome::Tabulated(row) => &row.modes,
            Outcome::Rejected(_) => &[],
        };
        for mode in modes {
            Row::of("mode")
                .with("record", id)
                .with("mode_order", mode.order as i64)
                .with("frequency_hz", mode.frequency_hz)
                .with("sd_hz", mode.sd_hz)
                .with("damping", mode.damping)
                .insert(connection)?;
        }
        Ok(())
    }
}

impl RodRow<'_> {
    fn write(
        &self,
        connection: &Connection,
        kept_states: &mut Kept,
        start: Option<Timestamp>,
    ) -> Result<(), Trouble> {
        let rod = &self.state.rod;
        kept_states.write(connection, self.state)?;
        for period in self.closed {
            state::write_period(connection, rod, self.state.segment.number, period)?;
        }
        for event in self.events {
            write_event(connection, rod, event)?;
        }
        let time = self.events.last().map(|event| event.time);
        let time = time.or(self.state.latest).or(start);
        write_standing(connection, rod, self.stands, self.state.segment.number, time)
    }
}

/// Keeps how a rod stands; since when changes only if the state does.
fn write_standing(
    connection: &Connection,
    rod: &RodId,
    stands: &RodState,
    segment: u32,
    time: Option<Timestamp>,
) -> Result<(), Trouble> {
    let before: Option<(String, String, Option<String>, u32)> = connection
        .prepare_cached("SELECT state, detail, since, segment FROM rod WHERE rod = ?")?
        .query_row([&rod.0], |row| {
            Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?))
        })
        .optional()?;
    let (code, detail) = (stands.code(), kept("state", stands)?);
    let since = match &before {
        Some((before_code, before_detail, since, before_segment)) => {
            let is_same = before_code == code && *before_detail == detail && *before_segment == segment;
            if is_same && (since.is_some() || time.is_none()) {
                return Ok(());
            }
            // A rod of which nothing had come yet stood so since no time that can be told.
            if before_code == code && since.is_some() {
                since.clone()
            } else {
                time.map(|time| time.to_string())
            }
        }
        None => time.map(|time| time.to_string()),
    };
    Row::of("rod")
        .with("rod", rod.0.clone())
        .with("state", code.to_owned())
        .with("detail", detail)
        .with("since", since)
        .with("segment", i64::from(segment))
        .upsert(connection, &["rod"])?;
    Ok(())
}

/// Brings an alarm's row up to date and puts the news into the outbox.
fn write_event(connection: &Connection, rod: &RodId, event: &AlarmEvent) -> Result<(), Trouble> {
    let alarm = &event.alarm;
    Row::of("alarm")
        .with("id", alarm.id.clone())
        .with("rod", rod.0.clone())
        .with("kind", alarm.kind.code().to_owned())
        .with("raised", alarm.raised.to_string())
        .with("raised_ns", alarm.raised.as_nanos())
        .with("message", alarm.message.clone())
        .with("acknowledged", alarm.acknowledged.map(|time| time.to_string()))
        .with("cleared", alarm.cleared.map(|time| time.to_string()))
        .with("stands", i64::from(!alarm.is_over()))
        .with("json", kept("alarm", alarm)?)
        .upsert(connection, &["id"])?;
    let number: i64 = connection
        .prepare_cached("SELECT coalesce(max(number), 0) + 1 FROM outbox")?
        .query_row((), |row| row.get(0))?;
    Row::of("outbox")
        .with("number", number)
        .with("alarm", alarm.id.clone())
        .with("rod", rod.0.clone())
        .with("what", plain(&event.what))
        .with("time", event.time.to_string())
        .with("json", kept("alarm event", event)?)
        .insert(connection)?;
    Ok(())
}
