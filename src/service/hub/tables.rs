//! Tables of the centre: those of a store with site and store in front, and its own.

use super::sql::{Sql, SqlError, integer, text};
use crate::site::store::{Shape, StoreError, ValueKind, shapes};
use rusqlite::types::Value;
use std::collections::BTreeSet;
use std::fmt::Write;

/// Format of the centre's own tables.
const FORMAT: &str = "2";
/// Format without the column [`COMMIT`].
const WITHOUT_COMMIT: &str = "1";

/// Tables partitioned by the month of their records or periods, in PostgreSQL.
pub const MONTHLY: [&str; 4] = ["record", "line", "mode", "period"];

/// Column with the commit that last wrote a row; 0 where a hub without it did.
pub const COMMIT: &str = "commit";

/// Month of what has no time that can be believed.
pub const NO_MONTH: i64 = 0;

/// Month of a time as year and month: 202607.
pub fn month_of(start_ns: Option<i64>) -> i64 {
    /// 1990 to 2100: a clock outside is wrong, and a partition for each month it names is no help.
    const YEARS: std::ops::RangeInclusive<i16> = 1990..=2100;
    let time = start_ns.and_then(|ns| jiff::Timestamp::from_nanosecond(i128::from(ns)).ok());
    let Some(time) = time else { return NO_MONTH };
    let date = time.to_zoned(jiff::tz::TimeZone::UTC).date();
    if YEARS.contains(&date.year()) {
        i64::from(date.year()) * 100 + i64::from(date.month())
    } else {
        NO_MONTH
    }
}

/// A table of the centre that copies one of a store.
#[derive(Debug, Clone)]
pub struct Copied {
    /// The store's table.
    pub shape: Shape,
    /// True with a column for the month.
    pub is_monthly: bool,
}

impl Copied {
    /// All of them.
    ///
    /// # Errors
    /// There is no memory for an empty store.
    pub fn all() -> Result<Vec<Self>, StoreError> {
        let all = shapes()?.into_iter().map(|mut shape| {
            // A configuration names its site in words; here the column is the centre's.
            for column in shape.columns.iter_mut().filter(|column| column.name == "site") {
                column.name = "site_name".to_owned();
            }
            Self {
                is_monthly: MONTHLY.contains(&shape.table),
                shape,
            }
        });
        Ok(all.collect())
    }

    /// True with a column for the commit: records, lines and modes are never changed, and known by their number.
    pub fn has_commit(&self) -> bool {
        !["record", "line", "mode"].contains(&self.shape.table)
    }

    /// Columns in order: site, store, perhaps month and commit, and the store's own.
    pub fn columns(&self) -> Vec<&str> {
        let mut columns = vec!["site", "store"];
        if self.is_monthly {
            columns.push("month");
        }
        if self.has_commit() {
            columns.push(COMMIT);
        }
        columns.extend(self.shape.columns.iter().map(|column| column.name.as_str()));
        columns
    }

    /// Columns of the primary key.
    pub fn key(&self) -> Vec<&str> {
        let mut own: Vec<_> = self
            .shape
            .columns
            .iter()
            .filter(|column| column.key > 0)
            .collect();
        own.sort_by_key(|column| column.key);
        let mut key = vec!["site", "store"];
        key.extend(own.iter().map(|column| column.name.as_str()));
        if self.is_monthly {
            key.push("month");
        }
        key
    }

    /// The one column of the store's own key; `None` if it has several.
    pub fn own_key(&self) -> Option<&str> {
        let mut own = self.shape.columns.iter().filter(|column| column.key > 0);
        let key = own.next()?;
        own.next().is_none().then_some(key.name.as_str())
    }

