//! State of a rod's fold, kept in parts so that a commit writes only the changed ones.

use super::StoreError;
use super::change::Changed;
use super::row::Row;
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::drift::watch::DriftWatch;
use crate::analysis::track::fold::packed::{Packed, Receipt};
use crate::analysis::track::{Period, RodState, Segment, State};
use rusqlite::{Connection, OptionalExtension};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value as Json;
use std::collections::BTreeMap;

/// Part that names the current segment; the segment itself is a row of its own.
const SEGMENT: &str = "segment";

/// Part that holds the drift watch.
pub(super) const WATCH: &str = "watch";

/// JSON of a value, checked to read back equal: a number that is not finite would not.
pub(super) fn kept<T: Serialize + DeserializeOwned + PartialEq>(
    what: &str,
    value: &T,
) -> Result<String, StoreError> {
    let not_storable = |detail: String| StoreError::NotStorable {
        what: what.to_owned(),
        detail,
    };
    let json = serde_json::to_string(value).map_err(|error| not_storable(error.to_string()))?;
    let back: T = serde_json::from_str(&json).map_err(|error| not_storable(error.to_string()))?;
    if back == *value {
        Ok(json)
    } else {
        Err(not_storable("it reads back as something else".to_owned()))
    }
}

/// The states as stored, without their periods and without the drift watch, which is large: a receipt shows
/// if that has changed.
pub(super) struct Kept {
    states: BTreeMap<RodId, Before>,
    /// False for a store that nobody can resume from: of the states, their segments alone are written then.
    is_resumable: bool,
}

struct Before {
    state: State,
    watch: Receipt<DriftWatch>,
}

impl Before {
    fn of(state: &State) -> Self {
        let mut before = Self {
            watch: state.watch.receipt(),
            state: state.clone(),
        };
        (before.state.periods, before.state.watch) = (Vec::new(), Packed::default());
        before
    }
}

impl Kept {
    /// Of a store whose states are not known yet.
    pub(super) fn new(is_resumable: bool) -> Self {
        Self {
            states: BTreeMap::new(),
            is_resumable,
        }
    }

    /// False for a store that nobody can resume from.
    pub(super) fn is_resumable(&self) -> bool {
        self.is_resumable
    }

    /// Forgets the state in the store: the next write of this rod writes everything.
    pub(super) fn distrust(&mut self, rod: &RodId) {
        self.states.remove(rod);
    }

    pub(super) fn trust(&mut self, state: &State) {
        self.states.insert(state.rod.clone(), Before::of(state));
    }

    /// Writes the parts of a state that differ from those in the store.
    pub(super) fn write(
        &mut self,
        connection: &Connection,
        state: &State,
        changed: &mut Changed,
    ) -> Result<(), Failure> {
        let mut fresh = false;
        let known = self.states.entry(state.rod.clone()).or_insert_with(|| {
            fresh = true;
            Before::of(state)
        });
        let rod = &state.rod.0;
        let before = &mut known.state;
        if fresh || before.segment != state.segment {
            write_segment(connection, rod, &state.segment)?;
            changed.note("segment", [rod.clone().into(), state.segment.number.into()]);
            write_part(connection, rod, SEGMENT, state.segment.number.to_string())?;
            before.segment.clone_from(&state.segment);
        }
        if !self.is_resumable {
            return Ok(());
        }
        if fresh || !state.watch.is_as_of(&known.watch) {
            let json = state.watch.json().map_err(|error| StoreError::NotStorable {
                what: WATCH.to_owned(),
                detail: error.to_string(),
            })?;
            write_part(connection, rod, WATCH, json)?;
            known.watch = state.watch.receipt();
        }
        // Named one by one, so that a new field of the state cannot be forgotten here: it does not compile.
        macro_rules! parts {
            ($($part:ident),*) => {
                let State { rod: _, segment: _, periods: _, watch: _, $($part),* } = state;
                $(if fresh || before.$part != *$part {
                    let name = stringify!($part);
                    write_part(connection, rod, name, kept(name, $part)?)?;
                    before.$part.clone_from($part);
                })*
            };
        }
        parts!(
            learning,
            open,
            readings,
            filters,
            early,
            scatter,
            before,
            doubted,
            closed,
            alarms,
            watches,
            plausibility,
            thermometer,
            latest,
            opened
        );
        Ok(())
    }
}

