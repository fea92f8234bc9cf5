//! The file of a Unix socket, by which clients find it: made anew when it was removed.

use super::listener::Listener;
use super::server::Door;
use crate::config::settings::ingest::Listen;
use crate::service::telemetry::owned::{Lost, Owned};
use crate::service::telemetry::{Fault, Health};

/// The file of a Unix socket.
pub(super) struct SocketFile(Owned);

impl SocketFile {
    /// The file of a socket; `None` if it has none.
    pub fn of(door: &Door) -> Option<Self> {
        let Door::Unix(listener) = door else { return None };
        let address = listener.local_addr().ok()?;
        Owned::of(address.as_pathname()?).map(Self)
    }

    /// Looks for it. One that was removed is made anew, with the socket that is returned.
    pub fn look(&mut self, address: &str, health: &Health) -> Option<Door> {
        let detail = match self.0.look() {
            Err(Lost::Removed) => {
                let listen = Listen::Unix(self.0.path().to_owned());
                let made = Listener::bind(&listen).map_err(anyhow::Error::from);
                match made.and_then(|listener| Ok(Door::new(listener)?)) {
                    Ok(door) => {
                        *self = Self::of(&door)?;
                        health.over(Fault::Refused, address);
                        health.fault(
                            Fault::Refused,
                            format_args!("{address}: its file was removed, it is made anew"),
                        );
                        return Some(door);
                    }
                    Err(error) => format!(
                        "{address}: its file was removed and cannot be made anew, so nobody can connect: {error:#}"
                    ),
                }
            }
            Err(Lost::Replaced) => format!(
                "{address}: another file has its name, so nobody can connect: remove that file, and this one is made anew"
            ),
            _ => {
                health.over(Fault::Refused, address);
                return None;
            }
        };
        health.hold(Fault::Refused, address, detail);
        None
    }
}
