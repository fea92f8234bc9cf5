//! Listings as Parquet, for data frames: the columns of the CSV, typed; times in nanoseconds, UTC.

use super::history::What;
use crate::analysis::signal::record::Timestamp;
use crate::site::store::{ColumnKind, Filter, Listing, Reader};
use anyhow::{Context, bail};
use parquet::basic::Compression;
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::parser::parse_message_type;
use rusqlite::types::Value;
use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;

/// Number of rows held in memory and written together.
const GROUP: usize = 65_536;

/// Number of records whose resonances are read at once.
const PAGE: usize = 1024;

/// Writes a listing of a store.
///
/// # Errors
/// The store cannot be read, or `out` cannot be written.
pub fn write(reader: &Reader, filter: &Filter, what: What, out: impl Write + Send) -> anyhow::Result<()> {
    let listing = what.listing();
    let mut sheet = Sheet::new(reader.column_kinds(listing)?, out)?;
    reader.list(listing, filter, |_, values| sheet.push(values))?;
    sheet.close()
}

/// Writes every record of some sites' stores, with the site in front.
///
/// # Errors
/// A store cannot be read, or `out` cannot be written.
pub fn write_sites(stores: &[(String, PathBuf)], out: impl Write + Send) -> anyhow::Result<()> {
    let mut widest = Vec::new();
    for (_, path) in stores {
        let kinds = Reader::open(path)?.column_kinds(Listing::Records)?;
        // Listings differ in the number of modes alone.
        if kinds.len() > widest.len() {
            widest = kinds;
        }
    }
    let site = ("site".to_owned(), ColumnKind::Text);
    let mut sheet = Sheet::new([site].into_iter().chain(widest).collect(), out)?;
    for (site, path) in stores {
        let reader = Reader::open(path)?;
        let mut row = vec![Value::Null; sheet.names.len()];
        reader.list(Listing::Records, &Filter::default(), |names, values| {
            row.fill(Value::Null);
            row[0] = Value::Text(site.clone());
            let places = sheet.names.iter().zip(&mut row).skip(1);
            let mut given = names.iter().zip(values).peekable();
            for (wanted, place) in places {
                if let Some((_, value)) = given.next_if(|(name, _)| *name == wanted) {
                    place.clone_from(value);
                }
            }
            if let Some((name, _)) = given.next() {
                bail!("column {name} is not where it is in the other stores");
            }
            sheet.push(&row)
        })?;
    }
    sheet.close()
}

/// Writes every resonance of every record of some sites' stores, with the site in front.
///
/// # Errors
/// A store cannot be read, or `out` cannot be written.
pub fn write_resonances(stores: &[(String, PathBuf)], out: impl Write + Send) -> anyhow::Result<()> {
    const COLUMNS: [(&str, ColumnKind); 12] = [
        ("site", ColumnKind::Text),
        ("rod", ColumnKind::Text),
        ("start", ColumnKind::Time),
        ("frequency_hz", ColumnKind::Real),
        ("sd_hz", ColumnKind::Real),
        ("damping", ColumnKind::Real),
        ("damping_log_sd", ColumnKind::Real),
        ("peak_to_noise", ColumnKind::Real),
        ("evidence", ColumnKind::Real),
        ("is_tone", ColumnKind::Integer),
        ("misfit", ColumnKind::Real),
        ("foreign_log_odds", ColumnKind::Real),
    ];
    let columns = COLUMNS.map(|(name, kind)| (name.to_owned(), kind));
    let mut sheet = Sheet::new(columns.to_vec(), out)?;
    for (site, path) in stores {
        let reader = Reader::open(path)?;
        let mut after = 0;
        loop {
            let rows = reader.found(after, PAGE)?;
            let Some(last) = rows.last() else { break };
            after = last.number;
            for row in &rows {
                let start = row.found.start().map(|start| start.to_string());
                for resonance in row.found.resonances() {
                    sheet.push(&[
                        Value::Text(site.clone()),
                        Value::Text(row.rod.0.clone()),
                        start.clone().into(),
                        Value::Real(resonance.frequency_hz),
                        Value::Real(resonance.frequency_sd_hz),
                        Value::Real(resonance.damping),
                        Value::Real(resonance.damping_log_sd),
                        Value::Real(resonance.peak_to_noise),
                        Value::Real(resonance.evidence),
                        Value::Integer(i64::from(resonance.line)),
                        Value::Real(resonance.misfit),
                        Value::Real(resonance.foreign_log_odds),
                    ])?;
                }
            }
        }
    }
    sheet.close()
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
    let columns = names.iter().map(|name| ((*name).to_owned(), ColumnKind::Real));
    let mut sheet = Sheet::new(columns.collect(), out)?;
    for row in rows {
        let values: Vec<Value> = row.map(Value::Real).collect();
        sheet.push(&values)?;
    }
    sheet.close()
}

/// A file of rows under way.
struct Sheet<W: Write + Send> {
    file: SerializedFileWriter<W>,
    names: Vec<String>,
    columns: Vec<Column>,
    rows: usize,
}

impl<W: Write + Send> Sheet<W> {
    fn new(kinds: Vec<(String, ColumnKind)>, out: W) -> anyhow::Result<Self> {
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
            names: kinds.into_iter().map(|(name, _)| name).collect(),
            rows: 0,
        })
    }

    fn push(&mut self, values: &[Value]) -> anyhow::Result<()> {
        for ((column, value), name) in self.columns.iter_mut().zip(values).zip(&self.names) {
            column.push(value).with_context(|| format!("column {name}"))?;
        }
        self.rows += 1;
        if self.rows == GROUP {
            self.flush()?;
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<(), ParquetError> {
        let mut group = self.file.next_row_group()?;
        for column in &mut self.columns {
            column.flush(&mut group)?;
        }
        group.close()?;
        self.rows = 0;
        Ok(())
    }

    fn close(mut self) -> anyhow::Result<()> {
        if self.rows > 0 {
            self.flush()?;
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
