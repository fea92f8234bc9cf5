//! Runs the listeners: admits clients, turns them away, and notifies them when the daemon stops.

use super::certificate::Rights;
use super::connection;
use super::counts::Counts;
use super::entrance::{Entrance, Stay};
use super::intake::Intake;
use super::listener::{ListenError, Listener};
use super::reply::Reply;
use super::shares::Shares;
use super::socket_file::SocketFile;
use super::tls::Identity;
use crate::config::RodConfig;
use crate::config::settings::ingest::IngestSettings;
use crate::service::telemetry::{Fault, Health, Via};
use crate::site::clock;
use std::collections::{BTreeSet, HashMap};
use std::io;
use std::net::SocketAddr;
use std::sync::atomic::AtomicUsize;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, UnixListener};
use tokio::sync::{Semaphore, watch};
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep, timeout, timeout_at};

/// Time of an admitted client for its TLS handshake and its first valid data. With the time to read the
/// error, it is gone within ten seconds.
pub(super) const GREETING: Duration = Duration::from_secs(7);

/// Time for clients to leave when the daemon stops.
const FAREWELL: Duration = Duration::from_millis(1500);

/// Longest time for a disconnected client to read the reason.
const LINGER: Duration = Duration::from_secs(1);

/// Most clients turned away at once with a reason.
const TOLD_AT_ONCE: usize = 16;

/// Interval at which the files of the certificates are looked at.
const LOOK: Duration = Duration::from_secs(1);

/// Most batches on their way from clients to the journal: they take turns.
const TURNS: usize = 2;

/// Topics that rods read.
pub type TopicSet = BTreeSet<String>;

/// Topics that rods read, at present: a reload sends new ones.
pub type Topics = watch::Receiver<Arc<TopicSet>>;

/// Topics that the rods of a configuration read.
pub fn topics_of(rods: &[RodConfig]) -> TopicSet {
    let channels = rods.iter().flat_map(|rod| rod.channels.all());
    channels.map(|channel| channel.topic.clone()).collect()
}

/// State shared by all connections.
pub struct Server<I> {
    pub(super) settings: IngestSettings,
    pub(super) topics: Topics,
    pub(super) intake: I,
    pub(super) health: Arc<Health>,
    pub(super) counts: Arc<Counts>,
    tls: Option<Identity>,
    pub(super) turns: Semaphore,
    /// Places of clients that have sent valid data.
    pub(super) clients: Arc<Semaphore>,
    /// Shares of the holders of certificates in them.
    pub(super) shares: Shares,
    /// Bytes all clients together hold.
    pub(super) held: AtomicUsize,
    /// The connection of each sender: when a newer one takes its place, the older one ends.
    pub(super) senders: Mutex<HashMap<String, watch::Sender<()>>>,
}

impl<I: Intake> Server<I> {
    /// Reads the certificates.
    ///
    /// # Errors
    /// They cannot be used.
    pub fn new(
        settings: IngestSettings,
        topics: Topics,
        intake: I,
        health: Arc<Health>,
        counts: Arc<Counts>,
    ) -> Result<Self, ListenError> {
        let tls = settings.tls.clone().map(Identity::read).transpose()?;
        Ok(Self {
            clients: Arc::new(Semaphore::new(settings.clients)),
            shares: Shares::of(settings.clients),
            settings,
            topics,
            intake,
            health,
            counts,
            tls,
            turns: Semaphore::new(TURNS),
            held: AtomicUsize::new(0),
            senders: Mutex::default(),
        })
    }

    /// Error for a client beyond the limit.
    pub(super) fn full(&self) -> String {
        format!("{} clients are connected already", self.settings.clients)
    }
}

