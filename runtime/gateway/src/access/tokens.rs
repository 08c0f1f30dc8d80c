//! Tokens. Their file holds digests, never the tokens themselves.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use sha2::{Digest, Sha256};
use subtle::{ConditionallySelectable, ConstantTimeEq};
use tracing::warn;

use super::entries::read;
use super::token::{Proof, Token, TokenError};
use super::{Role, User};
use crate::certificate::days_to_end;

/// Largest number of bytes of a token file. Reason: 1000 entries with long names fit.
const FILE_MAX: u64 = 512 * 1024;

/// Largest number of bytes of a presented token; a longer one is not hashed. Reason: generated tokens have 64.
const PRESENTED_MAX: usize = 512;

/// The tokens and certificates of a machine's users.
#[derive(Clone, PartialEq, Eq)]
pub struct Tokens {
    tokens: Vec<Arc<Token>>,
    file: Option<(PathBuf, Stamp)>,
}

/// Identifies the content of a file without reading it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Stamp {
    inode: u64,
    bytes: u64,
    modified: (i64, i64),
}

impl Stamp {
    pub(crate) fn from_metadata(file: &std::fs::Metadata) -> Self {
        use std::os::unix::fs::MetadataExt as _;
        Self {
            inode: file.ino(),
            bytes: file.len(),
            // not mtime: a corrected mode is a change, too
            modified: (file.ctime(), file.ctime_nsec()),
        }
    }
}

impl std::fmt::Debug for Tokens {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list()
            .entries(self.users().map(|(name, _)| name))
            .finish()
    }
}

impl Tokens {
    /// Reads a token file, which only its owner may be able to read and write.
    ///
    /// # Errors
    /// Fails if the file cannot be read, if other users may read or write it, or if it is malformed.
    pub fn read(path: &Path) -> Result<Tokens, TokenError> {
        use std::io::Read as _;
        use std::os::unix::fs::PermissionsExt as _;
        let unreadable = |source| TokenError::Unreadable {
            path: path.to_owned(),
            source,
        };
        let file = std::fs::File::open(path).map_err(unreadable)?;
        let metadata = file.metadata().map_err(unreadable)?;
        let mode = metadata.permissions().mode() & 0o777;
        if mode & 0o077 != 0 {
            return Err(TokenError::Open {
                path: path.to_owned(),
                mode,
            });
        }
        let mut text = String::new();
        file.take(FILE_MAX + 1)
            .read_to_string(&mut text)
            .map_err(unreadable)?;
        let wrong = |text: String| TokenError::Wrong {
            path: path.to_owned(),
            text,
        };
        if text.len() as u64 > FILE_MAX {
            return Err(wrong(format!("the file is larger than {FILE_MAX} bytes")));
        }
        let tokens = Self::parse(&text).map_err(wrong)?;
        tokens.announce_ends(SystemTime::now());
        Ok(Self {
            file: Some((path.to_owned(), Stamp::from_metadata(&metadata))),
            ..tokens
        })
    }

    /// Reads the text of a token file.
    ///
    /// # Errors
    /// Returns why it cannot be used, without anything secret.
    pub fn parse(text: &str) -> Result<Tokens, String> {
        let tokens = read(text)?.into_iter().map(Arc::new).collect();
        Ok(Tokens { tokens, file: None })
    }

    /// Warns of tokens that expire soon.
    fn announce_ends(&self, now: SystemTime) {
        for token in &self.tokens {
            if let Some(days) = token.until.and_then(|until| days_to_end(until, now)) {
                warn!(
                    "the entry of {} in the token file expires in {days} days; create a new one",
                    token.name
                );
            }
        }
    }

    /// Returns the file from which the tokens were read, and its state at that time.
    pub(super) fn file(&self) -> Option<(PathBuf, Stamp)> {
        self.file.clone()
    }

    pub(super) fn same_users(&self, other: &Tokens) -> bool {
        self.tokens == other.tokens
    }

    /// Returns the tokens without the expired ones, or `None` if none is expired.
    pub(super) fn without_expired(&self, now: SystemTime) -> Option<Tokens> {
        let counts = |token: &&Arc<Token>| token.until.is_none_or(|until| now < until);
        let tokens: Vec<_> = self.tokens.iter().filter(counts).cloned().collect();
        (tokens.len() < self.tokens.len()).then(|| Tokens {
            tokens,
            file: self.file.clone(),
        })
    }

