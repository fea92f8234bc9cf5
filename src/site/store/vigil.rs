//! A daemon's own watch in the store: rods it expects, conditions sent to the sinks, and its times of work.

use super::change::{Changed, FORGOTTEN};
use super::row::Row;
use super::state::{Failure, time};
use super::{Reader, Store, StoreError};
use crate::analysis::numerics::random;
use crate::analysis::signal::record::{RodId, Timestamp};
use rusqlite::{Connection, TransactionBehavior};
use std::collections::{BTreeMap, BTreeSet};

/// Gap below which two stretches of work are one \[s\].
const JOINED_S: f64 = 900.0;
/// Largest number of stretches kept; the oldest are removed.
const MOST_STRETCHES: i64 = 1000;

/// A condition of the daemon that began or ended, sent to the sinks in addition to the rods' alarms.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ConditionEvent {
    /// Number in the order of all notices, from 1; 0 while it is not stored.
    pub number: i64,
    /// Id of the condition, the same for its begin and its end.
    pub condition: String,
    /// Kind of fault, as in health and log.
    pub fault: String,
    /// Sink, file or folder concerned.
    pub about: String,
    /// True for the begin of the condition, false for its end.
    pub is_raised: bool,
    /// Begin of the condition, by the machine's clock.
    pub raised: Timestamp,
    /// Time of this notice, by the machine's clock.
    pub time: Timestamp,
    /// One sentence.
    pub detail: String,
}

impl ConditionEvent {
    /// Notice of the begin of a condition; fault, subject and time form its id.
    pub fn raised(fault: &str, about: &str, raised: Timestamp, detail: &str) -> Self {
        let seed = random::seed(&[
            b"condition",
            fault.as_bytes(),
            about.as_bytes(),
            &raised.as_nanos().to_le_bytes(),
        ]);
        Self {
            number: 0,
            condition: format!("{seed:016x}"),
            fault: fault.to_owned(),
            about: about.to_owned(),
            is_raised: true,
            raised,
            time: raised,
            detail: detail.to_owned(),
        }
    }

    /// Notice of the end of this condition.
    pub fn cleared(&self, time: Timestamp) -> Self {
        Self {
            number: 0,
            is_raised: false,
            time,
            ..self.clone()
        }
    }
}

/// A stretch of the machine's time in which a daemon worked and the clock had no step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stretch {
    /// Begin of the stretch.
    pub from: Timestamp,
    /// End of the stretch.
    pub to: Timestamp,
}

impl Stretch {
    /// Total length of `stretches` between two moments \[s\], each instant counted once: the real working
    /// time of a daemon, independent of changes of the clock.
    pub fn lived(stretches: &[Self], from: Timestamp, to: Timestamp) -> f64 {
        let mut parts: Vec<(Timestamp, Timestamp)> = stretches
            .iter()
            .map(|stretch| (stretch.from.max(from), stretch.to.min(to)))
            .filter(|(begin, end)| begin < end)
            .collect();
        parts.sort_unstable();
        let (mut lived_s, mut reached) = (0.0, from);
        for (begin, end) in parts {
            let begin = begin.max(reached);
            if end > begin {
                lived_s += end.seconds_since(begin);
                reached = end;
            }
        }
        lived_s
    }
}

pub(super) fn write_notice(
    connection: &Connection,
    notice: &ConditionEvent,
    changed: &mut Changed,
) -> rusqlite::Result<()> {
    let number: i64 = connection.query_row("SELECT coalesce(max(number), 0) + 1 FROM notice", (), |row| {
        row.get(0)
    })?;
    changed.note("notice", [number.into()]);
    let what = if notice.is_raised { "raised" } else { "cleared" };
    Row::of("notice")
        .with("number", number)
        .with("condition", notice.condition.clone())
        .with("fault", notice.fault.clone())
        .with("about", notice.about.clone())
        .with("what", what.to_owned())
        .with("raised", notice.raised.to_string())
        .with("time", notice.time.to_string())
        .with("detail", notice.detail.clone())
        .insert(connection)
}

