//! TLS of the listeners: HTTP, WebSocket and the embedded broker share one certificate, which is read again when its
//! files change. A client may present its own certificate, which is accepted if the token file names it.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use plc_protocol::supervisor::Supervisor;
use rustls::client::danger::HandshakeSignatureValid;
use rustls::crypto::{WebPkiSupportedAlgorithms, ring, verify_tls12_signature, verify_tls13_signature};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, UnixTime};
use rustls::server::danger::{ClientCertVerified, ClientCertVerifier};
use rustls::{CertificateError, DigitallySignedStruct, DistinguishedName, ServerConfig, SignatureScheme};
use sha2::{Digest, Sha256};
use tokio::net::TcpStream;
use tokio::sync::watch;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;
use tokio_util::either::Either;
use tracing::{info, warn};

use crate::access::{LiveTokens, Stamp};
use crate::certificate::{ClientCertificate, Validity, days_to_end};
use crate::position::every;

/// How often the files are checked.
const LOOK_INTERVAL: Duration = Duration::from_secs(2);

/// Longest time for a client to agree on keys; then its connection is closed.
const HANDSHAKE_MAX: Duration = Duration::from_secs(10);

/// The first byte of a client that speaks TLS: the type of a handshake record (RFC 8446, 5.1).
const HANDSHAKE_RECORD: u8 = 0x16;

/// `[tls]`: the certificate of the listeners.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServerTls {
    /// The certificate in PEM, followed by any intermediate ones.
    pub cert_file: PathBuf,
    /// Its private key in PEM, which only its owner may be able to read.
    pub key_file: PathBuf,
}

/// Last announcement of the end of the own certificate. Each is made once, so a coming end is announced once a day.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum CertificateEnd {
    /// The end is announced early: the days that are left.
    InDays(u64),
    Passed,
}

impl CertificateEnd {
    /// Returns the announcement that is due for an end. Returns `None` if the end is far away.
    fn at(end: SystemTime, now: SystemTime) -> Option<Self> {
        if end < now {
            return Some(Self::Passed);
        }
        days_to_end(end, now).map(Self::InDays)
    }

    fn announce(self, file: &Path) {
        let file = file.display();
        match self {
            Self::InDays(days) => warn!("the certificate {file} expires in {days} days; renew it"),
            Self::Passed => {
                warn!("the certificate {file} has expired, so clients refuse to connect; renew it");
            }
        }
    }
}

/// A configuration of the listeners, with the validity of its certificate.
struct ReadCertificate {
    config: ServerConfig,
    validity: Option<Validity>,
}

/// A connection of a client, with TLS or without.
pub(crate) type ClientStream = Either<TcpStream, Box<TlsStream<TcpStream>>>;

impl ServerTls {
    /// Checks whether the files can be used.
    ///
    /// # Errors
    /// Fails if a file cannot be read or holds nothing of its kind, if other users may read the key, or if key and
    /// certificate do not belong together.
    pub(crate) fn check(&self) -> Result<(), String> {
        self.config(None).map(drop)
    }

    fn config(&self, tokens: Option<LiveTokens>) -> Result<ReadCertificate, String> {
        let chain = CertificateDer::pem_file_iter(&self.cert_file)
            .and_then(Iterator::collect::<Result<Vec<_>, _>>)
            .map_err(|error| format!("[tls] cert_file {}: {error}", self.cert_file.display()))?;
        if chain.is_empty() {
            let file = self.cert_file.display();
            return Err(format!(
                "[tls] cert_file {file}: the file contains no certificate in PEM"
            ));
        }
        let validity = chain.first().and_then(|own| Validity::of_certificate(own));
        self.check_mode()?;
        let wrong_key =
            |error: &dyn std::fmt::Display| format!("[tls] key_file {}: {error}", self.key_file.display());
        let key = PrivateKeyDer::from_pem_file(&self.key_file).map_err(|error| wrong_key(&error))?;
        let provider = Arc::new(ring::default_provider());
        let verifier = Arc::new(NamedCertificates {
            algorithms: provider.signature_verification_algorithms,
            tokens,
        });
        let config = ServerConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .map_err(|error| error.to_string())?
            .with_client_cert_verifier(verifier)
            .with_single_cert(chain, key)
            .map_err(|error| wrong_key(&error))?;
        Ok(ReadCertificate { config, validity })
    }

    fn check_mode(&self) -> Result<(), String> {
        use std::os::unix::fs::PermissionsExt as _;
        let file = self.key_file.display();
        let metadata =
            std::fs::metadata(&self.key_file).map_err(|error| format!("[tls] key_file {file}: {error}"))?;
        let mode = metadata.permissions().mode() & 0o777;
        if mode & 0o077 != 0 {
            return Err(format!(
                "[tls] key_file {file}: its mode is {mode:03o}, so other users may read the file; run chmod \
                 600 {file}"
            ));
        }
        Ok(())
    }

