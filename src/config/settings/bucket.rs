//! Object storage for the journal's parts.

use super::credential::CredentialPath;

/// A bucket of a server with the S3 interface.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BucketSettings {
    /// Server: scheme, host and port.
    pub server: String,
    /// Name of the bucket.
    pub bucket: String,
    /// Beginning of all objects' names, without a slash at its ends; may be empty.
    pub prefix: String,
    /// Region that the requests are signed for.
    pub region: String,
    /// File with two lines: access key id and secret access key.
    pub credentials: CredentialPath,
    /// File with the certificates (PEM) that are trusted instead of the built-in roots.
    pub ca: Option<CredentialPath>,
}

impl BucketSettings {
    /// Address as configured.
    pub fn address(&self) -> String {
        let parts = [self.server.as_str(), &self.bucket, &self.prefix];
        let parts: Vec<&str> = parts.into_iter().filter(|part| !part.is_empty()).collect();
        parts.join("/")
    }
}
