//! A site's rows at the centre as a store of its own: whatever reads a store reads them, page, history, report and exports.

use super::centre::{Centre, CentreError};
use super::sql::{integer, text};
use super::tables::{self, COMMIT, Copied, NO_MONTH};
use crate::site::store::{Durability, Reader, Shape, Store, StoreError, shapes};
use rusqlite::types::Value;
use std::path::Path;

/// Records read at once.
const PAGE: i64 = 5000;

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
    /// It is no longer wanted.
    #[error("the copy is no longer wanted")]
    Stopped,
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
    /// Last commit of the centre that it has; -1 before the first look, for rows of an older hub have commit 0.
    through: i64,
    /// First month whose records it has.
    from_month: i64,
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
        let mut store = Store::open(path, Durability::Replay)?;
        store.mark_gathered(site)?;
        Ok(Self {
            store,
            shapes: shapes()?,
            is_present: number.is_none(),
            site: site.to_owned(),
            number: history.store,
            through: -1,
            from_month: from_month.unwrap_or(NO_MONTH),
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

    /// The copy as a store to write.
    pub fn into_store(self) -> Store {
        self.store
    }

    /// Takes what the centre has beyond it, unless `is_stopped` between two pages; returns false if that is nothing.
    ///
    /// # Errors
    /// The store was replaced, or the centre's database or the file fails: the copy is to be begun anew.
    pub fn renew(&mut self, centre: &mut Centre, is_stopped: &dyn Fn() -> bool) -> Result<bool, CopyError> {
        let (present, through) = centre.end_of(&self.site, self.number)?;
        if self.is_present && present != self.number {
            return Err(CopyError::Replaced(self.site.clone()));
        }
        if through == self.through {
            return Ok(false);
        }
        centre.begin_reading()?;
        let taken = self.take(centre, is_stopped);
        let ended = centre.end_reading();
        taken?;
        ended?;
        self.through = through;
        Ok(true)
    }

    /// Takes what changed in all tables as of one moment, those first that others refer to.
    fn take(&mut self, centre: &mut Centre, is_stopped: &dyn Fn() -> bool) -> Result<(), CopyError> {
        self.store.begin_group()?;
        for copied in centre.copied().to_vec() {
            let of = (self.site.as_str(), self.number);
            if copied.shape.table == "record" {
                self.take_records(centre, &copied, is_stopped)?;
            } else if copied.has_commit() {
                let later = format!("\"{COMMIT}\" > $3");
                let rows = centre.rows_where(&copied, of, &later, &[Value::Integer(self.through)])?;
                self.gather(&copied, &rows)?;
                if copied.shape.table == "rod" {
                    let left = centre.rods_of(&self.site, self.number)?;
                    self.store.gather_no_others(&left)?;
                }
            }
            if is_stopped() {
                return Err(CopyError::Stopped);
            }
        }
        self.store.end_group()?;
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

    /// Takes the records after those it has, with lines and modes.
    fn take_records(
        &mut self,
        centre: &mut Centre,
        records: &Copied,
        is_stopped: &dyn Fn() -> bool,
    ) -> Result<(), CopyError> {
        let with_records = |copied: &&Copied| ["line", "mode"].contains(&copied.shape.table);
        let of_records: Vec<Copied> = centre.copied().iter().filter(with_records).cloned().collect();
        let (site, number) = (self.site.clone(), self.number);
        let of = (site.as_str(), number);
        let months = "(\"month\" >= $3 OR \"month\" = 0)";
        let mut after = self.store.latest_record()?;
        loop {
            let from = Value::Integer(self.from_month);
            let rows = centre.rows_where(
                records,
                of,
                &format!("{months} AND \"id\" > $4 ORDER BY \"id\" LIMIT $5"),
                &[from.clone(), Value::Integer(after), Value::Integer(PAGE)],
            )?;
            let Some(last) = rows.last() else {
                return Ok(());
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
            after = through;
            if is_stopped() {
                return Err(CopyError::Stopped);
            }
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

    /// Names of the rods of one store.
    fn rods_of(&mut self, site: &str, store: i64) -> Result<Vec<String>, CentreError> {
        let rods = "SELECT \"rod\" FROM \"rod\" WHERE \"site\" = $1 AND \"store\" = $2";
        let of = [Value::Text(site.to_owned()), Value::Integer(store)];
        let rows = self.sql.query(rods, &of)?;
        Ok(rows.iter().map(|row| text(row.first())).collect())
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::signal::record::{RodId, Timestamp};
    use crate::analysis::track::AlarmEvent;
    use crate::analysis::track::alarm::{Alarm, Kind, What};
    use crate::service::hub::post::{Post, store};
    use crate::site::store::{ConditionEvent, Relayed};

    fn assert_same(copy: &SiteCopy, store: &Store) {
        for shape in shapes().unwrap() {
            assert_eq!(
                copy.reader().copied_rows(&shape).unwrap(),
                store.copied_rows(&shape).unwrap(),
                "{}",
                shape.table
            );
        }
    }

    #[test]
    fn a_copy_takes_what_changed_and_nothing_else() {
        let (mut post, mut store) = (Post::new(), store());
        let raised = Timestamp::from_nanos(1_780_000_000_000_000_000);
        let mut alarm = Alarm::new(
            &RodId("north".to_owned()),
            Kind::Drift,
            1,
            raised,
            "It fell.".to_owned(),
        );
        let event = |what, alarm: &Alarm| Relayed {
            events: vec![AlarmEvent {
                what,
                time: raised,
                alarm: alarm.clone(),
            }],
            ..Relayed::default()
        };
        store.relay(&event(What::Raised, &alarm)).unwrap();
        let mut sent = 0;
        let mut send = |post: &mut Post, store: &Store| {
            let last = store.latest_change().unwrap();
            let message = post.of("todi", store, sent + 1, last);
            post.send(&message);
            sent = last;
        };
        let begin = |post: &mut Post, name: &str| {
            let path = post.folder.path().join(name);
            SiteCopy::begin(&mut post.centre, "todi", None, None, &path).unwrap()
        };
        send(&mut post, &store);
        let mut copy = begin(&mut post, "copy.db");
        assert!(copy.renew(&mut post.centre, &|| false).unwrap());
        assert_same(&copy, &store);
        assert!(!copy.renew(&mut post.centre, &|| false).unwrap());
        let before = copy.through;
        alarm.cleared = Some(raised.plus_seconds(60.0));
        alarm.acknowledged = alarm.cleared;
        store.relay(&event(What::Cleared, &alarm)).unwrap();
        send(&mut post, &store);
        assert!(copy.renew(&mut post.centre, &|| false).unwrap());
        assert_same(&copy, &store);
        // Who has all but the last commit reads the rows of that one.
        let mut late = begin(&mut post, "late.db");
        late.through = before;
        assert!(late.renew(&mut post.centre, &|| false).unwrap());
        let read = |table: &str| {
            let shape = late.shapes.iter().find(|shape| shape.table == table).unwrap();
            late.reader().copied_rows(shape).unwrap().len()
        };
        assert_eq!(["alarm", "outbox", "notice", "config"].map(read), [1, 1, 0, 0]);
        let begun = ConditionEvent::raised("sink", "desk", raised, "refused");
        store.watch(&[begun], None).unwrap();
        send(&mut post, &store);
        assert!(matches!(
            copy.renew(&mut post.centre, &|| true),
            Err(CopyError::Stopped)
        ));
    }

    #[test]
    fn tables_of_an_older_hub_are_brought_up_to_date_and_copied_whole() {
        let (mut post, store) = (Post::new(), store());
        let message = post.of("todi", &store, 1, 6);
        post.send(&message);
        let mut older = "DROP INDEX \"period_by_commit\"; UPDATE \"centre\" SET \"value\" = '1' WHERE \"key\" = 'format';".to_owned();
        for copied in post.centre.copied().iter().filter(|copied| copied.has_commit()) {
            older += &format!("ALTER TABLE \"{}\" DROP COLUMN \"{COMMIT}\";", copied.shape.table);
        }
        post.centre.sql().batch(&older).unwrap();
        let folder = post.folder;
        drop(post.centre);
        let path = folder.path().join("centre.db");
        let storage = crate::config::settings::hub::Storage::Sqlite(path);
        let refused = crate::service::hub::beside(&storage).err().unwrap().to_string();
        assert!(refused.contains("start the hub once"), "{refused}");
        drop(crate::service::hub::open(&storage).unwrap());
        let mut centre = crate::service::hub::open(&storage).unwrap();
        let mut copy =
            SiteCopy::begin(&mut centre, "todi", None, None, &folder.path().join("copy.db")).unwrap();
        assert!(copy.renew(&mut centre, &|| false).unwrap());
        assert_same(&copy, &store);
    }
}
