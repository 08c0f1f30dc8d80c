//! An uploaded program, and the condition under which it replaces the stored program.

use super::refusal::{Refusal, RefusalCode};

/// A program to be stored, and the condition for storing it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ProgramUpload {
    /// Text of the program.
    pub text: String,
    /// Condition for storing the program; its check and the change are one atomic step.
    pub condition: ProgramCondition,
    /// The Ed25519 signature of the text's bytes, 64 bytes in Base64.
    pub signature: Option<String>,
    /// NC dialect; `None` means the dialect of the lowest coordinate system.
    pub dialect: Option<String>,
}

/// Condition for changing a program; the fields are the headers `If-Match` and `If-None-Match`.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ProgramCondition {
    /// Hashes of which the stored program must have one.
    pub if_match: Option<Hashes>,
    /// Hashes of which the stored program must have none.
    pub if_none_match: Option<Hashes>,
}

/// A set of programs, given by their hashes.
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
    /// Checks the condition against `now`, the hash of the stored program. `now` is `None` if no program has
    /// this number, and empty if the program is damaged.
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
