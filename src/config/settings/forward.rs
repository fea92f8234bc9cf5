//! Connection to the post between sites and centre, and what a site sends there.

use super::credential::CredentialPath;
use crate::analysis::signal::record::time::DAY_S;

/// Longest name of a site, which is a word of its subjects \[bytes\].
pub const LONGEST_SITE: usize = 64;

/// Connection to NATS.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NatsSettings {
    /// Host name or address.
    pub host: String,
    /// Port.
    pub port: u16,
    /// True if the connection is encrypted.
    pub is_tls: bool,
    /// File with an NKEY seed or a JWT with its seed; `None` on loopback without login.
    pub credentials: Option<CredentialPath>,
    /// File with the certificates (PEM) that are trusted besides the machine's own.
    pub ca: Option<CredentialPath>,
}

impl NatsSettings {
    /// Address as configured.
    pub fn url(&self) -> String {
        let scheme = if self.is_tls { "nats+tls" } else { "nats" };
        format!("{scheme}://{}:{}", self.host, self.port)
    }
}

/// Content that a site sends to the centre.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Content {
    /// Records, modes, periods and segments.
    Results,
    /// Alarms, conditions, and outcomes of requests.
    Alarms,
    /// Status of each rod.
    States,
}

impl Content {
    /// All of it, with its word in the configuration.
    pub const ALL: [(&'static str, Self); 3] = [
        ("results", Self::Results),
        ("alarms", Self::Alarms),
        ("states", Self::States),
    ];

    /// Content that a table of the store belongs to; `None` for what is always sent.
    pub fn of_table(table: &str) -> Option<Self> {
        match table {
            "record" | "line" | "mode" | "period" | "segment" => Some(Self::Results),
            "alarm" | "outbox" | "notice" | "request" => Some(Self::Alarms),
            "rod" => Some(Self::States),
            _ => None,
        }
    }
}

/// Settings of the copy to a centre.
#[derive(Debug, Clone, PartialEq)]
pub struct ForwardSettings {
    /// Post.
    pub nats: NatsSettings,
    /// Name of the site at the centre.
    pub site: String,
    /// Content sent.
    pub what: Vec<Content>,
    /// Time for which results must stay in the store, since the post may lose them \[s\].
    pub keep_s: f64,
}

impl ForwardSettings {
    /// Default of [`ForwardSettings::keep_s`] \[s\].
    pub const KEEP_S: f64 = 30.0 * DAY_S;
}

/// True for a name that can be a word of a subject.
pub fn is_site(name: &str) -> bool {
    (1..=LONGEST_SITE).contains(&name.len())
        && name
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || byte == b'-' || byte == b'_')
}
