//! A daemon as a process of its own, ended when it is dropped.

use std::fs::{self, File};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// Longest wait on a busy machine.
pub const DEADLINE: Duration = Duration::from_secs(120);

pub struct Process {
    pub child: Child,
    log: PathBuf,
}

impl Process {
    /// Starts the daemon in a folder; `wrapped` is the command that runs it.
    pub fn start(folder: &Path, wrapped: &[&str]) -> Self {
        Self::with(folder, wrapped, &[])
    }

    pub fn with(folder: &Path, wrapped: &[&str], variables: &[(&str, &str)]) -> Self {
        let log = folder.join("daemon.log");
        let daemon = [
            env!("CARGO_BIN_EXE_tirante"),
            "run",
            "--config",
            "site.toml",
            "--threads",
            "2",
        ];
        let words = [wrapped, &daemon[..]].concat();
        let child = Command::new(words[0])
            .args(&words[1..])
            .current_dir(folder)
            .env("TIRANTE_CACHE_DIR", env!("CARGO_TARGET_TMPDIR"))
            .env("TIRANTE_LOG", "info")
            .envs(variables.iter().copied())
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(File::create(&log).unwrap())
            .process_group(0)
            .spawn()
            .unwrap();
        Self { child, log }
    }

    pub fn log(&self) -> String {
        fs::read_to_string(&self.log).unwrap_or_default()
    }

    pub fn is_running(&mut self) -> bool {
        self.child.try_wait().unwrap().is_none()
    }

    /// Waits until a condition holds; panics if the daemon ends before.
    pub fn wait_until(&mut self, what: &str, mut is_so: impl FnMut(&str) -> bool) {
        let until = Instant::now() + DEADLINE;
        while !is_so(&self.log()) {
            assert!(Instant::now() < until, "not so: {what}\n{}", self.log());
            assert!(self.is_running(), "ended before {what}:\n{}", self.log());
            thread::sleep(Duration::from_millis(10));
        }
    }

    /// Waits until a condition holds, or the daemon ends; returns true if it holds.
    pub fn becomes(&mut self, is_so: impl Fn(&str) -> bool) -> bool {
        let until = Instant::now() + DEADLINE;
        while self.is_running() {
            if is_so(&self.log()) {
                return true;
            }
            assert!(Instant::now() < until, "neither so nor ended:\n{}", self.log());
            thread::sleep(Duration::from_millis(10));
        }
        false
    }

    /// Process id of the daemon itself, inside its wrapper.
    pub fn pid(&self) -> u32 {
        let mut pid = self.child.id();
        while let Ok(children) = fs::read_to_string(format!("/proc/{pid}/task/{pid}/children"))
            && let Some(child) = children.split_whitespace().next()
        {
            pid = child.parse().unwrap();
        }
        pid
    }

    pub fn signal(&self, name: &str) {
        let pid = self.pid().to_string();
        let told = Command::new("kill").args([name, &pid]).status().unwrap();
        // It may have ended a moment ago.
        assert!(told.success() || !Path::new("/proc").join(&pid).exists());
    }

    pub fn wait(&mut self) -> ExitStatus {
        let until = Instant::now() + DEADLINE;
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(Instant::now() < until, "does not end:\n{}", self.log());
            thread::sleep(Duration::from_millis(2));
        }
    }

    /// Stops it with a signal: it must end with 0 within five seconds.
    pub fn stop(mut self, signal: &str) {
        self.signal(signal);
        let begun = Instant::now();
        let status = self.wait();
        assert_eq!(status.code(), Some(0), "{}", self.log());
        assert!(
            begun.elapsed() < Duration::from_secs(5),
            "{:?}\n{}",
            begun.elapsed(),
            self.log()
        );
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if self.child.try_wait().is_ok_and(|ended| ended.is_none()) {
            // The whole group: otherwise the program under strace or bwrap would outlive it.
            let group = format!("-{}", self.child.id());
            let _ = Command::new("kill").args(["-KILL", "--", &group]).status();
            let _ = self.child.wait();
        }
    }
}
