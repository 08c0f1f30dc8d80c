//! Tokens. Their file holds digests, never the tokens themselves.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Deserialize;
use sha2::{Digest, Sha256};
use subtle::{ConditionallySelectable, ConstantTimeEq};

use super::{Role, User};

/// Bytes of a token file. Reason: [`TOKENS_MAX`] entries with long names fit.
const FILE_MAX: u64 = 512 * 1024;

/// Tokens of one file. Reason: each request is compared with every one.
const TOKENS_MAX: usize = 1000;

/// Characters of a user's name, which is also a topic level and a file name.
const NAME_MAX: usize = 64;

/// Bytes of a presented token; a longer one is not hashed. Reason: ours have 64.
const PRESENTED_MAX: usize = 512;

/// Random bytes of a new token. Nobody can guess them, so a plain digest is as safe as a slow one.
const TOKEN_BYTES: usize = 32;

/// Why a token file cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TokenError {
    /// It cannot be read.
    #[error("token file {}: {source}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// Others than its owner may read or write it.
    #[error("token file {}: its mode is {mode:03o}, so that others may read or write it; run chmod 600 {}", path.display(), path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// Its permission bits.
        mode: u32,
    },
    /// It is malformed.
    #[error("token file {}: {text}", path.display())]
    Wrong {
        /// The file.
        path: PathBuf,
        /// What is wrong, and how to correct it.
        text: String,
    },
    /// The name of a new token cannot be used.
    #[error(
        "{0:?} is not a name for a token; write 1 to 64 of a to z, A to Z, 0 to 9, . _ -, not beginning with . or -"
    )]
    Name(String),
    /// The system provides no random bytes.
    #[error("the system gives no random bytes: {0}")]
    Random(String),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    token: Vec<FileEntry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FileEntry {
    name: String,
    role: Role,
    sha256: String,
}

/// An entry of the token file.
#[derive(PartialEq, Eq)]
pub(crate) struct Token {
    pub(crate) name: String,
    pub(crate) role: Role,
    digest: [u8; 32],
}

impl Token {
    /// A user with a token that nobody can present.
    #[cfg(test)]
    pub(crate) fn user_for_test(name: &str, role: Role) -> User {
        User::Token(Arc::new(Token {
            name: name.to_owned(),
            role,
            digest: [0; 32],
        }))
    }
}

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.name)
    }
}

/// The tokens of a machine.
#[derive(Clone, PartialEq, Eq)]
pub struct Tokens {
    tokens: Vec<Arc<Token>>,
    file: Option<(PathBuf, Stamp)>,
}

/// Identifies the content of a file without reading it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Stamp {
    inode: u64,
    bytes: u64,
    modified: (i64, i64),
}

