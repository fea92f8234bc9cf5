//! `tirante serve` on a port of its own, and a client that sends exactly the bytes of a test.
#![allow(clippy::unwrap_used, dead_code)] // helpers of tests are tests; not every test uses all of them

use super::site::Site;
use serde_json::Value as Json;
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::os::unix::fs::PermissionsExt;
use std::process::{Child, Stdio};
use std::sync::Mutex;
use std::time::Duration;

/// Longest wait before the test fails.
const PATIENCE: Duration = Duration::from_secs(60);

pub const TOKEN: &str = "0123456789abcdef-secret";

/// The server, ended when this is dropped.
pub struct Server {
    pub address: SocketAddr,
    child: Child,
}

impl Server {
    pub fn of(site: &Site, store: &str) -> Self {
        // Tests that share a site begin servers side by side.
        static TOKENS: Mutex<()> = Mutex::new(());
        let writing = TOKENS.lock().unwrap();
        if !site.path("token").exists() {
            fs::write(site.path("token"), format!("{TOKEN}\n")).unwrap();
            fs::set_permissions(site.path("token"), fs::Permissions::from_mode(0o600)).unwrap();
        }
        drop(writing);
        let words = [
            "serve",
            "--store",
            store,
            "--listen",
            "127.0.0.1:0",
            "--token-file",
            "token",
            "--viewer-origin",
            "https://viewer.example",
        ];
        let mut child = site.command(&words).stderr(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        let mut said = BufReader::new(child.stderr.take().unwrap());
        said.read_line(&mut line).unwrap();
        let address = line.split("http://").nth(1).unwrap_or_else(|| panic!("{line}"));
        Self {
            address: address.split_whitespace().next().unwrap().parse().unwrap(),
            child,
        }
    }

    /// Sends a request and returns the connection.
    fn send(&self, method: &str, path: &str, headers: &str) -> TcpStream {
        let mut stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let host = if headers.contains("Host:") {
            ""
        } else {
            "Host: localhost\r\n"
        };
        write!(stream, "{method} {path} HTTP/1.1\r\n{host}{headers}\r\n").unwrap();
        stream
    }

    fn answer(&self, method: &str, path: &str, headers: &str) -> (String, Vec<u8>) {
        let mut stream = self.send(method, path, &format!("Connection: close\r\n{headers}"));
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        let end = answer.windows(4).position(|four| four == b"\r\n\r\n").unwrap();
        let body = answer.split_off(end + 4);
        (String::from_utf8(answer).unwrap().to_ascii_lowercase(), body)
    }

    fn whole(&self, method: &str, path: &str, headers: &str) -> (String, String) {
        let (head, body) = self.answer(method, path, headers);
        (head, String::from_utf8(body).unwrap())
    }

    /// Status and body as they were sent.
    pub fn bytes(&self, path: &str, headers: &str) -> (u16, Vec<u8>) {
        let (head, body) = self.answer("GET", path, headers);
        (head.split(' ').nth(1).unwrap().parse().unwrap(), body)
    }

    /// Status and body.
    pub fn ask(&self, method: &str, path: &str, headers: &str) -> (u16, String) {
        let (head, body) = self.whole(method, path, headers);
        (head.split(' ').nth(1).unwrap().parse().unwrap(), body)
    }

    /// The head of an answer, in lower case.
    pub fn head(&self, path: &str) -> String {
        self.whole("GET", path, "").0
    }

    /// The whole answer to HEAD, in lower case.
    pub fn only_head(&self, path: &str) -> String {
        let (head, body) = self.whole("HEAD", path, "");
        assert_eq!(body, "", "{path}");
        head
    }

    pub fn get(&self, path: &str) -> Json {
        let (status, body) = self.ask("GET", path, "");
        assert_eq!(status, 200, "{path}: {body}");
        serde_json::from_str(&body).unwrap()
    }

    /// Status of an answer with a reason.
    pub fn refused(&self, path: &str) -> u16 {
        let (status, body) = self.ask("GET", path, "");
        let reason: Result<Json, _> = serde_json::from_str(&body);
        assert!(
            reason.is_ok_and(|body| body["error"].is_string()),
            "{path}: {status} {body}"
        );
        status
    }

    /// A connection with a continuing answer.
    pub fn stream(&self, path: &str) -> TcpStream {
        self.send("GET", path, "")
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