fn write_stretch(connection: &Connection, latest: Option<Stretch>, stretch: Stretch) -> rusqlite::Result<()> {
    let last: i64 =
        connection.query_row("SELECT coalesce(max(number), 0) FROM alive", (), |row| row.get(0))?;
    let goes_on =
        |latest: &Stretch| latest.from <= stretch.from && stretch.from.seconds_since(latest.to) <= JOINED_S;
    let (number, whole) = match latest.filter(goes_on) {
        Some(latest) => {
            let to = latest.to.max(stretch.to);
            (
                last,
                Stretch {
                    from: latest.from,
                    to,
                },
            )
        }
        None => (last + 1, stretch),
    };
    Row::of("alive")
        .with("number", number)
        .with("from_ns", whole.from.as_nanos())
        .with("to_ns", whole.to.as_nanos())
        .upsert(connection, &["number"])?;
    connection.execute("DELETE FROM alive WHERE number <= ?", [number - MOST_STRETCHES])?;
    Ok(())
}

impl Store {
    /// Expects these rods and no others; returns the time since which each rod without a record has been
    /// expected. A new rod is expected from `now` on, and so is one dated in the future by a wrong clock.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn expect_rods(
        &mut self,
        rods: &[&RodId],
        now: Timestamp,
    ) -> Result<BTreeMap<RodId, Timestamp>, StoreError> {
        let known = self.reader.expected()?;
        let wanted: BTreeSet<&RodId> = rods.iter().copied().collect();
        let write = |connection: &mut Connection| -> rusqlite::Result<BTreeMap<RodId, Timestamp>> {
            let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
            for rod in known.keys().filter(|rod| !wanted.contains(rod)) {
                transaction.execute("DELETE FROM expected WHERE rod = ?", [&rod.0])?;
            }
            let mut expected = BTreeMap::new();
            for rod in &wanted {
                let since = known.get(*rod).copied().filter(|since| *since <= now);
                if since.is_none() {
                    Row::of("expected")
                        .with("rod", rod.0.clone())
                        .with("since", now.to_string())
                        .upsert(&transaction, &["rod"])?;
                }
                expected.insert((*rod).clone(), since.unwrap_or(now));
            }
            transaction.commit()?;
            Ok(expected)
        };
        write(&mut self.reader.connection).map_err(|error| self.reader.fault(Failure::Sql(error)))
    }

    /// Removes the row of a rod without records.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn forget_rod(&mut self, rod: &RodId) -> Result<(), StoreError> {
        let write = |connection: &mut Connection| -> rusqlite::Result<()> {
            let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
            for table in ["state", "segment", "rod"] {
                transaction.execute(&format!("DELETE FROM {table} WHERE rod = ?"), [&rod.0])?;
            }
            let mut changed = Changed::default();
            changed.note(FORGOTTEN, [rod.0.clone().into()]);
            changed.write(&transaction)?;
            transaction.commit()
        };
        self.kept.distrust(rod);
        write(&mut self.reader.connection).map_err(|error| self.reader.fault(Failure::Sql(error)))
    }

    /// Stores notices after those already there, together with a stretch of a daemon's work, which extends
    /// the latest stretch if the gap is small.
    ///
    /// # Errors
    /// They cannot be written.
    pub fn watch(&mut self, notices: &[ConditionEvent], stretch: Option<Stretch>) -> Result<(), StoreError> {
        let latest = self.reader.stretches()?.last().copied();
        let write = |connection: &mut Connection| -> rusqlite::Result<()> {
            let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
            let mut changed = Changed::default();
            for notice in notices {
                write_notice(&transaction, notice, &mut changed)?;
            }
            changed.write(&transaction)?;
            if let Some(stretch) = stretch {
                write_stretch(&transaction, latest, stretch)?;
            }
            transaction.commit()
        };
        write(&mut self.reader.connection).map_err(|error| self.reader.fault(Failure::Sql(error)))
    }
}