    fn definition(&self, is_postgres: bool) -> String {
        let kind = |kind: ValueKind| match (kind, is_postgres) {
            (ValueKind::Integer, true) => "BIGINT",
            (ValueKind::Integer, false) => "INTEGER",
            (ValueKind::Real, true) => "DOUBLE PRECISION",
            (ValueKind::Real, false) => "REAL",
            (ValueKind::Text, _) => "TEXT",
            (ValueKind::Blob, true) => "BYTEA",
            (ValueKind::Blob, false) => "BLOB",
        };
        let number = kind(ValueKind::Integer);
        let mut sql = format!(
            "CREATE TABLE IF NOT EXISTS \"{}\" (\"site\" TEXT NOT NULL, \"store\" {number} NOT NULL, ",
            self.shape.table
        );
        if self.is_monthly {
            let _ = write!(sql, "\"month\" {number} NOT NULL, ");
        }
        if self.has_commit() {
            let _ = write!(sql, "\"{COMMIT}\" {number} NOT NULL DEFAULT 0, ");
        }
        for column in &self.shape.columns {
            let required = if column.is_required { " NOT NULL" } else { "" };
            let _ = write!(sql, "\"{}\" {}{required}, ", column.name, kind(column.kind));
        }
        let _ = write!(sql, "PRIMARY KEY ({}))", quoted(&self.key()));
        match (is_postgres, self.is_monthly) {
            (true, true) => sql += " PARTITION BY LIST (\"month\")",
            (true, false) => {}
            (false, _) => sql += " STRICT, WITHOUT ROWID",
        }
        sql + ";"
    }

    /// Statement that writes `rows` rows at once; a row of the same key is replaced.
    pub fn upsert(&self, rows: usize) -> String {
        let (columns, key) = (self.columns(), self.key());
        let mut places = String::new();
        for row in 0..rows {
            let numbers = (1..=columns.len()).map(|column| format!("${}", row * columns.len() + column));
            let separator = if row > 0 { ", " } else { "" };
            let _ = write!(places, "{separator}({})", numbers.collect::<Vec<_>>().join(", "));
        }
        let updates: Vec<String> = columns
            .iter()
            .filter(|column| !key.contains(column))
            .map(|column| format!("\"{column}\" = excluded.\"{column}\""))
            .collect();
        format!(
            "INSERT INTO \"{}\" ({}) VALUES {places} ON CONFLICT ({}) DO UPDATE SET {}",
            self.shape.table,
            quoted(&columns),
            quoted(&key),
            updates.join(", ")
        )
    }
}

/// Names in quotes: some are words of SQL.
pub fn quoted(names: &[&str]) -> String {
    let names: Vec<String> = names.iter().map(|name| format!("\"{name}\"")).collect();
    names.join(", ")
}

/// The centre's own tables.
const OWN: [(&str, &str); 8] = [
    ("centre", "(\"key\" TEXT PRIMARY KEY, \"value\" TEXT NOT NULL)"),
    // The latest message of the stream that was folded.
    (
        "position",
        "(\"stream\" TEXT PRIMARY KEY, \"sequence\" INT8 NOT NULL, \"time_ns\" INT8 NOT NULL)",
    ),
    // Histories of each site, in the order in which they began here.
    (
        "store",
        "(\"site\" TEXT NOT NULL, \"store\" INT8 NOT NULL, \"epoch\" TEXT NOT NULL, \"began_ns\" INT8 NOT NULL, \
          \"through\" INT8 NOT NULL, \"sequence\" INT8 NOT NULL, \"latest_ns\" INT8 NOT NULL, PRIMARY KEY (\"site\", \"store\"))",
    ),
    // The latest that was heard of a site, and what is wrong with its messages.
    (
        "site",
        "(\"site\" TEXT PRIMARY KEY, \"heard_ns\" INT8 NOT NULL, \"fault\" TEXT NOT NULL, \"detail\" TEXT NOT NULL)",
    ),
    // The latest heartbeat of each site: times by the post's clock and by the site's, and what it said, as JSON.
    (
        "beat",
        "(\"site\" TEXT PRIMARY KEY, \"heard_ns\" INT8 NOT NULL, \"clock_ns\" INT8 NOT NULL, \"through\" INT8 NOT NULL, \
          \"state\" TEXT NOT NULL, \"json\" TEXT NOT NULL)",
    ),
    // Commands to the sites as they were signed; `condition` is the id of the notice with the site's answer.
    (
        "command",
        "(\"site\" TEXT NOT NULL, \"number\" INT8 NOT NULL, \"condition\" TEXT NOT NULL, \"expires_ns\" INT8 NOT NULL, \
          \"text\" TEXT NOT NULL, \"signature\" TEXT NOT NULL, PRIMARY KEY (\"site\", \"number\"))",
    ),
    // Messages that were not folded, with the reason.
    (
        "parked",
        "(\"sequence\" INT8 NOT NULL, \"time_ns\" INT8 NOT NULL, \"site\" TEXT NOT NULL, \"fault\" TEXT NOT NULL, \
          \"detail\" TEXT NOT NULL, \"headers\" TEXT NOT NULL, \"payload\" BYTES NOT NULL, \
          PRIMARY KEY (\"sequence\", \"time_ns\"))",
    ),
    // The worker that has a site without a computer: the number of its lease, which fences off those before it, its name, and the
    // end of the lease by the database's clock; then the state at the last commit: id of the store, the message up to which all is
    // in it, and the remainder of the store.
    (
        "lease",
        "(\"site\" TEXT PRIMARY KEY, \"number\" INT8 NOT NULL, \"holder\" TEXT NOT NULL, \"until_ms\" INT8 NOT NULL, \
          \"sequence\" INT8 NOT NULL, \"time_ns\" INT8 NOT NULL, \"remainder\" BYTES)",
    ),
];

