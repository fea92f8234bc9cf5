//! Copy of a store's log to a centre, over NATS JetStream: one more sink, which reads beside the writer.
//!
//! The end of the site's subject is the position: whatever was lost on the way, the next message follows the last one there. A
//! broker that is dead, hangs or refuses delays nothing but itself. docs/hub.md describes post and centre.

pub mod beat;
pub mod command;
pub mod link;
pub mod message;
pub mod obey;
mod session;
pub mod throttle;

pub use session::{Session, SessionError};

use crate::analysis::numerics::random;
use crate::config::settings::forward::ForwardSettings;
use crate::service::alert::{Backoff, Pace};
use crate::service::telemetry::metrics::Delivery;
use crate::service::telemetry::{Fault, Telemetry};
use crate::site::store::Reader;
use obey::Obedience;
use std::future::Future;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::{Duration, Instant};
use std::{io, thread};
use throttle::Throttle;
use tokio::sync::{Notify, watch};

/// Id of this sink, in conditions, metrics and the store. The slash keeps it apart from every `[[sink]]`, whose ids have none.
pub const SINK: &str = "copy/forward";
/// Subject of the condition of heartbeats that are not taken.
const BEAT: &str = "copy/heartbeat";
/// Subject of the condition of commands that cannot be asked for.
const COMMANDS: &str = "copy/commands";
/// Subjects of this sink's conditions.
pub const ABOUTS: [&str; 3] = [SINK, BEAT, COMMANDS];
/// Wait after a heartbeat that was not taken.
const BEAT_AGAIN: Duration = Duration::from_secs(10);
/// Name of its thread.
const THREAD: &str = "forward";

/// Interval at which the store is checked without notification.
const LOOK: Duration = Duration::from_secs(5);
/// Interval at which a site that pauses looks for what the centre asks for by now, and for heartbeats that are due.
const HEAR: Duration = Duration::from_secs(1);
/// Least time between two notes of the position in the store.
const NOTE: Duration = Duration::from_secs(10);
/// Longest time to stop, unless in the middle of a send.
const STOP_WITHIN: Duration = Duration::from_millis(100);

/// Waits between connections: a post that is back is soon found, by some 2000 sites not all at once.
const PACE: Pace = Pace {
    first: Duration::from_secs(1),
    longest: Duration::from_secs(30),
    deadline: link::ANSWER,
};

/// Callback for the number of the last commit that the post has; must not wait.
pub type Noted = Box<dyn FnMut(i64) + Send>;

/// The running copy, ended when dropped.
pub struct Forwarder {
    settings: ForwardSettings,
    wake: Arc<Notify>,
    stop: watch::Sender<bool>,
    ended: Receiver<()>,
}

impl Forwarder {
    /// Starts it on a thread of its own.
    ///
    /// # Errors
    /// The system gives no thread.
    pub fn start(
        settings: &ForwardSettings,
        store: PathBuf,
        config: &Path,
        noted: Noted,
        telemetry: Telemetry,
    ) -> io::Result<Self> {
        let (wake, (stop, stopped)) = (Arc::<Notify>::default(), watch::channel(false));
        let (ending, ended) = sync_channel(0);
        let seed = random::seed(&[SINK.as_bytes(), settings.site.as_bytes()]);
        let obedience = settings
            .command_key
            .as_ref()
            .map(|key| Obedience::new(key, &settings.site, &store, config));
        let worker = Worker {
            obedience,
            settings: settings.clone(),
            store,
            noted,
            noted_at: None,
            telemetry,
            backoff: Backoff::new(PACE, seed),
            throttle: Throttle::new(seed),
            wake: Arc::clone(&wake),
            stopped,
            has_led: false,
            beat_due: Instant::now(),
        };
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?;
        thread::Builder::new().name(THREAD.to_owned()).spawn(move || {
            runtime.block_on(worker.run());
            drop(ending);
        })?;
        Ok(Self {
            settings: settings.clone(),
            wake,
            stop,
            ended,
        })
    }

    /// True if it works with these settings.
    pub fn is_of(&self, settings: &ForwardSettings) -> bool {
        self.settings == *settings
    }

    /// Notifies it that there may be commits.
    pub fn wake(&self) {
        self.wake.notify_one();
    }
}

impl Drop for Forwarder {
    fn drop(&mut self) {
        self.stop.send_replace(true);
        let _ = self.ended.recv_timeout(STOP_WITHIN);
    }
}

struct Worker {
    settings: ForwardSettings,
    store: PathBuf,
    noted: Noted,
    noted_at: Option<Instant>,
    telemetry: Telemetry,
    backoff: Backoff,
    throttle: Throttle,
    wake: Arc<Notify>,
    stopped: watch::Receiver<bool>,
    /// True after this process has sent a message.
    has_led: bool,
    /// Time at which the next heartbeat is due.
    beat_due: Instant,
    /// The centre's commands, if any are carried out.
    obedience: Option<Obedience>,
}

