//! A receiver of alarms that can be down, hang, refuse, and come back.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Mutex, Weak};
use std::thread;
use std::time::Duration;

/// Interval between looks for connections.
const LOOK: Duration = Duration::from_millis(5);

/// Reaction to a request.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Mood {
    Well,
    /// No listener.
    Down,
    /// Takes the request and does not answer.
    Hanging,
    /// Answers with this.
    Refusing(&'static str),
}

pub struct Server {
    pub address: SocketAddr,
    shared: Arc<Shared>,
}

struct Shared {
    mood: Mutex<Mood>,
    /// Bodies that were answered with 200, in order.
    taken: Mutex<Vec<String>>,
    refused: Mutex<usize>,
}

impl Server {
    pub fn new(mood: Mood) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let shared = Arc::new(Shared {
            mood: Mutex::new(mood),
            taken: Mutex::default(),
            refused: Mutex::default(),
        });
        let weak = Arc::downgrade(&shared);
        thread::spawn(move || listen(listener, &weak));
        Self { address, shared }
    }

    /// Answers so from now on.
    pub fn set(&self, mood: Mood) {
        *self.shared.mood.lock().unwrap() = mood;
    }

    pub fn heal(&self) {
        self.set(Mood::Well);
    }

    pub fn taken(&self) -> Vec<String> {
        self.shared.taken.lock().unwrap().clone()
    }

    pub fn refused(&self) -> usize {
        *self.shared.refused.lock().unwrap()
    }
}

/// Takes connections while there is a listener to be, and until the server is dropped.
fn listen(listener: TcpListener, shared: &Weak<Shared>) {
    let address = listener.local_addr().unwrap();
    let mut listener = Some(listener);
    while let Some(shared) = shared.upgrade() {
        if *shared.mood.lock().unwrap() == Mood::Down {
            listener = None;
        } else {
            let listener = listener.get_or_insert_with(|| TcpListener::bind(address).unwrap());
            listener.set_nonblocking(true).unwrap();
            while let Ok((stream, _)) = listener.accept() {
                let shared = Arc::clone(&shared);
                thread::spawn(move || shared.answer(stream));
            }
        }
        drop(shared);
        thread::sleep(LOOK);
    }
}

impl Shared {
    fn answer(&self, stream: TcpStream) -> Option<()> {
        stream.set_nonblocking(false).ok()?;
        stream.set_read_timeout(Some(Duration::from_secs(60))).ok()?;
        let mut reader = BufReader::new(stream);
        loop {
            let mut length = 0;
            loop {
                let mut line = String::new();
                if reader.read_line(&mut line).ok()? == 0 {
                    return None;
                }
                if let Some(value) = line.to_ascii_lowercase().strip_prefix("content-length:") {
                    length = value.trim().parse().ok()?;
                }
                if line.trim().is_empty() {
                    break;
                }
            }
            let mut body = vec![0; length];
            reader.read_exact(&mut body).ok()?;
            let mood = *self.mood.lock().unwrap();
            let answer = match mood {
                Mood::Well => {
                    self.taken.lock().unwrap().push(String::from_utf8(body).ok()?);
                    "200 OK\r\n"
                }
                Mood::Refusing(answer) => {
                    *self.refused.lock().unwrap() += 1;
                    answer
                }
                Mood::Down => return None,
                Mood::Hanging => {
                    *self.refused.lock().unwrap() += 1;
                    // Until the other side gives up.
                    let _ = reader.read(&mut [0]);
                    return None;
                }
            };
            write!(reader.get_mut(), "HTTP/1.1 {answer}Content-Length: 0\r\n\r\n").ok()?;
        }
    }
}
