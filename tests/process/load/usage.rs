//! Resources of a process: memory, descriptors, processor time; and its own metrics.

use crate::survival::process::Process;
use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

/// Resources of a process at one moment.
#[derive(Debug, Clone, Copy)]
pub struct Usage {
    pub resident_mb: f64,
    pub peak_mb: f64,
    pub descriptors: usize,
    /// Processor time so far, user and system \[s\].
    pub cpu_s: f64,
}

impl Usage {
    pub fn of(pid: u32) -> Self {
        let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
        let mb = |name: &str| -> f64 {
            let line = status.lines().find(|line| line.starts_with(name)).unwrap();
            line.split_whitespace().nth(1).unwrap().parse::<f64>().unwrap() / 1024.0
        };
        let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
        let fields: Vec<&str> = stat.rsplit(')').next().unwrap().split_whitespace().collect();
        let ticks: f64 = fields[11].parse::<f64>().unwrap() + fields[12].parse::<f64>().unwrap();
        Self {
            resident_mb: mb("VmRSS:"),
            peak_mb: mb("VmHWM:"),
            descriptors: fs::read_dir(format!("/proc/{pid}/fd")).unwrap().count(),
            cpu_s: ticks / 100.0,
        }
    }
}

/// Content of `/metrics`.
pub fn metrics(daemon: &Process) -> String {
    answer(daemon, "/metrics")
}

/// Answer of the daemon's HTTP server, head and body.
pub fn answer(daemon: &Process, path: &str) -> String {
    let log = daemon.log();
    let address = log
        .split("metrics at http://")
        .nth(1)
        .and_then(|rest| rest.split_whitespace().next())
        .unwrap()
        .to_owned();
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    let words = format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n");
    stream.write_all(words.as_bytes()).unwrap();
    let mut text = String::new();
    stream.read_to_string(&mut text).unwrap();
    text
}

/// Sum of all series that begin with `series`; 0 if there are none.
pub fn metric(text: &str, series: &str) -> f64 {
    let values = text.lines().filter(|line| line.starts_with(series));
    values
        .map(|line| line.rsplit(' ').next().unwrap().parse::<f64>().unwrap())
        .sum()
}
