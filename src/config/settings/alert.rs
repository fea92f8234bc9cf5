//! Where alarms go, as the configuration says.

use super::credential::CredentialPath;
use crate::analysis::signal::record::RodId;
use crate::analysis::track::alarm::Kind;

/// The id of the log, the sink that is always there.
pub const LOG: &str = "log";

/// The names in braces that a topic may hold.
pub const TOPIC_PLACES: [&str; 5] = ["{site}", "{rod}", "{kind}", "{what}", "{alarm}"];

/// How the sinks are told of the daemon itself.
#[derive(Debug, Clone, PartialEq)]
pub struct AlertSettings {
    /// How long a condition must last, or be absent, to be told \[s\].
    pub settle_s: f64,
    /// Ids of the sinks that are told every day that the daemon is at work.
    pub daily: Vec<String>,
    /// The hour at which they are, UTC \[h\].
    pub daily_h: f64,
    /// The sign of life.
    pub heartbeat: Option<HeartbeatSettings>,
}

impl Default for AlertSettings {
    fn default() -> Self {
        Self {
            settle_s: 60.0,
            daily: Vec::new(),
            daily_h: 6.0,
            heartbeat: None,
        }
    }
}

/// A sign of life to a dead-man switch.
#[derive(Debug, Clone, PartialEq)]
pub struct HeartbeatSettings {
    /// The switch.
    pub target: HttpTarget,
    /// From one sign to the next \[s\].
    pub every_s: f64,
}

/// One sink.
#[derive(Debug, Clone, PartialEq)]
pub struct SinkSettings {
    /// Its name, unique within the site; the store remembers by it what was delivered.
    pub id: String,
    /// What it is.
    pub kind: SinkKind,
    /// The kinds of alarms it wants; all if empty.
    pub kinds: Vec<Kind>,
    /// The rods it wants; all if empty.
    pub rods: Vec<RodId>,
}

impl SinkSettings {
    /// The log.
    pub fn log() -> Self {
        Self {
            id: LOG.to_owned(),
            kind: SinkKind::Log,
            kinds: Vec::new(),
            rods: Vec::new(),
        }
    }

    /// Whether it wants to hear of alarms of this kind and rod.
    pub fn wants(&self, kind: Kind, rod: &RodId) -> bool {
        (self.kinds.is_empty() || self.kinds.contains(&kind))
            && (self.rods.is_empty() || self.rods.contains(rod))
    }
}

/// What a sink is, with the settings of its own.
#[derive(Debug, Clone, PartialEq)]
pub enum SinkKind {
    /// The program's log.
    Log,
    /// JSON posted to a URL.
    Webhook(WebhookSettings),
    /// The API of a Prometheus Alertmanager.
    Alertmanager(AlertmanagerSettings),
    /// A message to an MQTT 5 broker.
    Mqtt(MqttSettings),
    /// A mail.
    Email(EmailSettings),
}

/// An HTTP server.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HttpTarget {
    /// The URL, http or https.
    pub url: String,
    /// The file with the bearer token.
    pub token_file: Option<CredentialPath>,
    /// The file with the certificates (PEM) that are trusted instead of the built-in roots.
    pub ca_file: Option<CredentialPath>,
}

/// JSON posted to a URL.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WebhookSettings {
    /// The server.
    pub target: HttpTarget,
    /// Further headers, name and value.
    pub headers: Vec<(String, String)>,
}

/// The API of a Prometheus Alertmanager.
#[derive(Debug, Clone, PartialEq)]
pub struct AlertmanagerSettings {
    /// The server; the path of the API is put behind its URL.
    pub target: HttpTarget,
    /// Everything that stands is sent again after this time \[s\].
    pub resend_s: f64,
}

/// A message to an MQTT 5 broker.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MqttSettings {
    /// The broker.
    pub host: String,
    /// Its port.
    pub port: u16,
    /// Whether the connection is encrypted.
    pub is_tls: bool,
    /// The topic, with `{site}`, `{rod}`, `{kind}`, `{what}` and `{alarm}` in it.
    pub topic: String,
    /// Whether the broker keeps the latest message of each topic for those who come later.
    pub is_retained: bool,
    /// The topic of the daemon's state, with `{site}` in it.
    pub status_topic: Option<String>,
    /// Who we are.
    pub login: Option<Login>,
    /// The file with the certificates (PEM) that are trusted instead of the built-in roots.
    pub ca_file: Option<CredentialPath>,
}

/// How a mail server is spoken to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MailSecurity {
    /// Not encrypted; only on this machine.
    Plain,
    /// Encrypted after a greeting, and refused if the server cannot.
    StartTls,
    /// Encrypted from the first byte.
    Tls,
}

/// A mail.
#[derive(Debug, Clone, PartialEq)]
pub struct EmailSettings {
    /// The server.
    pub host: String,
    /// Its port.
    pub port: u16,
    /// How it is spoken to.
    pub security: MailSecurity,
    /// Who writes.
    pub from: lettre::message::Mailbox,
    /// Who reads, at least one.
    pub to: Vec<lettre::message::Mailbox>,
    /// Who we are.
    pub login: Option<Login>,
    /// The file with the certificates (PEM) that are trusted instead of the built-in roots.
    pub ca_file: Option<CredentialPath>,
}

/// A user and the file with the password.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Login {
    /// The user.
    pub user: String,
    /// The file with the password.
    pub password_file: CredentialPath,
}
