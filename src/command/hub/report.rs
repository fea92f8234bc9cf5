//! `tirante hub report`: the report of a site from the centre's rows.

use super::store::gathered;
use crate::command::which_store::check_rod;
use crate::command::{print, report};
use crate::config::HubConfig;
use std::path::PathBuf;
use std::process::ExitCode;

/// Write the report of a site from the centre's rows, as one HTML page.
///
/// It is the page that `tirante report` writes from the site's own store, without the pictures of records, which stay at the site.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  tirante hub report todi --out reports/ --config hub.toml
  tirante hub report todi --rod north --out north.html \\
      --config hub.toml")]
pub struct Args {
    /// Name of the site.
    #[arg(value_name = "SITE")]
    pub site: String,

    /// Number of the store at the centre, from 1; the present one without it.
    #[arg(long, value_name = "N")]
    pub segment: Option<i64>,

    /// Folder, in which the page is named after the site, or the page itself (*.html).
    #[arg(long, value_name = "DIR|FILE", default_value = ".")]
    pub out: PathBuf,

    /// Only this rod.
    #[arg(long, value_name = "ID")]
    pub rod: Option<String>,
}

/// Runs the command.
///
/// # Errors
/// The centre has no such store or rod, or the page cannot be written.
pub fn run(args: &Args, config: &HubConfig) -> anyhow::Result<ExitCode> {
    let (_folder, copy) = gathered(config, &args.site, args.segment, &args.out)?;
    let rod = check_rod(copy.reader(), args.rod.as_deref())?;
    let page = report::write(copy.reader(), rod.as_ref(), &args.out)?;
    print(format!("{}\n", page.display()).as_bytes())
}
