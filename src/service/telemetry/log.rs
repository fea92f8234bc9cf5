//! Output of the log: plain lines on stderr, JSON lines, or the systemd journal with its fields.

use crate::site::text::turns_reading;
use clap::ValueEnum;
use std::env;
use std::io::{self, IsTerminal};
use std::sync::OnceLock;
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

/// Form and level of a log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Form {
    format: Format,
    filter: String,
}

/// The log of this process.
static FORM: OnceLock<Form> = OnceLock::new();

/// Form of the log of this process, so that a child of it writes the same; that of a log that was never started is warnings in
/// plain lines.
pub fn form() -> &'static Form {
    FORM.get_or_init(|| Form {
        format: Format::Plain,
        filter: "warn".to_owned(),
    })
}

impl Form {
    /// As words of a command line.
    pub fn words(&self) -> [String; 2] {
        let format = self.format.to_possible_value();
        let format = format.map_or_else(String::new, |value| value.get_name().to_owned());
        [format, self.filter.clone()]
    }

    /// From such words.
    pub fn of_words(format: &str, filter: &str) -> Option<Self> {
        Some(Self {
            format: Format::from_str(format, false).ok()?,
            filter: filter.to_owned(),
        })
    }

    /// Starts the log of a child of the daemon.
    pub fn start(&self) {
        start(Some(self.format), EnvFilter::new(&self.filter), true);
    }
}

/// Starts the log. Without a format it is `journal` if stderr leads there, else `plain`; `is_daemon` puts times on plain
/// lines, which nothing else stamps.
pub fn start(format: Option<Format>, filter: EnvFilter, is_daemon: bool) {
    let format = format.unwrap_or(if is_daemon && stderr_is_the_journal() {
        Format::Journal
    } else {
        Format::Plain
    });
    let filter_words = filter.to_string();
    FORM.get_or_init(|| Form {
        format,
        filter: filter_words,
    });
    let (layer, trouble) = layer(format, is_daemon);
    tracing_subscriber::registry()
        .with(layer.with_filter(filter))
        .init();
    if let Some(trouble) = trouble {
        tracing::warn!("the log goes to stderr, the journal cannot be reached: {trouble}");
    }
}

/// Stderr, to which each event is written at once as one line: an inner end of a line is followed by a margin, so that no name of
/// a file and no words of a person can look like a line of the log, nor turn the direction in which it is read. (Escape sequences are escaped by the
/// formatter.)
struct Lines;

impl io::Write for Lines {
    fn write(&mut self, event: &[u8]) -> io::Result<usize> {
        io::stderr().write_all(with_margin(event).as_bytes())?;
        Ok(event.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        io::stderr().flush()
    }
}

fn with_margin(event: &[u8]) -> String {
    let event = String::from_utf8_lossy(event);
    let (inner, end) = match event.strip_suffix('\n') {
        Some(inner) => (inner, "\n"),
        None => (&*event, ""),
    };
    let mut out = String::with_capacity(event.len());
    for c in inner.chars() {
        match c {
            '\n' => out += "\n    ",
            '\r' => out += "\\r",
            // As JSON has it, so that a JSON line stays one.
            c if turns_reading(c) => out += &format!("\\u{:04x}", u32::from(c)),
            c => out.push(c),
        }
    }
    out + end
}

type Boxed = Box<dyn Layer<Registry> + Send + Sync>;

fn layer(format: Format, is_daemon: bool) -> (Boxed, Option<io::Error>) {
    let lines = || {
        let lines = fmt::layer().with_writer(|| Lines);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_form_survives_a_command_line() {
        for format in [Format::Plain, Format::Journal, Format::Json] {
            let filter = "info,async_nats=warn".to_owned();
            let form = Form { format, filter };
            let [format, filter] = form.words();
            assert_eq!(Form::of_words(&format, &filter), Some(form));
        }
        assert_eq!(Form::of_words("loud", "info"), None);
    }

    #[test]
    fn no_words_look_like_a_line_of_the_log() {
        let forged = b"2026 INFO x\n2026 ERROR forged.mcap\r2026 is read\n";
        assert_eq!(
            with_margin(forged),
            "2026 INFO x\n    2026 ERROR forged.mcap\\r2026 is read\n"
        );
        assert_eq!(with_margin(b""), "");
        let turned = "{\"path\":\"nave\u{202e}pacm.exe\"}\n";
        assert_eq!(
            with_margin(turned.as_bytes()),
            "{\"path\":\"nave\\u202epacm.exe\"}\n"
        );
    }
}
