//! The reason why a request is refused.

use serde::{Deserialize, Serialize};

use super::execution::Execution;
use super::explained::explained;
use super::program::ProgramDiagnostic;
use super::verb::Verb;

/// The refusal of a request; nothing has changed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{text}")]
pub struct Refusal {
    /// Machine-readable reason.
    pub code: RefusalCode,
    /// Description, reason and remedy.
    pub text: String,
    /// With `not_allowed`: the current state.
    pub state: Option<Execution>,
    /// With `not_allowed`: the verbs that are allowed now.
    pub allowed: Vec<Verb>,
    /// With `program_has_errors`: the findings of the check.
    pub diagnostics: Vec<ProgramDiagnostic>,
    /// With `program_runs`: the id of the run.
    pub run_id: Option<String>,
}

impl Refusal {
    /// Creates a refusal with this code.
    pub fn new(code: RefusalCode, text: impl Into<String>) -> Self {
        Self {
            code,
            text: text.into(),
            state: None,
            allowed: Vec::new(),
            diagnostics: Vec::new(),
            run_id: None,
        }
    }
}

explained! {
    "refusal of a request"
    /// Machine-readable reason of a refusal.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    #[non_exhaustive]
    pub enum RefusalCode {
        /// The coordinate system, program, command, alarm or value does not exist (404).
        NotFound = "not_found",
            "Look at the number or name; the text says what there is.";
        /// The state does not allow it (409).
        NotAllowed = "not_allowed",
            "The answer says the state and what is allowed in it: bring the machine there first.";
        /// The program runs (409).
        ProgramRuns = "program_runs",
            "Wait for the end of the run, or stop it.";
        /// A start lock or the interlock is on (409).
        StartLocked = "start_locked",
            "Whoever has set the start lock or the interlock ends it; its text says why it is on.";
        /// The user may not do this (403).
        Forbidden = "forbidden",
            "Use a token whose role has the right, or ask the administrator for one.";
        /// Another client holds the control lease (409).
        Busy = "busy",
            "Wait until the holder of the control lease gives it back or it expires; an administrator can break it.";
        /// The control lease under which it was sent has ended (409).
        LeaseLost = "lease_lost",
            "Take the control lease anew, look at the machine, and send the command with the new fence.";
        /// Another instance of the handler's id is online (409).
        HandlerTaken = "handler_taken",
            "End the other program, or give this one a handler_id of its own; with take_over it takes the other's place, which is told so.";
        /// No answer was received within the time limit: it is unknown whether the request was executed. Only clients
        /// report this.
        NoAnswer = "no_answer",
            "Look at the state, or send it again: a command with the same command_id is never done twice.";
        /// Its `command_id` is that of another command of the last 10 minutes (422).
        CommandIdReused = "command_id_reused",
            "Give each command a command_id of its own; the same one is for sending the same command again.";
        /// The condition of the command does not hold (412).
        PreconditionFailed = "precondition_failed",
            "Read the state again and decide anew: it is not what the command expects.";
        /// The program has errors (422).
        ProgramHasErrors = "program_has_errors",
            "Correct what the diagnostics of the answer say, and store the program again.";
        /// The program is of another dialect than the coordinate system (422).
        WrongDialect = "wrong_dialect",
            "Load it into a coordinate system of its dialect, or store it with the dialect that it is written in.";
        /// The machine runs only signed programs, and this one has no valid signature (422).
        NotSigned = "not_signed",
            "Sign the program with a key of [programs] signed_by, and store it with its signature.";
        /// The program cannot start at that line (422).
        LineRefused = "line_refused",
            "Choose a line whose state the text alone decides: outside of cutter compensation and fixed cycles, and before what a handler, a capture or an input decides.";
        /// The request is not well-formed, or a value is out of its range (400).
        Invalid = "invalid",
            "Correct what the text names; the page of routes or topics has the form.";
        /// The request is larger than the limit (413).
        TooLarge = "too_large",
            "Send less at a time, or delete what takes the room; the text says the limit.";
        /// Known, but not implemented (501).
        NotSupported = "not_supported",
            "Do without it; this version does not have it.";
        /// A command over MQTT had the retain flag (refused only there).
        Retained = "retained",
            "Send commands without the retain flag: a broker would send them again to every new connection.";
        /// The request is older than its `not_after` or `ttl_ms` allows (412).
        Expired = "expired",
            "Nothing has changed: look at the machine and decide anew. With ttl_ms, compare the clocks of both computers.";
        /// The runtime cannot execute the request now: it stops, or its store fails (503).
        Unavailable = "unavailable",
            "Try again in a moment; alarms 402 to 405 say what cannot be written.";
    }
}

impl RefusalCode {
    /// Returns true if the same request may succeed a moment later.
    pub fn may_pass(self) -> bool {
        matches!(self, RefusalCode::Unavailable | RefusalCode::NoAnswer)
    }

    /// Returns true if the state, a lock or the control lease is the reason: such a refusal of a command contains the
    /// state and the commands that it allows.
    pub fn is_of_state(self) -> bool {
        matches!(
            self,
            RefusalCode::NotAllowed | RefusalCode::StartLocked | RefusalCode::Busy | RefusalCode::LeaseLost
        )
    }
}
