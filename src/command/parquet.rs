//! Listings as Parquet, for data frames: the columns of the CSV, typed; times in nanoseconds, UTC.

use super::history::What;
use crate::analysis::signal::record::Timestamp;
use crate::site::store::{ColumnKind, Filter, Reader};
use anyhow::{Context, bail};
use parquet::basic::Compression;
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::parser::parse_message_type;
use rusqlite::types::Value;
use std::io::Write;
use std::sync::Arc;

/// Number of rows held in memory and written together.
const GROUP: usize = 65_536;

/// Writes a listing of a store.
///
/// # Errors
/// The store cannot be read, or `out` cannot be written.
pub fn write(reader: &Reader, filter: &Filter, what: What, out: impl Write + Send) -> anyhow::Result<()> {
    let listing = what.listing();
    let mut table = Table::begin(&reader.column_kinds(listing)?, out)?;
    reader.list(listing, filter, |names, values| table.push(names, values))?;
    table.finish()
}

/// Writes columns of numbers.
///
/// # Errors
/// `out` cannot be written.
pub fn write_numbers(
    names: &[&str],
    rows: impl Iterator<Item = impl Iterator<Item = f64>>,
    out: impl Write + Send,
) -> anyhow::Result<()> {
    let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
    let kinds: Vec<(String, ColumnKind)> = names
        .iter()
        .map(|name| (name.clone(), ColumnKind::Real))
        .collect();
    let mut table = Table::begin(&kinds, out)?;
    for row in rows {
        let values: Vec<Value> = row.map(Value::Real).collect();
        table.push(&names, &values)?;
    }
    table.finish()
}

/// A table being written.
struct Table<W: Write + Send> {
    file: SerializedFileWriter<W>,
    columns: Vec<Column>,
    rows: usize,
}

impl<W: Write + Send> Table<W> {
    fn begin(kinds: &[(String, ColumnKind)], out: W) -> anyhow::Result<Self> {
        let fields: String = kinds
            .iter()
            .map(|(name, kind)| format!("OPTIONAL {};\n", field(name, *kind)))
            .collect();
        let schema = parse_message_type(&format!("message history {{\n{fields}}}"))?;
        let properties = WriterProperties::builder()
            .set_created_by(concat!("tirante ", env!("CARGO_PKG_VERSION")).to_owned())
            .set_compression(Compression::SNAPPY)
            .build();
        Ok(Self {
            file: SerializedFileWriter::new(out, Arc::new(schema), Arc::new(properties))?,
            columns: kinds.iter().map(|(_, kind)| Column::new(*kind)).collect(),
            rows: 0,
        })
    }

    fn push(&mut self, names: &[String], values: &[Value]) -> anyhow::Result<()> {
        for ((column, value), name) in self.columns.iter_mut().zip(values).zip(names) {
            column.push(value).with_context(|| format!("column {name}"))?;
        }
        self.rows += 1;
        if self.rows == GROUP {
            flush(&mut self.file, &mut self.columns)?;
            self.rows = 0;
        }
        Ok(())
    }

    fn finish(mut self) -> anyhow::Result<()> {
        if self.rows > 0 {
            flush(&mut self.file, &mut self.columns)?;
        }
        self.file.close()?;
        Ok(())
    }
}

/// A column in Parquet's schema language.
fn field(name: &str, kind: ColumnKind) -> String {
    match kind {
        ColumnKind::Text => format!("BYTE_ARRAY {name} (STRING)"),
        ColumnKind::Time => format!("INT64 {name} (TIMESTAMP(NANOS,true))"),
        ColumnKind::Integer => format!("INT64 {name}"),
        ColumnKind::Real => format!("DOUBLE {name}"),
    }
}

fn flush<W: Write + Send>(
    file: &mut SerializedFileWriter<W>,
    columns: &mut [Column],
) -> Result<(), ParquetError> {
    let mut group = file.next_row_group()?;
    for column in columns {
        column.flush(&mut group)?;
    }
    group.close()?;
    Ok(())
}

/// Cells of one column not yet written.
struct Column {
    /// 1 for a value, 0 for nothing.
    levels: Vec<i16>,
    cells: Cells,
}

enum Cells {
    Text(Vec<ByteArray>),
    Time(Vec<i64>),
    Integer(Vec<i64>),
    Real(Vec<f64>),
}

impl Column {
    fn new(kind: ColumnKind) -> Self {
        Self {
            levels: Vec::new(),
            cells: match kind {
                ColumnKind::Text => Cells::Text(Vec::new()),
                ColumnKind::Time => Cells::Time(Vec::new()),
                ColumnKind::Integer => Cells::Integer(Vec::new()),
                ColumnKind::Real => Cells::Real(Vec::new()),
            },
        }
    }

    fn push(&mut self, value: &Value) -> anyhow::Result<()> {
        self.levels.push(i16::from(*value != Value::Null));
        match (&mut self.cells, value) {
            (_, Value::Null) => {}
            (Cells::Text(cells), Value::Text(text)) => cells.push(text.as_bytes().to_vec().into()),
            (Cells::Time(cells), Value::Text(text)) => {
                let time: Timestamp = serde_json::from_value(text.as_str().into())?;
                cells.push(time.as_nanos());
            }
            (Cells::Integer(cells), Value::Integer(number)) => cells.push(*number),
            (Cells::Real(cells), Value::Real(number)) => cells.push(*number),
            (_, value) => bail!(
                "holds {:?}, which is not what the column is for",
                value.data_type()
            ),
        }
        Ok(())
    }

    fn flush<W: Write + Send>(
        &mut self,
        group: &mut SerializedRowGroupWriter<'_, W>,
    ) -> Result<(), ParquetError> {
        let Some(mut writer) = group.next_column()? else {
            return Err(ParquetError::General(
                "more columns than the schema has".to_owned(),
            ));
        };
        let levels = Some(self.levels.as_slice());
        match &self.cells {
            Cells::Text(cells) => writer.typed::<ByteArrayType>().write_batch(cells, levels, None)?,
            Cells::Time(cells) | Cells::Integer(cells) => {
                writer.typed::<Int64Type>().write_batch(cells, levels, None)?
            }
            Cells::Real(cells) => writer.typed::<DoubleType>().write_batch(cells, levels, None)?,
        };
        writer.close()?;
        self.levels.clear();
        match &mut self.cells {
            Cells::Text(cells) => cells.clear(),
            Cells::Time(cells) | Cells::Integer(cells) => cells.clear(),
            Cells::Real(cells) => cells.clear(),
        }
        Ok(())
    }
}
