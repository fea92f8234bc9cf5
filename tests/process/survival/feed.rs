//! Data on their way to a daemon that may be gone at any moment: files that appear, one that grows, `tirante send`, and a client that
//! checks the daemon's acknowledgements.

use super::campaign::Data;
use serde_json::Value;
use std::fs::{self, OpenOptions};
use std::io::{BufRead, BufReader, ErrorKind, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// State shared by the two senders and the test.
#[derive(Default)]
struct Shared {
    /// Share of all data that may be sent [millionths].
    share: AtomicU64,
    stop: AtomicBool,
    /// The client is to break off in the middle of a line.
    cut: AtomicBool,
    lines_are_done: AtomicBool,
    files_are_sent: AtomicBool,
    acks: AtomicU64,
    welcomes: AtomicU64,
    sender: Mutex<Option<Child>>,
    broken: Mutex<Vec<String>>,
}

impl Shared {
    fn of(&self, total: usize) -> usize {
        let share = self.share.load(Ordering::Relaxed);
        (total as u64 * share / 1_000_000) as usize
    }

    fn is_over(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

pub struct Feed {
    data: Arc<Data>,
    folder: PathBuf,
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
    appeared: usize,
    grown: usize,
}

impl Feed {
    pub fn start(data: Arc<Data>, folder: &Path) -> Self {
        let shared = Arc::<Shared>::default();
        let lines = {
            let (shared, data) = (Arc::clone(&shared), Arc::clone(&data));
            let socket = folder.join("state/in.sock");
            thread::spawn(move || while !client(&shared, &socket, &data.lines) {})
        };
        let sender = {
            let (shared, data) = (Arc::clone(&shared), Arc::clone(&data));
            let folder = folder.to_owned();
            thread::spawn(move || send(&shared, &folder, &data.sent))
        };
        Self {
            data,
            folder: folder.to_owned(),
            shared,
            threads: vec![lines, sender],
            appeared: 0,
            grown: 0,
        }
    }

    /// Offers this share of all data.
    pub fn offer(&mut self, share: f64) {
        self.shared.share.store((share * 1e6) as u64, Ordering::Relaxed);
        let archive = self.folder.join("archive");
        while self.appeared < self.shared.of(self.data.files.len()) {
            let name = format!("north-{:03}.mcap", self.appeared);
            fs::write(self.folder.join("coming"), &self.data.files[self.appeared]).unwrap();
            fs::rename(self.folder.join("coming"), archive.join(name)).unwrap();
            self.appeared += 1;
        }
        let until = self.shared.of(self.data.growing.len());
        if until > self.grown {
            let path = archive.join("west.mcap");
            let mut file = OpenOptions::new().create(true).append(true).open(path).unwrap();
            file.write_all(&self.data.growing[self.grown..until]).unwrap();
            self.grown = until;
        }
    }

    /// Kills `tirante send`; it is started again with `--resume`.
    pub fn kill_sender(&self) {
        if let Some(sender) = self.shared.sender.lock().unwrap().as_mut() {
            let _ = sender.kill();
        }
    }

    /// Cuts the client's connection in the middle of a line; it comes again.
    pub fn cut(&self) {
        self.shared.cut.store(true, Ordering::Relaxed);
    }

    /// True if the senders were told that all data is durable.
    pub fn is_done(&self) -> bool {
        assert_eq!(*self.shared.broken.lock().unwrap(), [""; 0]);
        self.shared.lines_are_done.load(Ordering::Relaxed)
            && self.shared.files_are_sent.load(Ordering::Relaxed)
    }

    /// Number of acknowledgements the client received.
    pub fn acks(&self) -> u64 {
        self.shared.acks.load(Ordering::Relaxed)
    }

    /// Welcomes that told the client how much is durable.
    pub fn welcomes(&self) -> u64 {
        self.shared.welcomes.load(Ordering::Relaxed)
    }
}

impl Drop for Feed {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        self.kill_sender();
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// Runs one `tirante send` per recording, started again until it reports that everything is durable.
fn send(shared: &Shared, folder: &Path, recordings: &[PathBuf]) {
    let to = format!("unix://{}", folder.join("state/in.sock").display());
    let mut sent = 0;
    while sent < recordings.len() && !shared.is_over() {
        if sent < shared.of(recordings.len()) {
            let child = Command::new(env!("CARGO_BIN_EXE_tirante"))
                .arg("send")
                .arg(&recordings[sent])
                .args(["--to", &to, "--sender", "south", "--speed", "max", "--resume"])
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .unwrap();
            *shared.sender.lock().unwrap() = Some(child);
            let status = loop {
                let ended = shared
                    .sender
                    .lock()
                    .unwrap()
                    .as_mut()
                    .unwrap()
                    .try_wait()
                    .unwrap();
                match ended {
                    Some(status) => break status,
                    None => thread::sleep(Duration::from_millis(5)),
                }
            };
            sent += usize::from(status.success());
        }
        thread::sleep(Duration::from_millis(5));
    }
    shared
        .files_are_sent
        .store(sent == recordings.len(), Ordering::Relaxed);
}

/// Runs a connection of the client; returns true if it is the last one.
fn client(shared: &Shared, socket: &Path, lines: &[String]) -> bool {
    thread_local! {
        /// Number of lines acknowledged, and true if the end was sent: the daemon may have forgotten the
        /// stream then.
        static ACKED: std::cell::Cell<(u64, bool)> = const { std::cell::Cell::new((0, false)) };
    }
    if shared.is_over() {
        return true;
    }
    let lost = || thread::sleep(Duration::from_millis(3));
    let Ok(stream) = UnixStream::connect(socket) else {
        lost();
        return false;
    };
    stream.set_read_timeout(Some(Duration::from_millis(20))).unwrap();
    stream
        .set_write_timeout(Some(Duration::from_millis(200)))
        .unwrap();
    let mut answers = BufReader::new(stream.try_clone().unwrap());
    let mut stream = stream;
    if stream.write_all(b"{\"hello\":{\"sender\":\"east\"}}\n").is_err() {
        return false;
    }
    let (mut next, mut has_ended) = (None, false);
    let mut said = String::new();
    loop {
        if shared.is_over() {
            return true;
        }
        match answers.read_line(&mut said) {
            Ok(0) => {
                lost();
                return false;
            }
            Ok(_) => {
                let answer: Value = serde_json::from_str(&said).unwrap_or_default();
                said.clear();
                let count = |what: &str| answer[what]["messages"].as_u64();
                let (acked, was_ended) = ACKED.get();
                if let Some(from) = count("welcome") {
                    let is_forgotten = was_ended && from == 0;
                    if from < acked && !is_forgotten {
                        let what = format!("{acked} lines were acknowledged, {from} are there");
                        shared.broken.lock().unwrap().push(what);
                    }
                    // The number in the daemon's welcome is acknowledged.
                    shared.welcomes.fetch_add(u64::from(from > 0), Ordering::Relaxed);
                    ACKED.set((from, false));
                    next = Some(usize::try_from(from).unwrap());
                } else if let Some(acked) = count("ack") {
                    shared.acks.fetch_add(1, Ordering::Relaxed);
                    ACKED.set((acked, was_ended));
                } else if count("done") == Some(lines.len() as u64) {
                    shared.lines_are_done.store(true, Ordering::Relaxed);
                    return true;
                }
            }
            Err(fault) if matches!(fault.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(_) => return false,
        }
        let Some(next) = &mut next else { continue };
        if shared.cut.swap(false, Ordering::Relaxed) {
            let line = lines.get(*next).map_or("{", String::as_str).as_bytes();
            let _ = stream.write_all(&line[..line.len() / 2]);
            return false;
        }
        let until = shared.of(lines.len());
        while *next < until {
            if stream.write_all(lines[*next].as_bytes()).is_err() {
                return false;
            }
            *next += 1;
        }
        if *next == lines.len() && !has_ended {
            has_ended = true;
            ACKED.set((ACKED.get().0, true));
            if stream.write_all(b"{\"end\":true}\n").is_err() {
                return false;
            }
        }
    }
}
