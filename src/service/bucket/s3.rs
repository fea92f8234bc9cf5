//! The three questions to a server with the S3 interface: is an object there, how long is it, take it.

use crate::config::settings::bucket::BucketSettings;
use crate::config::settings::credential::CredentialError;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use rusty_s3::{Bucket, Credentials, S3Action, UrlStyle};
use std::fs::File;
use std::io::Read;
use std::time::Duration;
use ureq::Agent;
use ureq::tls::{PemItem, RootCerts, TlsConfig, parse_pem};

/// Time for which a signed request is good.
const SIGNED: Duration = Duration::from_secs(3600);
/// Longest wait for an answer, and for each megabyte of an upload.
const ANSWER: Duration = Duration::from_secs(30);
const MEGABYTE: Duration = Duration::from_secs(60);
/// Most bytes of an answer read for its reason, and most characters of it shown.
const READ: u64 = 4096;
const SHOWN: usize = 300;

/// Reason why an object is not known to be there.
#[derive(Debug, thiserror::Error)]
pub enum S3Error {
    /// The keys, or the certificates.
    #[error(transparent)]
    Credential(#[from] CredentialError),
    /// The file.
    #[error("{0}")]
    File(#[from] std::io::Error),
    /// The server, in one sentence.
    #[error("{0}")]
    Server(String),
}

/// A bucket with the keys of the moment.
pub struct S3 {
    server: String,
    bucket: Bucket,
    keys: Credentials,
    roots: RootCerts,
}

impl S3 {
    /// Reads keys and certificates, which may have changed.
    ///
    /// # Errors
    /// They cannot be read.
    pub fn new(settings: &BucketSettings) -> Result<Self, S3Error> {
        let wrong = |what: String| S3Error::Server(format!("{}: {what}", settings.server));
        let text = settings.credentials.read_private()?;
        let text = String::from_utf8_lossy(&text).into_owned();
        let mut lines = text.lines().map(str::trim).filter(|line| !line.is_empty());
        let (Some(key), Some(secret), None) = (lines.next(), lines.next(), lines.next()) else {
            let what = format!(
                "{} does not hold two lines, access key id and secret access key",
                settings.credentials.as_str()
            );
            return Err(S3Error::Server(what));
        };
        let Ok(server) = settings.server.parse() else {
            return Err(wrong("is no address".to_owned()));
        };
        let bucket = Bucket::new(
            server,
            UrlStyle::Path,
            settings.bucket.clone(),
            settings.region.clone(),
        );
        let roots = match &settings.ca {
            None => RootCerts::WebPki,
            Some(file) => {
                let pem = file.read()?;
                let certificates = parse_pem(&pem).filter_map(|item| match item {
                    Ok(PemItem::Certificate(certificate)) => Some(certificate),
                    _ => None,
                });
                RootCerts::from(certificates.collect::<Vec<_>>())
            }
        };
        Ok(Self {
            server: settings.server.clone(),
            bucket: bucket.map_err(|error| wrong(error.to_string()))?,
            keys: Credentials::new(key, secret),
            roots,
        })
    }

    fn agent(&self, longest: Duration) -> Agent {
        Agent::config_builder()
            .timeout_global(Some(longest))
            .timeout_connect(Some(ANSWER))
            .http_status_as_error(false)
            .max_redirects(0)
            .max_idle_connections(0)
            .proxy(None)
            .user_agent(concat!("tirante/", env!("CARGO_PKG_VERSION")))
            .tls_config(TlsConfig::builder().root_certs(self.roots.clone()).build())
            .build()
            .into()
    }

    fn failed(&self, error: &dyn std::fmt::Display) -> S3Error {
        S3Error::Server(format!("{}: {error}", self.server))
    }

    /// Length of an object \[bytes\]; `None` if there is none of this name.
    ///
    /// # Errors
    /// The server does not say.
    pub fn length(&self, name: &str) -> Result<Option<u64>, S3Error> {
        let url = self.bucket.head_object(Some(&self.keys), name).sign(SIGNED);
        let answer = self.agent(ANSWER).head(url.as_str()).call();
        let answer = answer.map_err(|error| self.unsaid(&error))?;
        if answer.status() == 404 {
            return Ok(None);
        }
        if !answer.status().is_success() {
            return Err(self.failed(&format!("answers {} about {name}", answer.status())));
        }
        let length = answer.headers().get("content-length");
        let length = length.and_then(|value| value.to_str().ok()?.parse().ok());
        length
            .map(Some)
            .ok_or_else(|| self.failed(&format!("does not say how long {name} is")))
    }

    /// Sends a file of a known length; the server compares what arrives with its SHA-256, if it can.
    ///
    /// # Errors
    /// It is not known to be there.
    pub fn put(&self, name: &str, file: File, bytes: u64, sha256: &[u8]) -> Result<(), S3Error> {
        let sum = STANDARD.encode(sha256);
        let mut action = self.bucket.put_object(Some(&self.keys), name);
        action.headers_mut().insert("x-amz-checksum-sha256", sum.clone());
        let url = action.sign(SIGNED);
        let longest = ANSWER + MEGABYTE * u32::try_from(bytes >> 20).unwrap_or(u32::MAX / 60);
        let sent = self
            .agent(longest)
            .put(url.as_str())
            .header("x-amz-checksum-sha256", sum)
            .header("content-type", "application/octet-stream")
            .header("content-length", bytes.to_string())
            .send(ureq::SendBody::from_owned_reader(file));
        let mut answer = sent.map_err(|error| self.unsaid(&error))?;
        if answer.status().is_success() {
            return Ok(());
        }
        let mut text = Vec::new();
        // It is only shown, so the readable part is enough.
        let _ = answer.body_mut().as_reader().take(READ).read_to_end(&mut text);
        Err(self.failed(&format!("answers {} to {name}{}", answer.status(), reason(&text))))
    }

    /// A failure without the address, whose query signs for whoever reads it.
    fn unsaid(&self, error: &ureq::Error) -> S3Error {
        match error {
            ureq::Error::Timeout(_) => self.failed(&"no answer in time"),
            ureq::Error::BadUri(_) => self.failed(&"no address"),
            error => self.failed(error),
        }
    }
}

/// Reason that a refusal gives, in brackets. The rest of it may hold the key's id and the signature.
fn reason(answer: &[u8]) -> String {
    let answer = String::from_utf8_lossy(answer);
    let of = |name: &str| {
        let (_, rest) = answer.split_once(&format!("<{name}>"))?;
        Some(rest.split_once("</")?.0.to_owned())
    };
    let told: Vec<String> = ["Code", "Message"].into_iter().filter_map(of).collect();
    if told.is_empty() {
        return String::new();
    }
    let readable = told.join(": ");
    let readable = readable.chars().map(|c| if c.is_control() { ' ' } else { c });
    format!(" ({})", readable.take(SHOWN).collect::<String>())
}
