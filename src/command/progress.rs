//! Progress on standard error, for people only: nothing without a terminal, nothing for short work.

use indicatif::{DecimalBytes, ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{self, IsTerminal, Read};
use std::path::PathBuf;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::{Duration, Instant};

/// Time before work shows a bar.
const PATIENCE: Duration = Duration::from_secs(2);

/// A number of bytes in the largest unit that fits.
pub fn size(bytes: u64) -> String {
    DecimalBytes(bytes).to_string()
}

/// A bar that appears after two seconds.
pub struct Progress {
    bar: ProgressBar,
    since: Instant,
}

impl Progress {
    /// A bar over `all` steps (zero if not known yet) in the format of `indicatif`.
    pub fn new(all: u64, template: &str) -> Self {
        let bar = ProgressBar::with_draw_target(Some(all), ProgressDrawTarget::hidden());
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        Self {
            bar,
            since: Instant::now(),
        }
    }

    /// A bar over the bytes of files, and their number.
    pub fn of_files<E>(files: &[Result<PathBuf, E>]) -> (Self, u64) {
        let sizes = files.iter().flatten().filter_map(|file| file.metadata().ok());
        let total = sizes.map(|data| data.len()).sum();
        let bar = Self::new(
            total,
            "{bar:40} {percent:>3} %  {bytes} of {total_bytes}, {eta} left",
        );
        (bar, total)
    }

    /// A bar for the model solves that train a chaos.
    pub fn of_solves() -> Self {
        Self::new(
            0,
            "{wide_bar} {human_pos}/{human_len} finite-element solves for the chaos, {eta} left",
        )
    }

    /// Runs work that tells no steps, with its name and its time on a line that appears after two seconds.
    pub fn during<T>(what: &str, work: impl FnOnce() -> T) -> T {
        if !io::stderr().is_terminal() {
            return work();
        }
        let line = Self::new(0, "{spinner} {msg}, {elapsed}");
        line.bar.set_message(what.to_owned());
        thread::scope(|scope| {
            let (ended, end) = mpsc::channel::<()>();
            scope.spawn(move || {
                if end.recv_timeout(PATIENCE) == Err(RecvTimeoutError::Timeout) {
                    line.bar.set_draw_target(ProgressDrawTarget::stderr_with_hz(5));
                    line.bar.enable_steady_tick(PATIENCE / 10);
                    let _ = end.recv();
                    line.bar.finish_and_clear();
                }
            });
            let _ended = ended;
            work()
        })
    }

    /// Sets the number of steps done, of all.
    pub fn set(&self, done: u64, all: u64) {
        self.bar.set_length(all);
        self.bar.set_position(done);
        self.show();
    }

    /// Adds a number of steps done, of all.
    pub fn add(&self, more: u64, all: u64) {
        self.bar.set_length(all);
        self.bar.inc(more);
        self.show();
    }

    /// Sets the number of steps done, of all, with the name of the last. Reports may come out of order.
    pub fn say_at(&self, what: &str, done: u64, all: u64) {
        self.bar.set_message(what.to_owned());
        self.set(done.max(self.bar.position()), all);
    }

    /// Prints without the bar in the way.
    pub fn suspend<T>(&self, print: impl FnOnce() -> T) -> T {
        self.bar.suspend(print)
    }

    /// Prints a line on standard error.
    pub fn say(&self, line: &str) {
        self.suspend(|| tell!("{line}"));
    }

    fn show(&self) {
        if self.bar.is_hidden() && self.since.elapsed() > PATIENCE && io::stderr().is_terminal() {
            self.bar.set_draw_target(ProgressDrawTarget::stderr_with_hz(5));
        }
    }
}

/// A file whose reading drives a bar.
pub struct Watched<R> {
    from: R,
    read: u64,
    all: u64,
    progress: Progress,
}

impl<R: Read> Watched<R> {
    /// Wraps a file of `all` bytes.
    pub fn new(from: R, all: u64) -> Self {
        let progress = Progress::new(all, "{wide_bar} {bytes}/{total_bytes} read, {eta} left");
        Self {
            from,
            read: 0,
            all,
            progress,
        }
    }
}

impl<R: Read> Read for Watched<R> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let count = self.from.read(into)?;
        self.read += count as u64;
        self.progress.set(self.read, self.all.max(self.read));
        Ok(count)
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
