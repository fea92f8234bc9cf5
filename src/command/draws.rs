//! Posterior draws as a file, one row a draw: a column for every quantity, in SI and named with its unit, and its weight.

use crate::analysis::inference::Posterior;
use crate::recording::atomic::AtomicFile;
use anyhow::Context;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Name of the column of weights, which sum to one.
const WEIGHT: &str = "weight";

/// Format of a file of draws, by its ending.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// Comma-separated values; numbers as short as exactness allows.
    Csv,
    /// NumPy, version 1.0, with one named field a column.
    Npy,
    /// Apache Parquet.
    Parquet,
}

/// A file for posterior draws.
#[derive(Debug, Clone)]
pub struct DrawsFile {
    path: PathBuf,
    kind: Kind,
}

impl DrawsFile {
    /// Parses the name of a file.
    ///
    /// # Errors
    /// Its ending says no format that is written.
    pub fn parse(text: &str) -> Result<Self, String> {
        let path = PathBuf::from(text);
        let ending = path
            .extension()
            .map(|ending| ending.to_string_lossy().to_lowercase());
        let kind = match ending.as_deref() {
            Some("csv") => Kind::Csv,
            Some("npy") => Kind::Npy,
            Some("parquet") => Kind::Parquet,
            _ => return Err("a name that ends in .csv, .npy or .parquet is wanted".to_owned()),
        };
        Ok(Self { path, kind })
    }

    /// Writes the draws of a run's `number`-th force, which appear under their name only when complete.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, posterior: &Posterior, number: usize) -> anyhow::Result<()> {
        let path = self.numbered(number);
        let written = || -> anyhow::Result<()> {
            let mut out = AtomicFile::create(&path)?;
            match self.kind {
                Kind::Csv => write_csv(posterior, &mut out)?,
                Kind::Npy => write_npy(posterior, &mut out)?,
                Kind::Parquet => {
                    super::parquet::write_numbers(&columns(posterior), rows(posterior), &mut out)?
                }
            }
            Ok(out.commit()?)
        };
        written().with_context(|| path.display().to_string())
    }

    /// `draws.csv`, `draws-2.csv`, ...
    fn numbered(&self, number: usize) -> PathBuf {
        if number == 1 {
            return self.path.clone();
        }
        let part = |of: Option<&std::ffi::OsStr>| of.unwrap_or_default().to_string_lossy().into_owned();
        let (stem, ending) = (part(self.path.file_stem()), part(self.path.extension()));
        let name = format!("{stem}-{number}.{ending}");
        self.path.parent().unwrap_or(Path::new("")).join(name)
    }
}

/// Names of the columns.
fn columns(posterior: &Posterior) -> Vec<&'static str> {
    let quantities = posterior.parameterisation.quantities().iter();
    quantities
        .map(|quantity| quantity.key())
        .chain([WEIGHT])
        .collect()
}

/// The draws, each with its weight as the last value.
fn rows(posterior: &Posterior) -> impl Iterator<Item = impl Iterator<Item = f64>> {
    let particles = posterior.particles.chunks_exact(posterior.parameterisation.len());
    particles
        .zip(&posterior.weights)
        .map(|(particle, weight)| particle.iter().chain([weight]).copied())
}

fn write_csv(posterior: &Posterior, out: &mut impl Write) -> io::Result<()> {
    write!(out, "{}\r\n", columns(posterior).join(","))?;
    for row in rows(posterior) {
        let cells: Vec<String> = row.map(|value| value.to_string()).collect();
        write!(out, "{}\r\n", cells.join(","))?;
    }
    Ok(())
}

/// Writes magic, version, length of the header, header, rows; the rows begin at a multiple of 64 bytes.
fn write_npy(posterior: &Posterior, out: &mut impl Write) -> io::Result<()> {
    const BEFORE_HEADER: usize = 10;
    let fields: Vec<String> = columns(posterior)
        .iter()
        .map(|name| format!("('{name}', '<f8')"))
        .collect();
    let mut header = format!(
        "{{'descr': [{}], 'fortran_order': False, 'shape': ({},), }}",
        fields.join(", "),
        posterior.weights.len()
    );
    let end = (BEFORE_HEADER + header.len() + 1).next_multiple_of(64);
    header.extend(std::iter::repeat_n(' ', end - 1 - BEFORE_HEADER - header.len()));
    header.push('\n');
    let length = u16::try_from(header.len()).map_err(io::Error::other)?;
    out.write_all(b"\x93NUMPY\x01\x00")?;
    out.write_all(&length.to_le_bytes())?;
    out.write_all(header.as_bytes())?;
    for row in rows(posterior) {
        for value in row {
            out.write_all(&value.to_le_bytes())?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ending_says_the_format_and_later_records_have_a_number() {
        let file = DrawsFile::parse("out/draws.NPY").unwrap();
        assert_eq!(file.kind, Kind::Npy);
        assert_eq!(file.numbered(1), Path::new("out/draws.NPY"));
        assert_eq!(file.numbered(3), Path::new("out/draws-3.NPY"));
        for wrong in ["draws", "draws.txt", ".csv"] {
            assert!(DrawsFile::parse(wrong).is_err(), "{wrong}");
        }
        assert!(DrawsFile::parse("x.parquet").is_ok());
    }
}
