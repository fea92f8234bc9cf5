//! The daemon of a site without a computer: this program as a child, over a folder of the worker's own.

use crate::config::Config;
use crate::service::telemetry::log;
use rustix::process::{Pid, Signal, kill_process};
use std::io::{self, BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// Longest time to stop by itself.
const STOP_WITHIN: Duration = Duration::from_secs(10);

/// Checks a file with the configuration of a site without a computer.
///
/// # Errors
/// It is bad, or has sources or sinks of its own: the reason with the file and the section.
pub fn check(path: &Path) -> Result<(), String> {
    let config = Config::load(path).map_err(|error| error.to_string())?;
    fit(&config).map_err(|reason| format!("{}: {reason}", path.display()))
}

fn fit(config: &Config) -> Result<(), String> {
    let ingest = &config.ingest;
    let own = [
        ("[ingest] folder", ingest.folder.is_some()),
        ("[ingest] listen", !ingest.listen.is_empty()),
        ("[[sink]]", !config.sinks.is_empty()),
        ("[forward]", config.forward.is_some()),
        ("[bucket]", config.bucket.is_some()),
    ];
    match own.iter().find(|(_, is_there)| *is_there) {
        Some((section, _)) => Err(format!(
            "{section} stands in the configuration of a site without a computer: its samples come through the post, and its alarms go \
             through the hub's sinks"
        )),
        None => Ok(()),
    }
}

/// A running daemon, killed when dropped.
pub struct Daemon(Child);

impl Daemon {
    /// Starts it with a site's configuration, within a folder. It ends with the thread that started it; its lines in plain text have
    /// the site in front.
    ///
    /// # Errors
    /// The system gives no process.
    pub fn start(site: &str, config: &Path, within: &Path) -> io::Result<Self> {
        let [format, filter] = log::form().words();
        let is_plain = format == "plain";
        let mut child = Command::new("/proc/self/exe")
            .arg0("tirante")
            .args(["run", "--log", &format, "--config"])
            .arg(config)
            .arg("--within")
            .arg(within)
            .env("TIRANTE_LOG", filter)
            // They are the worker's alone.
            .env_remove("NOTIFY_SOCKET")
            .env_remove("WATCHDOG_USEC")
            .env_remove("WATCHDOG_PID")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(if is_plain {
                Stdio::piped()
            } else {
                Stdio::inherit()
            })
            .spawn()?;
        if let Some(lines) = child.stderr.take() {
            let site = site.to_owned();
            thread::spawn(move || {
                for line in BufReader::new(lines).lines().map_while(Result::ok) {
                    eprintln!("{site}: {line}");
                }
            });
        }
        Ok(Self(child))
    }

    /// Exit status, once it has ended.
    ///
    /// # Errors
    /// The system does not say.
    pub fn ended(&mut self) -> io::Result<Option<ExitStatus>> {
        self.0.try_wait()
    }

    /// Lets it read its configuration again.
    pub fn reload(&self) {
        self.signal(Signal::HUP);
    }

    /// Lets it come to its end.
    pub fn stop(&mut self) {
        self.signal(Signal::TERM);
        let until = Instant::now() + STOP_WITHIN;
        while Instant::now() < until && matches!(self.ended(), Ok(None)) {
            thread::sleep(Duration::from_millis(10));
        }
    }

    fn signal(&self, signal: Signal) {
        let pid = i32::try_from(self.0.id()).ok().and_then(Pid::from_raw);
        // It may have ended meanwhile.
        let _ = pid.map(|pid| kill_process(pid, signal));
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_configuration_with_sources_or_sinks_of_its_own_is_refused() {
        let plain = include_str!("../../../../config/minimal.toml");
        let of = |more: &str| fit(&Config::parse(&format!("{plain}\n{more}"), "site.toml").unwrap());
        assert_eq!(of(""), Ok(()));
        assert_eq!(of("[ingest]\njoin_s = 60"), Ok(()));
        for (more, named) in [
            ("[ingest]\nfolder = 'in'", "[ingest] folder"),
            ("[ingest]\nlisten = ['tcp://127.0.0.1:7411']", "[ingest] listen"),
            (
                "[[sink]]\nid = 'desk'\nkind = 'webhook'\nurl = 'https://example.org/'",
                "[[sink]]",
            ),
            (
                "[forward]\nto = 'nats://127.0.0.1:4222'\nsite = 'todi'",
                "[forward]",
            ),
        ] {
            let said = of(more).unwrap_err();
            assert!(said.starts_with(named), "{said}");
        }
    }
}
