//! Leases of sites without a computer, and what a worker keeps under one: rows, state and position in one transaction.
//!
//! A lease has a number, and each taking raises it. What is written under an older number is refused, however long its holder stood
//! still: the row of the lease is locked until the transaction ends. Times are those of the database's clock.

use crate::service::hub::batch::Batch;
use crate::service::hub::centre::{Centre, CentreError, Position};
use crate::service::hub::sql::{SqlError, integer, text};
use crate::site::store::Remainder;
use rusqlite::types::Value;
use std::collections::BTreeMap;
use std::time::Duration;

/// The database's clock \[ms since 1970\].
const NOW: &str = "CAST(extract(epoch FROM clock_timestamp()) * 1000 AS BIGINT)";

/// A site that a worker has.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lease {
    /// Name of the site.
    pub site: String,
    /// Number of the lease.
    number: i64,
    /// Time for which it lasts from each renewal on.
    pub lasts: Duration,
}

impl Lease {
    fn values(&self) -> Vec<Value> {
        vec![
            Value::Text(self.site.clone()),
            Value::Integer(self.number),
            Value::Integer(millis(self.lasts)),
        ]
    }
}

fn millis(time: Duration) -> i64 {
    i64::try_from(time.as_millis()).unwrap_or(i64::MAX)
}

/// State of a site at its last commit.
#[derive(Debug, Clone, PartialEq)]
pub struct Kept {
    /// Message of the stream up to which all is in it.
    pub position: Position,
    /// Rows from which a daemon goes on.
    pub remainder: Remainder,
}

impl Centre {
    /// Takes a site that nobody has, or whose holder did not renew its lease; `None` if somebody has it.
    ///
    /// # Errors
    /// The database refuses.
    pub fn take_lease(
        &mut self,
        site: &str,
        holder: &str,
        lasts: Duration,
    ) -> Result<Option<Lease>, CentreError> {
        let sql = format!(
            "INSERT INTO \"lease\" (\"site\", \"number\", \"holder\", \"until_ms\", \"sequence\", \"time_ns\")
             VALUES ($1, 1, $2, {NOW} + $3, 0, 0)
             ON CONFLICT (\"site\") DO UPDATE SET \"number\" = \"lease\".\"number\" + 1, \"holder\" = excluded.\"holder\",
                \"until_ms\" = excluded.\"until_ms\" WHERE \"lease\".\"until_ms\" < {NOW}
             RETURNING \"number\""
        );
        let values = [
            Value::Text(site.to_owned()),
            Value::Text(holder.to_owned()),
            Value::Integer(millis(lasts)),
        ];
        let taken = match self.sql.query(&sql, &values) {
            // Its holder is in the middle of a transaction.
            Err(SqlError::Busy(_)) => return Ok(None),
            taken => taken?,
        };
        Ok(taken.first().map(|row| Lease {
            site: site.to_owned(),
            number: integer(row.first()),
            lasts,
        }))
    }

    /// Makes a lease last from now on; false if another worker has the site.
    ///
    /// # Errors
    /// The database refuses.
    pub fn renew(&mut self, lease: &Lease) -> Result<bool, CentreError> {
        let sql =
            format!("UPDATE \"lease\" SET \"until_ms\" = {NOW} + $3 WHERE \"site\" = $1 AND \"number\" = $2");
        Ok(self.sql.execute(&sql, &lease.values())? == 1)
    }

    /// Ends a lease: the site is free at once.
    ///
    /// # Errors
    /// The database refuses.
    pub fn release(&mut self, lease: &Lease) -> Result<(), CentreError> {
        let sql = "UPDATE \"lease\" SET \"until_ms\" = 0 WHERE \"site\" = $1 AND \"number\" = $2";
        self.sql.execute(sql, &lease.values()[..2])?;
        Ok(())
    }

    /// State of a site at its last commit; `None` before the first.
    ///
    /// # Errors
    /// The database refuses, or the state cannot be read.
    pub fn kept(&mut self, site: &str) -> Result<Option<Kept>, CentreError> {
        let sql = "SELECT \"sequence\", \"time_ns\", \"remainder\" FROM \"lease\" WHERE \"site\" = $1";
        let rows = self.sql.query(sql, &[Value::Text(site.to_owned())])?;
        let Some(row) = rows.first() else { return Ok(None) };
        let Some(Value::Blob(bytes)) = row.get(2) else {
            return Ok(None);
        };
        Ok(Some(Kept {
            position: Position {
                sequence: integer(row.first()),
                time_ns: integer(row.get(1)),
            },
            remainder: Remainder::decode(bytes)?,
        }))
    }

    /// Makes rows and state durable at once, and renews the lease; false, and nothing is written, if another worker has the site.
    ///
    /// # Errors
    /// The database refuses; nothing was written, unless the connection was lost at the very end.
    pub fn commit_under(&mut self, lease: &Lease, batch: Batch, kept: &Kept) -> Result<bool, CentreError> {
        let sql = format!(
            "UPDATE \"lease\" SET \"until_ms\" = {NOW} + $3, \"sequence\" = $4, \"time_ns\" = $5, \"remainder\" = $6
             WHERE \"site\" = $1 AND \"number\" = $2"
        );
        let mut values = lease.values();
        values.extend([
            Value::Integer(kept.position.sequence),
            Value::Integer(kept.position.time_ns),
            Value::Blob(kept.remainder.encode()?),
        ]);
        self.commit_if(batch, |own| Ok(own.execute(&sql, &values)? == 1))
    }

    /// Names of the workers that have a site, by its name.
    ///
    /// # Errors
    /// The database refuses.
    pub fn holders(&mut self) -> Result<BTreeMap<String, String>, CentreError> {
        let sql = format!("SELECT \"site\", \"holder\" FROM \"lease\" WHERE \"until_ms\" >= {NOW}");
        let rows = self.sql.query(&sql, &[])?;
        Ok(rows
            .iter()
            .map(|row| (text(row.first()), text(row.get(1))))
            .collect())
    }
}
