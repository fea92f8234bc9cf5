//! Listeners on free ports, with a substitute for the journal behind them.
#![allow(dead_code, reason = "each test file uses its part")]
#![allow(clippy::unwrap_used, reason = "a test that cannot be set up fails")]

use std::collections::HashMap;
use std::io::{BufRead, BufReader, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tirante::config::settings::ingest::{IngestSettings, Listen};
use tirante::service::ingest::{Counts, Intake, IntakeLine, Listener, Server, TopicSet, serve};
use tirante::service::journal::{Batch, Closed, End, Entry};
use tirante::service::telemetry::{Fault, Health};
use tokio::sync::watch;

/// Result of one stream.
#[derive(Debug, Clone, Default)]
pub struct Written {
    pub sender: Option<String>,
    pub entries: Vec<Entry>,
    pub through: u64,
    /// End of the stream; `None` while it runs, or when it was dropped.
    pub end: Option<End>,
}

impl Written {
    /// Topic of every channel.
    pub fn channels(&self) -> Vec<&str> {
        let topics = self.entries.iter().filter_map(|entry| match entry {
            Entry::Channel { topic, .. } => Some(topic.as_str()),
            Entry::Message { .. } => None,
        });
        topics.collect()
    }

    /// Topic and content of every message.
    pub fn messages(&self) -> Vec<(String, u64, Vec<u8>)> {
        let mut topics = HashMap::new();
        let mut found = Vec::new();
        for entry in &self.entries {
            match entry {
                Entry::Channel { id, topic, .. } => {
                    topics.insert(*id, topic.clone());
                }
                Entry::Message {
                    channel,
                    log_time,
                    data,
                    ..
                } => {
                    found.push((topics[channel].clone(), *log_time, data.clone()));
                }
            }
        }
        found
    }
}

/// Substitute for the journal: everything is durable at once, unless its gate is shut.
#[derive(Clone)]
pub struct Ledger {
    inner: Arc<Mutex<Inner>>,
    gate: Arc<watch::Sender<bool>>,
}

#[derive(Default)]
struct Inner {
    streams: Vec<Written>,
    positions: HashMap<String, u64>,
    newest: HashMap<String, usize>,
}

pub struct LedgerLine {
    ledger: Ledger,
    index: usize,
    begins_at: u64,
    durable: watch::Sender<u64>,
}

impl Ledger {
    pub fn new() -> Self {
        Self {
            inner: Arc::default(),
            gate: Arc::new(watch::channel(true).0),
        }
    }

    pub fn streams(&self) -> Vec<Written> {
        self.inner.lock().unwrap().streams.clone()
    }

    /// Lets batches pass, or not.
    pub fn open(&self, is_open: bool) {
        self.gate.send_replace(is_open);
    }
}

impl Intake for Ledger {
    type Line = LedgerLine;

    async fn connect(&self, sender: Option<&str>) -> Result<LedgerLine, Closed> {
        let mut inner = self.inner.lock().unwrap();
        let index = inner.streams.len();
        let begins_at = sender
            .and_then(|name| inner.positions.get(name).copied())
            .unwrap_or(0);
        inner.streams.push(Written {
            sender: sender.map(str::to_owned),
            through: begins_at,
            ..Default::default()
        });
        if let Some(name) = sender {
            inner.newest.insert(name.to_owned(), index);
        }
        Ok(LedgerLine {
            ledger: self.clone(),
            index,
            begins_at,
            durable: watch::channel(begins_at).0,
        })
    }
}

impl IntakeLine for LedgerLine {
    fn begins_at(&self) -> u64 {
        self.begins_at
    }

    async fn append(&mut self, batch: Batch) -> Result<(), Closed> {
        let mut gate = self.ledger.gate.subscribe();
        gate.wait_for(|open| *open).await.map_err(|_| Closed::Stopping)?;
        let mut inner = self.ledger.inner.lock().unwrap();
        let sender = inner.streams[self.index].sender.clone();
        if let Some(name) = sender {
            if inner.newest[&name] != self.index {
                return Err(Closed::TakenOver);
            }
            inner.positions.insert(name, batch.through);
        }
        let stream = &mut inner.streams[self.index];
        stream.entries.extend(batch.entries);
        stream.through = batch.through;
        self.durable.send_replace(batch.through);
        Ok(())
    }

    fn durable(&self) -> watch::Receiver<u64> {
        self.durable.subscribe()
    }

    async fn end(self, how: End) -> Result<(), Closed> {
        let mut inner = self.ledger.inner.lock().unwrap();
        inner.streams[self.index].end = Some(how);
        if let (Some(name), End::Complete) = (inner.streams[self.index].sender.clone(), how) {
            inner.positions.remove(&name);
        }
        Ok(())
    }
}

/// Listeners at work, on TCP and Unix; they stop when it is dropped.
pub struct Daemon {
    pub address: SocketAddr,
    pub path: PathBuf,
    pub ledger: Ledger,
    pub health: Arc<Health>,
    pub counts: Arc<Counts>,
    pub topics: watch::Sender<Arc<TopicSet>>,
    stop: watch::Sender<bool>,
    thread: Option<std::thread::JoinHandle<()>>,
    _folder: tempfile::TempDir,
}

impl Daemon {
    pub fn start(settings: IngestSettings) -> Self {
        Self::with(settings, Ledger::new(), TcpListener::bind("127.0.0.1:0").unwrap())
    }

    pub fn with(settings: IngestSettings, ledger: Ledger, tcp: TcpListener) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ingest.sock");
        let address = tcp.local_addr().unwrap();
        let listeners = vec![
            Listener::Tcp(tcp),
            Listener::bind(&Listen::Unix(path.clone())).unwrap(),
        ];
        let topics: TopicSet = ["/laser", "/air"].map(str::to_owned).into();
        let (topics, wanted) = watch::channel(Arc::new(topics));
        let (health, counts) = (Arc::new(Health::default()), Arc::new(Counts::default()));
        let server = Server::new(
            settings,
            wanted,
            ledger.clone(),
            Arc::clone(&health),
            Arc::clone(&counts),
        )
        .unwrap();
        let (stop, stopped) = watch::channel(false);
        let thread = std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_multi_thread()
                .worker_threads(2)
                .enable_all()
                .build()
                .unwrap();
            runtime.block_on(serve(listeners, server, stopped)).unwrap();
        });
        Self {
            address,
            path,
            ledger,
            health,
            counts,
            topics,
            stop,
            thread: Some(thread),
            _folder: folder,
        }
    }

    pub fn client(&self) -> Client<TcpStream> {
        let stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
        stream.set_write_timeout(Some(Duration::from_secs(30))).unwrap();
        let copy = stream.try_clone().unwrap();
        Client {
            stream,
            answers: BufReader::new(copy),
        }
    }

    /// Stops, and returns the time taken.
    pub fn stop(&mut self) -> Duration {
        let since = Instant::now();
        self.stop.send_replace(true);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
        since.elapsed()
    }

    /// Waits until the only stream, or the last one, meets a condition.
    pub fn until(&self, what: &str, is_so: impl Fn(&Written) -> bool) -> Written {
        let mut last = None;
        wait_for(what, || {
            last = self.ledger.streams().pop();
            last.as_ref().is_some_and(&is_so)
        });
        last.unwrap()
    }

    pub fn count(&self, fault: Fault) -> u64 {
        self.health.count(fault)
    }

    pub fn clients(&self) -> u64 {
        self.counts.clients.load(Ordering::Relaxed)
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        self.stop.send_replace(true);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// A client that reads answers.
pub struct Client<S> {
    pub stream: S,
    pub answers: BufReader<S>,
}

impl<S: Write + std::io::Read> Client<S> {
    pub fn send(&mut self, bytes: impl AsRef<[u8]>) {
        self.stream.write_all(bytes.as_ref()).unwrap();
    }

    /// The next answer that is no ack; empty at the end.
    pub fn answer(&mut self) -> String {
        loop {
            let mut line = String::new();
            self.answers.read_line(&mut line).unwrap();
            if !line.starts_with("{\"ack\"") {
                return line.trim_end().to_owned();
            }
        }
    }
}

/// Waits for a condition.
pub fn wait_for(what: &str, mut is_so: impl FnMut() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(30);
    while !is_so() {
        assert!(Instant::now() < deadline, "not within 30 s: {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// A line of data.
pub fn line(topic: &str, i: u64) -> String {
    format!(
        "{{\"topic\":\"{topic}\",\"time\":{},\"value\":{i}}}\n",
        1_772_344_800_000_000_000 + i * 5_000_000
    )
}