impl Reader {
    /// Rods that a daemon expects, with the time since which it does.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn expected(&self) -> Result<BTreeMap<RodId, Timestamp>, StoreError> {
        let read = || -> Result<BTreeMap<RodId, Timestamp>, Failure> {
            let mut statement = self
                .connection
                .prepare_cached("SELECT rod, since FROM expected")?;
            let mut rows = statement.query(())?;
            let mut expected = BTreeMap::new();
            while let Some(row) = rows.next()? {
                let since: String = row.get(1)?;
                expected.insert(RodId(row.get(0)?), time(&since)?);
            }
            Ok(expected)
        };
        read().map_err(|trouble| self.fault(trouble))
    }

    /// Notices after `number`, in order, at most `limit` of them.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn notices_after(&self, number: i64, limit: usize) -> Result<Vec<ConditionEvent>, StoreError> {
        let limit = i64::try_from(limit).unwrap_or(i64::MAX);
        self.notices("number > ? ORDER BY number LIMIT ?", &[&number, &limit])
    }

    /// Notices of begin of the active conditions, in order. One that was told no longer may have begun again.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn standing_notices(&self) -> Result<Vec<ConditionEvent>, StoreError> {
        let lasts = "what = 'raised' AND NOT EXISTS (SELECT 1 FROM notice AS later
            WHERE later.condition = notice.condition AND later.what = 'cleared' AND later.number > notice.number) ORDER BY number";
        self.notices(lasts, &[])
    }

    /// True if there is a notice of a condition, by its id.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn has_notice(&self, condition: &str) -> Result<bool, StoreError> {
        let found = self.notices("condition = ?1 LIMIT 1", &[&condition])?;
        Ok(!found.is_empty())
    }

    fn notices(
        &self,
        wanted: &str,
        values: &[&dyn rusqlite::ToSql],
    ) -> Result<Vec<ConditionEvent>, StoreError> {
        let read = || -> Result<Vec<ConditionEvent>, Failure> {
            let sql = format!(
                "SELECT number, condition, fault, about, what, raised, time, detail FROM notice WHERE {wanted}"
            );
            let mut statement = self.connection.prepare_cached(&sql)?;
            let mut rows = statement.query(values)?;
            let mut notices = Vec::new();
            while let Some(row) = rows.next()? {
                let (what, raised, at): (String, String, String) = (row.get(4)?, row.get(5)?, row.get(6)?);
                notices.push(ConditionEvent {
                    number: row.get(0)?,
                    condition: row.get(1)?,
                    fault: row.get(2)?,
                    about: row.get(3)?,
                    is_raised: what == "raised",
                    raised: time(&raised)?,
                    time: time(&at)?,
                    detail: row.get(7)?,
                });
            }
            Ok(notices)
        };
        read().map_err(|trouble| self.fault(trouble))
    }

    /// Number of the latest notice; 0 if there is none.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn latest_notice(&self) -> Result<i64, StoreError> {
        let latest = || {
            self.connection
                .prepare_cached("SELECT coalesce(max(number), 0) FROM notice")?
                .query_row((), |row| row.get(0))
        };
        latest().map_err(|error| self.fault(Failure::Sql(error)))
    }

    /// Stretches of daemons' work, in their order.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn stretches(&self) -> Result<Vec<Stretch>, StoreError> {
        let read = || -> rusqlite::Result<Vec<Stretch>> {
            let mut statement = self
                .connection
                .prepare_cached("SELECT from_ns, to_ns FROM alive ORDER BY number")?;
            let rows = statement.query_map((), |row| {
                Ok(Stretch {
                    from: Timestamp::from_nanos(row.get(0)?),
                    to: Timestamp::from_nanos(row.get(1)?),
                })
            })?;
            rows.collect()
        };
        read().map_err(|error| self.fault(Failure::Sql(error)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DAY_S: f64 = 86_400.0;

    fn day(days: f64) -> Timestamp {
        Timestamp::from_nanos(1_800_000_000_000_000_000).plus_seconds(days * DAY_S)
    }

    fn stretch(from: f64, to: f64) -> Stretch {
        Stretch {
            from: day(from),
            to: day(to),
        }
    }

    #[test]
    fn only_time_that_was_lived_counts() {
        // An hour with the clock 31 days ahead, then right again.
        let lived = [stretch(0.0, 1.0), stretch(32.0, 32.1), stretch(1.1, 2.0)];
        let age_d = |from: f64, to: f64| Stretch::lived(&lived, day(from), day(to)) / DAY_S;
        // Written just before the jump, it is minutes old while the clock is wrong, and a day old a day later.
        assert!((age_d(0.99, 32.1) - 1.01).abs() < 1e-6, "{}", age_d(0.99, 32.1));
        assert!((age_d(0.99, 1.0) - 0.01).abs() < 1e-6);
        assert!((age_d(0.99, 2.0) - 0.91).abs() < 1e-6);
        assert_eq!(age_d(40.0, 41.0), 0.0);
        let twice = [stretch(0.0, 1.0), stretch(0.5, 1.5)];
        assert!((Stretch::lived(&twice, day(0.0), day(9.0)) / DAY_S - 1.5).abs() < 1e-6);
    }

    #[test]
    fn stretches_join_over_a_restart_and_part_at_a_gap() {
        let mut store = Store::in_memory().unwrap();
        store.watch(&[], Some(stretch(0.0, 1.0))).unwrap();
        store.watch(&[], Some(stretch(1.001, 1.5))).unwrap();
        assert_eq!(store.stretches().unwrap(), [stretch(0.0, 1.5)]);
        store.watch(&[], Some(stretch(32.0, 32.1))).unwrap();
        // The clock was set back.
        store.watch(&[], Some(stretch(2.0, 2.0))).unwrap();
        store.watch(&[], Some(stretch(2.0, 3.0))).unwrap();
        let lived = [stretch(0.0, 1.5), stretch(32.0, 32.1), stretch(2.0, 3.0)];
        assert_eq!(store.stretches().unwrap(), lived);
    }

    #[test]
    fn a_condition_stands_from_its_begin_to_its_end_and_has_one_id() {
        let mut store = Store::in_memory().unwrap();
        let begun = ConditionEvent::raised("disk-full", "site.db", day(1.0), "no room");
        let other = ConditionEvent::raised("sink", "mail", day(1.0), "refused");
        store.watch(&[begun.clone(), other.clone()], None).unwrap();
        let standing = store.standing_notices().unwrap();
        assert_eq!(standing.len(), 2);
        assert_ne!(begun.condition, other.condition);
        store.watch(&[begun.cleared(day(2.0))], None).unwrap();
        let standing = store.standing_notices().unwrap();
        assert_eq!(standing, [ConditionEvent { number: 2, ..other }]);
        let later = store.notices_after(2, 10).unwrap();
        assert_eq!(later.len(), 1);
        assert_eq!(
            (later[0].condition.as_str(), later[0].raised),
            (begun.condition.as_str(), day(1.0))
        );
        assert_eq!(store.latest_notice().unwrap(), 3);
    }

    #[test]
    fn rods_are_waited_for_since_they_were_configured() {
        let mut store = Store::in_memory().unwrap();
        let [a, b] = ["a", "b"].map(|rod| RodId(rod.to_owned()));
        assert_eq!(store.expect_rods(&[&a], day(1.0)).unwrap()[&a], day(1.0));
        let both = store.expect_rods(&[&a, &b], day(2.0)).unwrap();
        assert_eq!((both[&a], both[&b]), (day(1.0), day(2.0)));
        // One that is gone and comes back is waited for anew; so is one of which a wrong clock spoke.
        store.expect_rods(&[&b], day(3.0)).unwrap();
        let both = store.expect_rods(&[&a, &b], day(1.5)).unwrap();
        assert_eq!((both[&a], both[&b]), (day(1.5), day(1.5)));
        assert_eq!(store.expected().unwrap(), both);
    }
}
