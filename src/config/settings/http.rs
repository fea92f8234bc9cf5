//! Where the HTTP server listens, and who may change something.

use super::credential::CredentialPath;
use crate::service::http::Access;
use std::net::SocketAddr;
use std::os::unix::fs::PermissionsExt;

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
                refuse_if_open(file.as_str())?;
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

/// Refuses a file that every user of this machine can read or write. systemd's credentials are its own.
fn refuse_if_open(path: &str) -> anyhow::Result<()> {
    const OTHERS: u32 = 0o006;
    // A file that is not there is told where it is read.
    let Ok(data) = std::fs::metadata(path) else {
        return Ok(());
    };
    let mode = data.permissions().mode() & 0o777;
    anyhow::ensure!(
        mode & OTHERS == 0,
        "http.token_file: {path} can be read or written by everybody on this machine (mode {mode:03o}): `chmod 600 {path}`"
    );
    Ok(())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_everybody_can_read_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("token");
        std::fs::write(&path, "0123456789abcdef0123\n").unwrap();
        let settings = HttpSettings {
            token_file: Some(CredentialPath::new(path.to_str().unwrap())),
            ..HttpSettings::default()
        };
        for (mode, is_good) in [(0o600, true), (0o640, true), (0o644, false), (0o602, false)] {
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
            match settings.access() {
                Ok(access) => assert!(is_good && access.has_token(), "{mode:o}"),
                Err(error) => assert!(!is_good && error.to_string().contains("chmod 600"), "{error}"),
            }
        }
    }
}
