//! Questions of a copy about the log: what tells a store from its own copy, and what was not sent yet.

use super::state::Failure;
use super::{Reader, StoreError};
use rusqlite::OptionalExtension;
use serde_json::Value as Json;

/// Number of rows in a mark.
const MARKED: usize = 4;
/// Most commits searched for them.
const SEARCHED: i64 = 1000;

impl Reader {
    /// Checksums of the last rows up to a commit that are written once and kept. Two stores that went on differently from one copy
    /// differ in them as soon as one has taken a record, told an event, or noticed a condition that the other has not.
    ///
    /// # Errors
    /// The log cannot be read.
    pub fn mark_of(&self, number: i64) -> Result<String, StoreError> {
        let read = || -> rusqlite::Result<Vec<String>> {
            let mut found = Vec::new();
            let mut statement = self.connection.prepare_cached(
                "SELECT rows FROM change WHERE number <= ?1 AND number > ?1 - ?2 ORDER BY number DESC",
            )?;
            let mut rows = statement.query([number, SEARCHED])?;
            while let Some(row) = rows.next()? {
                for name in names(&row.get::<_, String>(0)?).iter().rev() {
                    let (Some(table), Some(key)) = (name.first(), name.get(1)) else {
                        continue;
                    };
                    let sql = match table.as_str() {
                        Some("config") => "SELECT checksum FROM config WHERE hash = ?",
                        Some("record") => "SELECT checksum FROM record WHERE id = ?",
                        Some("outbox") => "SELECT checksum FROM outbox WHERE number = ?",
                        Some("notice") => "SELECT checksum FROM notice WHERE number = ?",
                        _ => continue,
                    };
                    let mut statement = self.connection.prepare_cached(sql)?;
                    let of = |row: &rusqlite::Row<'_>| row.get::<_, i64>(0);
                    let checksum = match key {
                        Json::String(text) => statement.query_row([text], of),
                        key => statement.query_row([key.as_i64()], of),
                    };
                    found.push(
                        checksum
                            .optional()?
                            .map_or_else(String::new, |one| one.to_string()),
                    );
                    if found.len() == MARKED {
                        return Ok(found);
                    }
                }
            }
            Ok(found)
        };
        let found = read().map_err(|error| self.fault(Failure::Sql(error)))?;
        Ok(found.join("."))
    }

    /// First record that a commit after `number` names; its line must still be there when it is sent.
    ///
    /// # Errors
    /// The log cannot be read.
    pub fn first_record_after(&self, number: i64) -> Result<Option<i64>, StoreError> {
        let read = || -> rusqlite::Result<Option<i64>> {
            let mut statement = self
                .connection
                .prepare_cached("SELECT rows FROM change WHERE number > ? ORDER BY number")?;
            let mut rows = statement.query([number])?;
            while let Some(row) = rows.next()? {
                let names = names(&row.get::<_, String>(0)?);
                let records = names
                    .iter()
                    .filter(|name| name.first().is_some_and(|table| table == "record"));
                let first = records
                    .filter_map(|name| name.get(1).and_then(Json::as_i64))
                    .min();
                if first.is_some() {
                    return Ok(first);
                }
            }
            Ok(None)
        };
        read().map_err(|error| self.fault(Failure::Sql(error)))
    }
}

/// Names of rows in a change; none if it cannot be read, which whoever sends it says.
fn names(text: &str) -> Vec<Vec<Json>> {
    serde_json::from_str(text).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use crate::analysis::signal::record::Timestamp;
    use crate::site::store::{ConditionEvent, Store};

    fn notice(store: &mut Store, at_ns: i64, detail: &str) {
        let begun = ConditionEvent::raised("sink", "mail", Timestamp::from_nanos(at_ns), detail);
        store.watch(&[begun], None).unwrap();
    }

    #[test]
    fn stores_that_went_on_differently_from_one_copy_have_other_marks_from_then_on() {
        let stores = [1, 2].map(|own| {
            let mut store = Store::in_memory().unwrap();
            store.keep_config("a", "tower", "text").unwrap();
            notice(&mut store, 1, "refused");
            notice(&mut store, 1 + own, "own");
            for at in 5..9 {
                notice(&mut store, at, "the same again");
            }
            store
        });
        let marks = |number: i64| [0, 1].map(|place| stores[place].mark_of(number).unwrap());
        for number in 0..8 {
            let [one, other] = marks(number);
            // Four rows are looked at: the difference of commit 3 is seen up to commit 6.
            assert_eq!(
                one == other,
                !(3..=6).contains(&number),
                "{number}: {one} {other}"
            );
        }
        assert_eq!(marks(7)[0].split('.').count(), 4);
        assert_eq!(stores[0].first_record_after(0).unwrap(), None);
    }
}
