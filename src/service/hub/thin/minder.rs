//! A site's daemon, begun again when it ends or comes to no end.
//!
//! It is begun over the same folder: there it knows at which step it ended, and sets that aside when it ends there again.

use super::daemon::Daemon;
use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitStatus;
use std::time::{Duration, Instant};

/// Longest time to read what it was given.
const SLOW: Duration = Duration::from_secs(600);
/// Waits before it is begun again, twice as long each time: the first, and the longest, after which it counts as well.
const AGAIN: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(60));

/// State of a daemon at a look.
pub(super) enum Looked {
    /// It is at work.
    Well,
    /// It ended not long ago.
    AsBefore,
    /// It has just ended, with a sentence; it is begun again.
    Ended(String),
    /// It does not take its arguments or its configuration.
    GivenUp(ExitStatus),
}

/// A daemon that is minded.
pub(super) struct Minder {
    site: String,
    config: PathBuf,
    folder: PathBuf,
    daemon: Option<Daemon>,
    /// Number of times that it ended since it was last well.
    ends: u32,
    /// Time at which it was begun, or is to be.
    begins: Instant,
}

impl Minder {
    /// Starts the daemon of a site.
    ///
    /// # Errors
    /// The system gives no process.
    pub(super) fn start(site: &str, config: &Path, folder: &Path) -> io::Result<Self> {
        Ok(Self {
            daemon: Some(Daemon::start(site, config, folder)?),
            site: site.to_owned(),
            config: config.to_owned(),
            folder: folder.to_owned(),
            ends: 0,
            begins: Instant::now(),
        })
    }

    /// Looks after it; `given`: time since which it has something to read.
    ///
    /// # Errors
    /// The system gives no process.
    pub(super) fn look(&mut self, given: Option<Instant>) -> io::Result<Looked> {
        let now = Instant::now();
        let Some(daemon) = &mut self.daemon else {
            if now >= self.begins {
                self.daemon = Some(Daemon::start(&self.site, &self.config, &self.folder)?);
                self.begins = now;
            }
            return Ok(Looked::AsBefore);
        };
        let is_slow = given.is_some_and(|since| now - since.max(self.begins) >= SLOW);
        let how = match daemon.ended()? {
            Some(status) if status.code() == Some(2) => return Ok(Looked::GivenUp(status)),
            Some(status) => format!("ended ({status})"),
            None if is_slow => format!("has not read what it was given for {} min", SLOW.as_secs() / 60),
            None => {
                if given.is_none() && now - self.begins >= AGAIN.1 {
                    self.ends = 0;
                }
                return Ok(match self.ends {
                    0 => Looked::Well,
                    _ => Looked::AsBefore,
                });
            }
        };
        self.daemon = None;
        self.begins = now + AGAIN.0.saturating_mul(1 << self.ends.min(10)).min(AGAIN.1);
        self.ends += 1;
        Ok(Looked::Ended(format!(
            "{}: its daemon {how}; it is begun again, {} in a row",
            self.site, self.ends
        )))
    }

    /// It has read all that it was given.
    pub(super) fn came_to_an_end(&mut self) {
        self.ends = 0;
    }

    /// True if it did not end since it was last well.
    pub(super) fn is_well(&self) -> bool {
        self.ends == 0
    }

    /// Lets it read its configuration again.
    pub(super) fn reload(&self) {
        self.daemon.iter().for_each(Daemon::reload);
    }

    /// Lets it come to its end.
    pub(super) fn stop(&mut self) {
        self.daemon.iter_mut().for_each(Daemon::stop);
    }
}
