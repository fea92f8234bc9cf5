//! One client from its first byte to its last: reads, parses, passes data to the journal, answers.

use super::certificate::Rights;
use super::counts::Counts;
use super::entrance::Stay;
use super::intake::{Intake, IntakeLine};
use super::protocol::{Protocol, Refusal, Step};
use super::reply::Reply;
use super::server::{GREETING, Server, Socket, Topics, linger};
use super::shares::Share;
use super::writer::{Said, write};
use crate::service::journal::{Closed, End, Entry};
use crate::service::telemetry::{Fault, Via};
use crate::site::clock;
use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt};
use tokio::sync::{OwnedSemaphorePermit, mpsc, watch};
use tokio::time::{Instant, timeout, timeout_at};

/// Number of bytes read at once.
const READ_BYTES: usize = 64 << 10;

/// Most bytes of incomplete data of all clients together.
const MAX_HELD: usize = 64 << 20;

/// Most answers that wait for the client to read them: each foreign topic's, and those of the streams.
const ANSWERS: usize = 40;

/// Longest time for a client to read its last answers.
const PATIENCE: Duration = Duration::from_secs(1);

/// Reason why a conversation is over, other than the client's own end.
enum Farewell {
    /// The client sent malformed data.
    Garbage(Refusal),
    /// The client sent nothing complete for too long.
    Idle(Duration),
    /// All clients together hold too much.
    Crowded,
    /// All places are taken.
    Full,
    /// The holder of the client's certificate has as many places as one may.
    Crowd,
    /// The client's certificate does not allow what it sent.
    Forbidden(String),
    /// The client sent nothing valid, and others came.
    Pushed,
    /// The connection broke.
    Gone(String),
    /// The journal takes no more of its data.
    Closed(Closed),
}

impl From<Closed> for Farewell {
    fn from(closed: Closed) -> Self {
        Self::Closed(closed)
    }
}

/// Serves one client, admitted at that moment, to its end.
pub(super) async fn attend<I: Intake>(
    socket: Box<dyn Socket>,
    let_in: Instant,
    stay: Stay,
    (peer, rights): (&str, Rights),
    server: &Server<I>,
    mut stop: watch::Receiver<bool>,
) {
    let (mut input, output) = tokio::io::split(socket);
    let (said, answers) = mpsc::channel(ANSWERS);
    let mut writer = tokio::spawn(write(output, answers));
    let mut topics = server.topics.clone();
    let of_rods = Arc::clone(&topics.borrow_and_update());
    let mut protocol = Protocol::new(rights.narrow(&of_rods));
    // A topic of a rod that is not the holder's must be seen among any number of others.
    protocol.name(of_rods);
    let mut client = Client {
        server,
        topics,
        rights,
        protocol,
        said,
        name: None,
        line: None,
        place: None,
        standing: Standing::Entering(stay),
        held: Held {
            all: &server.held,
            mine: 0,
        },
    };
    let outcome = tokio::select! {
        _ = stop.wait_for(|stop| *stop) => Err(Farewell::Closed(Closed::Stopping)),
        outcome = client.converse(&mut input, let_in) => outcome,
    };
    client.leave(peer, outcome).await;
    drop(client);
    // Dropping the client ended its answers; those already written are either read by the client or lost.
    if timeout(PATIENCE, &mut writer).await.is_err() {
        writer.abort();
    }
    linger(&mut input).await;
}

struct Client<'a, I: Intake> {
    server: &'a Server<I>,
    topics: Topics,
    rights: Rights,
    protocol: Protocol,
    said: mpsc::Sender<Said>,
    /// Name of the sender of the current stream.
    name: Option<String>,
    /// Way of the current stream into the journal.
    line: Option<I::Line>,
    /// Closed when a newer connection has this sender's name.
    place: Option<watch::Receiver<()>>,
    standing: Standing<'a>,
    held: Held<'a>,
}

/// Place of a client.
enum Standing<'a> {
    /// It has sent nothing valid yet.
    Entering(Stay),
    /// It has a place, until it leaves.
    In {
        _place: OwnedSemaphorePermit,
        _share: Share,
        _present: Present<'a>,
    },
}

/// Completes when a client in the entrance must make room.
async fn pushed(standing: &Standing<'_>) {
    match standing {
        Standing::Entering(stay) => stay.must_leave().await,
        Standing::In { .. } => std::future::pending().await,
    }
}

