//! Content of one transaction: a record, the changes to its rod, and the position in its source.

use super::StoreError;
use super::change::Changed;
use super::columns::COLUMNS;
use super::operation::{Carry, FileMark, write_carry, write_delivery, write_file};
use super::resonance;
use super::row::Row;
use super::snapshot::SnapshotRow;
use super::state::{self, Failure, Kept, kept, plain};
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::alarm::Alarm;
use crate::analysis::track::{AlarmEvent, Period, RodState, State};
use crate::recording::read::Place;
use crate::site::found::Found;
use crate::site::record_row::RecordRow;
use rusqlite::{Connection, OptionalExtension};

/// Changes that become durable at once.
#[derive(Clone, Copy, Default)]
pub struct Commit<'a> {
    /// The record; `None` for changes without one: a clock tick, a request, a configuration that opened a
    /// segment.
    pub record: Option<NewRecord<'a>>,
    /// Changes to the rod; `None` for a record that is not tracked.
    pub rod: Option<RodRow<'a>>,
    /// Temperatures of a rod that belong to no record: the time of the last \[ns since 1970\], and all of them.
    pub readings: Option<(&'a RodId, i64, &'a Found)>,
    /// View of the record, for the report.
    pub snapshot: Option<SnapshotRow<'a>>,
    /// Number of the request that was applied.
    pub applied: Option<i64>,
    /// Position reached in its source.
    pub source: Option<Position<'a>>,
    /// Marks of files read to their ends.
    pub files: &'a [FileMark],
    /// Open samples that a part or a file leaves for the next.
    pub carry: &'a [Carry],
    /// A sink, and the number of the latest event delivered to it.
    pub delivered: Option<(&'a str, i64)>,
}

/// A record, identified or rejected.
#[derive(Clone, Copy)]
pub struct NewRecord<'a> {
    /// Row of the record.
    pub row: &'a RecordRow,
    /// Identity of the record, by its content.
    pub identity: [u8; 32],
    /// Findings of its samples; `None` where another analysis needs the samples.
    pub found: Option<&'a Found>,
    /// Root mean square of the samples.
    pub rms: Option<f64>,
    /// Forward model used.
    pub emulator: &'a str,
}

/// Changes to a rod.
#[derive(Clone, Copy)]
pub struct RodRow<'a> {
    /// State of its fold.
    pub state: &'a State,
    /// Status of the rod.
    pub stands: &'a RodState,
    /// Periods of the current segment that closed.
    pub closed: &'a [Period],
    /// Changes of alarms, in order.
    pub events: &'a [AlarmEvent],
}

/// Position reached in a source.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Position<'a> {
    /// Name of the source: its file.
    pub name: &'a str,
    /// Name of the file that holds the last sample of the record found there.
    pub origin: &'a str,
    /// Number of bytes read.
    pub bytes: u64,
    /// Number of records found.
    pub records: u64,
}

impl<'a> From<&'a Place> for Position<'a> {
    fn from(place: &'a Place) -> Self {
        Position {
            name: &place.file,
            origin: &place.origin,
            bytes: place.bytes,
            records: place.records,
        }
    }
}

impl Commit<'_> {
    /// Writes everything into the tables of an open transaction.
    pub(super) fn write(&self, connection: &Connection, kept: &mut Kept) -> Result<(), Failure> {
        let mut changed = Changed::default();
        if let Some(record) = &self.record {
            record.write(connection, self.source.map(|source| source.origin), &mut changed)?;
        }
        if let Some((rod, last_ns, found)) = self.readings {
            resonance::write_readings(connection, rod, last_ns, found)?;
        }
        if let Some(rod) = &self.rod {
            let start = self.record.as_ref().and_then(|record| record.row.start);
            rod.write(connection, kept, start, &mut changed)?;
        }
        if let Some(snapshot) = &self.snapshot {
            snapshot.write(connection)?;
        }
        if let Some(number) = self.applied {
            super::request::mark_applied(connection, number)?;
            changed.note("request", [number.into()]);
        }
        if let Some(position) = &self.source {
            let count = |number: u64| i64::try_from(number).unwrap_or(i64::MAX);
            Row::of("source")
                .with("name", position.name.to_owned())
                .with("bytes", count(position.bytes))
                .with("records", count(position.records))
                .upsert(connection, &["name"])?;
        }
        for file in self.files {
            write_file(connection, file)?;
        }
        for carry in self.carry {
            write_carry(connection, carry)?;
        }
        if let Some((sink, through)) = self.delivered {
            write_delivery(connection, sink, through)?;
        }
        changed.write(connection)?;
        Ok(())
    }
}

