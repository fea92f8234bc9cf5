//! Status of the rods of a store, for `status`, pages, reports and metrics.

use super::read::parse;
use super::state::{self, Failure};
use super::{Reader, Request, StoreError};
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::baseline::spacing::usual_s;
use crate::analysis::track::{Alarm, JUMP_S, RodState};
use crate::site::clock;
use crate::site::record_row::RecordRow;
use rusqlite::{OptionalExtension, Params};
use std::collections::BTreeMap;

/// Gap after which records that lie ahead of the machine's clock were dated by a wrong one \[ns\]: the silence after which
/// tracking doubts a time, too.
const GAP_NS: i64 = (JUMP_S * 1e9) as i64;

/// Number of records that tell the usual distance of a rod without a baseline.
const RECENT: usize = 30;

/// Status of one rod.
#[derive(Debug, Clone, PartialEq)]
pub struct Standing {
    /// Id of the rod.
    pub rod: RodId,
    /// State of the rod.
    pub state: RodState,
    /// Time of the last change of state, in event time.
    pub since: Option<Timestamp>,
    /// Number of the current segment.
    pub segment: u32,
    /// The JSON line of the rod's latest record that was not rejected.
    pub latest: Option<String>,
    /// The start of the rod's latest record, rejected or not, whose time can be believed.
    pub latest_start: Option<Timestamp>,
    /// Number of the rod's records that a wrong clock dated after that one.
    pub ahead: u64,
    /// Usual distance between the rod's records \[s\]; `None` before two of them.
    pub usual_s: Option<f64>,
    /// Active alarms, in the order they were raised.
    pub alarms: Vec<Alarm>,
    /// Words of the people who acknowledged them, by the alarm's id.
    pub words: BTreeMap<String, String>,
    /// Requests that wait for the rod's next record.
    pub waiting: Vec<Request>,
    /// Time since which a daemon has expected the rod's first record; `None` once it has come.
    pub awaited: Option<Timestamp>,
}

impl Standing {
    /// Row of the latest record that was not rejected.
    ///
    /// # Errors
    /// Its line cannot be understood.
    pub fn latest_row(&self) -> Result<Option<RecordRow>, StoreError> {
        let latest = self.latest.as_deref();
        latest.map(parse).transpose()
    }
}