/// Key in the table `centre` of the word that a store is not the present one of its site, though it began later.
pub fn overruled(site: &str, epoch: &str) -> String {
    format!("overruled {site} {epoch}")
}

/// Present store of each site.
const PRESENT: &str = "VIEW \"present\" AS SELECT s.\"site\" AS \"site\", max(s.\"store\") AS \"store\" FROM \"store\" s \
    WHERE NOT EXISTS (SELECT 1 FROM \"centre\" c WHERE c.\"key\" = 'overruled ' || s.\"site\" || ' ' || s.\"epoch\") \
    GROUP BY s.\"site\";";

/// Names of all tables.
pub fn names(copied: &[Copied]) -> Vec<&str> {
    let own = OWN.iter().map(|(name, _)| *name);
    own.chain(copied.iter().map(|copied| copied.shape.table))
        .collect()
}

/// Creates the tables that are missing.
///
/// # Errors
/// The database refuses, or its tables are of another format.
pub fn create(sql: &mut dyn Sql, copied: &[Copied]) -> Result<(), SqlError> {
    let is_postgres = sql.is_postgres();
    let (number, bytes) = if is_postgres {
        ("BIGINT", "BYTEA")
    } else {
        ("INTEGER", "BLOB")
    };
    let mut all = String::new();
    for (name, columns) in OWN {
        let columns = columns.replace("INT8", number).replace("BYTES", bytes);
        let _ = writeln!(all, "CREATE TABLE IF NOT EXISTS \"{name}\" {columns};");
    }
    for copied in copied {
        let _ = writeln!(all, "{}", copied.definition(is_postgres));
    }
    let create = if is_postgres {
        "CREATE OR REPLACE"
    } else {
        "CREATE"
    };
    let there = if is_postgres { "VIEW" } else { "VIEW IF NOT EXISTS" };
    all += &format!("{create} {}\n", PRESENT.replacen("VIEW", there, 1));
    all += "CREATE INDEX IF NOT EXISTS \"record_of_rod\" ON \"record\" (\"site\", \"store\", \"rod\", \"start_ns\");";
    sql.batch(&all)?;
    sql.execute(
        "INSERT INTO \"centre\" (\"key\", \"value\") VALUES ('format', $1) ON CONFLICT DO NOTHING",
        &[Value::Text(FORMAT.to_owned())],
    )?;
    if format(sql)? == WITHOUT_COMMIT {
        let mut all = "BEGIN;".to_owned();
        for copied in copied.iter().filter(|copied| copied.has_commit()) {
            let table = copied.shape.table;
            let _ = write!(
                all,
                "ALTER TABLE \"{table}\" ADD COLUMN \"{COMMIT}\" {number} NOT NULL DEFAULT 0;"
            );
        }
        let _ = write!(
            all,
            "UPDATE \"centre\" SET \"value\" = '{FORMAT}' WHERE \"key\" = 'format'; COMMIT;"
        );
        sql.batch(&all)?;
    }
    check(sql)?;
    let by_commit = format!("\"period_by_commit\" ON \"period\" (\"site\", \"store\", \"{COMMIT}\");");
    sql.batch(&format!("CREATE INDEX IF NOT EXISTS {by_commit}"))
}

