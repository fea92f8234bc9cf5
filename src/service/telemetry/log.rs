//! Output of the log: plain lines on stderr, JSON lines, or the systemd journal with its fields.

use clap::ValueEnum;
use std::env;
use std::io::{self, IsTerminal};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Layer, Registry, fmt};

/// Form of the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// Plain lines on stderr.
    Plain,
    /// The systemd journal, each field by its own name (`journalctl TIRANTE_FAULT=sink`).
    Journal,
    /// One JSON object per line on stderr.
    Json,
}

/// Starts the log. Without a format it is `journal` if stderr leads there, else `plain`; `is_daemon` puts times on plain
/// lines, which nothing else stamps.
pub fn start(format: Option<Format>, filter: EnvFilter, is_daemon: bool) {
    let format = format.unwrap_or(if is_daemon && stderr_is_the_journal() {
        Format::Journal
    } else {
        Format::Plain
    });
    let (layer, trouble) = layer(format, is_daemon);
    tracing_subscriber::registry()
        .with(layer.with_filter(filter))
        .init();
    if let Some(trouble) = trouble {
        tracing::warn!("the log goes to stderr, the journal cannot be reached: {trouble}");
    }
}

type Boxed = Box<dyn Layer<Registry> + Send + Sync>;

fn layer(format: Format, is_daemon: bool) -> (Boxed, Option<io::Error>) {
    let lines = || {
        let lines = fmt::layer().with_writer(io::stderr);
        // Colours are for a terminal only, unless NO_COLOR is set.
        if io::stderr().is_terminal() {
            lines
        } else {
            lines.with_ansi(false)
        }
    };
    match format {
        Format::Json => (Box::new(lines().json().flatten_event(true)), None),
        Format::Journal => match tracing_journald::layer() {
            Ok(journal) => {
                let journal = journal
                    .with_field_prefix(Some("TIRANTE".to_owned()))
                    .with_syslog_identifier("tirante".to_owned());
                (Box::new(journal), None)
            }
            Err(error) => (layer(Format::Plain, is_daemon).0, Some(error)),
        },
        Format::Plain if is_daemon && !stderr_is_the_journal() => (Box::new(lines()), None),
        Format::Plain => (Box::new(lines().without_time()), None),
    }
}

/// True if stderr is the stream that systemd opened to its journal: `JOURNAL_STREAM` names its device and
/// inode.
fn stderr_is_the_journal() -> bool {
    let Ok(stream) = env::var("JOURNAL_STREAM") else {
        return false;
    };
    rustix::fs::fstat(io::stderr()).is_ok_and(|stat| stream == format!("{}:{}", stat.st_dev, stat.st_ino))
}