impl Stamp {
    pub(super) fn of(file: &std::fs::Metadata) -> Self {
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
    /// It cannot be read, others than its owner may read or write it, or it is malformed.
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
            return Err(wrong(format!("it is larger than {FILE_MAX} bytes")));
        }
        let tokens = Self::parse(&text).map_err(wrong)?;
        Ok(Self {
            file: Some((path.to_owned(), Stamp::of(&metadata))),
            ..tokens
        })
    }

    /// The file they were read from, and its state then.
    pub(super) fn file(&self) -> Option<(PathBuf, Stamp)> {
        self.file.clone()
    }

    pub(super) fn same_users(&self, other: &Tokens) -> bool {
        self.tokens == other.tokens
    }

    fn parse(text: &str) -> Result<Tokens, String> {
        // only the message: the file's lines must not appear in a log
        let file: File = toml::from_str(text).map_err(|error| error.message().to_owned())?;
        if file.token.is_empty() {
            return Err("it has no [[token]]; make one with tandem token NAME --role ROLE".to_owned());
        }
        if file.token.len() > TOKENS_MAX {
            return Err(format!("it has more than {TOKENS_MAX} tokens"));
        }
        let mut tokens: Vec<Arc<Token>> = Vec::with_capacity(file.token.len());
        for FileEntry { name, role, sha256 } in file.token {
            if !is_name(&name) {
                return Err(TokenError::Name(name).to_string());
            }
            let mut digest = [0; 32];
            hex::decode_to_slice(sha256, &mut digest)
                .map_err(|_| format!("token {name}: sha256 is 64 hexadecimal digits"))?;
            let is_same = |token: &Arc<Token>| token.name == name || token.digest == digest;
            if tokens.iter().any(is_same) {
                return Err(format!("token {name}: its name or sha256 is there twice"));
            }
            tokens.push(Arc::new(Token { name, role, digest }));
        }
        Ok(Tokens { tokens, file: None })
    }

    /// Names and roles, in the order of the file.
    pub fn users(&self) -> impl Iterator<Item = (&str, Role)> {
        self.tokens.iter().map(|token| (token.name.as_str(), token.role))
    }

    /// The user with this name.
    pub(crate) fn user_named(&self, name: &str) -> Option<User> {
        let token = self.tokens.iter().find(|token| token.name == name);
        token.cloned().map(User::Token)
    }

    /// Whether the token of a user is still valid, with the same role.
    pub(crate) fn has(&self, user: &User) -> bool {
        match user {
            User::Token(token) => self.tokens.contains(token),
            User::Anyone | User::Stranger => true,
        }
    }

    /// The owner of a presented token. It is compared with every token, each in constant time.
    pub(crate) fn user_of(&self, presented: &[u8]) -> Option<User> {
        if presented.len() > PRESENTED_MAX {
            return None;
        }
        let digest: [u8; 32] = Sha256::digest(presented).into();
        let mut place = u64::MAX;
        for (at, token) in (0..).zip(&self.tokens) {
            place.conditional_assign(&at, token.digest.ct_eq(&digest));
        }
        let token = self.tokens.get(usize::try_from(place).ok()?)?;
        Some(User::Token(Arc::clone(token)))
    }
}

/// A new token.
pub struct NewToken {
    /// The token itself: shown once, stored nowhere.
    pub token: String,
    /// Its entry for a token file.
    pub entry: String,
}

impl std::fmt::Debug for NewToken {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("NewToken").finish_non_exhaustive()
    }
}

/// Makes a token of 256 random bits.
///
/// # Errors
/// The name cannot be used, or the system provides no random bytes.
pub fn new_token(name: &str, role: Role) -> Result<NewToken, TokenError> {
    if !is_name(name) {
        return Err(TokenError::Name(name.to_owned()));
    }
    let token = random_secret()?;
    let digest = hex::encode(Sha256::digest(token.as_bytes()));
    let entry = format!(
        "[[token]]\nname = \"{name}\"\nrole = \"{}\"\nsha256 = \"{digest}\"\n",
        role.word()
    );
    Ok(NewToken { token, entry })
}

/// 256 random bits as hexadecimal digits.
pub(crate) fn random_secret() -> Result<String, TokenError> {
    let mut bytes = [0_u8; TOKEN_BYTES];
    getrandom::fill(&mut bytes).map_err(|error| TokenError::Random(error.to_string()))?;
    Ok(hex::encode(bytes))
}

fn is_name(name: &str) -> bool {
    (1..=NAME_MAX).contains(&name.len())
        && !name.starts_with(['.', '-'])
        && name
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || ['.', '_', '-'].contains(&c))
}

#[cfg(test)]
mod tests {
    use super::*;

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
        assert_eq!(tokens.user_of(ABC.as_bytes()), None, "the digest is no token");
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
    fn a_new_token_is_the_one_of_its_entry_and_no_two_are_the_same() {
        let new = new_token("hmi-1", Role::Operate).unwrap();
        let tokens = Tokens::parse(&new.entry).unwrap();
        assert_eq!(
            tokens.user_of(new.token.as_bytes()).unwrap().role(),
            Role::Operate
        );
        assert_ne!(new.token, new_token("hmi-1", Role::Operate).unwrap().token);
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
            (entry("../x", "view", ABC), "not a name"),
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