    /// Returns when the next of them expires.
    pub(super) fn next_end(&self) -> Option<SystemTime> {
        self.tokens.iter().filter_map(|token| token.until).min()
    }

    /// Returns true if the file names certificates.
    pub(crate) fn names_certificates(&self) -> bool {
        self.tokens
            .iter()
            .any(|token| matches!(token.proof, Proof::Certificate(_)))
    }

    /// Returns the owner of a certificate with this SHA-256.
    pub(crate) fn user_of_certificate(&self, fingerprint: &[u8; 32]) -> Option<User> {
        let proof = Proof::Certificate(*fingerprint);
        let token = self.tokens.iter().find(|token| token.proof == proof);
        token.cloned().map(User::Token)
    }

    /// Returns the user with this name who types a PIN.
    pub(super) fn with_pin(&self, name: &str) -> Option<Arc<Token>> {
        let mut persons = self.tokens.iter().filter(|token| token.pin().is_some());
        persons.find(|token| token.name == name).cloned()
    }

    /// Names and roles, in the order of the file.
    pub fn users(&self) -> impl Iterator<Item = (&str, Role)> {
        self.tokens.iter().map(|token| (token.name.as_str(), token.role))
    }

    /// Returns the user with this name.
    pub(crate) fn user_named(&self, name: &str) -> Option<User> {
        let token = self.tokens.iter().find(|token| token.name == name);
        token.cloned().map(User::Token)
    }

    /// Returns true if the token of a user is still valid, with the same role.
    pub(crate) fn has(&self, user: &User) -> bool {
        match user {
            User::Token(token) => self.tokens.contains(token),
            User::Anyone | User::Unauthenticated | User::Unidentified => true,
        }
    }

