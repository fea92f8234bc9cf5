//! Rows of a message, each checked against its table: what is put into the database is what a site's store may hold.

use super::batch::{Batch, Claim};
use super::tables::Copied;
use crate::site::store::{Change, Column, FORGOTTEN, is_intact};
use rusqlite::types::Value;
use std::collections::HashMap;

/// Tables whose rows are written once and kept, each with a key of one column.
const KEPT: [&str; 4] = ["config", "record", "outbox", "notice"];

/// Longest text in a key \[bytes\]: names are at most 255, and PostgreSQL's indices take some 2700 in a row.
const LONGEST_KEY: usize = 600;

/// Tables that messages may have rows of.
pub(super) struct Rows {
    copied: Vec<Copied>,
    places: HashMap<&'static str, usize>,
}

/// A row that was checked.
pub(super) enum Taken {
    /// A row of a table.
    Row {
        /// Place of the table among the copied ones.
        table: usize,
        /// Begin of its record or period \[ns since 1970\].
        start_ns: Option<i64>,
        /// Commit that wrote it.
        commit: i64,
        values: Vec<Value>,
    },
    /// A rod that was removed.
    Forgotten(String),
}

impl Taken {
    /// Begin of the record, if it is one.
    pub fn begin_of_record(&self, rows: &Rows) -> Option<i64> {
        match self {
            Self::Row { table, start_ns, .. } if rows.copied.get(*table)?.shape.table == "record" => {
                *start_ns
            }
            _ => None,
        }
    }

    /// Adds it to the batch.
    pub fn put(self, rows: &Rows, batch: &mut Batch, (site, store): (&str, i64)) {
        match self {
            Self::Row {
                table,
                start_ns,
                commit,
                values,
            } => batch.put(&rows.copied, table, (site, store), (start_ns, commit), values),
            Self::Forgotten(rod) => batch.forget(&rows.copied, site, store, &rod),
        }
    }
}

impl Rows {
    /// Rows of these tables.
    pub fn of(copied: Vec<Copied>) -> Self {
        let places = copied.iter().enumerate();
        Self {
            places: places
                .map(|(place, copied)| (copied.shape.table, place))
                .collect(),
            copied,
        }
    }

    /// Rows of the commits up to `through` that are written once and kept, with the place of their table: what tells a store from its
    /// own copy. They are those of a store's mark.
    ///
    /// # Errors
    /// One of them is no row of its table.
    pub fn claims(&self, changes: &[Change], through: i64) -> Result<Vec<(usize, Claim)>, String> {
        let mut claims = Vec::new();
        for change in changes.iter().take_while(|change| change.number <= through) {
            for row in change
                .rows
                .iter()
                .filter(|row| KEPT.contains(&row.table.as_str()))
            {
                let place = self.places.get(row.table.as_str()).copied();
                let copied = place.and_then(|place| Some((place, self.copied.get(place)?)));
                let Some((place, copied)) = copied else { continue };
                check_values(&copied.shape.columns, &row.values).map_err(|what| {
                    format!("commit {}: a row of table {}: {what}", change.number, row.table)
                })?;
                let mut columns = copied.shape.columns.iter().zip(&row.values);
                let key = columns.find(|(column, _)| column.key > 0);
                if let (Some((_, key)), Some(Value::Integer(checksum))) = (key, row.values.last()) {
                    let row = (key.clone(), *checksum);
                    claims.push((
                        place,
                        Claim {
                            commit: change.number,
                            row,
                        },
                    ));
                }
            }
        }
        Ok(claims)
    }

    /// Rows of the commits after `through`, each checked against its table.
    pub fn check(&self, changes: &[Change], through: i64) -> Result<Vec<Taken>, String> {
        let mut rows = Vec::new();
        for change in changes.iter().filter(|change| change.number > through) {
            // Lines and modes have the month of their record, which comes before them.
            let mut of_record = HashMap::<i64, Option<i64>>::new();
            for row in &change.rows {
                let wrong =
                    |what: &str| format!("commit {}: a row of table {}: {what}", change.number, row.table);
                if row.table == FORGOTTEN {
                    match row.values.as_slice() {
                        [Value::Text(rod)] if is_text(rod) && rod.len() <= LONGEST_KEY => {
                            rows.push(Taken::Forgotten(rod.clone()));
                        }
                        _ => return Err(wrong("no rod")),
                    }
                    continue;
                }
                let place = self.places.get(row.table.as_str()).copied();
                let (Some(place), Some(copied)) = (place, place.and_then(|place| self.copied.get(place)))
                else {
                    return Err(wrong("there is no such table"));
                };
                let columns = &copied.shape.columns;
                check_values(columns, &row.values).map_err(|what| wrong(&what))?;
                let number = |name: &str| {
                    let place = columns.iter().position(|column| column.name == name)?;
                    match row.values.get(place) {
                        Some(Value::Integer(number)) => Some(*number),
                        _ => None,
                    }
                };
                let start_ns = match row.table.as_str() {
                    "record" => {
                        let start_ns = number("start_ns");
                        if let Some(id) = number("id") {
                            of_record.insert(id, start_ns);
                        }
                        start_ns
                    }
                    "line" | "mode" => {
                        let record = number("record").and_then(|record| of_record.get(&record));
                        *record.ok_or_else(|| wrong("its record is not in the same commit"))?
                    }
                    _ => number("start_ns"),
                };
                rows.push(Taken::Row {
                    table: place,
                    start_ns,
                    commit: change.number,
                    values: row.values.clone(),
                });
            }
        }
        Ok(rows)
    }
}

