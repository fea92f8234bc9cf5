//! Where live data comes from, and what a client may do.

use std::fmt;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::str::FromStr;

/// A place to listen at.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Listen {
    /// TCP.
    Tcp(SocketAddr),
    /// A Unix socket.
    Unix(PathBuf),
}

impl Listen {
    /// Whether others than this machine can reach it.
    pub fn is_open(&self) -> bool {
        matches!(self, Self::Tcp(address) if !address.ip().is_loopback())
    }
}

/// `tcp://127.0.0.1:7415`, `unix:///run/tirante/ingest.sock`
impl fmt::Display for Listen {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(address) => write!(f, "tcp://{address}"),
            Self::Unix(path) => write!(f, "unix://{}", path.display()),
        }
    }
}

impl FromStr for Listen {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        if let Some(address) = text.strip_prefix("tcp://") {
            let address = address.parse().map(Self::Tcp);
            return address
                .map_err(|_| "is no IP address with a port: write tcp://127.0.0.1:7415 or tcp://[::1]:7415");
        }
        match text.strip_prefix("unix://") {
            Some(path) if path.starts_with('/') && path.len() > 1 => Ok(Self::Unix(PathBuf::from(path))),
            _ => Err("is no socket: write tcp://127.0.0.1:7415 or unix:///run/tirante/ingest.sock"),
        }
    }
}

/// TLS for the TCP sockets: certificates as PEM files.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TlsSettings {
    /// The daemon's certificate and those between it and its authority.
    pub certificate: PathBuf,
    /// Its private key.
    pub key: PathBuf,
    /// The authority clients' certificates must come from.
    pub client_ca: PathBuf,
}

/// Where live data comes from, and what a client may do.
#[derive(Debug, Clone, PartialEq)]
pub struct IngestSettings {
    /// The watched folder.
    pub folder: Option<PathBuf>,
    /// A growing recording that has not grown for this long counts as cut short \[s\].
    pub settle_s: f64,
    /// Where to listen.
    pub listen: Vec<Listen>,
    /// TLS; wanted on every TCP socket that is not on loopback.
    pub tls: Option<TlsSettings>,
    /// Most clients at once.
    pub clients: usize,
    /// A client that says nothing for this long is closed \[s\].
    pub idle_s: f64,
    /// A named sender that was cut off may take up its stream for this long; then its last record ends \[s\].
    pub resume_s: f64,
}

impl Default for IngestSettings {
    fn default() -> Self {
        Self {
            folder: None,
            settle_s: 600.0,
            listen: Vec::new(),
            tls: None,
            clients: 64,
            idle_s: 600.0,
            resume_s: 86_400.0,
        }
    }
}
