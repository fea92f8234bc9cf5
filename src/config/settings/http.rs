//! Address of the HTTP server, and permissions of its clients.

use super::credential::CredentialPath;
use std::net::SocketAddr;

/// Address of the HTTP server, and permissions of its clients.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HttpSettings {
    /// Address to listen at; `None` for no server.
    pub listen: Option<SocketAddr>,
    /// File with the token for acknowledging alarms; `None`: not allowed over HTTP.
    pub token_file: Option<CredentialPath>,
    /// Host names under which browsers may reach it, besides addresses and `localhost`.
    pub names: Vec<String>,
    /// Origins of web pages that may open the live view.
    pub viewer_origins: Vec<String>,
}

impl Default for HttpSettings {
    fn default() -> Self {
        Self {
            listen: Some(SocketAddr::from(([127, 0, 0, 1], 7416))),
            token_file: None,
            names: Vec::new(),
            viewer_origins: Vec::new(),
        }
    }
}

/// Checks an origin as browsers send it: a scheme and a host, perhaps with a port, nothing behind; `file://`
/// has no host.
///
/// # Errors
/// It is none; the text names the expected form.
pub fn origin(text: &str) -> Result<String, String> {
    let is_origin = text.split_once("://").is_some_and(|(scheme, host)| {
        !scheme.is_empty() && !host.contains(['/', '*', ' ']) && (scheme == "file") == host.is_empty()
    });
    is_origin.then(|| text.to_owned()).ok_or_else(|| {
        "no origin, write it like \"https://app.foxglove.dev\", without a path, or \"file://\"".to_owned()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn origins_have_a_scheme_and_a_host_and_nothing_else() {
        for good in ["https://app.foxglove.dev", "http://tower.local:8080", "file://"] {
            assert_eq!(origin(good).as_deref(), Ok(good));
        }
        for bad in [
            "",
            "app.foxglove.dev",
            "https://",
            "://x",
            "file://x",
            "https://x/",
            "https://*",
            "null",
        ] {
            assert!(origin(bad).is_err(), "{bad}");
        }
    }
}
