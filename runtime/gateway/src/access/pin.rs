//! PINs and their hashes.

use argon2::password_hash::{PasswordHash, PasswordHasher, PasswordVerifier, SaltString};
use argon2::{Algorithm, Argon2, Params, Version};

use super::token::TokenError;

/// Characters of a PIN.
const PIN_MIN: usize = 6;
const PIN_MAX: usize = 128;

/// Different characters of a PIN, at least.
const DIFFERENT_MIN: usize = 3;

/// Returns why a PIN is easy to guess: few different characters (`111111`), a sequence (`123456`, `987654`, `890123`),
/// or a short part that repeats (`147147`).
pub(super) fn weakness(pin: &str) -> Option<&'static str> {
    let characters: Vec<_> = pin.chars().map(u32::from).collect();
    let mut different = characters.clone();
    different.sort_unstable();
    different.dedup();
    if different.len() < DIFFERENT_MIN {
        return Some("the PIN has fewer than 3 different characters");
    }
    let is_digits = pin.bytes().all(|byte| byte.is_ascii_digit());
    let next = |character: u32| match character {
        // digits begin again after 9
        0x39 if is_digits => 0x30,
        other => other + 1,
    };
    let is_up = characters.windows(2).all(|pair| pair[1] == next(pair[0]));
    let is_down = characters.windows(2).all(|pair| pair[0] == next(pair[1]));
    if is_up || is_down {
        return Some("the PIN is a sequence");
    }
    let repeats = |part: usize| {
        characters.len() >= 2 * part && characters.chunks(part).all(|chunk| characters.starts_with(chunk))
    };
    (1..=characters.len() / 2)
        .any(repeats)
        .then_some("a part of the PIN repeats")
}

fn argon2() -> Argon2<'static> {
    // 19 MiB, 2 passes: the minimum that OWASP recommends
    Argon2::new(Algorithm::Argon2id, Version::V0x13, Params::default())
}

/// Returns true if a PIN has this hash.
pub(super) fn is_of(pin: &str, phc: &str) -> bool {
    PasswordHash::new(phc).is_ok_and(|hash| argon2().verify_password(pin.as_bytes(), &hash).is_ok())
}

/// Returns the hash of a new PIN, for the token file.
pub(super) fn hash(pin: &str) -> Result<String, TokenError> {
    if !(PIN_MIN..=PIN_MAX).contains(&pin.chars().count()) {
        return Err(TokenError::Pin);
    }
    if let Some(weakness) = weakness(pin) {
        return Err(TokenError::WeakPin(weakness));
    }
    let wrong = |error: argon2::password_hash::Error| TokenError::Random(error.to_string());
    let mut bytes = [0_u8; 16];
    getrandom::fill(&mut bytes).map_err(|error| TokenError::Random(error.to_string()))?;
    let salt = SaltString::encode_b64(&bytes).map_err(wrong)?;
    let hash = argon2().hash_password(pin.as_bytes(), &salt).map_err(wrong)?;
    Ok(hash.to_string())
}

/// Returns true for a result of [`hash`].
pub(super) fn is_hash(phc: &str) -> bool {
    PasswordHash::new(phc)
        .is_ok_and(|hash| hash.algorithm == Algorithm::Argon2id.ident() && hash.hash.is_some())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pin_that_is_easy_to_guess_is_refused_and_an_ordinary_one_taken() {
        for pin in [
            "111111",
            "121212",
            "112112",
            "123456",
            "012345",
            "654321",
            "890123",
            "987654",
            "210987",
            "abcdef",
            "147147",
            "aaaaaaaaaa",
        ] {
            assert!(matches!(hash(pin), Err(TokenError::WeakPin(_))), "{pin}");
        }
        for pin in ["493021", "100200", "124578", "a1b2c3", "correct horse"] {
            assert_eq!(weakness(pin), None, "{pin}");
        }
    }

    #[test]
    fn short_pin_is_refused_and_hashes_of_one_pin_differ() {
        assert!(hash("12345").is_err());
        let (one, other) = (hash("493021").unwrap(), hash("493021").unwrap());
        assert!(one.starts_with("$argon2id$") && one != other && is_hash(&one));
        assert!(is_of("493021", &one) && !is_of("493022", &one));
        assert!(!is_hash("493021") && !is_hash("$argon2i$v=19$m=8,t=1,p=1$c29tZXNhbHQ$x"));
    }
}