impl Reader {
    /// Status of every rod.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn standings(&self) -> Result<Vec<Standing>, StoreError> {
        self.standings_of(None, clock::now())
    }

    /// Status of one rod; `None` if it is not in the store.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn standing(&self, rod: &RodId) -> Result<Option<Standing>, StoreError> {
        Ok(self.standings_of(Some(rod), clock::now())?.pop())
    }

    /// Status of every rod, or of one, at `now` by the machine's clock.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn standings_of(&self, rod: Option<&RodId>, now: Timestamp) -> Result<Vec<Standing>, StoreError> {
        let standings = self.try_standings(rod, now);
        let mut standings = standings.map_err(|failure| self.fault(failure))?;
        for standing in &mut standings {
            standing.waiting = self.waiting(&standing.rod)?;
            standing.words = self.words_of(&standing.alarms)?;
        }
        Ok(standings)
    }

    fn try_standings(&self, rod: Option<&RodId>, now: Timestamp) -> Result<Vec<Standing>, Failure> {
        let mut statement = self.connection.prepare_cached(
            "SELECT rod, detail, since, segment,
                (SELECT since FROM expected WHERE expected.rod = rod.rod
                    AND NOT EXISTS (SELECT 1 FROM record WHERE record.rod = rod.rod))
             FROM rod WHERE ?1 IS NULL OR rod = ?1 ORDER BY rod",
        )?;
        let mut rows = statement.query([rod.map(|rod| rod.0.as_str())])?;
        let mut standings = Vec::new();
        while let Some(row) = rows.next()? {
            let (rod, detail): (String, String) = (row.get(0)?, row.get(1)?);
            let since: Option<String> = row.get(2)?;
            let segment: u32 = row.get(3)?;
            let awaited: Option<String> = row.get(4)?;
            let latest_start = self.latest_start(&rod, now)?;
            let end = latest_start.unwrap_or(i64::MAX);
            standings.push(Standing {
                state: state::read(&rod, &detail)?,
                since: since.as_deref().map(state::time).transpose()?,
                segment,
                latest: self.one(
                    "SELECT json FROM line WHERE line.record =
                        (SELECT id FROM record WHERE rod = ? AND start_ns <= ? AND rejection IS NULL AND set_aside IS NULL
                         ORDER BY start_ns DESC, id DESC LIMIT 1)",
                    (&rod, end),
                )?,
                latest_start: latest_start.map(Timestamp::from_nanos),
                ahead: self
                    .one("SELECT count(*) FROM record WHERE rod = ? AND start_ns > ?", (&rod, end))?
                    .map_or(0, i64::unsigned_abs),
                usual_s: self.usual_s(&rod, segment, end)?,
                alarms: self.standing_alarms(&rod)?,
                words: BTreeMap::new(),
                waiting: Vec::new(),
                awaited: awaited.as_deref().map(state::time).transpose()?,
                rod: RodId(rod),
            });
        }
        Ok(standings)
    }

    /// First value of the first row of a query, if there is one.
    fn one<T: rusqlite::types::FromSql>(
        &self,
        sql: &str,
        parameters: impl Params,
    ) -> rusqlite::Result<Option<T>> {
        let mut statement = self.connection.prepare_cached(sql)?;
        statement.query_row(parameters, |row| row.get(0)).optional()
    }

    /// Start of a rod's latest record whose time can be believed \[ns\]. One that tracking set aside for its clock cannot
    /// be, nor one that lies ahead of the machine's clock beyond a gap: a recorder's clock jumped. Records that go on into
    /// the future without a gap are simulated, or the machine's own clock is wrong.
    fn latest_start(&self, rod: &str, now: Timestamp) -> rusqlite::Result<Option<i64>> {
        let latest = |from: i64, to: i64| -> rusqlite::Result<Option<i64>> {
            self.one(
                "SELECT start_ns FROM record WHERE rod = ? AND start_ns > ? AND start_ns <= ? AND set_aside IS NOT 'clock'
                 ORDER BY start_ns DESC LIMIT 1",
                (rod, from, to),
            )
        };
        let Some(mut last) = latest(i64::MIN, clock::latest_past(now).as_nanos())? else {
            return match latest(i64::MIN, i64::MAX)? {
                Some(last) => Ok(Some(last)),
                None => self
                    .one("SELECT max(start_ns) FROM record WHERE rod = ?", [rod])
                    .map(Option::flatten),
            };
        };
        while let Some(next) = latest(last, last.saturating_add(GAP_NS))? {
            last = next;
        }
        Ok(Some(last))
    }

    /// Usual distance between a rod's records up to a time \[s\], as tracking counts it: that of the baseline's records, or of
    /// the latest ones since the last long gap where there is no baseline yet.
    fn usual_s(&self, rod: &str, segment: u32, end: i64) -> Result<Option<f64>, Failure> {
        let mut statement = self.connection.prepare_cached(
            "SELECT baseline_first, baseline_last, baseline_records FROM segment
             WHERE rod = ? AND number = ? AND baseline_records > 1",
        )?;
        let baseline = statement.query_row((rod, segment), |row| {
            Ok((
                row.get::<_, String>(0)?,
                row.get::<_, String>(1)?,
                row.get::<_, u32>(2)?,
            ))
        });
        if let Some((first, last, records)) = baseline.optional()? {
            let (first, last) = (state::time(&first)?, state::time(&last)?);
            let learned = self.usable_starts(rod, first.as_nanos(), last.as_nanos(), records as usize)?;
            let mean = last.seconds_since(first) / f64::from(records - 1);
            return Ok(usual_s(learned.iter().copied()).or(Some(mean)));
        }
        let recent = self.usable_starts(rod, i64::MIN, end, RECENT)?;
        let is_near = |two: &[Timestamp]| two[1].as_nanos().saturating_sub(two[0].as_nanos()) <= GAP_NS;
        let gap = recent.windows(2).rposition(|two| !is_near(two));
        let since = gap.map_or(0, |gap| gap + 1);
        Ok(usual_s(recent[since..].iter().copied()))
    }

    /// Starts of the last `count` records between two times that count \[ns\], ascending.
    fn usable_starts(&self, rod: &str, from: i64, to: i64, count: usize) -> Result<Vec<Timestamp>, Failure> {
        let mut statement = self.connection.prepare_cached(
            "SELECT start_ns FROM record
             WHERE rod = ? AND start_ns BETWEEN ? AND ? AND rejection IS NULL AND set_aside IS NULL
             ORDER BY start_ns DESC LIMIT ?",
        )?;
        let rows = statement.query_map((rod, from, to, count as i64), |row| row.get(0))?;
        let mut starts = rows
            .map(|start| start.map(Timestamp::from_nanos))
            .collect::<rusqlite::Result<Vec<_>>>()?;
        starts.reverse();
        Ok(starts)
    }

    fn standing_alarms(&self, rod: &str) -> Result<Vec<Alarm>, Failure> {
        let mut statement = self
            .connection
            .prepare_cached("SELECT json FROM alarm WHERE rod = ? AND stands = 1 ORDER BY raised_ns, id")?;
        let mut rows = statement.query([rod])?;
        let mut alarms = Vec::new();
        while let Some(row) = rows.next()? {
            let json: String = row.get(0)?;
            alarms.push(state::read(rod, &json)?);
        }
        Ok(alarms)
    }
}
