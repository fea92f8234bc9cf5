//! Connection to the post between sites and centre, and what a site sends there.

use super::credential::CredentialPath;
use std::time::Duration;

/// Longest name of a site, which is a word of its subjects \[bytes\].
pub const LONGEST_SITE: usize = 64;

/// Connection to NATS.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NatsSettings {
    /// Servers of one cluster, or a single one: host name or address, and port.
    pub servers: Vec<(String, u16)>,
    /// True if the connection is encrypted.
    pub is_tls: bool,
    /// File with an NKEY seed or a JWT with its seed; `None` on loopback without login.
    pub credentials: Option<CredentialPath>,
    /// File with the certificates (PEM) that are trusted besides the machine's own.
    pub ca: Option<CredentialPath>,
}

impl NatsSettings {
    /// Addresses as configured.
    pub fn url(&self) -> String {
        self.addresses("nats+tls").join(",")
    }

    /// Servers that keep each message of a stream: three of a cluster of three or more, so that any one may be gone.
    pub fn replicas(&self) -> usize {
        if self.servers.len() < 3 { 1 } else { 3 }
    }

    /// Addresses with the name that a client has for encryption.
    pub fn addresses(&self, encrypted: &str) -> Vec<String> {
        let scheme = if self.is_tls { encrypted } else { "nats" };
        let servers = self.servers.iter();
        servers
            .map(|(host, port)| format!("{scheme}://{host}:{port}"))
            .collect()
    }
}

/// Settings of the copy to a centre.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ForwardSettings {
    /// Post.
    pub nats: NatsSettings,
    /// Name of the site at the centre.
    pub site: String,
    /// Interval between heartbeats.
    pub heartbeat: Duration,
    /// Public key of those whose commands are carried out; none are without.
    pub command_key: Option<String>,
}

/// Name of the hub at the server, which no site may have: it hears what the hub hears.
pub const HUB: &str = "HUB";

/// Name of the workers at the server, which no site may have either.
pub const WORK: &str = "WORK";

/// True for a name that can be a word of a subject, and is neither the hub's nor the workers'.
pub fn is_site(name: &str) -> bool {
    ![HUB, WORK].contains(&name)
        && (1..=LONGEST_SITE).contains(&name.len())
        && name
            .bytes()
            .all(|byte| byte.is_ascii_alphanumeric() || byte == b'-' || byte == b'_')
}
