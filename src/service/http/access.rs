//! Access control: host names that the server answers to, and the token for requests that change something.

use crate::config::settings::http::HttpSettings;
use axum::http::HeaderMap;
use axum::http::header::{AUTHORIZATION, HOST, ORIGIN};
use sha2::{Digest, Sha256};
use std::net::IpAddr;
use subtle::ConstantTimeEq;

/// Fewest characters of a token; shorter ones can be guessed.
const SHORTEST_TOKEN: usize = 16;

/// Rules of access.
#[derive(Clone, Default)]
pub struct Access {
    /// SHA-256 of the token; `None`: no request may change anything.
    token: Option<[u8; 32]>,
    /// Host names that the server answers to, besides addresses and `localhost`.
    names: Vec<String>,
    /// Origins of pages that may open the live view, besides our own.
    viewer_origins: Vec<String>,
}

impl Access {
    /// Rules from the settings, with the present token of its file.
    ///
    /// # Errors
    /// The file cannot be read, or its content is not a token.
    pub fn of(settings: &HttpSettings) -> anyhow::Result<Self> {
        let token = match &settings.token_file {
            Some(file) => {
                let token = file
                    .read_line()
                    .map_err(|error| anyhow::anyhow!("http.token_file: {error}"))?;
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
        Ok(Self::new(
            token.as_deref(),
            &settings.names,
            &settings.viewer_origins,
        ))
    }

    /// Rules from their parts; `token` is the secret itself.
    pub fn new(token: Option<&str>, names: &[String], viewer_origins: &[String]) -> Self {
        let lower = |texts: &[String]| texts.iter().map(|text| text.to_ascii_lowercase()).collect();
        Self {
            token: token.map(|token| Sha256::digest(token).into()),
            names: lower(names),
            viewer_origins: lower(viewer_origins),
        }
    }

    /// Checks if these headers may open the live view; else returns the forbidden origin. Programs send no
    /// origin; a browser sends its page's, and lets any page open a WebSocket.
    pub fn may_view(&self, headers: &HeaderMap) -> Result<(), String> {
        let Some(origin) = headers.get(ORIGIN) else {
            return Ok(());
        };
        let origin = String::from_utf8_lossy(origin.as_bytes()).to_ascii_lowercase();
        let host = headers.get(HOST).and_then(|host| host.to_str().ok());
        let is_own = host.is_some_and(|host| {
            let after = origin.split_once("://").map(|(_, after)| after);
            after.is_some_and(|after| after.eq_ignore_ascii_case(host))
        });
        if is_own || self.viewer_origins.contains(&origin) {
            Ok(())
        } else {
            Err(origin)
        }
    }

    /// True if there is a token for requests that change something.
    pub fn has_token(&self) -> bool {
        self.token.is_some()
    }

    /// True if these headers carry the token. Hashes of equal length are compared in constant time.
    pub fn may_write(&self, headers: &HeaderMap) -> bool {
        let said = headers
            .get(AUTHORIZATION)
            .and_then(|value| value.to_str().ok())
            .and_then(|value| value.strip_prefix("Bearer "));
        match (&self.token, said) {
            (Some(token), Some(said)) => {
                let said: [u8; 32] = Sha256::digest(said.trim()).into();
                token.ct_eq(&said).into()
            }
            _ => false,
        }
    }

    /// True if the browser was led here under an allowed name: a foreign page may point its own name at this
    /// address to read the answers.
    pub fn is_host(&self, headers: &HeaderMap) -> bool {
        let Some(host) = headers.get(HOST) else {
            // Only HTTP/1.0 has none, and no browser speaks it.
            return true;
        };
        let Ok(host) = host.to_str() else { return false };
        let name = match host.strip_prefix('[') {
            Some(rest) => rest.split(']').next().unwrap_or_default(),
            None => host.rsplit_once(':').map_or(host, |(name, _)| name),
        };
        let name = name.to_ascii_lowercase();
        name.parse::<IpAddr>().is_ok() || name == "localhost" || self.names.contains(&name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::settings::credential::CredentialPath;
    use axum::http::{HeaderName, HeaderValue};
    use std::os::unix::fs::PermissionsExt;

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
            match Access::of(&settings) {
                Ok(access) => assert!(is_good && access.has_token(), "{mode:o}"),
                Err(error) => assert!(!is_good && error.to_string().contains("chmod 600"), "{error}"),
            }
        }
    }

    fn headers(name: HeaderName, value: &'static str) -> HeaderMap {
        HeaderMap::from_iter([(name, HeaderValue::from_static(value))])
    }

    #[test]
    fn the_token_and_nothing_else_may_write() {
        let access = Access::new(Some("a long secret"), &[], &[]);
        let may = |value| access.may_write(&headers(AUTHORIZATION, value));
        assert!(may("Bearer a long secret"));
        for wrong in [
            "Bearer a long secre",
            "Bearer ",
            "a long secret",
            "Basic a long secret",
            "Bearer a long secret2",
        ] {
            assert!(!may(wrong), "{wrong}");
        }
        assert!(!access.may_write(&HeaderMap::new()));
        assert!(!Access::default().may_write(&headers(AUTHORIZATION, "Bearer ")));
    }

    #[test]
    fn foreign_names_are_not_ours() {
        let access = Access::new(None, &["Tower.example".to_owned()], &[]);
        for ours in [
            "127.0.0.1:7416",
            "localhost",
            "LOCALHOST:80",
            "[::1]:7416",
            "192.168.1.4",
            "tower.example:7416",
        ] {
            assert!(access.is_host(&headers(HOST, ours)), "{ours}");
        }
        for foreign in [
            "evil.example",
            "evil.example:7416",
            "tower.example.evil:1",
            "",
            "[evil]",
        ] {
            assert!(!access.is_host(&headers(HOST, foreign)), "{foreign}");
        }
    }

    #[test]
    fn foreign_pages_may_not_view() {
        let access = Access::new(None, &[], &["https://viewer.example".to_owned()]);
        let may = |origin| {
            let mut said = headers(ORIGIN, origin);
            said.insert(HOST, HeaderValue::from_static("127.0.0.1:7416"));
            access.may_view(&said).is_ok()
        };
        for ours in [
            "https://viewer.example",
            "HTTPS://Viewer.example",
            "http://127.0.0.1:7416",
        ] {
            assert!(may(ours), "{ours}");
        }
        for foreign in [
            "https://evil.example",
            "null",
            "file://",
            "http://127.0.0.1:80",
            "",
        ] {
            assert!(!may(foreign), "{foreign}");
        }
        assert!(access.may_view(&HeaderMap::new()).is_ok());
    }
}
