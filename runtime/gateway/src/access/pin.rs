//! PINs, and the hashes by which they are known.

use argon2::password_hash::{PasswordHash, PasswordHasher, PasswordVerifier, SaltString};
use argon2::{Algorithm, Argon2, Params, Version};

use super::token::TokenError;

/// Characters of a PIN.
const PIN_MIN: usize = 6;
const PIN_MAX: usize = 128;

fn argon2() -> Argon2<'static> {
    // 19 MiB, 2 passes: what OWASP asks for at least
    Argon2::new(Algorithm::Argon2id, Version::V0x13, Params::default())
}

/// True for the PIN of a hash.
pub(super) fn is_of(pin: &str, phc: &str) -> bool {
    PasswordHash::new(phc).is_ok_and(|hash| argon2().verify_password(pin.as_bytes(), &hash).is_ok())
}

/// The hash of a new PIN, for the token file.
pub(super) fn hash(pin: &str) -> Result<String, TokenError> {
    if !(PIN_MIN..=PIN_MAX).contains(&pin.chars().count()) {
        return Err(TokenError::Pin);
    }
    let wrong = |error: argon2::password_hash::Error| TokenError::Random(error.to_string());
    let mut bytes = [0_u8; 16];
    getrandom::fill(&mut bytes).map_err(|error| TokenError::Random(error.to_string()))?;
    let salt = SaltString::encode_b64(&bytes).map_err(wrong)?;
    let hash = argon2().hash_password(pin.as_bytes(), &salt).map_err(wrong)?;
    Ok(hash.to_string())
}

/// True for what [`hash`] gives.
pub(super) fn is_hash(phc: &str) -> bool {
    PasswordHash::new(phc)
        .is_ok_and(|hash| hash.algorithm == Algorithm::Argon2id.ident() && hash.hash.is_some())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pin_that_is_too_short_is_refused_and_no_two_hashes_of_one_are_the_same() {
        assert!(hash("12345").is_err());
        let (one, other) = (hash("493021").unwrap(), hash("493021").unwrap());
        assert!(one.starts_with("$argon2id$") && one != other && is_hash(&one));
        assert!(is_of("493021", &one) && !is_of("493022", &one));
        assert!(!is_hash("493021") && !is_hash("$argon2i$v=19$m=8,t=1,p=1$c29tZXNhbHQ$x"));
    }
}
