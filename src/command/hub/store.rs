//! `tirante hub store`: a site's rows at the centre as a store.

use crate::command::print;
use crate::command::progress::Progress;
use crate::config::HubConfig;
use crate::service::hub::{self, copy::SiteCopy, scratch::Scratch};
use anyhow::Context;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Write a site's rows at the centre as a store, for every command that reads one.
///
/// `history`, `status`, `report`, `serve` and the exports take it like the store of the site. It has the results, events and
/// baselines that the site has sent; the states from which a daemon goes on, pictures of records and samples stay at the site: no
/// daemon can go on with it.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  tirante hub store todi --out todi.db --config hub.toml
  tirante history --store todi.db --format parquet > todi.parquet
  tirante hub store todi --segment 1 --out before.db \\
      --config hub.toml                # the store before it was replaced")]
pub struct Args {
    /// Name of the site.
    #[arg(value_name = "SITE")]
    pub site: String,

    /// Number of the store at the centre, from 1; the present one without it.
    #[arg(long, value_name = "N")]
    pub segment: Option<i64>,

    /// File to write; one of this name is replaced.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
}

/// A copy of a site's rows, and the folder that holds it, for a while, where the output will be.
pub(super) fn gathered(
    config: &HubConfig,
    site: &str,
    segment: Option<i64>,
    out: &Path,
) -> anyhow::Result<(Scratch, SiteCopy)> {
    let parent = out.parent().filter(|folder| !folder.as_os_str().is_empty());
    let below = if out.is_dir() {
        out
    } else {
        parent.unwrap_or(Path::new("."))
    };
    let folder =
        Scratch::new(below).with_context(|| format!("{}: no folder for the copy", below.display()))?;
    let mut centre = hub::beside(&config.storage)?;
    let path = folder.path().join("site.db");
    let mut copy = SiteCopy::begin(&mut centre, site, segment, None, &path)?;
    Progress::during(&format!("reading the rows of {site}"), || {
        copy.renew(&mut centre, &|| false)
    })?;
    Ok((folder, copy))
}

/// Runs the command.
///
/// # Errors
/// The centre has no such store, or the file cannot be written.
pub fn run(args: &Args, config: &HubConfig) -> anyhow::Result<ExitCode> {
    let (_folder, copy) = gathered(config, &args.site, args.segment, &args.out)?;
    let reader = copy.reader();
    reader.copy_to(&args.out)?;
    let (records, rejected) = reader.count_records()?;
    let line = format!(
        "{}: store {} of {}, {records} records, {rejected} rejected\n",
        args.out.display(),
        copy.number(),
        args.site
    );
    print(line.as_bytes())
}
