//! A question of a scan program to the operator.

use plc_protocol::types::question::check_question;
use plc_protocol::types::refusal::{Refusal, RefusalCode};

/// A question to the operator about an M code.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ScanQuestion {
    pub(super) text: String,
    pub(super) choices: Vec<String>,
}

impl ScanQuestion {
    /// Validates the text and the choices.
    ///
    /// # Errors
    /// Fails if text or choices are out of range.
    pub(super) fn check(&self) -> Result<(), Refusal> {
        if self.choices.is_empty() {
            return Err(Refusal::new(RefusalCode::Invalid, "a question needs a choice"));
        }
        check_question(&self.text, &self.choices)
    }
}
