//! Destinations of alarms (sinks), as configured.

use super::credential::CredentialPath;
use crate::analysis::signal::record::RodId;
use crate::analysis::track::alarm::Kind;

/// Id of the log, the sink that always exists.
pub const LOG: &str = "log";

/// Names in braces that a topic may hold.
pub const TOPIC_PLACES: [&str; 5] = ["{site}", "{rod}", "{kind}", "{what}", "{alarm}"];

/// Settings of messages about the daemon itself.
#[derive(Debug, Clone, PartialEq)]
pub struct AlertSettings {
    /// Time for which a condition must last, or be absent, before it is reported \[s\].
    pub settle_s: f64,
    /// Ids of the sinks that get a daily message that the daemon is working.
    pub daily: Vec<String>,
    /// Hour of the daily message, UTC \[h\].
    pub daily_h: f64,
    /// Heartbeat to a dead-man switch.
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

/// Heartbeat to a dead-man switch.
#[derive(Debug, Clone, PartialEq)]
pub struct HeartbeatSettings {
    /// Address of the switch.
    pub target: HttpTarget,
    /// Interval between heartbeats \[s\].
    pub every_s: f64,
}

/// Settings of one sink.
#[derive(Debug, Clone, PartialEq)]
pub struct SinkSettings {
    /// Its name, unique within the site; the store records deliveries under it.
    pub id: String,
    /// Kind of the sink, with its own settings.
    pub kind: SinkKind,
    /// Kinds of alarms delivered; all if empty.
    pub kinds: Vec<Kind>,
    /// Rods whose alarms are delivered; all if empty.
    pub rods: Vec<RodId>,
    /// Sites of a centre whose alarms and conditions are delivered; all if empty.
    pub sites: Vec<String>,
}

impl SinkSettings {
    /// The log as a sink.
    pub fn log() -> Self {
        Self {
            id: LOG.to_owned(),
            kind: SinkKind::Log,
            kinds: Vec::new(),
            rods: Vec::new(),
            sites: Vec::new(),
        }
    }

    /// File with the token or password that it logs in with.
    pub fn secret(&self) -> Option<&CredentialPath> {
        match &self.kind {
            SinkKind::Log => None,
            SinkKind::Webhook(webhook) => webhook.target.token_file.as_ref(),
            SinkKind::Alertmanager(alertmanager) => alertmanager.target.token_file.as_ref(),
            SinkKind::Mqtt(mqtt) => mqtt.login.as_ref().map(|login| &login.password_file),
            SinkKind::Email(email) => email.login.as_ref().map(|login| &login.password_file),
        }
    }

    /// True if alarms of this kind and rod are delivered.
    pub fn wants(&self, kind: Kind, rod: &RodId) -> bool {
        (self.kinds.is_empty() || self.kinds.contains(&kind))
            && (self.rods.is_empty() || self.rods.contains(rod))
            && self.wants_site_of(&rod.0)
    }

    /// True if news about this rod or condition of a centre's sites are delivered: its id has the site and a slash in front. What is
    /// no site's is always.
    pub fn wants_site_of(&self, id: &str) -> bool {
        let site = id.split_once('/').map(|(site, _)| site);
        self.sites.is_empty() || site.is_none_or(|site| self.sites.iter().any(|wanted| wanted == site))
    }
}

/// Kind of a sink, with its own settings.
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
    /// URL, http or https.
    pub url: String,
    /// File with the bearer token.
    pub token_file: Option<CredentialPath>,
    /// File with the certificates (PEM) that are trusted instead of the built-in roots.
    pub ca_file: Option<CredentialPath>,
}

/// JSON posted to a URL.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WebhookSettings {
    /// HTTP server to post to.
    pub target: HttpTarget,
    /// Further headers, name and value.
    pub headers: Vec<(String, String)>,
}

/// The API of a Prometheus Alertmanager.
#[derive(Debug, Clone, PartialEq)]
pub struct AlertmanagerSettings {
    /// Server; the path of the API is appended to its URL.
    pub target: HttpTarget,
    /// Interval at which active alarms are sent again \[s\].
    pub resend_s: f64,
}

/// A message to an MQTT 5 broker.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MqttSettings {
    /// Host name or address of the broker.
    pub host: String,
    /// Its port.
    pub port: u16,
    /// True if the connection is encrypted.
    pub is_tls: bool,
    /// Topic; may hold `{site}`, `{rod}`, `{kind}`, `{what}` and `{alarm}`.
    pub topic: String,
    /// True if the broker keeps the latest message of each topic for later subscribers.
    pub is_retained: bool,
    /// Topic of the daemon's state; may hold `{site}`.
    pub status_topic: Option<String>,
    /// User name and password file, if the broker requires a login.
    pub login: Option<Login>,
    /// File with the certificates (PEM) that are trusted instead of the built-in roots.
    pub ca_file: Option<CredentialPath>,
}

/// Encryption of the connection to a mail server.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MailSecurity {
    /// Not encrypted; only to this machine.
    Plain,
    /// Encrypted after a greeting, and refused if the server cannot.
    StartTls,
    /// Encrypted from the first byte.
    Tls,
}

/// Mail to one or more recipients.
#[derive(Debug, Clone, PartialEq)]
pub struct EmailSettings {
    /// Host name or address of the mail server.
    pub host: String,
    /// Its port.
    pub port: u16,
    /// Encryption of the connection.
    pub security: MailSecurity,
    /// Sender.
    pub from: lettre::message::Mailbox,
    /// Recipients, at least one.
    pub to: Vec<lettre::message::Mailbox>,
    /// Time for which alarms are gathered into one mail \[s\].
    pub group_s: f64,
    /// User name and password file, if the server requires a login.
    pub login: Option<Login>,
    /// File with the certificates (PEM) that are trusted instead of the built-in roots.
    pub ca_file: Option<CredentialPath>,
}

/// A user name and the file with the password.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Login {
    /// User name.
    pub user: String,
    /// File with the password.
    pub password_file: CredentialPath,
}
