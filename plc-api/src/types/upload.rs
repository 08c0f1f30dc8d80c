//! An uploaded program, and the condition under which it replaces the stored one.

use super::refusal::{Refusal, RefusalCode};

/// A program to be stored, and the condition for storing it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ProgramUpload {
    /// Text of the program.
    pub text: String,
    /// Condition; comparison and change are one step.
    pub condition: ProgramCondition,
    /// The Ed25519 signature of the text's bytes, 64 bytes in Base64.
    pub signature: Option<String>,
    /// NC dialect; `None` stands for that of the lowest coordinate system.
    pub dialect: Option<String>,
}

/// Condition for changing a program, as in `If-Match` and `If-None-Match`.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ProgramCondition {
    /// The stored program must be one of these.
    pub if_match: Option<Hashes>,
    /// The stored program must be none of these.
    pub if_none_match: Option<Hashes>,
}

/// Programs by their hashes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Hashes {
    /// Any stored program.
    Any,
    /// Programs with these hashes.
    OneOf(Vec<String>),
}

impl Hashes {
    fn have(&self, hash: Option<&str>) -> bool {
        match (self, hash) {
            (_, None) => false,
            (Hashes::Any, Some(_)) => true,
            (Hashes::OneOf(hashes), Some(hash)) => hashes.iter().any(|of| of.eq_ignore_ascii_case(hash)),
        }
    }
}

impl ProgramCondition {
    /// Compares the condition with the stored program of a number: `None` if there is no program, an empty hash if it
    /// is damaged.
    ///
    /// # Errors
    /// Fails if the condition does not hold.
    pub fn judge(&self, number: u16, now: Option<&str>) -> Result<(), Refusal> {
        let matches = self.if_match.as_ref().is_none_or(|hashes| hashes.have(now));
        let differs = self.if_none_match.as_ref().is_none_or(|hashes| !hashes.have(now));
        if matches && differs {
            return Ok(());
        }
        let is = match now {
            None => "is not in the store".to_owned(),
            Some("") => "is damaged".to_owned(),
            Some(hash) => format!("has the hash {hash}"),
        };
        let text =
            format!("program {number} {is}, which is not what was asked for; read it, and decide again");
        Err(Refusal::new(RefusalCode::PreconditionFailed, text))
    }

    /// Returns true if there is no condition.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}
