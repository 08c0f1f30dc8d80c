//! Rules for the ids that clients choose.

use super::refusal::{Refusal, RefusalCode};

/// Largest number of characters of the id of a client or a handler.
pub const CLIENT_ID_MAX: usize = 64;

/// Largest number of characters of a command id.
pub const COMMAND_ID_MAX: usize = 128;

/// Returns true for a valid id of a client or a handler: 1 to [`CLIENT_ID_MAX`] characters without `/ + #`
/// and without NUL, because the id is a level of MQTT topics.
pub fn is_client_id(id: &str) -> bool {
    has_length(id, CLIENT_ID_MAX) && !id.bytes().any(|byte| matches!(byte, b'/' | b'+' | b'#' | 0))
}

/// Validates the id of a client or a handler; `what` is the name of the id in the error text.
///
/// # Errors
/// Fails with `invalid` if the id is not valid. The error text gives the correct form.
pub fn check_client_id(what: &str, id: &str) -> Result<(), Refusal> {
    let text = || format!("{what}: write 1 to {CLIENT_ID_MAX} characters without / + #");
    is_client_id(id)
        .then_some(())
        .ok_or_else(|| Refusal::new(RefusalCode::Invalid, text()))
}

/// Validates the client id and the command id, which has 1 to [`COMMAND_ID_MAX`] characters.
///
/// # Errors
/// Fails with `invalid` if one of them is not valid. The error text gives the correct form.
pub fn check_command(client_id: &str, command_id: &str) -> Result<(), Refusal> {
    check_client_id("client_id", client_id)?;
    let text = || format!("command_id: write 1 to {COMMAND_ID_MAX} characters");
    has_length(command_id, COMMAND_ID_MAX)
        .then_some(())
        .ok_or_else(|| Refusal::new(RefusalCode::Invalid, text()))
}

fn has_length(id: &str, most: usize) -> bool {
    !id.is_empty() && (id.len() <= most || id.chars().nth(most).is_none())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_id_of_a_client_is_one_level_of_a_topic() {
        for id in ["hmi", "é", &"x".repeat(64)] {
            assert!(is_client_id(id), "{id:?}");
        }
        for id in ["", "a/b", "a+", "#", "a\0", &"x".repeat(65)] {
            assert!(!is_client_id(id), "{id:?}");
            assert!(
                check_client_id("handler_id", id)
                    .unwrap_err()
                    .text
                    .starts_with("handler_id:")
            );
        }
    }

    #[test]
    fn a_command_id_has_1_to_128_characters_of_any_kind() {
        for (id, is_right) in [
            ("", false),
            ("a/b #1", true),
            (&"é".repeat(128), true),
            (&"x".repeat(129), false),
        ] {
            assert_eq!(check_command("hmi", id).is_ok(), is_right, "{id:?}");
        }
        assert!(check_command("a/b", "1").is_err());
    }
}
