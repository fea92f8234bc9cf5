//! `tirante hub command`: sends commands to a site, and lists commands with their outcome.

use super::listed;
use crate::command::listing::minutes;
use crate::command::which_store::Format;
use crate::command::{BadArguments, print};
use crate::config::HubConfig;
use crate::service::forward::command::{Action, Order};
use crate::service::hub;
use crate::service::hub::commands::CommandRow;
use crate::site::{clock, text};
use anyhow::Context;
use clap::Subcommand;
use std::fs;
use std::path::PathBuf;
use std::process::ExitCode;

/// Largest configuration that is offered \[bytes\].
const LARGEST: usize = 256 << 10;
/// Nanoseconds of an hour.
const HOUR_NS: f64 = 3600e9;

/// Command a site, or list what became of commands.
///
/// The command is signed with the key of `[[site]] command_key` and kept in the database; the running hub takes it to the
/// post, and the site asks for it with its next heartbeat. It is carried out at most once, and not after its time. A
/// configuration is only kept as a file beside the site's own, and told there as a condition: a person accepts it.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  tirante hub command todi --config hub.toml acknowledge 5f1d0c7a9e3b2468 \\
      --by 'M. Rossi' --reason 'wedge inspected, sound'
  tirante hub command todi --config hub.toml rebaseline north \\
      --by 'M. Rossi' --reason 'retensioned by 20 kN'
  tirante hub command todi --config hub.toml resend 1 \\
      --by 'M. Rossi' --reason 'the post lost its disk'
  tirante hub command --list --config hub.toml