/// Checks columns, types, lengths and the checksum.
fn check_values(columns: &[Column], values: &[Value]) -> Result<(), String> {
    if columns.len() != values.len() {
        return Err("it has not the columns of its table".to_owned());
    }
    for (column, value) in columns.iter().zip(values) {
        let is_good = match value {
            Value::Null => !column.is_required,
            Value::Text(text) if !is_text(text) => false,
            Value::Text(text) if column.key > 0 && text.len() > LONGEST_KEY => false,
            value => column.kind.holds(value),
        };
        if !is_good {
            return Err(format!("column {} holds no value of its kind", column.name));
        }
    }
    if !is_intact(values) {
        return Err("its checksum is not that of its values".to_owned());
    }
    Ok(())
}

/// True for a text that PostgreSQL keeps, too.
fn is_text(text: &str) -> bool {
    !text.contains('\0')
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::forward::message::OUT;
    use crate::service::hub::fold::{Judged, LONGEST_DETAIL, NEWER, UNLISTED, UNREADABLE};
    use crate::service::hub::incoming::Incoming;
    use crate::service::hub::post::{Post, store};
    use crate::site::store::{ChangedRow, FORMAT};

    #[test]
    fn what_cannot_be_read_or_was_changed_on_the_way_is_parked_by_name() {
        let (mut post, store) = (Post::new(), store());
        let good = post.of("todi", &store, 1, 6);
        let mut wrong: Vec<(&str, Incoming)> = Vec::new();
        let broken = Incoming {
            payload: b"nothing".to_vec(),
            ..good.clone()
        };
        wrong.push((UNREADABLE, broken));
        let bare = Incoming {
            headers: String::new(),
            ..good.clone()
        };
        wrong.push((UNREADABLE, bare));
        let mut newer = good.clone();
        newer.headers = newer.headers.replace(
            &format!("Tirante-Format: {FORMAT}"),
            &format!("Tirante-Format: {}", FORMAT + 1),
        );
        wrong.push((NEWER, newer));
        let unlisted = Incoming {
            subject: format!("{OUT}.nobody"),
            ..good.clone()
        };
        wrong.push((UNLISTED, unlisted));
        let epoch = store.epoch().unwrap().unwrap();
        let changes = store.changes_after(0, 6).unwrap();
        let edits: [fn(&mut ChangedRow); 9] = [
            |row| row.table = "sqlite_schema".to_owned(),
            |row| row.table = "\0".repeat(1000),
            |row| {
                row.table = FORGOTTEN.to_owned();
                row.values = vec![Value::Text("\0".to_owned())];
            },
            |row| row.values[0] = Value::Text("k".repeat(5000)),
            |row| row.values[1] = Value::Text("another".to_owned()),
            |row| row.values[1] = Value::Null,
            |row| row.values[1] = Value::Integer(7),
            |row| row.values[1] = Value::Text("\0".to_owned()),
            |row| drop(row.values.pop()),
        ];
        for edit in edits {
            let mut changes = changes.clone();
            edit(&mut changes[0].rows[0]);
            wrong.push((UNREADABLE, post.with("todi", &epoch, 1, 6, &changes)));
        }
        for (fault, mut message) in wrong {
            post.sequence += 1;
            message.sequence = post.sequence;
            let judged = post.send(&message);
            assert!(
                matches!(&judged, Judged::Parked(found, _) if *found == fault),
                "{fault} {judged:?}"
            );
        }
        assert_eq!(post.rows("config", "todi", 1), 0);
        let parked = post.parked("todi");
        assert_eq!(parked.len(), 12);
        for message in parked {
            // PostgreSQL and a log take it.
            assert!(
                !message.detail.chars().any(char::is_control),
                "{}",
                message.detail
            );
            assert!(message.detail.len() <= LONGEST_DETAIL);
        }
        assert_eq!(post.send(&good), Judged::Folded(6));
        // A site that comes onto the list takes up what came before.
        post.again(&["todi", "gubbio", "nobody"]);
        assert_eq!(post.take_up("nobody"), 1);
        assert_eq!(
            (post.rows("notice", "nobody", 1), post.fault("nobody")),
            (5, None)
        );
    }
}
