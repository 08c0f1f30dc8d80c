//! The reason why a request is not carried out.

use serde::{Deserialize, Serialize};

use super::execution::Execution;
use super::program::ProgramDiagnostic;
use super::verb::Verb;

/// Why a request is not carried out; nothing has changed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{text}")]
pub struct Refusal {
    /// Machine-readable.
    pub code: RefusalCode,
    /// What, why, and what to do.
    pub text: String,
    /// With `not_allowed`: the state that refuses.
    pub state: Option<Execution>,
    /// With `not_allowed`: what is allowed now.
    pub allowed: Vec<Verb>,
    /// With `program_has_errors`: the findings.
    pub diagnostics: Vec<ProgramDiagnostic>,
}

impl Refusal {
    /// A refusal of this code.
    pub fn new(code: RefusalCode, text: impl Into<String>) -> Self {
        Self {
            code,
            text: text.into(),
            state: None,
            allowed: Vec::new(),
            diagnostics: Vec::new(),
        }
    }
}

/// Machine-readable reason of a refusal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum RefusalCode {
    /// There is no such coordinate system, program, command, alarm or value (404).
    NotFound,
    /// The state does not allow it (409).
    NotAllowed,
    /// The program runs (409).
    ProgramRuns,
    /// A start lock or the interlock is on (409).
    StartLocked,
    /// The user may not do this (403).
    Forbidden,
    /// Another holds the control lease (409).
    Busy,
    /// The control lease under which it was sent has ended (409).
    LeaseLost,
    /// Its `command_id` is that of another command of the last 10 minutes (422).
    CommandIdReused,
    /// The condition of the command does not hold (412).
    PreconditionFailed,
    /// The program has errors (422).
    ProgramHasErrors,
    /// The request is not well-formed, or a value is out of its range (400).
    Invalid,
    /// Larger than the limit (413).
    TooLarge,
    /// Known, and not built yet (501).
    NotSupported,
    /// A command over MQTT came with the retain flag (refused there only).
    Retained,
    /// The command is older than its `ttl_ms` (412).
    Expired,
    /// The runtime cannot do it now: it stops, or its store fails (503).
    Unavailable,
}

impl RefusalCode {
    /// True where the state, a lock or the control lease is the reason: such a refusal of a command says the state and
    /// what is allowed in it.
    pub fn is_of_state(self) -> bool {
        matches!(
            self,
            RefusalCode::NotAllowed | RefusalCode::StartLocked | RefusalCode::Busy | RefusalCode::LeaseLost
        )
    }
}
