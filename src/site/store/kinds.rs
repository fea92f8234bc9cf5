//! Kinds of the columns of a listing, for formats that need them before the first row.

use super::state::Failure;
use super::{Listing, Reader, StoreError};
use std::collections::BTreeMap;

/// Kind of a column's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColumnKind {
    /// Text.
    Text,
    /// A point in time, as RFC 3339 text in UTC.
    Time,
    /// Whole numbers.
    Integer,
    /// Numbers.
    Real,
}

/// Text columns that hold points in time.
const TIMES: [&str; 4] = ["start", "raised", "acknowledged", "cleared"];

impl Reader {
    /// Names of a listing's columns with their kinds.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn column_kinds(&self, listing: Listing) -> Result<Vec<(String, ColumnKind)>, StoreError> {
        let table = match listing {
            Listing::Records | Listing::Rejections => "record",
            Listing::Periods => "period",
            Listing::Alarms => "alarm",
        };
        let declared = || -> rusqlite::Result<BTreeMap<String, String>> {
            let mut statement = self
                .connection
                .prepare("SELECT name, type FROM pragma_table_info(?) UNION SELECT name, type FROM pragma_table_info('origin')")?;
            let rows = statement.query_map([table], |row| Ok((row.get(0)?, row.get(1)?)))?;
            rows.collect()
        };
        let declared = declared().map_err(|error| self.fault(Failure::Sql(error)))?;
        let kind = |name: &str| match declared.get(name).map(String::as_str) {
            Some("TEXT") if TIMES.contains(&name) => ColumnKind::Time,
            Some("TEXT") => ColumnKind::Text,
            Some("INTEGER") => ColumnKind::Integer,
            // Of the request, not of the alarm.
            None if name == "acknowledged_words" => ColumnKind::Text,
            // Columns missing in the tables are those of the modes: frequencies and dampings.
            _ => ColumnKind::Real,
        };
        let names = self.columns(listing)?;
        Ok(names
            .into_iter()
            .map(|name| (name.clone(), kind(&name)))
            .collect())
    }
}
