//! A program as it is uploaded, and the condition under which it replaces the stored one.

use super::refusal::{Refusal, RefusalCode};

/// What is to be stored as a program, and under which condition.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ProgramUpload {
    /// The text.
    pub text: String,
    /// What must hold; comparison and change are one step.
    pub condition: ProgramCondition,
    /// The Ed25519 signature of the text's bytes, 64 bytes in Base64.
    pub signature: Option<String>,
    /// NC dialect; `None`: that of the lowest coordinate system.
    pub dialect: Option<String>,
}

/// What must hold for a program to be changed, as `If-Match` and `If-None-Match` say it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ProgramCondition {
    /// The program is one of these.
    pub if_match: Option<Hashes>,
    /// The program is none of these.
    pub if_none_match: Option<Hashes>,
}

/// Programs by their hashes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Hashes {
    /// Any that is there.
    Any,
    /// These.
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
    /// Compares with what is stored under a number: `None` is nothing, and an empty hash something unknown.
    ///
    /// # Errors
    /// The condition does not hold.
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

    /// True where nothing must hold.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}
