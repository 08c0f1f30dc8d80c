//! Entries of the token file: their content, and how they are read.

use std::time::SystemTime;

use serde::Deserialize;
use sha2::{Digest, Sha256};

use super::Role;
use super::pin::{hash, is_hash};
use super::token::{Proof, Token, TokenError, random_secret};

/// Maximum number of entries in one file. Reason: each request is compared with every entry.
const ENTRIES_MAX: usize = 1000;

/// Largest number of characters allowed in a user's name, which is also a topic level and a file name.
const NAME_MAX: usize = 64;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    /// Users with a token, for machines.
    #[serde(default)]
    token: Vec<DigestEntry>,
    /// Users with a certificate.
    #[serde(default)]
    certificate: Vec<DigestEntry>,
    /// Users who type a PIN.
    #[serde(default)]
    person: Vec<PersonEntry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DigestEntry {
    name: String,
    role: Role,
    sha256: String,
    until: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PersonEntry {
    name: String,
    role: Role,
    argon2id: String,
    until: Option<String>,
}

impl DigestEntry {
    fn read(self, proof: fn([u8; 32]) -> Proof) -> Result<Token, String> {
        let mut digest = [0; 32];
        hex::decode_to_slice(&self.sha256, &mut digest)
            .map_err(|_| format!("{}: sha256 must be 64 hexadecimal digits", self.name))?;
        token(self.name, self.role, proof(digest), self.until)
    }
}

impl PersonEntry {
    fn read(self) -> Result<Token, String> {
        if !is_hash(&self.argon2id) {
            let text = "argon2id must be the value printed by tandem token NAME --role ROLE --pin";
            return Err(format!("{}: {text}", self.name));
        }
        token(self.name, self.role, Proof::Pin(self.argon2id), self.until)
    }
}

fn token(name: String, role: Role, proof: Proof, until: Option<String>) -> Result<Token, String> {
    if !is_name(&name) {
        return Err(TokenError::Name(name).to_string());
    }
    let until = until.map(|text| humantime::parse_rfc3339(&text)).transpose();
    let until = until.map_err(|_| format!("{name}: until must be a time such as 2027-01-31T00:00:00Z"))?;
    Ok(Token {
        name,
        role,
        proof,
        until,
    })
}

/// Reads the entries of the text of a token file.
pub(super) fn read(text: &str) -> Result<Vec<Token>, String> {
    // only the message: the file's lines must not appear in a log
    let file: File = toml::from_str(text).map_err(|error| error.message().to_owned())?;
    let tokens = file.token.into_iter().map(|entry| entry.read(Proof::Token));
    let certificates = file
        .certificate
        .into_iter()
        .map(|entry| entry.read(Proof::Certificate));
    let persons = file.person.into_iter().map(PersonEntry::read);
    let entries: Vec<_> = tokens
        .chain(certificates)
        .chain(persons)
        .collect::<Result<_, _>>()?;
    if entries.is_empty() {
        return Err("the file has no [[token]]; create one with tandem token NAME --role ROLE".to_owned());
    }
    if entries.len() > ENTRIES_MAX {
        return Err(format!("the file has more than {ENTRIES_MAX} entries"));
    }
    for (place, entry) in entries.iter().enumerate() {
        if entries[..place].iter().any(|other| contradict(other, entry)) {
            return Err(format!(
                "{}: the name or sha256 occurs twice; token, certificate and PIN of one name must have one \
                 role",
                entry.name
            ));
        }
    }
    Ok(entries)
}

/// Returns true for two entries that contradict each other.
fn contradict(one: &Token, other: &Token) -> bool {
    let same_kind = std::mem::discriminant(&one.proof) == std::mem::discriminant(&other.proof);
    one.proof == other.proof || one.name == other.name && (same_kind || one.role != other.role)
}

/// A new token.
pub struct NewToken {
    /// The token itself: shown only once, and stored nowhere.
    pub token: String,
    /// Its entry for a token file.
    pub entry: String,
}

impl std::fmt::Debug for NewToken {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("NewToken").finish_non_exhaustive()
    }
}

/// Creates a token of 256 random bits, valid until a time or without limit.
///
/// # Errors
/// Returns an error if the name cannot be used, or if the system provides no random bytes.
pub fn new_token(name: &str, role: Role, until: Option<SystemTime>) -> Result<NewToken, TokenError> {
    let token = random_secret()?;
    let proof = format!("sha256 = \"{}\"", hex::encode(Sha256::digest(token.as_bytes())));
    let entry = entry("token", name, role, &proof, until)?;
    Ok(NewToken { token, entry })
}

/// Returns the entry of the token file for a user who presents this certificate, in DER.
///
/// # Errors
/// Returns an error if the name cannot be used.
pub fn certificate_entry(
    name: &str,
    role: Role,
    certificate: &[u8],
    until: Option<SystemTime>,
) -> Result<String, TokenError> {
    let proof = format!("sha256 = \"{}\"", hex::encode(Sha256::digest(certificate)));
    entry("certificate", name, role, &proof, until)
}

/// Returns the entry of the token file for a user who types this PIN.
///
/// # Errors
/// Returns an error if the name cannot be used, if the PIN is too short or too long, or if the system provides no
/// random bytes.
pub fn pin_entry(name: &str, role: Role, pin: &str, until: Option<SystemTime>) -> Result<String, TokenError> {
    let proof = format!("argon2id = \"{}\"", hash(pin)?);
    entry("person", name, role, &proof, until)
}

fn entry(
    table: &str,
    name: &str,
    role: Role,
    proof: &str,
    until: Option<SystemTime>,
) -> Result<String, TokenError> {
    if !is_name(name) {
        return Err(TokenError::Name(name.to_owned()));
    }
    let role = role.name();
    let until = until.map(|until| format!("until = \"{}\"\n", humantime::format_rfc3339_seconds(until)));
    let until = until.unwrap_or_default();
    Ok(format!(
        "[[{table}]]\nname = \"{name}\"\nrole = \"{role}\"\n{proof}\n{until}"
    ))
}

fn is_name(name: &str) -> bool {
    (1..=NAME_MAX).contains(&name.len())
        && !name.starts_with(['.', '-'])
        && name
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || ['.', '_', '-'].contains(&c))
}
