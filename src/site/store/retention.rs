//! Removal of old JSON lines. Identities, numbers and history stay as they are.

use super::state::Failure;
use super::{Store, StoreError};
use crate::analysis::signal::record::{RodId, Timestamp};
use rusqlite::TransactionBehavior;

/// Number of records examined at once: a few milliseconds.
const AT_ONCE: i64 = 200;

impl Store {
    /// Removes the JSON lines of a rod's records that began before `before`, examining a bounded number of
    /// records from `from` on; returns where to continue. The line of the latest record that was used stays:
    /// `status` shows it. So do those of records from `unsent` on: a copy of the store does not have them yet.
    ///
    /// # Errors
    /// They cannot be removed.
    pub fn forget_lines(
        &mut self,
        rod: &RodId,
        from: Option<Timestamp>,
        before: Timestamp,
        unsent: Option<i64>,
    ) -> Result<Option<Timestamp>, StoreError> {
        self.try_forget_lines(rod, from, before, unsent)
            .map_err(|error| self.fault(Failure::Sql(error)))
    }

    fn try_forget_lines(
        &mut self,
        rod: &RodId,
        from: Option<Timestamp>,
        before: Timestamp,
        unsent: Option<i64>,
    ) -> rusqlite::Result<Option<Timestamp>> {
        let range = (
            &rod.0,
            from.map_or(i64::MIN, Timestamp::as_nanos),
            before.as_nanos(),
            unsent.unwrap_or(i64::MAX),
            AT_ONCE,
        );
        let old: Vec<(i64, i64)> = self
            .reader
            .connection
            .prepare_cached(
                "SELECT id, start_ns FROM record WHERE rod = ? AND start_ns >= ? AND start_ns < ? AND id < ?
                 ORDER BY start_ns LIMIT ?",
            )?
            .query_map(range, |row| Ok((row.get(0)?, row.get(1)?)))?
            .collect::<rusqlite::Result<_>>()?;
        let Some((_, last_ns)) = old.last() else {
            return Ok(from);
        };
        let transaction = self
            .reader
            .connection
            .transaction_with_behavior(TransactionBehavior::Immediate)?;
        for (id, _) in &old {
            transaction
                .prepare_cached(
                    "DELETE FROM line WHERE record = ?1 AND ?1 IS NOT
                        (SELECT id FROM record WHERE rod = ?2 AND rejection IS NULL AND set_aside IS NULL
                         ORDER BY start_ns DESC, id DESC LIMIT 1)",
                )?
                .execute((id, &rod.0))?;
        }
        transaction.commit()?;
        // Many records of one instant must not hold it up.
        let step = i64::from(old.len() as i64 == AT_ONCE && Some(*last_ns) == from.map(Timestamp::as_nanos));
        Ok(Some(Timestamp::from_nanos(last_ns + step)))
    }
}