    /// Returns the owner of a presented token. It is compared with every token, each in constant time.
    pub(crate) fn user_of(&self, presented: &[u8]) -> Option<User> {
        if presented.len() > PRESENTED_MAX {
            return None;
        }
        let digest: [u8; 32] = Sha256::digest(presented).into();
        let mut place = u64::MAX;
        for (at, token) in (0..).zip(&self.tokens) {
            if let Proof::Token(known) = &token.proof {
                place.conditional_assign(&at, known.ct_eq(&digest));
            }
        }
        let token = self.tokens.get(usize::try_from(place).ok()?)?;
        Some(User::Token(Arc::clone(token)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::access::entries::{certificate_entry, new_token};

    // SHA-256 of "abc", from FIPS 180-4
    const ABC: &str = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";

    fn entry(name: &str, role: &str, sha256: &str) -> String {
        format!("[[token]]\nname = \"{name}\"\nrole = \"{role}\"\nsha256 = \"{sha256}\"\n")
    }

    #[test]
    fn a_token_is_found_by_the_digest_in_the_file() {
        let other = "0".repeat(64);
        let text = entry("hmi-1", "operate", &other) + &entry("cell", "view", &ABC.to_uppercase());
        let tokens = Tokens::parse(&text).unwrap();
        let user = tokens.user_of(b"abc").unwrap();
        assert_eq!((user.name(), user.role()), (Some("cell"), Role::View));
        assert_eq!(tokens.user_of(b"abd"), None);
        assert_eq!(tokens.user_of(b""), None);
        assert_eq!(tokens.user_of(ABC.as_bytes()), None, "the digest is not a token");
        assert_eq!(tokens.user_named("hmi-1").unwrap().role(), Role::Operate);
    }

    #[test]
    fn a_user_is_known_as_long_as_name_role_and_token_are_the_same() {
        let other = "0".repeat(64);
        let cell = Tokens::parse(&entry("cell", "view", ABC)).unwrap();
        let user = cell.user_of(b"abc").unwrap();
        assert!(cell.has(&user) && cell.has(&User::Anyone));
        for text in [
            entry("cell", "admin", ABC),
            entry("cell", "view", &other),
            entry("board", "view", ABC),
        ] {
            assert!(!Tokens::parse(&text).unwrap().has(&user), "{text}");
        }
        assert!(!format!("{user:?}").contains("ba78"));
    }

    #[test]
    fn a_token_counts_until_its_end_and_a_file_may_say_one_for_each() {
        let until = humantime::parse_rfc3339("2027-01-31T12:00:00Z").unwrap();
        let new = new_token("cell", Role::View, Some(until)).unwrap();
        assert!(
            new.entry.contains("until = \"2027-01-31T12:00:00Z\""),
            "{}",
            new.entry
        );
        let forever = entry("hmi-1", "operate", &"0".repeat(64));
        let tokens = Tokens::parse(&(new.entry + &forever)).unwrap();
        assert!(
            tokens
                .without_expired(until - std::time::Duration::from_secs(1))
                .is_none()
        );
        let left = tokens.without_expired(until).unwrap();
        assert_eq!(left.users().collect::<Vec<_>>(), [("hmi-1", Role::Operate)]);
        assert_eq!(left.user_of(new.token.as_bytes()), None);
        let error = Tokens::parse(&(entry("a", "view", ABC) + "until = \"tomorrow\"\n")).unwrap_err();
        assert!(error.contains("2027-01-31T00:00:00Z"), "{error}");
    }

    #[test]
    fn a_certificate_is_shown_in_the_handshake_and_never_as_a_token() {
        let named = certificate_entry("panel", Role::Operate, b"abc", None).unwrap();
        let tokens = Tokens::parse(&named).unwrap();
        assert!(tokens.names_certificates());
        assert_eq!(tokens.user_of(b"abc"), None, "its bytes are not secret");
        let digest: [u8; 32] = Sha256::digest(b"abc").into();
        let user = tokens.user_of_certificate(&digest).unwrap();
        assert_eq!((user.name(), user.role()), (Some("panel"), Role::Operate));
        let token = entry("cell", "view", ABC);
        assert_eq!(Tokens::parse(&token).unwrap().user_of_certificate(&digest), None);
        let both = named.clone() + &entry("panel", "operate", &"0".repeat(64));
        assert_eq!(Tokens::parse(&both).unwrap().users().count(), 2);
        for wrong in [
            named.clone() + &named,
            named + &entry("panel", "view", &"0".repeat(64)),
        ] {
            assert!(Tokens::parse(&wrong).unwrap_err().contains("twice"));
        }
    }

    #[test]
    fn a_new_token_is_the_one_of_its_entry_and_no_two_are_the_same() {
        let new = new_token("hmi-1", Role::Operate, None).unwrap();
        let tokens = Tokens::parse(&new.entry).unwrap();
        assert_eq!(
            tokens.user_of(new.token.as_bytes()).unwrap().role(),
            Role::Operate
        );
        assert_ne!(new.token, new_token("hmi-1", Role::Operate, None).unwrap().token);
        assert_eq!(new.token.len(), 64);
        assert!(!new.entry.contains(&new.token) && !format!("{new:?}").contains(&new.token));
    }

    #[test]
    fn a_file_that_is_not_right_says_what_to_write() {
        for (text, part) in [
            (String::new(), "tandem token"),
            (entry("a", "boss", ABC), "boss"),
            (entry("a", "view", "12"), "64 hexadecimal"),
            (entry("a b", "view", ABC), "a b"),
            (entry("../x", "view", ABC), "not a valid name"),
            (entry("a", "view", ABC) + &entry("b", "view", ABC), "twice"),
            (entry("a", "view", ABC) + "secret = \"abc\"\n", "secret"),
        ] {
            let error = Tokens::parse(&text).unwrap_err();
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn a_file_that_others_may_read_is_refused_with_the_way_out() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tokens.toml");
        std::fs::write(&path, entry("a", "view", ABC)).unwrap();
        for (mode, allowed) in [
            (0o600, true),
            (0o400, true),
            (0o640, false),
            (0o604, false),
            (0o620, false),
        ] {
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
            match Tokens::read(&path) {
                Ok(_) => assert!(allowed, "{mode:o}"),
                Err(error) => {
                    assert!(!allowed && error.to_string().contains("chmod 600"), "{error}");
                }
            }
        }
    }

    #[test]
    fn neither_digest_nor_file_text_is_shown() {
        let tokens = Tokens::parse(&entry("hmi-1", "view", ABC)).unwrap();
        assert_eq!(format!("{tokens:?}"), "[\"hmi-1\"]");
        let error = Tokens::parse("[[token]]\nname = \"a\"\nsha256 = \"secret\"\nrole = 3\n").unwrap_err();
        assert!(!error.contains("secret"), "{error}");
    }
}
