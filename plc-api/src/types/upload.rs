//! An uploaded program, and the condition under which it replaces the stored program.

use super::refusal::{Refusal, RefusalCode};

/// A program to be stored, and the condition for storing it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ProgramUpload {
    /// Text of the program.
    pub text: String,
    /// Condition; the comparison and the change are one atomic step.
    pub condition: ProgramCondition,
    /// The Ed25519 signature of the text's bytes, 64 bytes in Base64.
    pub signature: Option<String>,
    /// NC dialect; `None` means the dialect of the lowest coordinate system.
    pub dialect: Option<String>,
}

/// Condition for changing a program, as in `If-Match` and `If-None-Match`.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ProgramCondition {
    /// The stored program must be among these.
    pub if_match: Option<Hashes>,
    /// The stored program must not be among these.
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
    /// Compares the condition with the hash of the stored program: `None` if no program has this number, an
    /// empty hash if the program is damaged.
    ///
    /// # Errors
    /// Fails if the condition does not hold.
    pub fn check_stored_hash(&self, number: u16, now: Option<&str>) -> Result<(), Refusal> {
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
            format!("program {number} {is}, which does not meet the condition; read it, and decide again");
        Err(Refusal::new(RefusalCode::PreconditionFailed, text))
    }

    /// Returns true if no condition is set.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}
