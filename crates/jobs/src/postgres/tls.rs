//! TLS to the database.

use std::io;
use std::sync::Arc;

use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject;
use rustls::{ClientConfig, RootCertStore};
use tokio_postgres_rustls::MakeRustlsConnect;

use super::address::Roots;

/// A connector that believes a server to be who it says where one of these says so, too.
///
/// # Errors
/// The certificates cannot be read, or there are none.
pub(super) fn connector(roots: &Roots) -> io::Result<MakeRustlsConnect> {
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions();
    let config = config.map_err(io::Error::other)?.with_root_certificates(store(roots)?);
    Ok(MakeRustlsConnect::new(config.with_no_client_auth()))
}

fn store(roots: &Roots) -> io::Result<RootCertStore> {
    let mut store = RootCertStore::empty();
    match roots {
        Roots::System => {
            // Some of a system's may be of kinds that are not understood.
            let found = rustls_native_certs::load_native_certs();
            store.add_parsable_certificates(found.certs);
        }
        Roots::File(path) => {
            for certificate in CertificateDer::pem_file_iter(path).map_err(io::Error::other)? {
                store.add(certificate.map_err(io::Error::other)?).map_err(io::Error::other)?;
            }
        }
    }
    if store.is_empty() {
        let place = if *roots == Roots::System { "the system has" } else { "sslrootcert has" };
        return Err(io::Error::other(format!(
            "{place} no certificates by which to know the database's server"
        )));
    }
    Ok(store)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn certificates_that_cannot_be_read_are_no_certificates() {
        let dir = tempfile::tempdir().expect("a folder");
        let of = |name: &str, text: &str| {
            let path = dir.path().join(name);
            std::fs::write(&path, text).expect("a file");
            connector(&Roots::File(path)).map(drop)
        };
        assert!(of("empty", "").expect_err("none").to_string().contains("no certificates"));
        of("broken", "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n")
            .expect_err("no certificate");
        connector(&Roots::File(dir.path().join("none"))).map(drop).expect_err("no file");
    }
}