States of the list: pending (not answered), accepted (a new baseline begins with
the rod's next record), carried-out, refused (with the reason), expired.")]
pub struct Args {
    /// Name of the site.
    #[arg(value_name = "SITE", required_unless_present = "list")]
    pub site: Option<String>,

    /// List commands, of SITE or of all sites, the latest first.
    #[arg(long)]
    pub list: bool,

    /// Output format of the list.
    #[arg(long, value_enum, default_value_t)]
    pub format: Format,

    /// Action.
    #[command(subcommand)]
    pub what: Option<What>,
}

/// Actions at a site.
#[derive(Debug, Subcommand)]
pub enum What {
    /// Acknowledge an alarm.
    #[command(visible_alias = "ack")]
    Acknowledge {
        /// Id of the alarm, as the site and the centre's table `alarm` have it.
        #[arg(value_name = "ALARM")]
        alarm: String,
        /// Who and why.
        #[command(flatten)]
        word: Word,
    },
    /// Start a new baseline for a rod, after work on it.
    Rebaseline {
        /// Id of the rod.
        #[arg(value_name = "ROD")]
        rod: String,
        /// Who and why.
        #[command(flatten)]
        word: Word,
    },
    /// Send commits again that the post has lost: the centre skips those it has.
    Resend {
        /// First commit to send, from 1.
        #[arg(value_name = "FROM", value_parser = clap::value_parser!(i64).range(1..))]
        from: i64,
        /// Who and why.
        #[command(flatten)]
        word: Word,
    },
    /// Offer a configuration, which a person at the site accepts.
    Configure {
        /// The configuration.
        #[arg(value_name = "FILE")]
        file: PathBuf,
        /// Who and why.
        #[command(flatten)]
        word: Word,
    },
}

/// Person, reason and time of a command.
#[derive(Debug, clap::Args)]
pub struct Word {
    /// Name of the person, kept at the site.
    #[arg(long, value_name = "NAME")]
    pub by: String,

    /// Reason, kept at the site.
    #[arg(long, value_name = "TEXT")]
    pub reason: String,

    /// Time after which it is not carried out any more [h].
    #[arg(long, value_name = "HOURS", default_value_t = 24.0, value_parser = hours)]
    pub expires_h: f64,
}

fn hours(text: &str) -> Result<f64, String> {
    let hours: f64 = text
        .parse()
        .map_err(|error: std::num::ParseFloatError| error.to_string())?;
    if (0.001..=2160.0).contains(&hours) {
        Ok(hours)
    } else {
        Err("from 0.001 to 2160 hours".to_owned())
    }
}

/// Runs the command.
///
/// # Errors
/// The site has no key or was never heard, the database refuses, or stdout cannot be written.
pub fn run(args: &Args, config: &HubConfig) -> anyhow::Result<ExitCode> {
    match (&args.site, &args.what) {
        (_, Some(_)) if args.list => {
            Err(BadArguments("either a command or --list, not both".to_owned()).into())
        }
        (Some(site), Some(what)) => give(site, what, config),
        (site, None) if args.list => list(site.as_deref(), args.format, config),
        _ => {
            let what = "say what is to be done: acknowledge ALARM, rebaseline ROD, configure FILE or resend FROM, or --list";
            Err(BadArguments(what.to_owned()).into())
        }
    }
}

fn give(site: &str, what: &What, config: &HubConfig) -> anyhow::Result<ExitCode> {
    let Some(settings) = config.site(site) else {
        return Err(BadArguments(format!("{site} is not on the list of sites")).into());
    };
    let Some(key) = &settings.command_key else {
        let what =
            format!("[[site]] {site} has no command_key: draw one with `tirante hub key --commands FILE`");
        return Err(BadArguments(what).into());
    };
    let seed = String::from_utf8_lossy(&key.read_private()?).into_owned();
    let (action, word) = match what {
        What::Acknowledge { alarm, word } => (Action::Acknowledge { alarm: alarm.clone() }, word),
        What::Rebaseline { rod, word } => (Action::Rebaseline { rod: rod.clone() }, word),
        What::Resend { from, word } => (Action::Resend { from: *from }, word),
        What::Configure { file, word } => {
            let text = fs::read_to_string(file).with_context(|| file.display().to_string())?;
            if text.len() > LARGEST {
                return Err(BadArguments(format!("{}: more than {LARGEST} bytes", file.display())).into());
            }
            (Action::Configure { text }, word)
        }
    };
    let mut centre = hub::beside(&config.storage)?;
    let state = centre.sites()?.remove(site).unwrap_or_default();
    // Of a store whose begin is lost the centre has nothing but its heartbeats.
    let heard = match &action {
        Action::Resend { .. } => centre.beats()?.remove(site).map(|heard| heard.beat.epoch),
        _ => None,
    };
    let Some(epoch) = heard.or_else(|| state.history().map(|present| present.epoch.clone())) else {
        return Err(BadArguments(format!("nothing of {site} has come yet")).into());
    };
    let now_ns = clock::now().as_nanos();
    let order = Order {
        site: site.to_owned(),
        epoch,
        number: centre.next_command(site, now_ns)?,
        issued_ns: now_ns,
        expires_ns: now_ns.saturating_add((word.expires_h * HOUR_NS) as i64),
        by: text::one_line(&word.by),
        reason: text::one_line(&word.reason),
        action,
    };
    let signed = order
        .sign(&seed)
        .map_err(|error| anyhow::anyhow!("{}: {error}", key.as_str()))?;
    centre.keep_command(&order, &signed)?;
    print(format!("command {} to {site}: {}\n", order.number, order.action.words()).as_bytes())
}

fn list(site: Option<&str>, format: Format, config: &HubConfig) -> anyhow::Result<ExitCode> {
    let mut centre = hub::beside(&config.storage)?;
    let rows = centre.commands(site, clock::now().as_nanos())?;
    print(listed(&rows, format, &HEAD, cells)?.as_bytes())
}

const HEAD: [&str; 8] = [
    "site",
    ">number",
    "given (UTC)",
    "by",
    "action",
    "reason",
    "state",
    "answer",
];

fn cells(row: &CommandRow) -> [String; 8] {
    [
        row.site.clone(),
        row.number.to_string(),
        row.issued.as_deref().map_or_else(|| "-".to_owned(), minutes),
        row.by.clone(),
        row.action.clone(),
        row.reason.clone(),
        row.state.code().to_owned(),
        row.answer.clone().unwrap_or_else(|| "-".to_owned()),
    ]
}
