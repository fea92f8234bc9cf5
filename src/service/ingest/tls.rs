//! TLS for the TCP sockets: only clients with a certificate of the configured authority are admitted. Both
//! sides of it.

use super::certificate::{Facts, Rights, Validity};
use super::clients::Clients;
use super::listener::ListenError;
use crate::config::settings::ingest::TlsSettings;
use crate::service::telemetry::{Fault, Health, Via};
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::server::WebPkiClientVerifier;
use tokio_rustls::rustls::{ClientConfig, RootCertStore, ServerConfig, ServerConnection};
use tokio_rustls::{TlsAcceptor, TlsConnector};

/// The daemon's side: certificates that are read again when their files change.
pub(super) struct Identity {
    settings: TlsSettings,
    present: Mutex<Present>,
    clients: Clients,
}

/// Certificates in force.
struct Present {
    acceptor: TlsAcceptor,
    stamps: Vec<Option<Stamp>>,
    /// Validity of the daemon's chain, and of its authorities together.
    valid: [Validity; 2],
}

/// Device, inode, length and time of change of a file.
type Stamp = (u64, u64, u64, i64, i64);

impl Identity {
    /// Reads the files.
    ///
    /// # Errors
    /// They cannot be used.
    pub fn read(settings: TlsSettings) -> Result<Self, ListenError> {
        let present = Mutex::new(read(&settings)?);
        Ok(Self {
            settings,
            present,
            clients: Clients::default(),
        })
    }

    /// Acceptor with the certificates in force.
    pub fn acceptor(&self) -> TlsAcceptor {
        self.lock().acceptor.clone()
    }

    /// Reads files that changed, and reports those that cannot be used, have ended, or end soon.
    pub fn look(&self, now_s: i64, health: &Health) {
        let TlsSettings {
            certificate,
            key,
            client_ca,
            ..
        } = &self.settings;
        const NEW: &str = "new certificates";
        if self.lock().stamps != stamps(&self.settings) {
            match read(&self.settings) {
                Ok(present) => {
                    *self.lock() = present;
                    health.over(Fault::Certificate, NEW);
                    tracing::info!("{}: new certificates are in force", certificate.display());
                }
                // The next look tries again: a key may come a moment after its certificate.
                Err(error) => health.hold(
                    Fault::Certificate,
                    NEW,
                    format_args!("{error}; the ones before stay in force"),
                ),
            }
        } else {
            // The files before may have come back.
            health.over(Fault::Certificate, NEW);
        }
        let valid = self.lock().valid;
        for ((name, path), valid) in [("certificate", certificate), ("client_ca", client_ca)]
            .into_iter()
            .zip(valid)
        {
            health.credentials().ends(name, valid.ends_s);
            // Two keys may name one file.
            let about = format!("{name} {}", path.display());
            match valid.warning(now_s) {
                Some(warning) => health.hold(
                    Fault::Certificate,
                    &about,
                    format_args!("{about} {warning}; put a new one in its place, it is read at once"),
                ),
                None => health.over(Fault::Certificate, &about),
            }
        }
        let about = format!("key {}", key.display());
        match fs::metadata(key).is_ok_and(|data| data.mode() & 0o006 != 0) {
            true => health.hold(
                Fault::Certificate,
                &about,
                format_args!(
                    "{about} can be read or written by everybody on this machine: `chmod 600 {}`",
                    key.display()
                ),
            ),
            false => health.over(Fault::Certificate, &about),
        }
        self.clients.look(now_s, health);
    }

    /// Rights of a client by its certificate, whose near end is reported.
    ///
    /// # Errors
    /// It may not send.
    pub fn rights(
        &self,
        connection: &ServerConnection,
        now_s: i64,
        health: &Health,
    ) -> Result<Rights, String> {
        let chain = connection.peer_certificates().unwrap_or_default();
        let facts = Facts::of(chain.first().ok_or("no certificate")?)?;
        let about = format!("client {}", facts.name());
        self.clients.connected(&about, facts.valid, now_s, health);
        // A session that is taken up again shows its certificate without having it checked anew.
        let rights = if facts.valid.holds(now_s) {
            Rights::of(&facts, &self.settings.bound)
        } else if facts.valid.is_early(now_s) {
            Err(format!(
                "the certificate of {about} is not valid yet by the daemon's clock"
            ))
        } else {
            Err(format!("the certificate of {about} has ended: renew it"))
        };
        if rights.is_err() {
            health.credentials().denied(Via::Socket);
        }
        rights
    }