/// An error on the way into or out of the tables.
pub(super) enum Failure {
    Sql(rusqlite::Error),
    Other(StoreError),
}

impl From<rusqlite::Error> for Failure {
    fn from(error: rusqlite::Error) -> Self {
        Self::Sql(error)
    }
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        Self::Other(error)
    }
}

fn write_part(connection: &Connection, rod: &str, part: &'static str, json: String) -> rusqlite::Result<()> {
    Row::of("state")
        .with("rod", rod.to_owned())
        .with("part", part.to_owned())
        .with("json", json)
        .upsert(connection, &["rod", "part"])
}

fn write_segment(connection: &Connection, rod: &str, segment: &Segment) -> Result<(), Failure> {
    let baseline = segment.baseline.as_ref();
    Row::of("segment")
        .with("rod", rod.to_owned())
        .with("number", i64::from(segment.number))
        .with("reason", plain(&segment.reason))
        .with("key", segment.key.clone())
        .with("baseline_first", baseline.map(|b| b.first.to_string()))
        .with("baseline_last", baseline.map(|b| b.last.to_string()))
        .with("baseline_records", baseline.map(|b| b.records as i64))
        .with("reference_c", segment.reference_c)
        .with("fault", segment.fault.clone())
        .with("json", kept(SEGMENT, segment)?)
        .upsert(connection, &["rod", "number"])?;
    Ok(())
}

/// Name of an enum variant as in JSON, without the quotes.
pub(super) fn plain<T: Serialize>(name: &T) -> String {
    serde_json::to_value(name)
        .ok()
        .and_then(|value| value.as_str().map(str::to_owned))
        .unwrap_or_default()
}

/// Writes a closed period into its table.
pub(super) fn write_period(
    connection: &Connection,
    rod: &RodId,
    segment: u32,
    period: &Period,
) -> Result<(), Failure> {
    let charted = period.charted.as_ref();
    let evidence = charted.map(|charted| charted.evidence).unwrap_or_default();
    Row::of("period")
        .with("rod", rod.0.clone())
        .with("segment", i64::from(segment))
        .with("period", period.index)
        .with("start", period.start.to_string())
        .with("start_ns", period.start.as_nanos())
        .with("records", period.records as i64)
        .with("delta", period.delta)
        .with("delta_sd", period.delta_sd)
        .with("not_axial_p", period.not_axial_p)
        .with("temperature_c", charted.and_then(|c| c.temperature_c))
        .with("expected", charted.map(|c| c.expected))
        .with("expected_sd", charted.map(|c| c.expected_sd))
        .with("residual", charted.map(|c| c.residual))
        .with("leverage", charted.map(|c| c.leverage))
        .with("at_reference", charted.and_then(|c| c.at_reference))
        .with("at_reference_sd", charted.and_then(|c| c.at_reference_sd))
        .with("evidence", evidence.compensated)
        .with("evidence_peers", evidence.peers)
        .with("evidence_blind", evidence.blind)
        .with("json", kept("period", period)?)
        .insert(connection)?;
    Ok(())
}

