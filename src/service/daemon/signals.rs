//! Turns SIGTERM, SIGINT and SIGHUP into events.

use super::LifecycleEvent;
use std::io;
use std::sync::mpsc::Sender;
use tokio::runtime::Runtime;
use tokio::signal::unix::{SignalKind, signal};

/// Sends lifecycle events for signals from now on. The second signal to stop ends the process at once:
/// nothing is lost, since data not committed is read again at the next start.
pub(super) fn listen(runtime: &Runtime, sender: Sender<LifecycleEvent>) -> io::Result<()> {
    let _inside = runtime.enter();
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut hang_up = signal(SignalKind::hangup())?;
    runtime.spawn(async move {
        let mut is_stopping = false;
        loop {
            let event = tokio::select! {
                Some(()) = terminate.recv() => LifecycleEvent::Stop,
                Some(()) = interrupt.recv() => LifecycleEvent::Stop,
                Some(()) = hang_up.recv() => LifecycleEvent::Reload,
                else => return,
            };
            let is_stop = matches!(event, LifecycleEvent::Stop);
            if is_stop && is_stopping {
                tracing::warn!("asked to stop twice: ending at once");
                std::process::exit(1);
            }
            is_stopping |= is_stop;
            if sender.send(event).is_err() {
                return;
            }
        }
    });
    Ok(())
}
