//! The centre's database: what it knows of each site, and a batch of messages written as one transaction.

use super::batch::{Batch, Claim};
use super::beats::Heard;
use super::park::write_parked;
use super::sql::{Sql, SqlError, integer, text};
use super::tables::{self, Copied, NO_MONTH, Partitions};
use crate::site::store::StoreError;
use rusqlite::types::Value;
use std::collections::BTreeMap;

/// Most rows written by one statement.
const TOGETHER: usize = 64;

/// Error of the centre.
#[derive(Debug, thiserror::Error)]
pub enum CentreError {
    /// The database.
    #[error("the centre's database: {0}")]
    Sql(SqlError),
    /// The shapes of the tables.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl From<SqlError> for CentreError {
    fn from(error: SqlError) -> Self {
        Self::Sql(error)
    }
}

/// History of one store of a site.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct History {
    /// Its number at the centre, from 1 in the order in which they began.
    pub store: i64,
    /// Id of the store.
    pub epoch: String,
    /// Time at which it began here \[ns since 1970\].
    pub began_ns: i64,
    /// Last commit folded.
    pub through: i64,
    /// Message of the stream that held it.
    pub sequence: i64,
    /// Begin of its latest record \[ns since 1970\]; 0 without any.
    pub latest_ns: i64,
    /// Last commit that counts, if an operator said that it is not the site's present one though it began later.
    pub overruled: Option<i64>,
}

/// Knowledge of the centre of a site.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SiteState {
    /// Its histories in the order in which they began.
    pub histories: Vec<History>,
    /// Time of its latest message \[ns since 1970\].
    pub heard_ns: i64,
    /// Fault of its messages that lasts, as `gap`, with its detail.
    pub fault: Option<(String, String)>,
}

impl SiteState {
    /// Place of the present history: the last that was not overruled.
    pub fn present(&self) -> Option<usize> {
        self.histories
            .iter()
            .rposition(|history| history.overruled.is_none())
    }

    /// The present history.
    pub fn history(&self) -> Option<&History> {
        self.histories.get(self.present()?)
    }
}

/// Place in the stream: its latest message that was folded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Position {
    /// Its number; 0 before any.
    pub sequence: i64,
    /// Time at which the server took it \[ns since 1970\]: another message of the same number has another one.
    pub time_ns: i64,
}

/// The centre's database.
pub struct Centre {
    pub(super) sql: Box<dyn Sql>,
    copied: Vec<Copied>,
    partitions: Partitions,
    stream: &'static str,
}

impl Centre {
    /// Opens a database and creates the tables it lacks.
    ///
    /// # Errors
    /// The database refuses, or its tables are of another format.
    pub fn open(mut sql: Box<dyn Sql>) -> Result<Self, CentreError> {
        let copied = Copied::all()?;
        tables::create(&mut *sql, &copied)?;
        let mut partitions = Partitions::default();
        partitions.ensure(&mut *sql, &[NO_MONTH].into())?;
        Ok(Self::over(sql, copied, partitions))
    }

    /// Reads a database that a hub has made.
    ///
    /// # Errors
    /// No hub has, or its tables are of another format.
    pub fn beside(mut sql: Box<dyn Sql>) -> Result<Self, CentreError> {
        tables::check(&mut *sql)?;
        Ok(Self::over(sql, Copied::all()?, Partitions::default()))
    }

    fn over(sql: Box<dyn Sql>, copied: Vec<Copied>, partitions: Partitions) -> Self {
        Self {
            sql,
            copied,
            partitions,
            stream: crate::service::forward::message::STREAM,
        }
    }

    /// Tables that copy those of a store.
    pub fn copied(&self) -> &[Copied] {
        &self.copied
    }

    /// The database, for other questions.
    pub fn sql(&mut self) -> &mut dyn Sql {
        &mut *self.sql
    }

    /// Latest message of the stream that was folded.
    ///
    /// # Errors
    /// The database refuses.
    pub fn position(&mut self) -> Result<Position, CentreError> {
        let found = self.sql.query(
            "SELECT \"sequence\", \"time_ns\" FROM \"position\" WHERE \"stream\" = $1",
            &[Value::Text(self.stream.to_owned())],
        )?;
        let of = |place: usize| integer(found.first().and_then(|row| row.get(place)));
        Ok(Position {
            sequence: of(0),
            time_ns: of(1),
        })
    }

