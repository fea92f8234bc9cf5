//! Connection to NATS: login, encryption, the version of the server, and its reasons for refusing.

use super::throttle;
use crate::config::settings::credential::CredentialError;
use crate::config::settings::forward::NatsSettings;
use async_nats::jetstream::{self, Context};
use async_nats::{Client, ConnectOptions, Event};
use std::future::Future;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::watch;

/// Oldest server accepted: older ones have lost acknowledged messages in crashes, or cannot flush each one.
pub const OLDEST: (u32, u32) = (2, 12);

/// Longest time for a connection.
const CONNECT: Duration = Duration::from_secs(5);
/// Longest time for an answer.
pub const ANSWER: Duration = Duration::from_secs(10);

/// Reason why there is no connection, or a request failed.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The credentials cannot be used.
    #[error(transparent)]
    Credential(#[from] CredentialError),
    /// The file holds neither a seed nor a JWT.
    #[error("{0} holds neither the NKEY seed of a user nor the content of a .creds file")]
    NoCredential(String),
    /// The server cannot be reached, or refuses.
    #[error("{url}: {reason}")]
    Refused {
        /// Address as configured.
        url: String,
        /// Reason of the server or the system.
        reason: String,
    },
    /// The server is too old.
    #[error(
        "{url}: nats-server {found} is older than {}.{}: older ones lose messages they have acknowledged",
        OLDEST.0,
        OLDEST.1
    )]
    Old {
        /// Address as configured.
        url: String,
        /// Version of the server.
        found: String,
    },
    /// A request failed.
    #[error("{0}")]
    Failed(String),
}

/// A connection; copies are of the same one.
#[derive(Clone)]
pub struct Link {
    /// The client.
    pub client: Client,
    /// Its requests to JetStream.
    pub jetstream: Context,
    said: Arc<Mutex<Said>>,
    is_lost: watch::Receiver<bool>,
}

/// Latest words of the server beside its answers.
#[derive(Default)]
struct Said {
    last: Option<String>,
    /// The same about the pauses, which no request waits for: it explains no failure.
    of_pauses: Option<String>,
}

impl Link {
    /// Connects under a name, which is also that of its answers' subjects: `_INBOX_NAME`.
    ///
    /// # Errors
    /// The server cannot be reached, refuses, or is too old.
    pub async fn open(settings: &NatsSettings, name: &str) -> Result<Self, LinkError> {
        let url = settings.url();
        let said = Arc::<Mutex<Said>>::default();
        let hears = Arc::clone(&said);
        let (lose, is_lost) = watch::channel(false);
        let mut options = ConnectOptions::new()
            .name(format!("tirante {name}"))
            .custom_inbox_prefix(format!("_INBOX_{name}"))
            .connection_timeout(CONNECT)
            .request_timeout(Some(ANSWER))
            .require_tls(settings.is_tls)
            // Each server once. Whoever lost the connection begins anew, at the end of what the server has.
            .max_reconnects(settings.servers.len())
            .event_callback(move |event| {
                match &event {
                    Event::ServerError(error) => {
                        let text = error.to_string();
                        let mut said = hears.lock().unwrap_or_else(PoisonError::into_inner);
                        if text.contains(throttle::SUBJECT) {
                            said.of_pauses = Some(text);
                        } else {
                            said.last = Some(text);
                        }
                    }
                    Event::Disconnected | Event::Closed => {
                        lose.send_replace(true);
                    }
                    _ => {}
                }
                std::future::ready(())
            });
        if let Some(ca) = &settings.ca {
            // Read here, so that a missing file is named.
            ca.read()?;
            options = options.add_root_certificates(ca.resolved()?);
        }
        if let Some(file) = &settings.credentials {
            let text = String::from_utf8_lossy(&file.read_private()?).into_owned();
            let no_credential = || LinkError::NoCredential(file.as_str().to_owned());
            options = if text.contains("NATS USER JWT") {
                options.credentials(&text).map_err(|_| no_credential())?
            } else {
                let pair = nkeys::KeyPair::from_seed(text.trim()).map_err(|_| no_credential())?;
                // A login signs what the server says: a key of commands must never be one.
                if pair.key_pair_type() != nkeys::KeyPairType::User {
                    return Err(no_credential());
                }
                options.nkey(text.trim().to_owned())
            };
        }
        let client = options
            .connect(settings.addresses("tls"))
            .await
            .map_err(|error| LinkError::Refused {
                url: url.clone(),
                reason: chain(&error),
            })?;
        let found = client.server_info().version.clone();
        if version(&found).is_none_or(|found| found < OLDEST) {
            return Err(LinkError::Old { url, found });
        }
        let mut jetstream = jetstream::new(client.clone());
        jetstream.set_timeout(ANSWER);
        Ok(Self {
            client,
            jetstream,
            said,
            is_lost,
        })
    }

    /// Waits for `work`, at most until the connection is lost.
    ///
    /// # Errors
    /// The connection was lost, or those of `work`.
    pub async fn unless_lost<T, E: From<LinkError>>(
        &self,
        work: impl Future<Output = Result<T, E>>,
    ) -> Result<T, E> {
        let mut is_lost = self.is_lost.clone();
        tokio::select! {
            done = work => done,
            _ = is_lost.wait_for(|is_lost| *is_lost) => {
                let said = self.take_said().map(|said| format!(" ({said})")).unwrap_or_default();
                Err(LinkError::Failed(format!("the connection was lost{said}")).into())
            }
        }
    }

    /// Latest word of the server beside its answers; it is forgotten then.
    fn take_said(&self) -> Option<String> {
        self.said
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .last
            .take()
    }

    /// The server's refusal to hear or tell the pauses; it is forgotten then.
    pub fn take_refused_pauses(&self) -> Option<String> {
        let mut said = self.said.lock().unwrap_or_else(PoisonError::into_inner);
        said.of_pauses.take()
    }

    /// Error of a request, with what the server said meanwhile: it tells who may not publish only beside the answer.
    pub fn failed(&self, what: &str, error: &dyn std::error::Error) -> LinkError {
        let said = self
            .take_said()
            .map(|said| format!(" ({said})"))
            .unwrap_or_default();
        LinkError::Failed(format!("{what}: {}{said}", chain(error)))
    }
}

/// An error with its causes.
fn chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut next = error.source();
    while let Some(error) = next {
        let more = error.to_string();
        if !text.contains(&more) {
            text = format!("{text}: {more}");
        }
        next = error.source();
    }
    text
}

/// Major and minor number of a version.
fn version(text: &str) -> Option<(u32, u32)> {
    let mut parts = text.trim_start_matches('v').split('.');
    Some((parts.next()?.parse().ok()?, parts.next()?.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_numbers_not_words() {
        assert!(version("2.9.10") < Some(OLDEST) && version("2.9.10").is_some());
        assert!(version("2.12.0-RC.1") >= Some(OLDEST));
        assert!(version("v2.15.1") >= Some(OLDEST));
        assert_eq!(version("unknown"), None);
    }
}
