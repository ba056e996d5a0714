//! Optional TLS. Certificate chain and key are PEM files that are read once at start.

use std::io;
use std::path::Path;
use std::sync::Arc;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};

/// Does the TLS handshake on accepted connections.
pub type Tls = TlsAcceptor;

/// Makes ring the TLS provider of this process. Call it before building an HTTP client; a second call changes nothing.
pub fn use_ring() {
    // An error means that a provider is installed already.
    let _ = ring::default_provider().install_default();
}

/// Reads the files and creates the acceptor.
///
/// # Errors
/// If a file cannot be read, contains no certificate or key, or key and certificate do not match.
pub fn load(certificates: &Path, key: &Path) -> io::Result<Tls> {
    let invalid = |path: &Path, cause: String| {
        io::Error::new(
            io::ErrorKind::InvalidData,
            format!("{}: {cause}", path.display()),
        )
    };
    let chain = CertificateDer::pem_file_iter(certificates)
        .and_then(Iterator::collect::<Result<Vec<_>, _>>);
    let chain = chain.map_err(|error| invalid(certificates, error.to_string()))?;
    if chain.is_empty() {
        return Err(invalid(
            certificates,
            "there is no certificate in it".into(),
        ));
    }
    let secret =
        PrivateKeyDer::from_pem_file(key).map_err(|error| invalid(key, error.to_string()))?;
    let config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .and_then(|builder| {
            builder
                .with_no_client_auth()
                .with_single_cert(chain, secret)
        });
    let mut config = config.map_err(|error| invalid(key, error.to_string()))?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok(TlsAcceptor::from(Arc::new(config)))
}
