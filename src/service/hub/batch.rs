//! Content of one transaction of the centre's database.

use super::centre::{Position, SiteState};
use super::park::Parked;
use super::sql::{integer, text};
use super::tables::{Copied, month_of};
use rusqlite::types::Value;
use std::collections::{BTreeMap, BTreeSet};

/// A row of a commit that is folded already: the database must have it so.
#[derive(Debug)]
pub(super) struct Claim {
    /// Commit that wrote it.
    pub commit: i64,
    /// Value of its key, and its checksum.
    pub row: (Value, i64),
}

/// Content of one transaction.
#[derive(Debug, Default)]
pub struct Batch {
    /// Rows to write by table and key: the last one of a key counts.
    pub(super) rows: BTreeMap<(usize, String), Vec<Value>>,
    /// Rows to be there when it is written, by table, site and store.
    pub(super) claims: BTreeMap<(usize, String, i64), Vec<Claim>>,
    /// Rods without records that were removed: site, store, rod.
    pub(super) forgotten: Vec<(String, i64, String)>,
    pub(super) months: BTreeSet<i64>,
    /// Bytes of the rows, roughly.
    bytes: usize,
    /// Sites whose state changed.
    pub sites: BTreeMap<String, SiteState>,
    /// Messages to park.
    pub parked: Vec<Parked>,
    /// Messages no longer parked, by number and time.
    pub taken_up: Vec<(i64, i64)>,
    /// Latest message of the stream.
    pub position: Option<Position>,
}

impl Batch {
    /// Adds a row of a copied table, with the begin of its record or period and the commit that wrote it.
    pub fn put(
        &mut self,
        copied: &[Copied],
        table: usize,
        (site, store): (&str, i64),
        (start_ns, commit): (Option<i64>, i64),
        row: Vec<Value>,
    ) {
        let Some(of) = copied.get(table) else { return };
        let mut key = format!("{site}/{store}");
        let mut own: Vec<_> = of
            .shape
            .columns
            .iter()
            .zip(&row)
            .filter(|(column, _)| column.key > 0)
            .collect();
        own.sort_by_key(|(column, _)| column.key);
        for (_, value) in own {
            key += &format!("/{value:?}");
        }
        let mut values = vec![Value::Text(site.to_owned()), Value::Integer(store)];
        if of.is_monthly {
            let month = month_of(start_ns);
            self.months.insert(month);
            values.push(Value::Integer(month));
        }
        if of.has_commit() {
            values.push(Value::Integer(commit));
        }
        values.extend(row);
        let size = |value: &Value| match value {
            Value::Text(text) => text.len(),
            Value::Blob(bytes) => bytes.len(),
            _ => 16,
        };
        self.bytes += key.len() + values.iter().map(size).sum::<usize>();
        self.rows.insert((table, key), values);
    }

    /// Adds a row of a copied table that must be there when this is written.
    pub(super) fn claim(&mut self, table: usize, (site, store): (&str, i64), claim: Claim) {
        let of = self.claims.entry((table, site.to_owned(), store)).or_default();
        of.push(claim);
    }

    /// Removes the rows of a rod without records, also those of this batch.
    pub fn forget(&mut self, copied: &[Copied], site: &str, store: i64, rod: &str) {
        let is_of_rod = |values: &[Value]| {
            values.first() == Some(&Value::Text(site.to_owned()))
                && values.get(1) == Some(&Value::Integer(store))
                // After the commit.
                && values.get(3) == Some(&Value::Text(rod.to_owned()))
        };
        self.rows.retain(|(table, _), values| {
            let name = copied.get(*table).map(|copied| copied.shape.table);
            !(matches!(name, Some("rod" | "segment")) && is_of_rod(values))
        });
        self.forgotten.push((site.to_owned(), store, rod.to_owned()));
    }

    /// True if it holds so much that it is to be written before more is added.
    pub fn is_full(&self) -> bool {
        const ENOUGH: usize = 16 << 20;
        /// A second's work of a slow database: nothing waits longer for its commit.
        const ROWS: usize = 5000;
        let parked: usize = self.parked.iter().map(|parked| parked.payload.len()).sum();
        let claimed: usize = self.claims.values().map(Vec::len).sum();
        self.bytes + parked >= ENOUGH || self.rows.len() + claimed >= ROWS
    }

    /// Number of rows of a table, by site and store.
    pub fn count(&self, table: usize) -> BTreeMap<(String, i64), i64> {
        let mut counts = BTreeMap::new();
        for (_, row) in self.rows.iter().filter(|((of, _), _)| *of == table) {
            *counts
                .entry((text(row.first()), integer(row.get(1))))
                .or_default() += 1;
        }
        counts
    }

    /// True if there is nothing to write but perhaps the position.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
            && self.claims.is_empty()
            && self.sites.is_empty()
            && self.parked.is_empty()
            && self.taken_up.is_empty()
    }
}