    fn stamps(&self) -> [Option<Stamp>; 2] {
        let stamp = |file: &Path| {
            std::fs::metadata(file)
                .ok()
                .map(|file| Stamp::from_metadata(&file))
        };
        [stamp(&self.cert_file), stamp(&self.key_file)]
    }
}

/// The current certificate.
#[derive(Clone)]
pub(crate) struct LiveTls(watch::Receiver<Arc<ServerConfig>>);

impl LiveTls {
    /// Loads the certificate of these files, and follows their changes while any handle exists.
    ///
    /// # Errors
    /// Fails if the files cannot be used.
    pub(crate) fn follow(
        files: ServerTls,
        tokens: Option<LiveTokens>,
        supervisor: &Supervisor,
    ) -> Result<Self, String> {
        let seen = files.stamps();
        let ReadCertificate { config, validity } = files.config(tokens.clone())?;
        let (sender, receiver) = watch::channel(Arc::new(config));
        let looking = CertificateReader {
            files: Arc::new(files),
            tokens,
            seen,
            validity,
            announced: None,
            sender,
        };
        let looking = looking.look_again(supervisor.clone());
        tokio::spawn(supervisor.essential("reader of the certificate", looking));
        Ok(Self(receiver))
    }

    /// Negotiates keys with a client. Returns a client without TLS unchanged; the caller decides whether it is
    /// admitted.
    ///
    /// # Errors
    /// Fails if the client disconnects, takes too long, or its TLS cannot be used.
    pub(crate) async fn accept(&self, stream: TcpStream) -> io::Result<AcceptedClient> {
        let config = Arc::clone(&self.0.borrow());
        let accepting = async {
            let mut first = [0];
            stream.peek(&mut first).await?;
            if first[0] != HANDSHAKE_RECORD {
                return Ok(AcceptedClient::plain(stream));
            }
            let stream = TlsAcceptor::from(config).accept(stream).await?;
            let shown = stream.get_ref().1.peer_certificates();
            Ok(AcceptedClient {
                certificate: shown
                    .and_then(<[_]>::first)
                    .map(|shown| ClientCertificate::of_der(shown)),
                stream: Either::Right(Box::new(stream)),
            })
        };
        tokio::time::timeout(HANDSHAKE_MAX, accepting).await?
    }
}

/// An accepted client.
#[derive(Debug)]
pub(crate) struct AcceptedClient {
    /// Its connection: `Right` with TLS.
    pub(crate) stream: ClientStream,
    /// Certificate that the client has presented.
    pub(crate) certificate: Option<ClientCertificate>,
}

impl AcceptedClient {
    /// Returns a client without TLS.
    pub(crate) fn plain(stream: TcpStream) -> Self {
        Self {
            stream: Either::Left(stream),
            certificate: None,
        }
    }

    /// Returns true if the connection uses TLS.
    pub(crate) fn is_private(&self) -> bool {
        matches!(self.stream, Either::Right(_))
    }
}

/// Reads the files of a certificate again when they change, and announces its end.
struct CertificateReader {
    files: Arc<ServerTls>,
    tokens: Option<LiveTokens>,
    seen: [Option<Stamp>; 2],
    /// Validity of the certificate in use; `None` if it is unknown.
    validity: Option<Validity>,
    announced: Option<CertificateEnd>,
    sender: watch::Sender<Arc<ServerConfig>>,
}

impl CertificateReader {
    async fn look_again(mut self, supervisor: Supervisor) {
        let mut look = every(LOOK_INTERVAL);
        loop {
            if let Some(end) = self.new_announcement(SystemTime::now()) {
                end.announce(&self.files.cert_file);
            }
            tokio::select! {
                () = self.sender.closed() => return,
                _ = look.tick() => {}
            }
            let (these, tokens, seen) = (Arc::clone(&self.files), self.tokens.clone(), self.seen);
            let read = move || {
                let stamps = these.stamps();
                (stamps != seen).then(|| (stamps, these.config(tokens)))
            };
            let read = supervisor.catch_blocking("read of the certificate", read);
            let Some(Some((stamps, read))) = read.await else {
                continue;
            };
            self.seen = stamps;
            match read {
                Ok(ReadCertificate { config, validity }) => {
                    info!(
                        "the certificate {} was read again",
                        self.files.cert_file.display()
                    );
                    (self.validity, self.announced) = (validity, None);
                    self.sender.send_replace(Arc::new(config));
                }
                // certificate and key are two files: between the two writes they do not match
                Err(error) => warn!("{error}; the previous certificate stays in use"),
            }
        }
    }

