//! An HTTP server that answers as scripted.

use serde_json::Value;
use std::collections::{BTreeMap, VecDeque};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use tokio_rustls::rustls::{ServerConfig, ServerConnection, StreamOwned};

/// Reaction of the server to a request.
#[derive(Debug, Clone)]
pub enum Answer {
    /// Answers with this status and these headers.
    Status(u16, &'static str),
    /// Ends the connection.
    Drop,
    /// Is silent for this time, then ends the connection.
    Hang(Duration),
}

/// A request as received.
#[derive(Debug, Clone)]
pub struct Request {
    pub time: Instant,
    pub path: String,
    /// Names in lower case.
    pub headers: BTreeMap<String, String>,
    pub body: Value,
}

pub struct Fake {
    pub address: SocketAddr,
    requests: Arc<Mutex<Vec<Request>>>,
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Fake {
    /// Answers by the script, then 200 to everything.
    pub fn new(script: &[Answer]) -> Self {
        Self::at("127.0.0.1:0".parse().unwrap(), script, None)
    }

    pub fn at(address: SocketAddr, script: &[Answer], tls: Option<Arc<ServerConfig>>) -> Self {
        let listener = TcpListener::bind(address).unwrap();
        let address = listener.local_addr().unwrap();
        let requests = Arc::new(Mutex::new(Vec::new()));
        let script = Arc::new(Mutex::new(VecDeque::from(script.to_vec())));
        let is_over = Arc::new(AtomicBool::new(false));
        let thread = thread::spawn({
            let (requests, is_over) = (Arc::clone(&requests), Arc::clone(&is_over));
            move || {
                for stream in listener.incoming() {
                    if is_over.load(Ordering::SeqCst) {
                        return;
                    }
                    let (requests, script, tls) = (Arc::clone(&requests), Arc::clone(&script), tls.clone());
                    let stream = stream.unwrap();
                    // A thread a connection: one that hangs does not hold up the next.
                    thread::spawn(move || match tls {
                        None => serve(stream, &requests, &script),
                        Some(config) => {
                            let session = ServerConnection::new(config).unwrap();
                            serve(StreamOwned::new(session, stream), &requests, &script)
                        }
                    });
                }
            }
        });
        Self {
            address,
            requests,
            is_over,
            thread: Some(thread),
        }
    }

    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    pub fn requests(&self) -> Vec<Request> {
        self.requests.lock().unwrap().clone()
    }

    pub fn bodies(&self) -> Vec<Value> {
        self.requests().into_iter().map(|request| request.body).collect()
    }
}

impl Drop for Fake {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::SeqCst);
        let _ = TcpStream::connect(self.address);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn serve<S: Read + Write>(stream: S, requests: &Mutex<Vec<Request>>, script: &Mutex<VecDeque<Answer>>) {
    let mut stream = BufReader::new(stream);
    let Some(request) = read(&mut stream) else { return };
    // Request and answer belong together: two connections do not take each other's.
    let answer = {
        let mut requests = requests.lock().unwrap();
        requests.push(request);
        script.lock().unwrap().pop_front()
    };
    let answer = answer.unwrap_or(Answer::Status(200, ""));
    match answer {
        Answer::Status(status, headers) => {
            let _ = write!(
                stream.get_mut(),
                "HTTP/1.1 {status} As scripted\r\n{headers}Content-Length: 6\r\nConnection: close\r\n\r\nanswer"
            );
            let _ = stream.get_mut().flush();
        }
        Answer::Drop => {}
        Answer::Hang(time) => thread::sleep(time),
    }
}

fn read(stream: &mut impl BufRead) -> Option<Request> {
    let mut line = String::new();
    stream.read_line(&mut line).ok()?;
    let path = line.split(' ').nth(1)?.to_owned();
    let mut headers = BTreeMap::new();
    loop {
        let mut line = String::new();
        stream.read_line(&mut line).ok()?;
        let Some((name, value)) = line.trim_end().split_once(':') else {
            break;
        };
        headers.insert(name.to_ascii_lowercase(), value.trim().to_owned());
    }
    let length = headers.get("content-length")?.parse().ok()?;
    let mut body = vec![0; length];
    stream.read_exact(&mut body).ok()?;
    Some(Request {
        time: Instant::now(),
        path,
        headers,
        body: serde_json::from_slice(&body).ok()?,
    })
}
