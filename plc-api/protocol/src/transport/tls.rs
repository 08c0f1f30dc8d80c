//! TLS of a client: trusted certificate authorities and the certificate of the client.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustls::crypto::ring;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::{ClientConfig, ConfigBuilder, RootCertStore, WantsVerifier};

/// Files of a TLS connection, each in PEM.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct TlsFiles {
    /// Certificates of the trusted authorities. `None` means the authorities of the system.
    pub ca_file: Option<PathBuf>,
    /// Certificate of the client, with any intermediate certificates. Requires `client_key_file`.
    pub client_cert_file: Option<PathBuf>,
    /// Private key of the certificate of the client.
    pub client_key_file: Option<PathBuf>,
}

impl TlsFiles {
    /// Returns the TLS configuration of a client, versions 1.2 and 1.3. The certificate of the server must be
    /// valid for the name of the host.
    ///
    /// # Errors
    /// Fails if a file cannot be read or used, the certificate or the key is missing, or the system trusts no
    /// authority.
    pub fn client_config(&self) -> Result<ClientConfig, String> {
        let roots = self.roots()?;
        let builder = builder()?.with_root_certificates(roots);
        Ok(match (&self.client_cert_file, &self.client_key_file) {
            (None, None) => builder.with_no_client_auth(),
            (Some(cert), Some(key)) => {
                let chain = certificates("client_cert_file", cert)?;
                let shown = key.display();
                let key = PrivateKeyDer::from_pem_file(key)
                    .map_err(|error| format!("client_key_file {shown}: {error}"))?;
                let config = builder.with_client_auth_cert(chain, key);
                config.map_err(|error| format!("client_cert_file {}: {error}", cert.display()))?
            }
            _ => return Err("client_cert_file and client_key_file need each other".to_owned()),
        })
    }

    fn roots(&self) -> Result<RootCertStore, String> {
        let mut roots = RootCertStore::empty();
        let Some(path) = &self.ca_file else {
            let found = rustls_native_certs::load_native_certs();
            roots.add_parsable_certificates(found.certs);
            if roots.is_empty() {
                return Err("the system has no certificate authorities; name one in ca_file".to_owned());
            }
            return Ok(roots);
        };
        for certificate in certificates("ca_file", path)? {
            let added = roots.add(certificate);
            added.map_err(|error| format!("ca_file {}: {error}", path.display()))?;
        }
        Ok(roots)
    }
}

/// Returns the TLS configuration of a client that makes no TLS connection and trusts no authority.
#[cfg(feature = "rest")]
pub(super) fn without_authorities() -> Result<ClientConfig, String> {
    Ok(builder()?
        .with_root_certificates(RootCertStore::empty())
        .with_no_client_auth())
}

fn builder() -> Result<ConfigBuilder<ClientConfig, WantsVerifier>, String> {
    ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|error| error.to_string())
}

fn certificates(key: &str, path: &Path) -> Result<Vec<CertificateDer<'static>>, String> {
    let wrong = |what: &dyn std::fmt::Display| format!("{key} {}: {what}", path.display());
    let certificates = CertificateDer::pem_file_iter(path)
        .and_then(Iterator::collect::<Result<Vec<_>, _>>)
        .map_err(|error| wrong(&error))?;
    if certificates.is_empty() {
        return Err(wrong(&"it holds no certificate in PEM"));
    }
    Ok(certificates)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_used_is_named() {
        let missing = TlsFiles {
            ca_file: Some("no/such/ca.pem".into()),
            ..TlsFiles::default()
        };
        let error = missing.client_config().err().unwrap();
        assert!(
            error.contains("ca_file") && error.contains("no/such/ca.pem"),
            "{error}"
        );
        let no_pem = TlsFiles {
            ca_file: Some("Cargo.toml".into()),
            ..TlsFiles::default()
        };
        assert!(no_pem.client_config().err().unwrap().contains("no certificate"));
    }
}
