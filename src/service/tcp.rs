//! TCP listeners with a queue that a burst of connections does not fill.

use std::io;
use std::net::{SocketAddr, TcpListener};

/// Connections that the system holds until they are accepted. Beyond, it drops the first packet of a client, which tries again after a
/// second; the standard library asks for 128.
const BACKLOG: i32 = 1024;

/// Listens at an address.
///
/// # Errors
/// It is taken, or not this machine's.
pub fn bind(address: SocketAddr) -> io::Result<TcpListener> {
    let listener = TcpListener::bind(address)?;
    rustix::net::listen(&listener, BACKLOG)?;
    Ok(listener)
}
