//! Columns of drawn parameters, kept once for all tables of a site.
//!
//! All tables are drawn from one seed. Rods of one material and kind of support have quantities with equal priors, whose
//! columns are then equal to the bit, block by block, whatever else differs: two thirds of a table are parameters.

use crate::numerics::random::BLOCK;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError, Weak};

/// One quantity of the draws of a block; zero beyond the last draw.
pub(super) type Column = [f32; BLOCK];

/// Columns that some table holds, by a few of their values.
#[derive(Debug, Default)]
pub(super) struct Columns(Mutex<HashMap<[u32; 4], Vec<Weak<Column>>>>);

impl Columns {
    /// The column of these values: that of another table, if one has the same bits.
    pub(super) fn keep(&self, values: &Column) -> Arc<Column> {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let alike = known.entry(probe(values)).or_default();
        let is_same = |column: &Arc<Column>| bits(column).eq(bits(values));
        if let Some(column) = alike.iter().filter_map(Weak::upgrade).find(is_same) {
            return column;
        }
        let column = Arc::new(*values);
        alike.push(Arc::downgrade(&column));
        column
    }

    /// Frees the columns that no table holds any more.
    pub(super) fn forget(&self) {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        known.retain(|_, alike| {
            alike.retain(|column| column.strong_count() > 0);
            !alike.is_empty()
        });
    }
}

fn bits(values: &Column) -> impl Iterator<Item = u32> + '_ {
    values.iter().map(|value| value.to_bits())
}

fn probe(values: &Column) -> [u32; 4] {
    std::array::from_fn(|i| values[i * BLOCK / 4].to_bits())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_columns_are_one_and_those_of_no_table_are_forgotten() {
        let columns = Columns::default();
        let mut values = [0f32; BLOCK];
        values[7] = 1.0;
        let first = columns.keep(&values);
        assert!(Arc::ptr_eq(&first, &columns.keep(&values)));
        // The same in the few values that columns are found by, and not the same.
        values[8] = 1.0;
        let second = columns.keep(&values);
        assert!(!Arc::ptr_eq(&first, &second));
        assert_eq!((first[8], second[8]), (0.0, 1.0));
        drop(first);
        columns.forget();
        let held = |columns: &Columns| columns.0.lock().unwrap().values().map(Vec::len).sum::<usize>();
        assert_eq!(held(&columns), 1);
        drop(second);
        columns.forget();
        assert_eq!(held(&columns), 0);
    }
}