    /// State of every site.
    ///
    /// # Errors
    /// The database refuses.
    pub fn sites(&mut self) -> Result<BTreeMap<String, SiteState>, CentreError> {
        let mut sites = BTreeMap::<String, SiteState>::new();
        let rows = self.sql.query(
            "SELECT \"site\", \"heard_ns\", \"fault\", \"detail\" FROM \"site\"",
            &[],
        )?;
        for row in rows {
            let fault = text(row.get(2));
            let state = SiteState {
                histories: Vec::new(),
                heard_ns: integer(row.get(1)),
                fault: (!fault.is_empty()).then(|| (fault, text(row.get(3)))),
            };
            sites.insert(text(row.first()), state);
        }
        let rows = self.sql.query(
            "SELECT \"site\", \"store\", \"epoch\", \"began_ns\", \"through\", \"sequence\", \"latest_ns\" FROM \"store\"
             ORDER BY \"site\", \"store\"",
            &[],
        )?;
        let overruled = self.overruled()?;
        for row in rows {
            let history = History {
                store: integer(row.get(1)),
                epoch: text(row.get(2)),
                began_ns: integer(row.get(3)),
                through: integer(row.get(4)),
                sequence: integer(row.get(5)),
                latest_ns: integer(row.get(6)),
                overruled: overruled
                    .get(&tables::overruled(&text(row.first()), &text(row.get(2))))
                    .copied(),
            };
            sites
                .entry(text(row.first()))
                .or_default()
                .histories
                .push(history);
        }
        Ok(sites)
    }

    /// Number of rows of a copied table, by site and store.
    ///
    /// # Errors
    /// The database refuses.
    pub fn counts(&mut self, table: &str) -> Result<BTreeMap<(String, i64), i64>, CentreError> {
        let sql =
            format!("SELECT \"site\", \"store\", count(*) FROM \"{table}\" GROUP BY \"site\", \"store\"");
        let rows = self.sql.query(&sql, &[])?;
        let count = |row: Vec<Value>| ((text(row.first()), integer(row.get(1))), integer(row.get(2)));
        Ok(rows.into_iter().map(count).collect())
    }

    /// Every row of a copied table of one store, in the order of its key, as that store has it.
    ///
    /// # Errors
    /// The database refuses.
    pub fn rows_of(
        &mut self,
        copied: &Copied,
        site: &str,
        store: i64,
    ) -> Result<Vec<Vec<Value>>, CentreError> {
        let columns: Vec<&str> = copied.shape.columns.iter().map(|c| c.name.as_str()).collect();
        let key = copied.key();
        let bytewise = self.sql.is_postgres();
        let order: Vec<String> = key[2..]
            .iter()
            .filter(|column| **column != "month")
            .map(|column| {
                let is_text =
                    copied.shape.columns.iter().any(|known| {
                        known.name == *column && known.kind == crate::site::store::ValueKind::Text
                    });
                // A store's order is that of the bytes.
                let collation = if bytewise && is_text { " COLLATE \"C\"" } else { "" };
                format!("\"{column}\"{collation}")
            })
            .collect();
        let sql = format!(
            "SELECT {} FROM \"{}\" WHERE \"site\" = $1 AND \"store\" = $2 ORDER BY {}",
            tables::quoted(&columns),
            copied.shape.table,
            order.join(", ")
        );
        let values = [Value::Text(site.to_owned()), Value::Integer(store)];
        Ok(self.sql.query(&sql, &values)?)
    }

    /// Makes all of a batch durable, or nothing.
    ///
    /// # Errors
    /// The database refuses; nothing was written.
    pub fn commit(&mut self, batch: Batch) -> Result<(), CentreError> {
        self.commit_if(batch, |_| Ok(true)).map(|_| ())
    }

    /// The same if a first statement of the transaction allows it; false if not, and nothing was written.
    ///
    /// # Errors
    /// The database refuses; nothing was written.
    pub(super) fn commit_if(
        &mut self,
        batch: Batch,
        allow: impl FnOnce(&mut dyn Sql) -> Result<bool, SqlError>,
    ) -> Result<bool, CentreError> {
        self.sql.batch("BEGIN")?;
        let written = allow(&mut *self.sql).and_then(|is_allowed| {
            if is_allowed {
                self.write(batch)?;
            }
            self.sql.batch(if is_allowed { "COMMIT" } else { "ROLLBACK" })?;
            Ok(is_allowed)
        });
        if written.is_err() {
            self.partitions.forget();
            // The first error matters more; a lost connection has rolled back by itself.
            let _ = self.sql.batch("ROLLBACK");
        }
        Ok(written?)
    }

