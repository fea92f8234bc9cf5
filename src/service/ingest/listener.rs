//! Listening sockets: those configured, and those handed over by systemd.

use crate::config::settings::ingest::Listen;
use crate::service::tcp;
use listenfd::ListenFd;
use std::fs::{self, Permissions};
use std::io;
use std::net::TcpListener;
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;

/// Mode of a Unix socket: its owner and its group may connect.
const UNIX_MODE: u32 = 0o660;

/// Reason why a socket cannot listen.
#[derive(Debug, thiserror::Error)]
pub enum ListenError {
    /// The system returned an error.
    #[error("cannot listen at {address}")]
    Io {
        /// Address of the socket.
        address: String,
        /// Error of the system.
        source: io::Error,
    },
    /// Another process listens there.
    #[error("{0}: another daemon listens there; stop it, or name another path in [ingest] listen")]
    Taken(String),
    /// The path is a file that is no socket.
    #[error("{0}: there is a file that is no socket; remove it, or name another path in [ingest] listen")]
    NoSocket(String),
    /// Other machines can reach the socket, but it has no TLS.
    #[error("{0} is not on loopback: [ingest.tls] is needed")]
    Open(String),
    /// The program panicked at a socket.
    #[error("a socket broke the program, please report it: {0}")]
    Broken(String),
    /// A certificate, key or authority cannot be used.
    #[error("[ingest.tls] {0}")]
    Tls(String),
}

/// A listening socket.
#[derive(Debug)]
pub enum Listener {
    /// TCP.
    Tcp(TcpListener),
    /// A Unix socket.
    Unix(UnixListener),
}

impl Listener {
    /// Listens at an address. The file of a Unix socket without a listener is replaced.
    ///
    /// # Errors
    /// It is taken, or the system returns an error.
    pub fn bind(listen: &Listen) -> Result<Self, ListenError> {
        let failed = |source| ListenError::Io {
            address: listen.to_string(),
            source,
        };
        match listen {
            Listen::Tcp(address) => tcp::bind(*address).map(Self::Tcp).map_err(failed),
            Listen::Unix(path) => {
                clear(path, failed)?;
                let listener = UnixListener::bind(path).map_err(failed)?;
                fs::set_permissions(path, Permissions::from_mode(UNIX_MODE)).map_err(failed)?;
                Ok(Self::Unix(listener))
            }
        }
    }

    /// Sockets handed over by systemd for socket activation; empty without. To be called once, before any
    /// thread starts: it clears the variables that announce them.
    ///
    /// # Errors
    /// One of them is neither a TCP nor a Unix stream socket.
    pub fn inherited() -> Result<Vec<Self>, ListenError> {
        // `listenfd` supports IPv4 only.
        const AF_INET6: i32 = 10;
        const SOCK_STREAM: i32 = 1;
        let mut given = ListenFd::from_env();
        let mut found = Vec::new();
        for i in 0..given.len() {
            let tcp = given
                .take_tcp_listener(i)
                .or_else(|_| given.take_custom(i, AF_INET6, SOCK_STREAM, "tcp socket"));
            let listener = match tcp {
                Ok(listener) => listener.map(Self::Tcp),
                Err(_) => given
                    .take_unix_listener(i)
                    .map(|listener| listener.map(Self::Unix))
                    .map_err(|source| ListenError::Io {
                        address: format!("socket {i} of systemd"),
                        source,
                    })?,
            };
            found.extend(listener);
        }
        Ok(found)
    }

    /// All sockets: those handed over by systemd, and the other configured ones.
    ///
    /// # Errors
    /// One of them is taken, or the system returns an error.
    pub fn all(inherited: Vec<Self>, listen: &[Listen]) -> Result<Vec<Self>, ListenError> {
        let known: Vec<String> = inherited.iter().map(Self::address).collect();
        let mut all = inherited;
        for place in listen.iter().filter(|place| !known.contains(&place.to_string())) {
            all.push(Self::bind(place)?);
        }
        Ok(all)
    }

    /// True if only this machine can reach it.
    pub(super) fn is_local(&self) -> bool {
        match self {
            Self::Tcp(listener) => listener
                .local_addr()
                .is_ok_and(|address| address.ip().is_loopback()),
            Self::Unix(_) => true,
        }
    }

    /// Address as in the configuration.
    pub fn address(&self) -> String {
        match self {
            Self::Tcp(listener) => match listener.local_addr() {
                Ok(address) => format!("tcp://{address}"),
                Err(_) => "a TCP socket".to_owned(),
            },
            Self::Unix(listener) => match listener.local_addr() {
                Ok(address) => match address.as_pathname() {
                    Some(path) => format!("unix://{}", path.display()),
                    None => "a Unix socket".to_owned(),
                },
                Err(_) => "a Unix socket".to_owned(),
            },
        }
    }
}

/// Removes the socket file of a daemon that has ended.
fn clear(path: &Path, failed: impl Fn(io::Error) -> ListenError) -> Result<(), ListenError> {
    let shown = || format!("unix://{}", path.display());
    let kind = match fs::symlink_metadata(path) {
        Ok(data) => data.file_type(),
        Err(fault) if fault.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(fault) => return Err(failed(fault)),
    };
    if !kind.is_socket() {
        return Err(ListenError::NoSocket(shown()));
    }
    match UnixStream::connect(path) {
        Err(fault) if fault.kind() == io::ErrorKind::ConnectionRefused => {
            fs::remove_file(path).map_err(failed)
        }
        Err(fault) if fault.kind() == io::ErrorKind::NotFound => Ok(()),
        Ok(_) => Err(ListenError::Taken(shown())),
        // For example because its queue is full: another process is listening.
        Err(fault) if fault.kind() == io::ErrorKind::WouldBlock => Err(ListenError::Taken(shown())),
        Err(fault) => Err(failed(fault)),
    }
}