impl Worker {
    async fn run(mut self) {
        let mut stopped = self.stopped.clone();
        let work = async {
            loop {
                let Err(error) = self.work().await;
                let wait = self.backoff.after_failure(None);
                let detail = format!(
                    "forward to {}: {error}; tried again in {:.0} s",
                    self.settings.nats.url(),
                    wait.as_secs_f64().ceil()
                );
                self.telemetry.metrics.delivery(SINK, Delivery::Failed);
                self.telemetry.health.hold(Fault::Forward, SINK, detail);
                tokio::time::sleep(wait).await;
            }
        };
        or_stopped(&mut stopped, work).await;
    }

    /// Sends until something fails.
    async fn work(&mut self) -> Result<std::convert::Infallible, SessionError> {
        let reader = Reader::open(&self.store)?;
        let settings = self.settings.clone();
        let mut session = Session::open(&settings, &reader, self.has_led).await?;
        loop {
            self.beat(&mut session, &reader).await?;
            let latest = reader.latest_change()?;
            let waiting = latest - session.end().through;
            self.telemetry
                .metrics
                .outbox(SINK, usize::try_from(waiting).unwrap_or(0));
            session.hear(&mut self.throttle);
            let now = Instant::now();
            if let Some(wait) = self.throttle.wait(waiting, now) {
                // The post answers: what is not sent waits because it may.
                self.reached();
                let wait = async {
                    tokio::time::sleep(wait.min(HEAR)).await;
                    Ok::<_, SessionError>(())
                };
                session.link().unless_lost(wait).await?;
                continue;
            }
            match session
                .send_next(&reader, self.throttle.most(waiting, now))
                .await?
            {
                Some(through) => {
                    self.has_led = true;
                    self.throttle.sent(waiting, Instant::now());
                    self.telemetry.metrics.delivery(SINK, Delivery::Delivered);
                    self.worked(through, through == latest);
                }
                None => {
                    self.worked(session.end().through, true);
                    let wake = async {
                        // A notification or the interval: both lead to the next look.
                        let longest = LOOK.min(settings.heartbeat);
                        let _ = tokio::time::timeout(longest, self.wake.notified()).await;
                        Ok::<_, SessionError>(())
                    };
                    session.link().unless_lost(wake).await?;
                }
            }
        }
    }

    /// Sends a heartbeat if one is due. One that the post does not take ends no connection.
    async fn beat(&mut self, session: &mut Session<'_>, reader: &Reader) -> Result<(), SessionError> {
        if Instant::now() < self.beat_due {
            return Ok(());
        }
        let (health, every) = (&self.telemetry.health, self.settings.heartbeat);
        if let Some(obedience) = &mut self.obedience {
            obedience.look(health);
            match session.commands(obedience, reader, health).await {
                Ok(()) => health.over(Fault::Forward, COMMANDS),
                Err(SessionError::Link(error)) => {
                    let detail = format!("forward: commands of the centre cannot be asked for: {error}");
                    health.hold(Fault::Forward, COMMANDS, detail);
                }
                Err(error) => return Err(error),
            }
            if let Some(from) = obedience.take_resend() {
                tracing::info!("forward: commits from {from} on are sent again, as the centre asks");
                session.go_back(from);
            }
        }
        let refused = self.obedience.as_ref().map(Obedience::refused);
        match session.beat(reader, health, refused).await {
            Ok(()) => {
                self.beat_due = Instant::now() + every;
                health.over(Fault::Forward, BEAT);
            }
            Err(SessionError::Link(error)) => {
                self.beat_due = Instant::now() + every.min(BEAT_AGAIN);
                let detail = format!("forward: the post does not take heartbeats: {error}");
                health.hold(Fault::Forward, BEAT, detail);
            }
            Err(error) => return Err(error),
        }
        Ok(())
    }

    /// Ends the condition of a post that cannot be reached.
    fn reached(&mut self) {
        self.backoff.reset();
        self.telemetry.health.over(Fault::Forward, SINK);
    }

    /// Ends the condition, and notes the position now and then.
    fn worked(&mut self, through: i64, is_all: bool) {
        self.reached();
        let is_due = self.noted_at.is_none_or(|at| at.elapsed() >= NOTE);
        if is_all && is_due {
            self.noted_at = Some(Instant::now());
            (self.noted)(through);
        }
    }
}

/// Runs `work` until it ends or `stopped` becomes true.
async fn or_stopped(stopped: &mut watch::Receiver<bool>, work: impl Future<Output = ()>) {
    tokio::select! {
        _ = stopped.wait_for(|stopped| *stopped) => {}
        () = work => {}
    }
}
