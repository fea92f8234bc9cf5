//! Store and output format of a command.

use super::BadArguments;
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::config::Config;
use crate::site::store::{Asked, Durability, Reader, Store, StoreError, request_of_writer};
use std::path::{Path, PathBuf};

/// Store of a command.
#[derive(Debug, Clone, clap::Args)]
pub struct WhichStore {
    /// Store; overrides `[store] path` of the configuration.
    #[arg(long, value_name = "FILE")]
    pub store: Option<PathBuf>,

    /// Configuration whose `[store] path` names the store.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
}

/// Output format.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// Aligned columns.
    #[default]
    #[value(alias = "text")]
    Table,
    /// One JSON object per line.
    Json,
    /// Comma-separated values (RFC 4180) with the unit in each column's name.
    Csv,
}

/// Output format of a command that prints text or JSON.
#[derive(Debug, Clone, Copy, Default, clap::Args)]
pub struct Output {
    /// Output format.
    #[arg(long, value_enum, default_value_t)]
    format: TextFormat,

    /// Older spelling of `--format json`.
    #[arg(long, hide = true, conflicts_with = "format")]
    json: bool,
}

/// Output as text or JSON.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum)]
enum TextFormat {
    /// Text and tables for people.
    #[default]
    #[value(alias = "table")]
    Text,
    /// One JSON object per line.
    Json,
}

impl Output {
    /// JSON output.
    pub const JSON: Self = Self {
        format: TextFormat::Json,
        json: false,
    };

    /// True if the output is JSON.
    pub fn is_json(self) -> bool {
        self.json || self.format == TextFormat::Json
    }
}

impl WhichStore {
    /// Path of the store.
    ///
    /// # Errors
    /// None is named, or the configuration is not valid.
    pub fn path(&self) -> anyhow::Result<PathBuf> {
        if let Some(path) = &self.store {
            return Ok(path.clone());
        }
        let Some(config) = &self.config else {
            return Err(BadArguments(
                "no store is named: --store FILE, or --config FILE with `path` in its section [store]"
                    .to_owned(),
            )
            .into());
        };
        match Config::resolve(Some(config), &[])?.store.path {
            Some(path) => Ok(path),
            None => Err(BadArguments(format!(
                "{} names no store: put `path = \"…\"` into its section [store], or say --store FILE",
                config.display()
            ))
            .into()),
        }
    }
}

/// Checks that the store has a rod.
pub fn check_rod(reader: &Reader, rod: Option<&str>) -> anyhow::Result<Option<RodId>> {
    let Some(id) = rod else { return Ok(None) };
    let rods: Vec<String> = reader.rods()?.into_iter().map(|rod| rod.0).collect();
    if rods.iter().any(|rod| rod == id) {
        return Ok(Some(RodId(id.to_owned())));
    }
    let known = if rods.is_empty() {
        "no rod yet".to_owned()
    } else {
        rods.join(", ")
    };
    Err(BadArguments(format!("rod {id}: {} has {known}", reader.path().display())).into())
}

/// Puts requests into a store, and applies those that need no fold at once if nothing writes to it; returns
/// when they take effect, in words.
pub fn ask(path: &Path, requests: &[(RodId, Asked)], asked: Timestamp) -> anyhow::Result<String> {
    let mut store = match Store::open(path, Durability::Full) {
        Ok(store) => store,
        Err(StoreError::Held { pid, .. }) => {
            request_of_writer(path, requests, asked)?;
            let writer = pid.map_or_else(
                || "the process that writes".to_owned(),
                |pid| format!("process {pid}"),
            );
            return Ok(format!(
                "requested; {writer} applies it: a daemon within seconds, a replay before the rod's next record"
            ));
        }
        Err(error) => return Err(error.into()),
    };
    if let Some(aside) = store.moved_aside() {
        anyhow::bail!(
            "the store was damaged and is now {}: nothing was asked for",
            aside.display()
        );
    }
    for (rod, what) in requests {
        store.request(rod, what, asked)?;
    }
    let mut states = store.states()?;
    let (_, still) = store.acknowledge_waiting(&mut states)?;
    Ok(if still == 0 {
        "done".to_owned()
    } else {
        "requested; applied before the rod's next record".to_owned()
    })
}