/// Serves until `stop` is true or its sender is gone, then disconnects all clients, within two seconds.
///
/// # Errors
/// A listener that others than this machine can reach, without TLS; one the system refuses, or one that broke.
pub async fn serve<I: Intake>(
    listeners: Vec<Listener>,
    server: Server<I>,
    stop: watch::Receiver<bool>,
) -> Result<(), ListenError> {
    if let Some(open) = listeners
        .iter()
        .find(|listener| server.tls.is_none() && !listener.is_local())
    {
        return Err(ListenError::Open(open.address()));
    }
    let shared = Arc::new(server);
    let mut doors = JoinSet::new();
    for listener in listeners {
        let address = listener.address();
        let door = Door::new(listener).map_err(|source| ListenError::Io {
            address: address.clone(),
            source,
        })?;
        tracing::info!("listening at {address}");
        let file = SocketFile::of(&door);
        doors.spawn(attend((door, file), address, Arc::clone(&shared), stop.clone()));
    }
    let closed = async {
        while let Some(ended) = doors.join_next().await {
            ended.map_err(|error| ListenError::Broken(error.to_string()))?;
        }
        Ok::<(), ListenError>(())
    };
    tokio::select! {
        closed = closed => closed,
        () = look_after(&shared) => Ok(()),
    }
}

/// Looks at the certificates from time to time.
async fn look_after<I: Intake>(shared: &Server<I>) {
    let Some(tls) = &shared.tls else {
        return std::future::pending().await;
    };
    loop {
        tls.look(clock::now_s(), &shared.health);
        sleep(LOOK).await;
    }
}

pub(super) trait Socket: AsyncRead + AsyncWrite + Send + Unpin {}
impl<T: AsyncRead + AsyncWrite + Send + Unpin> Socket for T {}

pub(super) enum Door {
    Tcp(TcpListener),
    Unix(UnixListener),
}

impl Door {
    pub(super) fn new(listener: Listener) -> io::Result<Self> {
        match listener {
            Listener::Tcp(listener) => {
                listener.set_nonblocking(true)?;
                TcpListener::from_std(listener).map(Self::Tcp)
            }
            Listener::Unix(listener) => {
                listener.set_nonblocking(true)?;
                UnixListener::from_std(listener).map(Self::Unix)
            }
        }
    }

    /// Accepts the next client, with its address if it has one.
    async fn accept(&self) -> io::Result<(Box<dyn Socket>, Option<SocketAddr>)> {
        match self {
            Self::Tcp(listener) => {
                let (stream, peer) = listener.accept().await?;
                stream.set_nodelay(true)?;
                Ok((Box::new(stream), Some(peer)))
            }
            Self::Unix(listener) => Ok((Box::new(listener.accept().await?.0), None)),
        }
    }
}

/// Admits clients at one listener.
async fn attend<I: Intake>(
    (mut door, mut file): (Door, Option<SocketFile>),
    address: String,
    shared: Arc<Server<I>>,
    mut stop: watch::Receiver<bool>,
) {
    let told = Arc::new(Semaphore::new(TOLD_AT_ONCE));
    let entrance = Arc::<Entrance>::default();
    let mut tasks = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            _ = stop.wait_for(|stop| *stop) => break,
            Some(ended) = tasks.join_next() => {
                report(&shared.health, ended);
                continue;
            }
            accepted = door.accept() => accepted,
            () = sleep(LOOK), if file.is_some() => {
                let renewed = file.as_mut().and_then(|file| file.look(&address, &shared.health));
                door = renewed.unwrap_or(door);
                continue;
            }
        };
        let (socket, peer) = match accepted {
            Ok(accepted) => accepted,
            Err(fault) => {
                // Out of descriptors, most likely: it passes when clients go.
                shared.health.fault(
                    Fault::Refused,
                    format_args!("{address}: a client cannot be let in: {fault}"),
                );
                sleep(Duration::from_millis(200)).await;
                continue;
            }
        };
        shared.counts.add(|counts| &counts.connections, 1);
        let name = match peer {
            Some(peer) => format!("tcp://{peer}"),
            None => format!("a client of {address}"),
        };
        let is_tls = matches!(door, Door::Tcp(_)) && shared.tls.is_some();
        // Without TLS the client is refused at once; with TLS after the handshake, so that it understands the reason.
        if !is_tls && shared.clients.available_permits() == 0 {
            let reason = shared.full();
            shared
                .health
                .fault(Fault::Refused, format_args!("{name}: turned away, {reason}"));
            if let Ok(telling) = Arc::clone(&told).try_acquire_owned() {
                tasks.spawn(async move {
                    turn_away(socket, reason, true).await;
                    drop(telling);
                });
            }
            continue;
        }
        let entering = entrance.enter(peer.map(|peer| peer.ip()));
        let (stay, has_left) = tokio::select! {
            _ = stop.wait_for(|stop| *stop) => break,
            entered = entering => entered,
        };
        if has_left {
            let what = "many connections that say nothing: the oldest is closed";
            shared
                .health
                .fault(Fault::Refused, format_args!("{address}: {what}"));
        }
        let (shared, stop) = (Arc::clone(&shared), stop.clone());
        tasks.spawn(async move { greet(socket, is_tls, stay, &name, &shared, stop).await });
    }
    drop(door);
    let farewell = async {
        while let Some(ended) = tasks.join_next().await {
            report(&shared.health, ended);
        }
    };
    let _ = timeout(FAREWELL, farewell).await;
    tasks.abort_all();
}

