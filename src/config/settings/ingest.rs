//! Sources of live data, and limits of their clients.

use std::fmt;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::str::FromStr;

/// An address to listen at.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Listen {
    /// TCP.
    Tcp(SocketAddr),
    /// A Unix socket.
    Unix(PathBuf),
}

impl Listen {
    /// True if other machines can reach it.
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
    /// Certificate of the daemon, with the intermediate ones up to its authority.
    pub certificate: PathBuf,
    /// Private key of the certificate.
    pub key: PathBuf,
    /// Authority that must have issued the clients' certificates.
    pub client_ca: PathBuf,
    /// Certificates with what their holders may send; empty: any holder may send everything.
    pub bound: Vec<BoundCertificate>,
}

/// A client's certificate with what its holder may send.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BoundCertificate {
    /// Its common name, or one of its DNS names.
    pub certificate: String,
    /// Sender names of its holder.
    pub senders: Vec<String>,
    /// Topics of its holder: exact, or with a `*` at the end.
    pub topics: Vec<String>,
}

impl BoundCertificate {
    /// True if the holder may send on a topic.
    pub fn allows(&self, topic: &str) -> bool {
        self.topics.iter().any(|pattern| names(pattern, topic))
    }
}

/// True if a pattern, exact or with a `*` at the end, names a topic.
pub fn names(pattern: &str, topic: &str) -> bool {
    match pattern.strip_suffix('*') {
        Some(beginning) => topic.starts_with(beginning),
        None => pattern == topic,
    }
}

/// Sources of live data, and limits of their clients.
#[derive(Debug, Clone, PartialEq)]
pub struct IngestSettings {
    /// Watched folder, if any.
    pub folder: Option<PathBuf>,
    /// True if the folders below it are watched too.
    pub subfolders: bool,
    /// Time without growth after which a recording counts as cut short \[s\].
    pub settle_s: f64,
    /// Time for which open samples at the end of a recording wait for the one that goes on there \[s\].
    pub join_s: f64,
    /// Time for which a finished recording waits for the readings of a thermometer that writes recordings of its own \[s\]: as late as records
    /// may be, but a rod whose thermometer died must not seem silent.
    pub readings_s: f64,
    /// Addresses to listen at.
    pub listen: Vec<Listen>,
    /// TLS; required on every TCP socket that is not on loopback.
    pub tls: Option<TlsSettings>,
    /// Most clients at once.
    pub clients: usize,
    /// Time without data after which a client is disconnected \[s\].
    pub idle_s: f64,
    /// Time for which a named sender that was cut off may resume its stream \[s\]; then its last record ends.
    pub resume_s: f64,
}

impl Default for IngestSettings {
    fn default() -> Self {
        Self {
            folder: None,
            subfolders: false,
            settle_s: 600.0,
            join_s: 2.0,
            readings_s: 3600.0,
            listen: Vec::new(),
            tls: None,
            clients: 64,
            idle_s: 600.0,
            resume_s: 86_400.0,
        }
    }
}
