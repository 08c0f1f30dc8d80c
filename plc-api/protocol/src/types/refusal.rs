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
            "Check the number or the name; the text names the existing ones.";
        /// The state does not allow the request (409).
        NotAllowed = "not_allowed",
            "The answer contains the state and the commands that this state allows: bring the machine into a state that allows the request.";
        /// The program runs (409).
        ProgramRuns = "program_runs",
            "Wait for the end of the run, or stop it.";
        /// A start lock or the interlock is on (409).
        StartLocked = "start_locked",
            "The program or the operator that has set the start lock or the interlock must clear it; its text gives the reason.";
        /// The user has no right for the request (403).
        Forbidden = "forbidden",
            "Use a token with a role that has the right, or ask the administrator for such a token.";
        /// Another client holds the control lease (409).
        Busy = "busy",
            "Wait until the holder releases the control lease or the lease expires; an administrator can break the lease.";
        /// The control lease under which the command was sent has ended (409).
        LeaseLost = "lease_lost",
            "Take the control lease again, check the machine, and send the command with the new fence.";
        /// Another instance of the handler's id is online (409).
        HandlerTaken = "handler_taken",
            "End the other program, or give this program a different handler_id. With take_over, this program replaces the other program, which is notified.";
        /// No answer was received within the time limit: it is unknown whether the request was executed. Only
        /// clients report this.
        NoAnswer = "no_answer",
            "Check the state, or send the request again: a command with the same command_id is never executed twice.";
        /// The `command_id` was used for a different command in the last 10 minutes (422).
        CommandIdReused = "command_id_reused",
            "Use a new command_id for each command. Use the same command_id only to send the same command again.";
        /// The condition of the command does not hold (412).
        PreconditionFailed = "precondition_failed",
            "The state differs from the state that the command expects: read the state, and decide again.";
        /// The program has errors (422).
        ProgramHasErrors = "program_has_errors",
            "Correct the errors that the diagnostics of the answer name, and store the program again.";
        /// The program is of another dialect than the coordinate system (422).
        WrongDialect = "wrong_dialect",
            "Load the program into a coordinate system of its dialect, or store it with the dialect in which it is written.";
        /// The machine runs only signed programs, and this program has no valid signature (422).
        NotSigned = "not_signed",
            "Sign the program with a key of [programs] signed_by, and store it with its signature.";
        /// The program cannot start at that line (422).
        LineRefused = "line_refused",
            "Choose a line for which the program text alone determines the state: outside of cutter compensation and fixed cycles, and before the first block that depends on a handler, a capture or an input.";
        /// The request is not well-formed, or a value is out of its range (400).
        Invalid = "invalid",
            "Correct the mistake that the text names; the reference pages of routes and topics describe the form.";
        /// The request is larger than the limit (413).
        TooLarge = "too_large",
            "Send less at a time, or delete stored data that need the space; the text names the limit.";
        /// The request is known, but not implemented (501).
        NotSupported = "not_supported",
            "This version does not support the request: use another one.";
        /// A command over MQTT had the retain flag (refused only there).
        Retained = "retained",
            "Send commands without the retain flag: a broker would send them again to every new connection.";
        /// The request is older than its `not_after` or `ttl_ms` allows (412).
        Expired = "expired",
            "Nothing has changed: check the machine, and decide again. With ttl_ms, compare the clocks of both computers.";
        /// The runtime cannot execute the request now, because it is shutting down or its store has failed
        /// (503).
        Unavailable = "unavailable",
            "Try again after a short time; alarms 402 to 405 name the data that cannot be written.";
    }
}

impl RefusalCode {
    /// Returns true if the same request may succeed when it is repeated after a short time.
    pub fn may_pass(self) -> bool {
        matches!(self, RefusalCode::Unavailable | RefusalCode::NoAnswer)
    }

    /// Returns true if the reason is the state, a lock or the control lease. Such a refusal of a command
    /// contains the state and the commands that the state allows.
    pub fn is_of_state(self) -> bool {
        matches!(
            self,
            RefusalCode::NotAllowed | RefusalCode::StartLocked | RefusalCode::Busy | RefusalCode::LeaseLost
        )
    }
}
