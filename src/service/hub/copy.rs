//! A site's rows at the centre as a store of its own: whatever reads a store reads them, page, history, report and exports.

use super::centre::{Centre, CentreError};
use super::sql::integer;
use super::tables::{self, Copied, NO_MONTH, month_of};
use crate::site::store::{Durability, Reader, Shape, Store, StoreError, shapes};
use rusqlite::types::Value;
use std::path::Path;

/// Records read at once.
const PAGE: i64 = 5000;
/// Age of a period that may still change place with a later one \[ns\]: a late record closes none before.
const LATE_NS: i64 = 62 * 86_400 * 1_000_000_000;

/// Error of a copy.
#[derive(Debug, thiserror::Error)]
pub enum CopyError {
    /// The centre's database.
    #[error(transparent)]
    Centre(#[from] CentreError),
    /// The copy.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// There is nothing to copy.
    #[error("the centre has no store of site {0}")]
    Unknown(String),
    /// There is no such history.
    #[error("stores of site {0} at the centre: {1}, numbered from 1")]
    NoSegment(String, usize),
    /// Another store took the place of the one that was copied.
    #[error("the store of site {0} was replaced")]
    Replaced(String),
}

/// A copy that can be brought up to date.
pub struct SiteCopy {
    store: Store,
    shapes: Vec<Shape>,
    site: String,
    /// Number of its history at the centre.
    number: i64,
    /// True if it follows the present history, whatever its number.
    is_present: bool,
    /// Last commit of the centre that it has.
    through: i64,
    /// First month whose records it has.
    from_month: i64,
    /// Month from which on periods are read again.
    periods_from: i64,
}

impl SiteCopy {
    /// Begins the copy of a site's present history, or of an earlier one by its number, at `path`; with the records of all months, or
    /// from one on.
    ///
    /// # Errors
    /// The centre has no such history, or the file cannot be created.
    pub fn begin(
        centre: &mut Centre,
        site: &str,
        number: Option<i64>,
        from_month: Option<i64>,
        path: &Path,
    ) -> Result<Self, CopyError> {
        let state = centre.sites()?.remove(site);
        let state = state.ok_or_else(|| CopyError::Unknown(site.to_owned()))?;
        let history = match number {
            None => state
                .history()
                .ok_or_else(|| CopyError::Unknown(site.to_owned()))?,
            Some(number) => state
                .histories
                .iter()
                .find(|history| history.store == number)
                .ok_or_else(|| CopyError::NoSegment(site.to_owned(), state.histories.len()))?,
        };
        Ok(Self {
            store: Store::open(path, Durability::Replay)?,
            shapes: shapes()?,
            is_present: number.is_none(),
            site: site.to_owned(),
            number: history.store,
            through: 0,
            from_month: from_month.unwrap_or(NO_MONTH),
            periods_from: NO_MONTH,
        })
    }

    /// Number of the history at the centre.
    pub fn number(&self) -> i64 {
        self.number
    }

    /// The copy as a store to read.
    pub fn reader(&self) -> &Reader {
        &self.store
    }

    /// Takes what the centre has beyond it; returns false if that is nothing.
    ///
    /// # Errors
    /// The store was replaced, or the centre's database or the file fails: the copy is to be begun anew.
    pub fn renew(&mut self, centre: &mut Centre) -> Result<bool, CopyError> {
        let (present, through) = centre.end_of(&self.site, self.number)?;
        if self.is_present && present != self.number {
            return Err(CopyError::Replaced(self.site.clone()));
        }
        if through == self.through {
            return Ok(false);
        }
        centre.begin_reading()?;
        let taken = self.take(centre);
        let ended = centre.end_reading();
        taken?;
        ended?;
        self.through = through;
        Ok(true)
    }

    /// Takes all tables as of one moment, those first that others refer to.
    fn take(&mut self, centre: &mut Centre) -> Result<(), CopyError> {
        self.store.begin_group()?;
        let mut latest_ns = None;
        for copied in centre.copied().to_vec() {
            match copied.shape.table {
                "record" => latest_ns = self.take_records(centre, &copied)?,
                // With the records.
                "line" | "mode" => {}
                "period" => {
                    let rows = centre.rows_where(
                        &copied,
                        (&self.site, self.number),
                        "(\"month\" >= $3 OR \"month\" = 0)",
                        &[Value::Integer(self.periods_from)],
                    )?;
                    self.gather(&copied, &rows)?;
                }
                table => {
                    let rows = centre.rows_where(&copied, (&self.site, self.number), "1 = 1", &[])?;
                    self.gather(&copied, &rows)?;
                    if table == "rod" {
                        let rods = rows.iter().map(|row| super::sql::text(row.first()));
                        self.store.gather_no_others(&rods.collect::<Vec<_>>())?;
                    }
                }
            }
        }
        self.store.end_group()?;
        if let Some(latest_ns) = latest_ns {
            self.periods_from = month_of(Some(latest_ns - LATE_NS)).max(self.periods_from);
        }
        Ok(())
    }