/// Serves a client that is in the entrance, first its TLS handshake if there must be one.
async fn greet<I: Intake>(
    socket: Box<dyn Socket>,
    is_tls: bool,
    stay: Stay,
    peer: &str,
    shared: &Server<I>,
    stop: watch::Receiver<bool>,
) {
    let let_in = Instant::now();
    let Some(tls) = shared.tls.as_ref().filter(|_| is_tls) else {
        return connection::attend(socket, let_in, stay, (peer, Rights::default()), shared, stop).await;
    };
    let shaken = tokio::select! {
        () = stay.must_leave() => return,
        shaken = timeout_at(let_in + GREETING, tls.acceptor().accept(socket)) => shaken,
    };
    match shaken {
        Ok(Ok(socket)) => match tls.rights(socket.get_ref().1, clock::now_s(), &shared.health) {
            Ok(rights) => {
                connection::attend(Box::new(socket), let_in, stay, (peer, rights), shared, stop).await;
            }
            Err(reason) => {
                shared
                    .health
                    .fault(Fault::Refused, format_args!("{peer}: {reason}"));
                turn_away(Box::new(socket), reason, false).await;
            }
        },
        Ok(Err(fault)) => {
            shared.health.credentials().denied(Via::Socket);
            shared
                .health
                .fault(Fault::Refused, format_args!("{peer}: no TLS connection: {fault}"));
        }
        Err(_) => {
            shared.health.fault(
                Fault::Idle,
                format_args!("{peer}: no TLS handshake in {GREETING:?}"),
            );
        }
    }
}

/// Reports a connection that panicked; the others go on.
fn report(health: &Health, ended: Result<(), tokio::task::JoinError>) {
    if ended.is_err_and(|fault| fault.is_panic()) {
        health.fault(Fault::Client, "a connection broke the program (please report)");
    }
}

async fn turn_away(mut socket: Box<dyn Socket>, reason: String, again: bool) {
    let reply = Reply::Error { reason, again };
    let told = timeout(LINGER, async {
        socket.write_all(format!("{reply}\n").as_bytes()).await?;
        socket.shutdown().await
    });
    if let Ok(Ok(())) = told.await {
        linger(&mut socket).await;
    }
}

/// Reads the client's remaining data for a moment: closing a socket with unread bytes would lose our last
/// answers.
pub(super) async fn linger(input: &mut (impl AsyncRead + Unpin)) {
    let until = Instant::now() + LINGER;
    let mut buffer = [0u8; 4096];
    while let Ok(Ok(1..)) = timeout_at(until, input.read(&mut buffer)).await {}
}