    fn lock(&self) -> MutexGuard<'_, Present> {
        self.present.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn stamps(settings: &TlsSettings) -> Vec<Option<Stamp>> {
    let files = [&settings.certificate, &settings.key, &settings.client_ca];
    let stamp = |path: &&std::path::PathBuf| {
        let data = fs::metadata(path).ok()?;
        Some((
            data.dev(),
            data.ino(),
            data.len(),
            data.mtime(),
            data.mtime_nsec(),
        ))
    };
    files.iter().map(stamp).collect()
}

/// Reads all files.
fn read(settings: &TlsSettings) -> Result<Present, ListenError> {
    // Before the content: a change in between is seen at the next look.
    let stamps = stamps(settings);
    let provider = Arc::new(ring::default_provider());
    let unusable = |key: &str, path: &Path, what: &dyn std::fmt::Display| {
        ListenError::Tls(format!("{key}: {}: {what}", path.display()))
    };
    let of_chain = |what: String| unusable("certificate", &settings.certificate, &what);
    let of_authority = |what: String| unusable("client_ca", &settings.client_ca, &what);
    let chain = certificates(&settings.certificate).map_err(of_chain)?;
    let authorities = certificates(&settings.client_ca).map_err(of_authority)?;
    // A chain is valid while all its links are; of several authorities one is enough while they are exchanged.
    let of_links = validities(&chain).map_err(of_chain)?;
    let own = chain.first().map(Facts::of).transpose().map_err(of_chain)?;
    if own.is_some_and(|own| !own.may_serve) {
        return Err(of_chain(
            "its extended key usage has no server authentication, so that every sender would turn away: have one issued for servers"
                .to_owned(),
        ));
    }
    let of_authorities = validities(&authorities).map_err(of_authority)?;
    let chain_valid = Validity {
        begins_s: of_links
            .iter()
            .map(|link| link.begins_s)
            .max()
            .unwrap_or_default(),
        ends_s: of_links.iter().map(|link| link.ends_s).min().unwrap_or_default(),
    };
    let authority_valid = Validity {
        begins_s: of_authorities
            .iter()
            .map(|authority| authority.begins_s)
            .min()
            .unwrap_or_default(),
        ends_s: of_authorities
            .iter()
            .map(|authority| authority.ends_s)
            .max()
            .unwrap_or_default(),
    };
    let key =
        PrivateKeyDer::from_pem_file(&settings.key).map_err(|what| unusable("key", &settings.key, &what))?;
    let roots = roots(authorities).map_err(of_authority)?;
    let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), Arc::clone(&provider))
        .build()
        .map_err(|what| unusable("client_ca", &settings.client_ca, &what))?;
    let config = ServerConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .map_err(|what| ListenError::Tls(what.to_string()))?
        .with_client_cert_verifier(verifier)
        .with_single_cert(chain, key)
        .map_err(|what| unusable("certificate and key", &settings.certificate, &what))?;
    Ok(Present {
        acceptor: TlsAcceptor::from(Arc::new(config)),
        stamps,
        valid: [chain_valid, authority_valid],
    })
}

fn validities(chain: &[CertificateDer<'_>]) -> Result<Vec<Validity>, String> {
    chain.iter().map(|der| Ok(Facts::of(der)?.valid)).collect()
}

/// The client's side: authority of the daemon's certificate, the client's own certificate and its key. Also
/// returns a warning about a certificate that ends soon.
///
/// # Errors
/// One of the files cannot be used, or the client's certificate is not valid.
pub(crate) fn connector(
    authority: &Path,
    certificate: &Path,
    key: &Path,
    now_s: i64,
) -> Result<(TlsConnector, Option<String>), String> {
    let named = |path: &Path, what: String| format!("{}: {what}", path.display());
    let roots = certificates(authority)
        .and_then(roots)
        .map_err(|what| named(authority, what))?;
    let chain = certificates(certificate).map_err(|what| named(certificate, what))?;
    let first = chain.first().ok_or("no certificate")?;
    let facts = Facts::of(first).map_err(|what| named(certificate, what))?;
    let warning = facts
        .valid
        .warning(now_s)
        .map(|what| format!("{}: this certificate {what}", certificate.display()));
    if !facts.valid.holds(now_s) {
        return Err(warning.unwrap_or_default() + ": the daemon would refuse it; renew it");
    }
    let private = PrivateKeyDer::from_pem_file(key).map_err(|what| named(key, what.to_string()))?;
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|what| what.to_string())?
        .with_root_certificates(roots)
        .with_client_auth_cert(chain, private)
        .map_err(|what| named(certificate, what.to_string()))?;
    Ok((TlsConnector::from(Arc::new(config)), warning))
}

/// Reads the certificates in a PEM file, at least one.
fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>, String> {
    let list: Vec<_> = CertificateDer::pem_file_iter(path)
        .and_then(Iterator::collect)
        .map_err(|fault| fault.to_string())?;
    if list.is_empty() {
        return Err("holds no certificate".to_owned());
    }
    Ok(list)
}

/// A store of authorities.
fn roots(authorities: Vec<CertificateDer<'static>>) -> Result<RootCertStore, String> {
    let mut roots = RootCertStore::empty();
    for certificate in authorities {
        roots.add(certificate).map_err(|fault| fault.to_string())?;
    }
    Ok(roots)
}
