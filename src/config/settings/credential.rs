//! Passwords, tokens and certificates: always in files, read when they are needed, never kept, never logged.

use std::fs::{self, File};
use std::io::Read;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use thiserror::Error;

/// Prefix of a path in the folder of systemd's `LoadCredential=`.
const PREFIX: &str = "$CREDENTIALS_DIRECTORY/";

/// The longest file read \[bytes\].
const LONGEST: u64 = 1 << 20;

/// A credential file that cannot be read or has the wrong content, in one sentence.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{0}")]
pub struct CredentialError(String);

/// The path of a file with a password, a token or certificates, as configured.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CredentialPath(String);

impl CredentialPath {
    /// A path from the text of the configuration; a leading `$CREDENTIALS_DIRECTORY/` is resolved at each
    /// reading.
    pub fn new(text: &str) -> Self {
        Self(text.to_owned())
    }

    /// Text as configured.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Content of the file.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn read(&self) -> Result<Vec<u8>, CredentialError> {
        let path = self.path()?;
        let mut bytes = Vec::new();
        File::open(&path)
            .and_then(|file| file.take(LONGEST).read_to_end(&mut bytes))
            .map_err(|error| CredentialError(format!("{}: {error}", self.0)))?;
        Ok(bytes)
    }

    /// Content of a file that nobody but its owner may read or write. systemd protects those it hands over itself.
    ///
    /// # Errors
    /// It cannot be read, or others can read or write it.
    pub fn read_private(&self) -> Result<Vec<u8>, CredentialError> {
        const OTHERS: u32 = 0o077;
        let mode = std::fs::metadata(self.path()?).map_or(0, |data| data.permissions().mode() & 0o777);
        if mode & OTHERS != 0 && !self.0.starts_with(PREFIX) {
            return Err(CredentialError(format!(
                "{}: others can read or write it (mode {mode:03o}): `chmod 600 {}`",
                self.0, self.0
            )));
        }
        self.read()
    }

    /// Path of the file.
    ///
    /// # Errors
    /// It is one of systemd's credentials, and there are none.
    pub fn resolved(&self) -> Result<PathBuf, CredentialError> {
        self.path()
    }

    /// The single line of the file.
    ///
    /// # Errors
    /// It cannot be read, can be read or written by everybody on this machine, or holds something else than
    /// one line of text.
    pub fn read_line(&self) -> Result<String, CredentialError> {
        const OTHERS: u32 = 0o006;
        // A missing file is reported where it is read. systemd protects its credentials itself.
        let mode = fs::metadata(self.path()?).map_or(0, |data| data.permissions().mode() & 0o777);
        if mode & OTHERS != 0 && !self.0.starts_with(PREFIX) {
            return Err(CredentialError(format!(
                "{0} can be read or written by everybody on this machine (mode {mode:03o}): `chmod 600 {0}`",
                self.0
            )));
        }
        let text = String::from_utf8(self.read()?).ok();
        let line = text.as_deref().map(|text| text.trim_end_matches(['\r', '\n']));
        match line {
            Some(line) if !line.is_empty() && !line.chars().any(char::is_control) => Ok(line.to_owned()),
            _ => Err(CredentialError(format!(
                "{} does not hold one line of text",
                self.0
            ))),
        }
    }

    fn path(&self) -> Result<PathBuf, CredentialError> {
        let Some(name) = self.0.strip_prefix(PREFIX) else {
            return Ok(PathBuf::from(&self.0));
        };
        match std::env::var_os("CREDENTIALS_DIRECTORY") {
            Some(folder) => Ok(PathBuf::from(folder).join(name)),
            None => Err(CredentialError(format!(
                "{}: $CREDENTIALS_DIRECTORY is not set; systemd sets it for a unit with LoadCredential=",
                self.0
            ))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_line_is_wanted() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("token");
        let file = CredentialPath::new(path.to_str().unwrap());
        assert!(file.read_line().unwrap_err().0.contains("token"));
        for (text, line) in [
            ("secret\n", Some("secret")),
            ("se cret", Some("se cret")),
            ("secret\r\n", Some("secret")),
            ("", None),
            ("\n", None),
            ("two\nlines\n", None),
        ] {
            std::fs::write(&path, text).unwrap();
            std::fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
            assert_eq!(file.read_line().ok().as_deref(), line, "{text:?}");
        }
    }

    #[test]
    fn a_secret_that_others_can_read_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("seed");
        let file = CredentialPath::new(path.to_str().unwrap());
        std::fs::write(&path, "secret").unwrap();
        for (mode, is_line, is_private) in [
            (0o600, true, true),
            (0o400, true, true),
            (0o640, true, false),
            (0o644, false, false),
            (0o602, false, false),
        ] {
            std::fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
            assert_eq!(file.read_line().is_ok(), is_line, "{mode:o}");
            assert_eq!(file.read_private().is_ok(), is_private, "{mode:o}");
        }
        assert!(file.read_line().unwrap_err().0.contains("chmod 600"));
    }

    #[test]
    fn a_missing_credentials_folder_is_named() {
        // The tests of this crate run without systemd.
        if std::env::var_os("CREDENTIALS_DIRECTORY").is_none() {
            let failure = CredentialPath::new("$CREDENTIALS_DIRECTORY/mail")
                .read()
                .unwrap_err();
            assert!(failure.0.contains("LoadCredential"), "{failure}");
        }
    }
}