    /// Returns what must be announced about the end of the certificate and was not announced before.
    fn new_announcement(&mut self, now: SystemTime) -> Option<CertificateEnd> {
        let end = CertificateEnd::at(self.validity?.not_after, now);
        let is_new = end != self.announced;
        self.announced = end;
        end.filter(|_| is_new)
    }
}

/// Requests a client certificate if the token file names any. Every certificate is accepted whose key the client has:
/// the token file assigns it to a user by its fingerprint, so no authority is needed.
#[derive(Debug)]
struct NamedCertificates {
    algorithms: WebPkiSupportedAlgorithms,
    tokens: Option<LiveTokens>,
}

impl ClientCertVerifier for NamedCertificates {
    fn offer_client_auth(&self) -> bool {
        self.tokens
            .as_ref()
            .is_some_and(|tokens| tokens.now().names_certificates())
    }

    fn client_auth_mandatory(&self) -> bool {
        false
    }

    fn root_hint_subjects(&self) -> &[DistinguishedName] {
        &[]
    }

    fn verify_client_cert(
        &self,
        certificate: &CertificateDer<'_>,
        _: &[CertificateDer<'_>],
        now: UnixTime,
    ) -> Result<ClientCertVerified, rustls::Error> {
        let validity = Validity::of_certificate(certificate).ok_or(CertificateError::BadEncoding)?;
        let now = SystemTime::UNIX_EPOCH + Duration::from_secs(now.as_secs());
        if now < validity.not_before {
            return Err(CertificateError::NotValidYet.into());
        }
        if now > validity.not_after {
            return Err(CertificateError::Expired.into());
        }
        if let Some(days) = days_to_end(validity.not_after, now) {
            let fingerprint = hex::encode(Sha256::digest(certificate));
            warn!(
                "the client certificate with SHA-256 {fingerprint} expires in {days} days; renew it with tandem cert client"
            );
        }
        Ok(ClientCertVerified::assertion())
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        verify_tls12_signature(message, certificate, signature, &self.algorithms)
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signature: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        verify_tls13_signature(message, certificate, signature, &self.algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.algorithms.supported_schemes()
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use rustls::pki_types::ServerName;
    use rustls::{ClientConfig, RootCertStore};
    use tokio::net::TcpListener;
    use tokio_rustls::TlsConnector;

    use super::*;

    struct CertificateFiles {
        folder: tempfile::TempDir,
        tls: ServerTls,
    }

    impl CertificateFiles {
        fn new() -> Self {
            let folder = tempfile::tempdir().unwrap();
            let tls = ServerTls {
                cert_file: folder.path().join("cert.pem"),
                key_file: folder.path().join("key.pem"),
            };
            let files = Self { folder, tls };
            files.write(&rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap());
            files
        }

        fn write(&self, made: &rcgen::CertifiedKey<rcgen::KeyPair>) {
            // as a tool does: write a temporary file, then rename it
            for (file, text) in [
                (&self.tls.key_file, made.signing_key.serialize_pem()),
                (&self.tls.cert_file, made.cert.pem()),
            ] {
                let beside = self.folder.path().join("beside");
                std::fs::write(&beside, text).unwrap();
                std::fs::set_permissions(&beside, std::fs::Permissions::from_mode(0o600)).unwrap();
                std::fs::rename(&beside, file).unwrap();
            }
        }
    }

    /// Returns true if a client that trusts only this certificate can connect to the server.
    async fn shows(tls: &LiveTls, certificate: &CertificateDer<'static>) -> bool {
        negotiates(tls, certificate, &[]).await.is_some()
    }

    /// Returns the protocol agreed on with a client that trusts only this certificate and offers these. The outer
    /// `None` means that the connection failed.
    async fn negotiates(
        tls: &LiveTls,
        certificate: &CertificateDer<'static>,
        offered: &[&[u8]],
    ) -> Option<Option<Vec<u8>>> {
        let mut roots = RootCertStore::empty();
        roots.add(certificate.clone()).unwrap();
        let mut config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()
            .unwrap()
            .with_root_certificates(roots)
            .with_no_client_auth();
        config.alpn_protocols = offered.iter().map(|name| name.to_vec()).collect();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let client = async {
            let stream = TcpStream::connect(address).await.unwrap();
            let name = ServerName::try_from("localhost").unwrap();
            TlsConnector::from(Arc::new(config)).connect(name, stream).await
        };
        let server = async { tls.accept(listener.accept().await.unwrap().0).await };
        let (client, accepted) = tokio::join!(client, server);
        let (client, accepted) = (client.ok()?, accepted.ok()?);
        let agreed = client.get_ref().1.alpn_protocol().map(<[u8]>::to_vec);
        accepted.is_private().then_some(agreed)
    }

    #[tokio::test]
    async fn http_2_is_not_agreed_on_over_tls() {
        let files = CertificateFiles::new();
        let tls = LiveTls::follow(files.tls.clone(), None, &Supervisor::default()).unwrap();
        let certificate = CertificateDer::from_pem_file(&files.tls.cert_file).unwrap();
        let agreed = negotiates(&tls, &certificate, &[b"h2", b"http/1.1"]).await;
        assert!(agreed.is_some_and(|protocol| protocol.is_none_or(|name| name == b"http/1.1")));
    }

    #[tokio::test]
    async fn renewed_certificate_applies_without_restart_invalid_one_is_ignored() {
        let files = CertificateFiles::new();
        let tls = LiveTls::follow(files.tls.clone(), None, &Supervisor::default()).unwrap();
        let first = CertificateDer::from_pem_file(&files.tls.cert_file).unwrap();
        assert!(shows(&tls, &first).await);
        let renewed = rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
        std::fs::write(&files.tls.cert_file, "nonsense").unwrap();
        tokio::time::sleep(LOOK_INTERVAL + Duration::from_millis(300)).await;
        assert!(shows(&tls, &first).await);
        files.write(&renewed);
        let mut changed = tls.0.clone();
        tokio::time::timeout(Duration::from_secs(20), changed.changed())
            .await
            .expect("the files are read again")
            .unwrap();
        assert!(shows(&tls, renewed.cert.der()).await);
        assert!(!shows(&tls, &first).await);
    }

    #[test]
    fn the_end_of_a_certificate_is_announced_each_day_and_when_it_passed() {
        let files = CertificateFiles::new();
        let begin = SystemTime::now();
        let day = Duration::from_hours(24);
        let mut reader = CertificateReader {
            files: Arc::new(files.tls.clone()),
            tokens: None,
            seen: files.tls.stamps(),
            validity: Some(Validity {
                not_before: begin,
                not_after: begin + 100 * day,
            }),
            announced: None,
            sender: watch::channel(Arc::new(files.tls.config(None).unwrap().config)).0,
        };
        let mut announced = Vec::new();
        for hour in 0..110 * 24 {
            announced.extend(reader.new_announcement(begin + Duration::from_hours(hour)));
        }
        let days = (0..=30).rev().map(CertificateEnd::InDays);
        let expected: Vec<_> = days.chain([CertificateEnd::Passed]).collect();
        assert_eq!(announced, expected);
    }

    #[test]
    fn a_client_certificate_outside_its_validity_is_refused() {
        let verifier = NamedCertificates {
            algorithms: ring::default_provider().signature_verification_algorithms,
            tokens: None,
        };
        let key = rcgen::KeyPair::generate().unwrap();
        let verified = |from: i32, until: i32| {
            let mut params = rcgen::CertificateParams::new(["panel".to_owned()]).unwrap();
            params.not_before = rcgen::date_time_ymd(from, 1, 1);
            params.not_after = rcgen::date_time_ymd(until, 1, 1);
            let certificate = params.self_signed(&key).unwrap();
            // 2026-07-01
            let now = UnixTime::since_unix_epoch(Duration::from_hours(495_240));
            verifier.verify_client_cert(certificate.der(), &[], now).map(drop)
        };
        assert_eq!(verified(2026, 2027), Ok(()));
        assert_eq!(verified(2020, 2026), Err(CertificateError::Expired.into()));
        assert_eq!(verified(2027, 2030), Err(CertificateError::NotValidYet.into()));
    }

    #[test]
    fn a_key_that_others_may_read_is_refused_with_the_way_out() {
        let files = CertificateFiles::new();
        files.tls.check().unwrap();
        std::fs::set_permissions(&files.tls.key_file, std::fs::Permissions::from_mode(0o640)).unwrap();
        let text = files.tls.check().unwrap_err();
        assert!(text.contains("chmod 600") && text.contains("key.pem"), "{text}");
    }

    #[test]
    fn mismatched_key_and_file_without_certificate_are_refused_by_setting() {
        let (one, other) = (CertificateFiles::new(), CertificateFiles::new());
        let mixed = ServerTls {
            cert_file: one.tls.cert_file.clone(),
            key_file: other.tls.key_file.clone(),
        };
        assert!(mixed.check().unwrap_err().contains("key_file"));
        std::fs::write(&one.tls.cert_file, "nothing").unwrap();
        let text = one.tls.check().unwrap_err();
        assert!(
            text.contains("cert_file") && text.contains("no certificate"),
            "{text}"
        );
    }
}
