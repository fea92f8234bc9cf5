//! SIGTERM, SIGINT and SIGHUP as lifecycle events.

use super::Happening;
use std::io;
use std::sync::mpsc::Sender;
use tokio::runtime::Runtime;
use tokio::signal::unix::{SignalKind, signal};

/// Sends lifecycle events for signals from now on. The second signal to stop ends the process at once:
/// nothing is lost, since data not committed is read again at the next start.
pub(super) fn listen(runtime: &Runtime, tell: Sender<Happening>) -> io::Result<()> {
    let _inside = runtime.enter();
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut hang_up = signal(SignalKind::hangup())?;
    runtime.spawn(async move {
        let mut is_stopping = false;
        loop {
            let happening = tokio::select! {
                Some(()) = terminate.recv() => Happening::Stop,
                Some(()) = interrupt.recv() => Happening::Stop,
                Some(()) = hang_up.recv() => Happening::Reload,
                else => return,
            };
            let is_stop = matches!(happening, Happening::Stop);
            if is_stop && is_stopping {
                tracing::warn!("asked to stop twice: ending at once");
                std::process::exit(1);
            }
            is_stopping |= is_stop;
            if tell.send(happening).is_err() {
                return;
            }
        }
    });
    Ok(())
}
