//! Messages that are not folded, and the word on which store is the present one, as the database keeps them.

use super::centre::{Centre, CentreError};
use super::sql::{Sql, SqlError, integer, text};
use super::tables;
use rusqlite::types::Value;
use std::collections::BTreeMap;

/// A message that is not folded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Parked {
    /// Its number in the stream.
    pub sequence: i64,
    /// Site of its subject.
    pub site: String,
    /// Time at which the server took it \[ns since 1970\].
    pub time_ns: i64,
    /// Word for the reason.
    pub fault: String,
    /// The reason in one sentence.
    pub detail: String,
    /// Its headers, one a line.
    pub headers: String,
    /// Its content.
    pub payload: Vec<u8>,
}

impl Centre {
    /// Some parked messages of a site after a place, in order; with a `fault`, those of that one alone.
    ///
    /// # Errors
    /// The database refuses.
    pub fn parked(
        &mut self,
        site: &str,
        fault: Option<&str>,
        after: (i64, i64),
    ) -> Result<Vec<Parked>, CentreError> {
        /// Each holds up to a message.
        const PAGE: i64 = 16;
        let rows = self.sql.query(
            "SELECT \"sequence\", \"site\", \"time_ns\", \"fault\", \"detail\", \"headers\", \"payload\" FROM \"parked\"
             WHERE \"site\" = $1 AND (\"sequence\", \"time_ns\") > ($2, $3) AND ($4 = '' OR \"fault\" = $4)
             ORDER BY \"sequence\", \"time_ns\" LIMIT $5",
            &[
                Value::Text(site.to_owned()),
                Value::Integer(after.0),
                Value::Integer(after.1),
                Value::Text(fault.unwrap_or_default().to_owned()),
                Value::Integer(PAGE),
            ],
        )?;
        let parked = rows.into_iter().map(|row| Parked {
            sequence: integer(row.first()),
            site: text(row.get(1)),
            time_ns: integer(row.get(2)),
            fault: text(row.get(3)),
            detail: text(row.get(4)),
            headers: text(row.get(5)),
            payload: match row.into_iter().nth(6) {
                Some(Value::Blob(bytes)) => bytes,
                _ => Vec::new(),
            },
        });
        Ok(parked.collect())
    }

    /// Fault and detail of a site's first parked message.
    ///
    /// # Errors
    /// The database refuses.
    pub fn first_fault(&mut self, site: &str) -> Result<Option<(String, String)>, CentreError> {
        let rows = self.sql.query(
            "SELECT \"fault\", \"detail\" FROM \"parked\" WHERE \"site\" = $1 ORDER BY \"sequence\", \"time_ns\" LIMIT 1",
            &[Value::Text(site.to_owned())],
        )?;
        Ok(rows.first().map(|row| (text(row.first()), text(row.get(1)))))
    }

    /// Fault and detail of the first parked message of the wanted sites that have any.
    ///
    /// # Errors
    /// The database refuses.
    pub fn first_faults(
        &mut self,
        is_wanted: impl Fn(&str) -> bool,
    ) -> Result<BTreeMap<String, (String, String)>, CentreError> {
        let sites = self.sql.query("SELECT DISTINCT \"site\" FROM \"parked\"", &[])?;
        let mut faults = BTreeMap::new();
        let sites = sites.iter().map(|row| text(row.first()));
        for site in sites.filter(|site| is_wanted(site)) {
            if let Some(fault) = self.first_fault(&site)? {
                faults.insert(site, fault);
            }
        }
        Ok(faults)
    }

    /// Writes the present reason of a message that is still parked.
    ///
    /// # Errors
    /// The database refuses.
    pub fn rename(&mut self, place: (i64, i64), fault: &str, detail: &str) -> Result<(), CentreError> {
        self.sql.execute(
            "UPDATE \"parked\" SET \"fault\" = $1, \"detail\" = $2 WHERE \"sequence\" = $3 AND \"time_ns\" = $4",
            &[
                Value::Text(fault.to_owned()),
                Value::Text(detail.to_owned()),
                Value::Integer(place.0),
                Value::Integer(place.1),
            ],
        )?;
        Ok(())
    }

    /// Drops the parked messages of a site, and its mark; returns their number.
    ///
    /// # Errors
    /// The database refuses.
    pub fn discard(&mut self, site: &str) -> Result<u64, CentreError> {
        let name = [Value::Text(site.to_owned())];
        let dropped = self
            .sql
            .execute("DELETE FROM \"parked\" WHERE \"site\" = $1", &name)?;
        self.sql.execute(
            "UPDATE \"site\" SET \"fault\" = '', \"detail\" = '' WHERE \"site\" = $1",
            &name,
        )?;
        Ok(dropped)
    }

    /// Stores that are not the present one of their site though they began later: by [`tables::overruled`], the last commit that
    /// counts.
    ///
    /// # Errors
    /// The database refuses.
    pub fn overruled(&mut self) -> Result<BTreeMap<String, i64>, CentreError> {
        let rows = self.sql.query("SELECT \"key\", \"value\" FROM \"centre\"", &[])?;
        let word = |row: &Vec<Value>| Some((text(row.first()), text(row.get(1)).parse().ok()?));
        Ok(rows.iter().filter_map(word).collect())
    }

    /// Makes a history the present one of its site, whatever began after it; a rebuild keeps to that.
    ///
    /// # Errors
    /// There is none of this epoch, or the database refuses.
    pub fn make_present(&mut self, site: &str, epoch: &str) -> Result<(), CentreError> {
        let state = self.sites()?.remove(site).unwrap_or_default();
        let Some(place) = state.histories.iter().position(|history| history.epoch == epoch) else {
            let what = format!("site \"{site}\" has no store {epoch} at the centre");
            return Err(SqlError::Refused(what).into());
        };
        self.sql.batch("BEGIN")?;
        let sql = &mut *self.sql;
        let mut write = || -> Result<(), SqlError> {
            for (at, history) in state.histories.iter().enumerate() {
                let key = Value::Text(tables::overruled(site, &history.epoch));
                if at == place {
                    sql.execute("DELETE FROM \"centre\" WHERE \"key\" = $1", &[key])?;
                } else if at > place && history.overruled.is_none() {
                    sql.execute(
                        "INSERT INTO \"centre\" (\"key\", \"value\") VALUES ($1, $2)",
                        &[key, Value::Text(history.through.to_string())],
                    )?;
                }
            }
            sql.batch("COMMIT")
        };
        if let Err(error) = write() {
            let _ = self.sql.batch("ROLLBACK");
            return Err(error.into());
        }
        Ok(())
    }
}

/// Writes a message that is parked.
pub(super) fn write_parked(sql: &mut dyn Sql, parked: Parked) -> Result<(), SqlError> {
    sql.execute(
        "INSERT INTO \"parked\" (\"sequence\", \"site\", \"time_ns\", \"fault\", \"detail\", \"headers\", \"payload\")
         VALUES ($1, $2, $3, $4, $5, $6, $7) ON CONFLICT (\"sequence\", \"time_ns\") DO NOTHING",
        &[
            Value::Integer(parked.sequence),
            Value::Text(parked.site),
            Value::Integer(parked.time_ns),
            Value::Text(parked.fault),
            Value::Text(parked.detail),
            Value::Text(parked.headers),
            Value::Blob(parked.payload),
        ],
    )?;
    Ok(())
}