impl<I: Intake> Client<'_, I> {
    /// Listens until the client closes its side.
    async fn converse(
        &mut self,
        input: &mut (impl AsyncRead + Unpin),
        let_in: Instant,
    ) -> Result<(), Farewell> {
        let mut buffer = vec![0; READ_BYTES];
        let mut alive = let_in;
        let mut progress = 0;
        loop {
            let patience = if self.protocol.has_spoken() {
                Duration::from_secs_f64(self.server.settings.idle_s)
            } else {
                GREETING
            };
            let read = tokio::select! {
                () = replaced(&mut self.place) => return Err(Closed::TakenOver.into()),
                () = pushed(&self.standing) => return Err(Farewell::Pushed),
                read = timeout_at(alive + patience, input.read(&mut buffer)) => read,
            };
            let count = match read {
                Err(_) => return Err(Farewell::Idle(patience)),
                Ok(Err(fault)) => return Err(Farewell::Gone(fault.to_string())),
                Ok(Ok(count)) => count,
            };
            self.server.counts.add(|counts| &counts.bytes, count as u64);
            self.protocol.push(buffer.get(..count).unwrap_or_default());
            if count == 0 {
                self.protocol.close();
            }
            self.digest().await?;
            if count == 0 {
                return Ok(());
            }
            self.held.set(self.protocol.held())?;
            // A record that comes byte by byte is no sign of life; time spent waiting for the journal does not count.
            if self.protocol.has_spoken() && progress != self.protocol.progress() {
                progress = self.protocol.progress();
                alive = Instant::now();
            }
        }
    }

    /// Passes on everything that is complete.
    async fn digest(&mut self) -> Result<(), Farewell> {
        if self.topics.has_changed().unwrap_or(false) {
            let of_rods = Arc::clone(&self.topics.borrow_and_update());
            self.protocol.retarget(self.rights.narrow(&of_rods));
            self.protocol.name(of_rods);
        }
        let mut turn = None;
        loop {
            // Only a connection with a turn holds batches, which bounds the memory of all.
            if turn.is_none() {
                turn = Some(self.server.turns.acquire().await);
            }
            let step = self.protocol.next(clock::now_ns());
            if matches!(self.standing, Standing::Entering(_)) && self.protocol.has_spoken() {
                let place = Arc::clone(&self.server.clients).try_acquire_owned();
                let place = place.map_err(|_| Farewell::Full)?;
                let holder = self.rights.holder();
                let share = self.server.shares.enter(holder).ok_or(Farewell::Crowd)?;
                self.standing = Standing::In {
                    _place: place,
                    _share: share,
                    _present: Present::of(&self.server.counts),
                };
            }
            let foreign = self.protocol.take_foreign();
            if foreign > 0 {
                let strays = self.server.health.strays();
                self.protocol.strays().for_each(|topic| strays.came(topic));
            }
            self.rights
                .check_topics(self.protocol.strays(), &self.topics.borrow())
                .map_err(Farewell::Forbidden)?;
            self.server.counts.add(|counts| &counts.foreign, foreign);
            self.server.counts.add(|counts| &counts.messages, foreign);
            if let Some(left_out) = self.protocol.take_left_out() {
                let who = self.name.as_deref().unwrap_or("a client without a name");
                self.server.health.fault(
                    Fault::Client,
                    format_args!("{who}: messages are left out: {}", left_out.reason),
                );
                self.say(Said::Reply(Reply::LeftOut(left_out)));
            }
            // No fault: a recording may well hold more than the rods' topics. The sender must know all the same.
            while let Some(stray) = self.protocol.take_stray() {
                self.say(Said::Reply(Reply::LeftOut(stray)));
            }
            match step.map_err(Farewell::Garbage)? {
                None => return Ok(()),
                Some(Step::Batch(batch)) => {
                    let messages = batch
                        .entries
                        .iter()
                        .filter(|entry| matches!(entry, Entry::Message { .. }));
                    self.server
                        .counts
                        .add(|counts| &counts.messages, messages.count() as u64);
                    let line = match &mut self.line {
                        Some(line) => line,
                        none => none.insert(self.server.intake.connect(None).await?),
                    };
                    line.append(batch).await?;
                }
                Some(Step::Hello(name)) => {
                    turn = None;
                    self.hello(name).await?;
                }
                Some(Step::End { messages, left_out }) => {
                    turn = None;
                    if let Some(line) = self.line.take() {
                        line.end(End::Complete).await?;
                    }
                    self.server.counts.add(|counts| &counts.completed, 1);
                    self.say(Said::Unfollow);
                    self.say(Said::Reply(Reply::Done { messages, left_out }));
                    self.forget();
                }
                Some(Step::Cut) => {
                    return Err(Farewell::Gone("it ended in the middle of a stream".to_owned()));
                }
            }
        }
    }

    async fn hello(&mut self, name: String) -> Result<(), Farewell> {
        self.rights.check_sender(&name).map_err(Farewell::Forbidden)?;
        let (newest, place) = watch::channel(());
        self.senders().insert(name.clone(), newest);
        self.place = Some(place);
        self.name = Some(name.clone());
        let line = self.server.intake.connect(Some(&name)).await?;
        let messages = line.begins_at();
        self.protocol.welcome(messages);
        self.say(Said::Reply(Reply::Welcome {
            sender: name,
            messages,
        }));
        self.say(Said::Follow(messages, line.durable()));
        self.line = Some(line);
        Ok(())
    }

    /// Gives the sender's name up.
    fn forget(&mut self) {
        let (Some(name), Some(place)) = (self.name.take(), self.place.take()) else {
            return;
        };
        let mut senders = self.senders();
        if senders
            .get(&name)
            .is_some_and(|newest| newest.subscribe().same_channel(&place))
        {
            senders.remove(&name);
        }
    }

    fn senders(&self) -> MutexGuard<'_, HashMap<String, watch::Sender<()>>> {
        self.server.senders.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sends an answer to the client, unless it has stopped reading.
    fn say(&self, what: Said) {
        let _ = self.said.try_send(what);
    }

    /// Reports the end of the conversation to client, health and log.
    async fn leave(&mut self, peer: &str, outcome: Result<(), Farewell>) {
        let who = match &self.name {
            Some(name) => format!("{name} ({peer})"),
            None => peer.to_owned(),
        };
        let health = &self.server.health;
        let is_named = self.name.is_some();
        self.forget();
        let is_amid = self.line.is_some();
        if is_amid {
            self.server.counts.add(|counts| &counts.cut, 1);
        }
        let farewell = match outcome {
            Ok(()) => None,
            Err(Farewell::Garbage(Refusal(what))) => {
                health.fault(Fault::Client, format_args!("{who}: {what}; closed"));
                Some((what, false))
            }
            Err(Farewell::Idle(patience)) => {
                let what = format!("nothing whole came for {} s", patience.as_secs_f64());
                health.fault(Fault::Idle, format_args!("{who}: {what}; closed"));
                Some((what, true))
            }
            Err(Farewell::Crowded) => {
                let what = format!(
                    "all clients together hold {} MiB; send smaller chunks",
                    MAX_HELD >> 20
                );
                health.fault(Fault::Refused, format_args!("{who}: {what}; closed"));
                Some((what, true))
            }
            Err(Farewell::Full) => {
                let what = self.server.full();
                health.fault(Fault::Refused, format_args!("{who}: turned away, {what}"));
                Some((what, true))
            }
            Err(Farewell::Crowd) => {
                let most = self.server.shares.most();
                let what =
                    format!("{most} clients with this certificate are connected already, the most of one");
                health.fault(Fault::Refused, format_args!("{who}: turned away, {what}"));
                Some((what, true))
            }
            Err(Farewell::Forbidden(what)) => {
                health.credentials().denied(Via::Socket);
                health.fault(Fault::Refused, format_args!("{who}: {what}; closed"));
                Some((what, false))
            }
            // Reported where it was released.
            Err(Farewell::Pushed) => Some(("it said nothing, and others came".to_owned(), true)),
            Err(Farewell::Gone(what)) => {
                if is_amid && !is_named {
                    health.fault(
                        Fault::Recording,
                        format_args!("{who}: {what}; its last record is cut short"),
                    );
                } else {
                    tracing::info!("{who}: {what}");
                }
                None
            }
            Err(Farewell::Closed(Closed::TakenOver)) => {
                let what = Closed::TakenOver.to_string();
                health.fault(
                    Fault::Client,
                    format_args!("{who}: {what}; the older one is closed"),
                );
                Some((what, false))
            }
            Err(Farewell::Closed(Closed::Stopping)) => Some((Closed::Stopping.to_string(), true)),
        };
        if let Some((reason, again)) = farewell {
            self.say(Said::Reply(Reply::Error { reason, again }));
        }
        // Dropped, its stream counts as broken.
        self.line = None;
    }
}

/// Completes when a newer connection has this sender's name.
async fn replaced(place: &mut Option<watch::Receiver<()>>) {
    match place {
        Some(place) => while place.changed().await.is_ok() {},
        None => std::future::pending().await,
    }
}

/// A client's share of the memory of all. It never shrinks, as buffers do not either.
struct Held<'a> {
    all: &'a AtomicUsize,
    mine: usize,
}

impl Held<'_> {
    fn set(&mut self, now: usize) -> Result<(), Farewell> {
        let more = now.saturating_sub(self.mine);
        if more == 0 {
            return Ok(());
        }
        self.mine = now;
        if self.all.fetch_add(more, Ordering::Relaxed) + more > MAX_HELD {
            return Err(Farewell::Crowded);
        }
        Ok(())
    }
}

impl Drop for Held<'_> {
    fn drop(&mut self) {
        self.all.fetch_sub(self.mine, Ordering::Relaxed);
    }
}

/// Counts a client until dropped.
struct Present<'a>(&'a AtomicU64);

impl<'a> Present<'a> {
    fn of(counts: &'a Counts) -> Self {
        counts.add(|counts| &counts.clients, 1);
        Self(&counts.clients)
    }
}

impl Drop for Present<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}