impl NewRecord<'_> {
    /// Writes the record, which came from `file`.
    fn write(
        &self,
        connection: &Connection,
        file: Option<&str>,
        changed: &mut Changed,
    ) -> Result<(), Failure> {
        let json = self.row.to_json().map_err(|error| StoreError::NotStorable {
            what: format!("a record of rod {}", self.row.rod),
            detail: error.to_string(),
        })?;
        let id: i64 = connection
            .prepare_cached("SELECT coalesce(max(id), 0) + 1 FROM record")?
            .query_row((), |row| row.get(0))?;
        let mut row = Row::of("record")
            .with("id", id)
            .with("rod", self.row.rod.0.clone())
            .with("identity", self.identity.to_vec())
            .with("start_ns", self.row.start.map(Timestamp::as_nanos));
        for column in &COLUMNS {
            row.put(column.name, (column.of)(self.row));
        }
        row.with("rms", self.rms)
            .with("emulator", self.emulator.to_owned())
            .insert(connection)?;
        changed.note("record", [id.into()]);
        Row::of("line")
            .with("record", id)
            .with("json", json)
            .insert(connection)?;
        if let Some(file) = file {
            Row::of("origin")
                .with("record", id)
                .with("file", file.to_owned())
                .insert(connection)?;
        }
        for mode in &self.row.modes {
            Row::of("mode")
                .with("record", id)
                .with("mode_order", mode.order as i64)
                .with("frequency_hz", mode.frequency_hz)
                .with("sd_hz", mode.sd_hz)
                .with("damping", mode.damping)
                .insert(connection)?;
        }
        if let Some(found) = self.found {
            resonance::write(connection, &self.row.rod, id, found)?;
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
        changed: &mut Changed,
    ) -> Result<(), Failure> {
        let rod = &self.state.rod;
        kept_states.write(connection, self.state, changed)?;
        for period in self.closed {
            state::write_period(connection, rod, self.state.segment.number, period)?;
            let segment = self.state.segment.number;
            changed.note(
                "period",
                [rod.0.clone().into(), segment.into(), period.index.into()],
            );
        }
        for event in self.events {
            write_event(connection, rod, event, changed)?;
        }
        let time = self.events.last().map(|event| event.time);
        let time = time.or(self.state.latest).or(start);
        if write_standing(connection, rod, self.stands, self.state.segment.number, time)? {
            changed.note("rod", [rod.0.clone().into()]);
        }
        Ok(())
    }
}

/// Writes the status of a rod, if it changed; its `since` changes only with the state.
fn write_standing(
    connection: &Connection,
    rod: &RodId,
    stands: &RodState,
    segment: u32,
    time: Option<Timestamp>,
) -> Result<bool, Failure> {
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
                return Ok(false);
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
    Ok(true)
}

/// Updates the row of an alarm.
pub(super) fn write_alarm(
    connection: &Connection,
    rod: &RodId,
    alarm: &Alarm,
    changed: &mut Changed,
) -> Result<(), Failure> {
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
    changed.note("alarm", [alarm.id.clone().into()]);
    Ok(())
}

/// Updates the row of an alarm and adds the event to the outbox.
pub(super) fn write_event(
    connection: &Connection,
    rod: &RodId,
    event: &AlarmEvent,
    changed: &mut Changed,
) -> Result<(), Failure> {
    let alarm = &event.alarm;
    write_alarm(connection, rod, alarm, changed)?;
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
    changed.note("outbox", [number.into()]);
    Ok(())
}