/// Every rod's state, its periods included.
pub(super) fn load(connection: &Connection) -> Result<BTreeMap<RodId, State>, Failure> {
    let mut parts: BTreeMap<String, serde_json::Map<String, Json>> = BTreeMap::new();
    let mut statement = connection.prepare("SELECT rod, part, json FROM state")?;
    let mut rows = statement.query(())?;
    while let Some(row) = rows.next()? {
        let (rod, part, json): (String, String, String) = (row.get(0)?, row.get(1)?, row.get(2)?);
        let value = if part == SEGMENT {
            let number: i64 = json.parse().map_err(|_| unreadable(&rod, &json))?;
            read(&rod, &segment_json(connection, &rod, number)?)?
        } else {
            read(&rod, &json)?
        };
        parts.entry(rod).or_default().insert(part, value);
    }
    let mut states = BTreeMap::new();
    for (rod, mut parts) in parts {
        parts.insert("rod".to_owned(), Json::String(rod.clone()));
        let mut state: State =
            serde_json::from_value(Json::Object(parts)).map_err(|error| unreadable(&rod, &error))?;
        state.periods = periods(connection, &state.rod, state.segment.number)?;
        states.insert(RodId(rod), state);
    }
    Ok(states)
}

/// The closed periods of one segment, ascending.
pub(super) fn periods(connection: &Connection, rod: &RodId, segment: u32) -> Result<Vec<Period>, Failure> {
    let mut statement =
        connection.prepare_cached("SELECT json FROM period WHERE rod = ? AND segment = ? ORDER BY period")?;
    let mut rows = statement.query((&rod.0, segment))?;
    let mut periods = Vec::new();
    while let Some(row) = rows.next()? {
        periods.push(read(
            &rod.0,
            row.get_ref(0)?.as_str().map_err(rusqlite::Error::from)?,
        )?);
    }
    Ok(periods)
}

/// Segments of a rod, ascending.
pub(super) fn segments(connection: &Connection, rod: &RodId) -> Result<Vec<Segment>, Failure> {
    let mut statement = connection.prepare("SELECT json FROM segment WHERE rod = ? ORDER BY number")?;
    let mut rows = statement.query([&rod.0])?;
    let mut segments = Vec::new();
    while let Some(row) = rows.next()? {
        segments.push(read(
            &rod.0,
            row.get_ref(0)?.as_str().map_err(rusqlite::Error::from)?,
        )?);
    }
    Ok(segments)
}

fn segment_json(connection: &Connection, rod: &str, number: i64) -> Result<String, Failure> {
    let json = connection
        .query_row(
            "SELECT json FROM segment WHERE rod = ? AND number = ?",
            (rod, number),
            |row| row.get(0),
        )
        .optional()?;
    Ok(json.ok_or_else(|| unreadable(rod, &format!("segment {number} is missing")))?)
}

pub(super) fn read<T: DeserializeOwned>(rod: &str, json: &str) -> Result<T, StoreError> {
    serde_json::from_str(json).map_err(|error| unreadable(rod, &error))
}

fn unreadable(rod: &str, detail: &impl ToString) -> StoreError {
    StoreError::Unreadable {
        what: format!("what is remembered of rod {rod}"),
        detail: detail.to_string(),
    }
}

/// Parses a point in time from a text of the store.
pub(super) fn time(text: &str) -> Result<Timestamp, StoreError> {
    serde_json::from_value(Json::String(text.to_owned())).map_err(|error| StoreError::Unreadable {
        what: format!("the time {text}"),
        detail: error.to_string(),
    })
}

/// Status of a rod that is no longer configured.
pub(super) fn not_followed() -> RodState {
    RodState::NotMonitoring {
        reason: "not in the configuration: no record of it is taken".to_owned(),
    }
}

/// Status of a rod by its state alone, for changes while no fold runs. The settings are not known here: a baseline that was
/// learned has its records, and learning is over if the last period was charted.
pub(super) fn standing_without_plan(state: &State) -> RodState {
    let records = state.segment.baseline.as_ref().map_or(0, |b| b.records);
    let has_learned = state
        .periods
        .last()
        .is_some_and(|period| period.charted.is_some());
    state.standing(records, if has_learned { 0 } else { usize::MAX })
}
