//! TLS for the TCP sockets: only clients with a certificate of the configured authority are admitted. Both
//! sides of it.

use super::listener::ListenError;
use crate::config::settings::ingest::TlsSettings;
use std::path::Path;
use std::sync::Arc;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::server::WebPkiClientVerifier;
use tokio_rustls::rustls::{ClientConfig, RootCertStore, ServerConfig};
use tokio_rustls::{TlsAcceptor, TlsConnector};

/// The daemon's side.
pub(super) fn acceptor(settings: &TlsSettings) -> Result<TlsAcceptor, ListenError> {
    let provider = Arc::new(ring::default_provider());
    let unusable = |key: &str, path: &Path, what: &dyn std::fmt::Display| {
        ListenError::Tls(format!("{key}: {}: {what}", path.display()))
    };
    let chain = certificates(&settings.certificate)
        .map_err(|what| unusable("certificate", &settings.certificate, &what))?;
    let key =
        PrivateKeyDer::from_pem_file(&settings.key).map_err(|what| unusable("key", &settings.key, &what))?;
    let roots =
        roots(&settings.client_ca).map_err(|what| unusable("client_ca", &settings.client_ca, &what))?;
    let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), Arc::clone(&provider))
        .build()
        .map_err(|what| unusable("client_ca", &settings.client_ca, &what))?;
    let config = ServerConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .map_err(|what| ListenError::Tls(what.to_string()))?
        .with_client_cert_verifier(verifier)
        .with_single_cert(chain, key)
        .map_err(|what| unusable("certificate and key", &settings.certificate, &what))?;
    Ok(TlsAcceptor::from(Arc::new(config)))
}

/// The client's side: authority of the daemon's certificate, the client's own certificate and its key.
///
/// # Errors
/// One of the files cannot be used.
pub(crate) fn connector(authority: &Path, certificate: &Path, key: &Path) -> Result<TlsConnector, String> {
    let named = |path: &Path, what: String| format!("{}: {what}", path.display());
    let roots = roots(authority).map_err(|what| named(authority, what))?;
    let chain = certificates(certificate).map_err(|what| named(certificate, what))?;
    let private = PrivateKeyDer::from_pem_file(key).map_err(|what| named(key, what.to_string()))?;
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|what| what.to_string())?
        .with_root_certificates(roots)
        .with_client_auth_cert(chain, private)
        .map_err(|what| named(certificate, what.to_string()))?;
    Ok(TlsConnector::from(Arc::new(config)))
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

/// Reads the authorities in a PEM file.
fn roots(path: &Path) -> Result<RootCertStore, String> {
    let mut roots = RootCertStore::empty();
    for certificate in certificates(path)? {
        roots.add(certificate).map_err(|fault| fault.to_string())?;
    }
    Ok(roots)
}
