//! Signed programs: an Ed25519 signature over the bytes of a program's file. The format is that of
//! `openssl pkeyutl -sign -rawin`.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use plc_protocol::types::program::SignatureState;
use ring::signature::{ED25519, ED25519_PUBLIC_KEY_LEN, UnparsedPublicKey};

use crate::disk::{DiskPath, read_regular};

/// Length of a signature, in bytes.
const SIGNATURE_BYTES: usize = 64;

/// Maximum number of bytes read from a signature file.
const FILE_BYTES_MAX: u64 = 1024;

/// Maximum number of bytes read from a public key file.
const KEY_FILE_BYTES_MAX: u64 = 64 << 10;

/// First bytes of a public Ed25519 key in DER (RFC 8410).
const DER_PREFIX: [u8; 12] = [
    0x30, 0x2a, 0x30, 0x05, 0x06, 0x03, 0x2b, 0x65, 0x70, 0x03, 0x21, 0x00,
];

/// An Ed25519 signature.
pub type Signature = [u8; SIGNATURE_BYTES];

/// Public keys of the signers whose programs a machine runs; if there are no signers, the machine runs all
/// programs.
#[derive(Debug, Clone, Default)]
pub struct Signers(Arc<[[u8; ED25519_PUBLIC_KEY_LEN]]>);

impl Signers {
    /// Creates the signers from their public keys, each in Base64 or as the name of a PEM file.
    ///
    /// # Errors
    /// Returns the index of the first key that is in neither form, and the reason.
    pub fn read(keys: &[String], base_dir: &Path) -> Result<Self, (usize, String)> {
        let read = keys.iter().enumerate();
        let read = read.map(|(place, key)| read_key(key, base_dir).map_err(|why| (place, why)));
        Ok(Self(read.collect::<Result<_, _>>()?))
    }

    /// Returns true if there are no signers, so that signatures are not checked.
    pub fn is_none(&self) -> bool {
        self.0.is_empty()
    }

    /// Checks a signature of these bytes; returns `None` if there are no signers.
    pub fn verify_signature(&self, bytes: &[u8], signature: Option<&Signature>) -> Option<SignatureState> {
        if self.is_none() {
            return None;
        }
        let Some(signature) = signature else {
            return Some(SignatureState::Missing);
        };
        let is_by = |key: &[u8; ED25519_PUBLIC_KEY_LEN]| {
            UnparsedPublicKey::new(&ED25519, key)
                .verify(bytes, signature)
                .is_ok()
        };
        let valid = self.0.iter().any(is_by);
        Some(if valid {
            SignatureState::Valid
        } else {
            SignatureState::Wrong
        })
    }
}

fn read_key(key: &str, base_dir: &Path) -> Result<[u8; ED25519_PUBLIC_KEY_LEN], String> {
    if let Some(key) = of_base64(key) {
        return Ok(key);
    }
    let path = base_dir.join(key);
    let what = "write a public Ed25519 key in Base64, or the name of its PEM file";
    let text = read_regular(&path.into(), KEY_FILE_BYTES_MAX)
        .map_err(|error| format!("{key:?} is not a key, and cannot be read as a file: {error}; {what}"))?;
    let text = String::from_utf8_lossy(&text);
    if text.contains("PRIVATE KEY") {
        return Err(format!(
            "{key} is a private key, which must stay with the signer; write the public key: openssl pkey \
             -in {key} -pubout"
        ));
    }
    let lines = text.lines().map(str::trim);
    let body: String = lines.filter(|line| !line.starts_with("-----")).collect();
    of_base64(&body).ok_or_else(|| format!("{key} contains no public Ed25519 key; {what}"))
}

/// Decodes a public key from Base64; the decoded bytes are the key alone, or the key in DER.
fn of_base64(text: &str) -> Option<[u8; ED25519_PUBLIC_KEY_LEN]> {
    let bytes = STANDARD.decode(text.trim()).ok()?;
    let key = bytes.strip_prefix(&DER_PREFIX[..]).unwrap_or(&bytes);
    key.try_into().ok()
}

