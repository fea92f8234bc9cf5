//! Alarms that arrive: the outbox delivered to every sink, in order, at least once.
//!
//! The store's outbox is the queue. One thread a sink, a courier, reads it beside the writer, sends one piece of news
//! at a time, and only when the other side has taken it reports the place reached to whoever started it. A sink
//! that fails is tried again for ever and holds up nobody else. docs/sinks.md is the page for operators.

mod alertmanager;
pub mod backoff;
mod courier;
mod couriers;
mod email;
mod heartbeat;
mod log;
mod marks;
pub mod message;
mod mqtt;
mod post;
mod presence;
mod signal;
mod webhook;

pub use backoff::{Backoff, Pace};
pub use couriers::Couriers;
pub use marks::Delivered;
pub use message::{Message, What};

use crate::analysis::signal::record::Timestamp;
use crate::config::settings::alert::{SinkKind, SinkSettings};
use crate::config::settings::credential::CredentialError;
use std::time::Duration;

/// Somewhere alarms go.
pub trait Sink: Send {
    /// Sends a message; returns when the other side has it.
    ///
    /// # Errors
    /// It is not known to have it.
    fn deliver(&mut self, message: &Message) -> Result<(), Failure>;

    /// After which time it wants to hear again of everything that stands; `None` for one that remembers.
    fn refresh_every(&self) -> Option<Duration> {
        None
    }

    /// Sends again what stands.
    ///
    /// # Errors
    /// It is not known to have it.
    fn refresh(&mut self, _standing: &[Message]) -> Result<(), Failure> {
        Ok(())
    }
}

/// Why a message was not delivered.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{reason}")]
pub struct Failure {
    /// One sentence.
    pub reason: String,
    /// The time before which the other side does not want to be asked again.
    pub retry_after: Option<Duration>,
}

impl Failure {
    /// A failure the other side says nothing more about.
    pub fn new(reason: impl Into<String>) -> Self {
        Self {
            reason: reason.into(),
            retry_after: None,
        }
    }
}

impl From<CredentialError> for Failure {
    fn from(error: CredentialError) -> Self {
        Self::new(error.to_string())
    }
}

/// The sink that `settings` describe for `site`; a send may take until `deadline`. Nothing is connected before the
/// first message.
pub fn open(settings: &SinkSettings, site: &str, deadline: Duration) -> Box<dyn Sink> {
    match &settings.kind {
        SinkKind::Log => Box::new(log::Log),
        SinkKind::Webhook(webhook) => Box::new(webhook::Webhook::new(webhook.clone(), deadline)),
        SinkKind::Alertmanager(alertmanager) => {
            Box::new(alertmanager::Alertmanager::new(alertmanager.clone(), deadline))
        }
        SinkKind::Mqtt(mqtt) => Box::new(mqtt::Mqtt::new(mqtt.clone(), site, &settings.id, deadline)),
        SinkKind::Email(email) => Box::new(email::Email::new(email.clone(), deadline)),
    }
}

/// What time it is.
fn now() -> Timestamp {
    Timestamp::from_nanos(i64::try_from(jiff::Timestamp::now().as_nanosecond()).unwrap_or(i64::MAX))
}
