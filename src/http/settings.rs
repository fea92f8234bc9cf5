//! Where the HTTP server listens, and who may change something.

use super::Access;
use crate::alert::credential::CredentialPath;
use std::net::SocketAddr;

/// Shorter ones are guessed.
const SHORTEST_TOKEN: usize = 16;

/// Where the HTTP server listens, and who may change something.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HttpSettings {
    /// Its address; `None` for no server.
    pub listen: Option<SocketAddr>,
    /// The file with the token of those who acknowledge alarms; `None`: nobody may, over HTTP.
    pub token_file: Option<CredentialPath>,
    /// Names browsers reach it under, besides addresses and `localhost`.
    pub names: Vec<String>,
    /// Origins of web pages that may open the live view.
    pub viewer_origins: Vec<String>,
}

impl HttpSettings {
    /// Who may ask, with the token as its file has it now.
    ///
    /// # Errors
    /// The file cannot be read, or what it holds is no token.
    pub fn access(&self) -> anyhow::Result<Access> {
        let token = match &self.token_file {
            Some(file) => {
                let token = file
                    .read_line()
                    .map_err(|failure| anyhow::anyhow!("http.token_file: {}", failure.reason))?;
                anyhow::ensure!(
                    token.len() >= SHORTEST_TOKEN,
                    "http.token_file: {} holds a token shorter than {SHORTEST_TOKEN} characters; \
                     `openssl rand -hex 24` makes a good one",
                    file.as_str()
                );
                Some(token)
            }
            None => None,
        };
        Ok(Access::new(token.as_deref(), &self.names, &self.viewer_origins))
    }
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
