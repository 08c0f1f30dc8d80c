//! A user of the token file, and its credentials.

use std::path::PathBuf;
use std::time::SystemTime;

use super::Role;

/// Random bytes of a new token. They cannot be guessed, so a plain digest is as safe as a slow one.
const TOKEN_BYTES: usize = 32;

/// Reason why a token file or a PIN cannot be used.
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
    /// Other users than its owner may read or write it.
    #[error("token file {}: its mode is {mode:03o}, so other users may read or write the file; run chmod \
             600 {}", path.display(), path.display())]
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
        /// The error, and how to correct it.
        text: String,
    },
    /// The name of a new token cannot be used.
    #[error(
        "{0:?} is not a valid name for a token; write 1 to 64 of a to z, A to Z, 0 to 9, . _ -, not \
         beginning with . or -"
    )]
    Name(String),
    /// A PIN cannot be used.
    #[error("a PIN must have 6 to 128 characters")]
    Pin,
    /// A PIN is easy to guess.
    #[error("this PIN is easy to guess: {0}; choose another PIN")]
    WeakPin(&'static str),
    /// The system provides no random bytes.
    #[error("the operating system provides no random bytes: {0}")]
    Random(String),
}

/// Credentials of a user.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Proof {
    /// A token with this SHA-256.
    Token([u8; 32]),
    /// A certificate with this SHA-256 of its DER, in the handshake of TLS.
    Certificate([u8; 32]),
    /// A PIN with this argon2id hash, for which a login gives a token.
    Pin(String),
}

/// An entry of the token file.
#[derive(PartialEq, Eq)]
pub(crate) struct Token {
    pub(crate) name: String,
    pub(crate) role: Role,
    pub(super) proof: Proof,
    /// End of its validity.
    pub(super) until: Option<SystemTime>,
}

impl Token {
    /// Returns the hash of its PIN.
    pub(super) fn pin(&self) -> Option<&str> {
        match &self.proof {
            Proof::Pin(hash) => Some(hash),
            Proof::Token(_) | Proof::Certificate(_) => None,
        }
    }

    /// Creates a user that is named by a topic. No client can present its token, because no text has this digest.
    pub(super) fn of_topic(name: String, role: Role) -> Self {
        Self {
            name,
            role,
            proof: Proof::Token([0; 32]),
            until: None,
        }
    }
}

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.name)
    }
}

/// Returns 256 random bits as hexadecimal digits.
pub(crate) fn random_secret() -> Result<String, TokenError> {
    let mut bytes = [0_u8; TOKEN_BYTES];
    getrandom::fill(&mut bytes).map_err(|error| TokenError::Random(error.to_string()))?;
    Ok(hex::encode(bytes))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::access::User;

    impl Token {
        /// Creates a user whose token cannot be presented.
        pub(crate) fn user_for_test(name: &str, role: Role) -> User {
            User::Token(Arc::new(Self::of_topic(name.to_owned(), role)))
        }
    }
}