    fn write(&mut self, batch: Batch) -> Result<(), SqlError> {
        let sql = &mut *self.sql;
        self.partitions.ensure(sql, &batch.months)?;
        for (site, store, rod) in batch.forgotten {
            let values = [Value::Text(site), Value::Integer(store), Value::Text(rod)];
            for table in ["segment", "rod"] {
                let sentence = format!(
                    "DELETE FROM \"{table}\" WHERE \"site\" = $1 AND \"store\" = $2 AND \"rod\" = $3"
                );
                sql.execute(&sentence, &values)?;
            }
        }
        let mut by_table = BTreeMap::<usize, Vec<Vec<Value>>>::new();
        for ((table, _), values) in batch.rows {
            by_table.entry(table).or_default().push(values);
        }
        for (table, rows) in by_table {
            let Some(copied) = self.copied.get(table) else {
                continue;
            };
            let mut rows = rows.as_slice();
            while !rows.is_empty() {
                // Few different lengths: each is a statement to prepare.
                let count = TOGETHER.min(1 << rows.len().ilog2());
                let (now, later) = rows.split_at(count);
                sql.execute(&copied.upsert(count), &now.concat())?;
                rows = later;
            }
        }
        for ((table, site, store), claims) in batch.claims {
            if let Some(copied) = self.copied.get(table) {
                confirm(sql, copied, (&site, store), &claims)?;
            }
        }
        for (site, state) in batch.sites {
            write_site(sql, &site, state)?;
        }
        for parked in batch.parked {
            write_parked(sql, parked)?;
        }
        for (sequence, time_ns) in batch.taken_up {
            sql.execute(
                "DELETE FROM \"parked\" WHERE \"sequence\" = $1 AND \"time_ns\" = $2",
                &[Value::Integer(sequence), Value::Integer(time_ns)],
            )?;
        }
        if let Some(position) = batch.position {
            sql.execute(
                "INSERT INTO \"position\" (\"stream\", \"sequence\", \"time_ns\") VALUES ($1, $2, $3)
                 ON CONFLICT (\"stream\") DO UPDATE SET \"sequence\" = excluded.\"sequence\", \"time_ns\" = excluded.\"time_ns\"",
                &[
                    Value::Text(self.stream.to_owned()),
                    Value::Integer(position.sequence),
                    Value::Integer(position.time_ns),
                ],
            )?;
        }
        Ok(())
    }

    /// Keeps heartbeats, each in the place of the one before.
    ///
    /// # Errors
    /// The database refuses; nothing was written.
    pub fn keep_beats(&mut self, beats: &BTreeMap<String, Heard>) -> Result<(), CentreError> {
        self.sql.batch("BEGIN")?;
        let sql = &mut *self.sql;
        let written = beats
            .iter()
            .try_for_each(|(site, heard)| write_beat(sql, site, heard))
            .and_then(|()| sql.batch("COMMIT"));
        if let Err(error) = written {
            let _ = self.sql.batch("ROLLBACK");
            return Err(error.into());
        }
        Ok(())
    }

    /// Latest heartbeat of each site.
    ///
    /// # Errors
    /// The database refuses.
    pub fn beats(&mut self) -> Result<BTreeMap<String, Heard>, CentreError> {
        let rows = self
            .sql
            .query("SELECT \"site\", \"heard_ns\", \"json\" FROM \"beat\"", &[])?;
        let heard = |row: &Vec<Value>| {
            // Written by a program of another version: the next heartbeat takes its place.
            let beat = serde_json::from_str(&text(row.get(2))).ok()?;
            let heard_ns = integer(row.get(1));
            Some((text(row.first()), Heard { heard_ns, beat }))
        };
        Ok(rows.iter().filter_map(heard).collect())
    }

    /// Leaves the time of flushes to the database: when it ends unexpectedly, the last transactions may be undone, the position with them,
    /// but no part of one. For what can be folded again.
    ///
    /// # Errors
    /// The database refuses.
    pub fn flush_later(&mut self) -> Result<(), CentreError> {
        let setting = if self.sql.is_postgres() {
            "SET synchronous_commit = off"
        } else {
            "PRAGMA synchronous = NORMAL"
        };
        Ok(self.sql.batch(setting)?)
    }

    /// Empties every table but the commands, to fold the stream from its beginning.
    ///
    /// # Errors
    /// The database refuses.
    pub fn clear(&mut self) -> Result<(), CentreError> {
        let empty = if self.sql.is_postgres() {
            "TRUNCATE"
        } else {
            "DELETE FROM"
        };
        let mut all = String::from("BEGIN;");
        for name in tables::names(&self.copied) {
            if !["centre", "command"].contains(&name) {
                all += &format!("{empty} \"{name}\";");
            }
        }
        Ok(self.sql.batch(&(all + "COMMIT;"))?)
    }
}

/// Refuses rows that are not in the database as they are claimed: the store that wrote their commits is not the one that goes on.
fn confirm(
    sql: &mut dyn Sql,
    copied: &Copied,
    (site, store): (&str, i64),
    claims: &[Claim],
) -> Result<(), SqlError> {
    let Some(key) = copied.own_key() else {
        return Ok(());
    };
    let table = copied.shape.table;
    for claims in claims.chunks(TOGETHER) {
        let places: Vec<String> = (0..claims.len()).map(|place| format!("${}", place + 3)).collect();
        let question = format!(
            "SELECT \"{key}\", \"checksum\" FROM \"{table}\" WHERE \"site\" = $1 AND \"store\" = $2 AND \"{key}\" IN ({})",
            places.join(", ")
        );
        let keys = claims.iter().map(|claim| claim.row.0.clone());
        let values: Vec<Value> = [Value::Text(site.to_owned()), Value::Integer(store)]
            .into_iter()
            .chain(keys)
            .collect();
        let found = sql.query(&question, &values)?;
        for Claim {
            commit,
            row: (value, checksum),
        } in claims
        {
            let is_there = |row: &Vec<Value>| row.first() == Some(value) && integer(row.get(1)) == *checksum;
            if !found.iter().any(is_there) {
                return Err(SqlError::Contradiction(format!(
                    "commit {commit} is folded already, and wrote another row of table {table}: the store was set back to a copy and \
                     went on from there; begin a new store at the site"
                )));
            }
        }
    }
    Ok(())
}

fn write_beat(sql: &mut dyn Sql, site: &str, heard: &Heard) -> Result<(), SqlError> {
    let beat = &heard.beat;
    let json = serde_json::to_string(beat).map_err(|error| SqlError::Refused(error.to_string()))?;
    sql.execute(
        "INSERT INTO \"beat\" (\"site\", \"heard_ns\", \"clock_ns\", \"through\", \"state\", \"json\")
         VALUES ($1, $2, $3, $4, $5, $6)
         ON CONFLICT (\"site\") DO UPDATE SET \"heard_ns\" = excluded.\"heard_ns\", \"clock_ns\" = excluded.\"clock_ns\",
            \"through\" = excluded.\"through\", \"state\" = excluded.\"state\", \"json\" = excluded.\"json\"",
        &[
            Value::Text(site.to_owned()),
            Value::Integer(heard.heard_ns),
            Value::Integer(beat.time_ns),
            Value::Integer(beat.through),
            Value::Text(beat.state.clone()),
            Value::Text(json),
        ],
    )?;
    Ok(())
}

fn write_site(sql: &mut dyn Sql, site: &str, state: SiteState) -> Result<(), SqlError> {
    let (fault, detail) = state.fault.unwrap_or_default();
    sql.execute(
        "INSERT INTO \"site\" (\"site\", \"heard_ns\", \"fault\", \"detail\") VALUES ($1, $2, $3, $4)
         ON CONFLICT (\"site\") DO UPDATE SET \"heard_ns\" = excluded.\"heard_ns\",
            \"fault\" = excluded.\"fault\", \"detail\" = excluded.\"detail\"",
        &[
            Value::Text(site.to_owned()),
            Value::Integer(state.heard_ns),
            Value::Text(fault),
            Value::Text(detail),
        ],
    )?;
    for history in &state.histories {
        sql.execute(
            "INSERT INTO \"store\" (\"site\", \"store\", \"epoch\", \"began_ns\", \"through\", \"sequence\", \"latest_ns\")
             VALUES ($1, $2, $3, $4, $5, $6, $7)
             ON CONFLICT (\"site\", \"store\") DO UPDATE SET \"through\" = excluded.\"through\",
                \"sequence\" = excluded.\"sequence\", \"latest_ns\" = excluded.\"latest_ns\"",
            &[
                Value::Text(site.to_owned()),
                Value::Integer(history.store),
                Value::Text(history.epoch.clone()),
                Value::Integer(history.began_ns),
                Value::Integer(history.through),
                Value::Integer(history.sequence),
                Value::Integer(history.latest_ns),
            ],
        )?;
    }
    Ok(())
}
