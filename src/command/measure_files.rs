//! Files of a measurement: an existing one is never overwritten, but for those of a measurement that gave no force, as it wrote them.

use super::BadArguments;
use super::listing::pasted;
use super::template;
use crate::recording::atomic::AtomicFile;
use crate::site::hex::hex;
use anyhow::Context;
use sha2::{Digest, Sha256};
use std::fs;
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};

/// Opening of the last line of a configuration that may be replaced; the digest of everything else follows.
const SEAL: &str = "# No record gave a force with this. As long as nothing is changed here, `tirante measure` writes it anew: ";

/// Configuration and report of a measurement.
pub(super) struct Files {
    /// Configuration.
    pub toml: PathBuf,
    /// Report.
    pub page: PathBuf,
    /// True if a measurement without a force left them.
    replaces: bool,
}

impl Files {
    /// Files that may be written, for a measurement of `file`.
    ///
    /// # Errors
    /// One exists and may not be replaced.
    pub fn new(toml: PathBuf, page: PathBuf, file: &Path) -> anyhow::Result<Self> {
        let text = existing(&toml)?;
        let report = existing(&page)?;
        let replaces = match &text {
            Some(text) => is_sealed(text, report.as_deref()),
            None => false,
        };
        if text.is_some() && !replaces {
            return Err(BadArguments(format!(
                "{}: exists, and is not overwritten: `tirante identify {} --config {}` uses it, or give another --out",
                toml.display(),
                pasted(file),
                pasted(&toml)
            ))
            .into());
        }
        if report.is_some() && !replaces {
            return Err(BadArguments(format!(
                "{}: exists, and is not overwritten: give another --out",
                page.display()
            ))
            .into());
        }
        Ok(Self { toml, page, replaces })
    }

    /// Writes the report by `report`, then the configuration, which is sealed without a force; reports their paths.
    pub fn keep(
        &self,
        text: &str,
        has_force: bool,
        report: impl FnOnce(&Path) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        let Self { toml, page, replaces } = self;
        let folder = toml.parent().filter(|folder| !folder.as_os_str().is_empty());
        if let Some(folder) = folder {
            fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
        }
        report(page)?;
        let text = match has_force {
            true => text.to_owned(),
            false => {
                let report = fs::read(page).with_context(|| format!("cannot read {}", page.display()))?;
                format!("{text}{SEAL}{}-{}\n", digest(text.as_bytes()), digest(&report))
            }
        };
        let written = match replaces {
            true => replace(toml, &text),
            false => template::save(toml, &text),
        };
        written.with_context(|| format!("cannot write {}", toml.display()))?;
        tell!("configuration: {}\nreport: {}", toml.display(), page.display());
        Ok(())
    }
}

fn existing(path: &Path) -> anyhow::Result<Option<Vec<u8>>> {
    match fs::read(path) {
        Ok(content) => Ok(Some(content)),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        // A folder of that name is no file to replace either.
        Err(_) if path.exists() => Ok(Some(Vec::new())),
        Err(error) => Err(error).with_context(|| format!("cannot read {}", path.display())),
    }
}

/// True for a configuration that was written without a force and is still as written, with its report if that is there.
fn is_sealed(text: &[u8], report: Option<&[u8]>) -> bool {
    let Ok(text) = std::str::from_utf8(text) else {
        return false;
    };
    let sealed = text.strip_suffix('\n').and_then(|text| text.rsplit_once(SEAL));
    let Some((text, (of_text, of_report))) =
        sealed.and_then(|(text, seal)| Some((text, seal.split_once('-')?)))
    else {
        return false;
    };
    digest(text.as_bytes()) == of_text && report.is_none_or(|report| digest(report) == of_report)
}

/// Sixteen hexadecimal digits of a file.
fn digest(content: &[u8]) -> String {
    hex(&Sha256::digest(content)[..8])
}

fn replace(path: &Path, text: &str) -> io::Result<()> {
    let mut file = AtomicFile::create(path)?;
    file.write_all(text.as_bytes())?;
    file.commit()
}