/// Decodes a signature as a client sends it.
pub fn decode_signature(text: &str) -> Option<Signature> {
    STANDARD.decode(text.trim()).ok()?.try_into().ok()
}

/// Reads the signature file next to a program's file, whose name is that of the program's file with the
/// suffix `.sig`.
///
/// # Errors
/// Returns an error if the signature file exists and cannot be read.
pub fn read_program_signature(program: &Path) -> io::Result<Option<Signature>> {
    let mut name = program.as_os_str().to_owned();
    name.push(".sig");
    read_signature(&PathBuf::from(name).into())
}

/// Reads a signature file: 64 bytes, or these bytes in Base64. Any other content is read as an invalid
/// signature. Returns `None` if the file does not exist.
///
/// # Errors
/// Returns an error if the file exists and cannot be read.
pub fn read_signature(path: &DiskPath) -> io::Result<Option<Signature>> {
    let bytes = match read_regular(path, FILE_BYTES_MAX) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        read => read?,
    };
    let raw = Signature::try_from(bytes.as_slice()).ok();
    let text = || str::from_utf8(&bytes).ok().and_then(decode_signature);
    Ok(Some(raw.or_else(text).unwrap_or([0; SIGNATURE_BYTES])))
}

#[cfg(test)]
mod tests {
    use ring::signature::{Ed25519KeyPair, KeyPair as _};

    use super::*;

    #[test]
    fn a_signature_is_valid_for_its_bytes_and_keys_alone() {
        let pair = Ed25519KeyPair::from_seed_unchecked(&[7; 32]).unwrap();
        let key = pair.public_key().as_ref();
        let der = [&DER_PREFIX[..], key].concat();
        let folder = tempfile::tempdir().unwrap();
        let pem = format!(
            "-----BEGIN PUBLIC KEY-----\n{}\n-----END PUBLIC KEY-----\n",
            STANDARD.encode(&der)
        );
        std::fs::write(folder.path().join("key.pem"), pem).unwrap();
        let signature: Signature = pair.sign(b"M30\n").as_ref().try_into().unwrap();
        for key in [STANDARD.encode(key), STANDARD.encode(&der), "key.pem".to_owned()] {
            let signers = Signers::read(&[key], folder.path()).unwrap();
            assert_eq!(
                signers.verify_signature(b"M30\n", Some(&signature)),
                Some(SignatureState::Valid)
            );
            assert_eq!(
                signers.verify_signature(b"M31\n", Some(&signature)),
                Some(SignatureState::Wrong)
            );
            assert_eq!(
                signers.verify_signature(b"M30\n", None),
                Some(SignatureState::Missing)
            );
        }
        let other = STANDARD.encode([1; 32]);
        let signers = Signers::read(&[other], folder.path()).unwrap();
        assert_eq!(
            signers.verify_signature(b"M30\n", Some(&signature)),
            Some(SignatureState::Wrong)
        );
        assert_eq!(Signers::default().verify_signature(b"M30\n", None), None);
        for bytes in [signature.to_vec(), STANDARD.encode(signature).into_bytes()] {
            std::fs::write(folder.path().join("7.nc.sig"), bytes).unwrap();
            let read = read_signature(&folder.path().join("7.nc.sig").into()).unwrap();
            assert_eq!(read, Some(signature));
        }
    }

    #[test]
    fn what_is_no_public_key_is_refused_with_what_to_write() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("private.pem"), "-----BEGIN PRIVATE KEY-----\n").unwrap();
        std::fs::write(folder.path().join("empty.pem"), "").unwrap();
        for (key, what) in [
            ("private.pem", "openssl pkey -in private.pem -pubout"),
            ("empty.pem", "no public Ed25519 key"),
            ("absent.pem", "or the name of its PEM file"),
            ("AAAA", "or the name of its PEM file"),
        ] {
            let (place, why) = Signers::read(&[key.to_owned()], folder.path()).unwrap_err();
            assert!(place == 0 && why.contains(what), "{why}");
        }
    }
}
