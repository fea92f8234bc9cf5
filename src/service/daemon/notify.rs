//! Notifications to systemd: ready, reloading, stopping, and that the work loop is alive.
//!
//! The watchdog is fed only while something passes through the whole pipeline (`telemetry::Beat`): a thread that merely lives
//! proves nothing. A daemon that hangs is ended and begun again by systemd, and loses nothing.

use crate::service::telemetry::{Fault, Phase, Telemetry};
use sd_notify::NotifyState;
use std::io;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Largest age of a beat without systemd, before the work loop counts as stalled.
const PATIENCE: Duration = Duration::from_secs(30);

/// Longest step during the start: emulators are fitted, many rows are checked.
const STEP: Duration = Duration::from_secs(60);

/// Longest start.
const LONGEST_START: Duration = Duration::from_secs(3600);

/// Subject of the condition of a stalled work loop.
const ABOUT: &str = "work loop";

/// Reports that the daemon is ready; `systemctl status` shows `status`.
pub fn ready(status: &str) {
    tell(&[NotifyState::Ready, NotifyState::Status(status)]);
}

/// Sets the status shown by `systemctl status`.
pub fn status(status: &str) {
    tell(&[NotifyState::Status(status)]);
}

/// Reports the begin of a reload; [`ready`] ends it, with the new configuration or the old one.
pub fn reloading() {
    match NotifyState::monotonic_usec_now() {
        Ok(now) => tell(&[NotifyState::Reloading, now]),
        Err(_) => tell(&[NotifyState::Reloading]),
    }
}

/// Reports that the daemon drains and ends.
pub fn stopping() {
    tell(&[NotifyState::Stopping, NotifyState::Status("stopping")]);
}

/// Sends states to systemd; does nothing without it.
fn tell(states: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(states) {
        tracing::debug!("systemd cannot be told: {error}");
    }
}

/// The thread that watches the work loop; it ends when this is dropped.
#[derive(Debug)]
pub struct Watchdog {
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Watchdog {
    /// Watches from now on: asks systemd for time while the daemon starts, holds the fault [`Fault::Stalled`] while the work
    /// loop is stalled, feeds systemd's watchdog (if there is one) while it is not, and lets health log the
    /// lines it held back.
    ///
    /// # Errors
    /// The system gives no thread.
    pub fn start(telemetry: Telemetry) -> io::Result<Self> {
        let limit = sd_notify::watchdog_enabled();
        // Half of systemd's own limit, so that two late beats in a row are not the end.
        let patience = limit.map_or(PATIENCE, |limit| limit / 2);
        let (stop, stopped) = channel();
        let thread = thread::Builder::new()
            .name("watchdog".to_owned())
            .spawn(move || watch(&telemetry, patience, limit.is_some(), &stopped))?;
        Ok(Self {
            stop: Some(stop),
            thread: Some(thread),
        })
    }
}

impl Drop for Watchdog {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            // It never panics; if it did, the panic could not be reported.
            let _ = thread.join();
        }
    }
}

fn watch(telemetry: &Telemetry, patience: Duration, is_fed: bool, stopped: &Receiver<()>) {
    let health = &telemetry.health;
    let every = (patience / 4).clamp(Duration::from_millis(10), Duration::from_secs(5));
    let begun = Instant::now();
    loop {
        let (age, phase) = (telemetry.beat.age(), health.phase());
        if let Phase::Starting(doing) = phase
            && begun.elapsed() < LONGEST_START
        {
            let usec = u32::try_from(STEP.as_micros()).unwrap_or(u32::MAX);
            tell(&[NotifyState::ExtendTimeoutUsec(usec), NotifyState::Status(doing)]);
        }
        // While the daemon starts or drains systemd has other limits, and there is no work loop yet, or any more.
        let is_working = phase.not_ready().is_none();
        if age < patience || !is_working {
            health.over(Fault::Stalled, ABOUT);
            if is_fed {
                tell(&[NotifyState::Watchdog]);
            }
        } else {
            let detail = format!("nothing passed through it for {} s", age.as_secs());
            health.hold(Fault::Stalled, ABOUT, detail);
        }
        health.tick();
        match stopped.recv_timeout(every) {
            Err(RecvTimeoutError::Timeout) => {}
            Ok(()) | Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}