fn format(sql: &mut dyn Sql) -> Result<String, SqlError> {
    let found = sql.query("SELECT \"value\" FROM \"centre\" WHERE \"key\" = 'format'", &[])?;
    Ok(text(found.first().and_then(|row| row.first())))
}

/// Checks the format of the tables.
///
/// # Errors
/// It is another one, or there are none yet.
pub fn check(sql: &mut dyn Sql) -> Result<(), SqlError> {
    let found = format(sql)?;
    if found.is_empty() {
        let what = "the centre's tables are not made yet: start the hub first";
        return Err(SqlError::Refused(what.to_owned()));
    }
    if found == WITHOUT_COMMIT {
        let what =
            "the centre's tables are of an older hub: start the hub once, and it brings them up to date";
        return Err(SqlError::Refused(what.to_owned()));
    }
    if found != FORMAT {
        return Err(SqlError::Refused(format!(
            "the centre's tables are of format {found}, and this program knows {FORMAT}"
        )));
    }
    Ok(())
}

/// Partitions known to exist.
#[derive(Debug, Default)]
pub struct Partitions(Option<BTreeSet<i64>>);

impl Partitions {
    /// Creates the partitions of the months that have none.
    ///
    /// # Errors
    /// The database refuses.
    pub fn ensure(&mut self, sql: &mut dyn Sql, months: &BTreeSet<i64>) -> Result<(), SqlError> {
        if !sql.is_postgres() {
            return Ok(());
        }
        let known = match &mut self.0 {
            Some(known) => known,
            none => {
                let found = sql.query(
                    // Those of our table alone: another schema may hold a copy of the centre.
                    "SELECT CAST(substr(relname, 8) AS BIGINT) FROM pg_inherits JOIN pg_class ON pg_class.oid = inhrelid
                     WHERE inhparent = '\"period\"'::regclass AND relname ~ '^period_[0-9]+$'",
                    &[],
                )?;
                none.insert(found.iter().map(|row| integer(row.first())).collect())
            }
        };
        for month in months.difference(&known.clone()) {
            for table in MONTHLY {
                sql.batch(&format!(
                    "CREATE TABLE IF NOT EXISTS \"{table}_{month}\" PARTITION OF \"{table}\" FOR VALUES IN ({month});"
                ))?;
            }
            known.insert(*month);
        }
        Ok(())
    }

    /// Forgets what is known, after a transaction that did not come about.
    pub fn forget(&mut self) {
        self.0 = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn months_are_those_of_utc_and_wrong_clocks_have_none() {
        for (ns, month) in [
            (Some(1_782_863_999_999_999_999), 202606),
            (Some(1_782_864_000_000_000_000), 202607),
            (Some(0), NO_MONTH),
            (Some(i64::MAX), NO_MONTH),
            (None, NO_MONTH),
        ] {
            assert_eq!(month_of(ns), month, "{ns:?}");
        }
    }

    #[test]
    fn every_monthly_table_is_copied_and_has_its_month_in_the_key() {
        let copied = Copied::all().unwrap();
        for name in MONTHLY {
            let found = copied.iter().find(|copied| copied.shape.table == name).unwrap();
            assert!(found.key().contains(&"month"));
        }
        for copied in copied {
            let columns = copied.columns();
            let distinct: BTreeSet<&&str> = columns.iter().collect();
            assert_eq!(distinct.len(), columns.len(), "{columns:?}");
        }
    }
}