    /// Puts rows into the table that they copy, whose columns have the store's own names.
    fn gather(&mut self, copied: &Copied, rows: &[Vec<Value>]) -> Result<(), CopyError> {
        let shape = self.shapes.iter().find(|shape| shape.table == copied.shape.table);
        match shape {
            Some(shape) => Ok(self.store.gather(shape, rows)?),
            None => Ok(()),
        }
    }

    /// Takes the records after those it has, with lines and modes; returns the begin of the latest, if there are any.
    fn take_records(&mut self, centre: &mut Centre, records: &Copied) -> Result<Option<i64>, CopyError> {
        let of_records: Vec<Copied> = centre
            .copied()
            .iter()
            .filter(|copied| ["line", "mode"].contains(&copied.shape.table))
            .cloned()
            .collect();
        let (site, number) = (self.site.clone(), self.number);
        let of = (site.as_str(), number);
        let start = records
            .shape
            .columns
            .iter()
            .position(|column| column.name == "start_ns");
        let months = "(\"month\" >= $3 OR \"month\" = 0)";
        let (mut after, mut latest_ns) = (self.store.latest_record()?, None);
        loop {
            let from = Value::Integer(self.from_month);
            let rows = centre.rows_where(
                records,
                of,
                &format!("{months} AND \"id\" > $4 ORDER BY \"id\" LIMIT $5"),
                &[from.clone(), Value::Integer(after), Value::Integer(PAGE)],
            )?;
            let Some(last) = rows.last() else {
                return Ok(latest_ns);
            };
            let through = integer(last.first());
            self.gather(records, &rows)?;
            for copied in &of_records {
                let rows = centre.rows_where(
                    copied,
                    of,
                    &format!("{months} AND \"record\" > $4 AND \"record\" <= $5"),
                    &[from.clone(), Value::Integer(after), Value::Integer(through)],
                )?;
                self.gather(copied, &rows)?;
            }
            let starts = rows
                .iter()
                .map(|row| integer(start.and_then(|place| row.get(place))));
            latest_ns = latest_ns.max(starts.max());
            after = through;
        }
    }
}

impl Centre {
    /// Number of a site's present history, and the last commit of one.
    fn end_of(&mut self, site: &str, store: i64) -> Result<(i64, i64), CentreError> {
        let site = Value::Text(site.to_owned());
        let present = "SELECT \"store\" FROM \"present\" WHERE \"site\" = $1";
        let present = self.sql.query(present, std::slice::from_ref(&site))?;
        let through = "SELECT \"through\" FROM \"store\" WHERE \"site\" = $1 AND \"store\" = $2";
        let through = self.sql.query(through, &[site, Value::Integer(store)])?;
        let of = |rows: Vec<Vec<Value>>| integer(rows.first().and_then(|row| row.first()));
        Ok((of(present), of(through)))
    }

    /// Rows of a copied table of one store that meet a condition on further values, from `$3` on, as that store has them.
    fn rows_where(
        &mut self,
        copied: &Copied,
        (site, store): (&str, i64),
        condition: &str,
        more: &[Value],
    ) -> Result<Vec<Vec<Value>>, CentreError> {
        let columns: Vec<&str> = copied.shape.columns.iter().map(|c| c.name.as_str()).collect();
        let sql = format!(
            "SELECT {} FROM \"{}\" WHERE \"site\" = $1 AND \"store\" = $2 AND {condition}",
            tables::quoted(&columns),
            copied.shape.table
        );
        let of = [Value::Text(site.to_owned()), Value::Integer(store)];
        Ok(self.sql.query(&sql, &[&of[..], more].concat())?)
    }

    /// Sees the database as it is now until [`Centre::end_reading`].
    fn begin_reading(&mut self) -> Result<(), CentreError> {
        let begin = if self.sql.is_postgres() {
            "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY"
        } else {
            "BEGIN"
        };
        Ok(self.sql.batch(begin)?)
    }

    fn end_reading(&mut self) -> Result<(), CentreError> {
        Ok(self.sql.batch("ROLLBACK")?)
    }
}
