//! Alarms that arrive: the outbox delivered to every sink, in order, at least once.
//!
//! The store's outbox is the queue. One thread per sink, a courier, reads it beside the writer, sends one
//! event at a time, and reports its position to its owner only when the other side has taken the event. A
//! failed sink is retried indefinitely and delays no other. docs/sinks.md is the page for operators.

mod alertmanager;
pub mod backoff;
mod conditions;
mod courier;
mod couriers;
mod damping;
mod digest;
mod email;
mod heartbeat;
mod log;
mod marks;
pub mod message;
mod mqtt;
mod place;
mod post;
mod presence;
mod signal;
mod webhook;

pub use backoff::{Backoff, Pace};
pub use conditions::Conditions;
pub use couriers::Couriers;
pub use marks::Delivered;
pub use message::{Message, What};
pub use place::marks_of_new;

use crate::config::settings::alert::{SinkKind, SinkSettings};
use crate::config::settings::credential::CredentialError;
use std::time::Duration;

/// A destination of alarms.
pub trait Sink: Send {
    /// Sends a message; returns when the other side has it.
    ///
    /// # Errors
    /// It is not known to have it.
    fn deliver(&mut self, message: &Message) -> Result<(), Failure>;

    /// Time for which messages are gathered before they are sent together.
    fn gathers_for(&self) -> Duration {
        Duration::ZERO
    }

    /// Sends messages together; returns when the other side has all of them.
    ///
    /// # Errors
    /// It is not known to have them.
    fn deliver_all(&mut self, messages: &[Message]) -> Result<(), Failure> {
        messages.iter().try_for_each(|message| self.deliver(message))
    }

    /// Interval at which it needs all active alarms again; `None` for one that remembers.
    fn refresh_every(&self) -> Option<Duration> {
        None
    }

    /// Sends the active alarms again.
    ///
    /// # Errors
    /// It is not known to have it.
    fn refresh(&mut self, _standing: &[Message]) -> Result<(), Failure> {
        Ok(())
    }
}

/// Reason why a message was not delivered.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{reason}")]
pub struct Failure {
    /// Reason in one sentence.
    pub reason: String,
    /// Least wait that the other side asks for.
    pub retry_after: Option<Duration>,
}

impl Failure {
    /// A failure without a requested wait.
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
