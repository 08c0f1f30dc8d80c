//! Errors of the crate.

use crate::alarm::Alarm;
use crate::types::request::Refusal;

/// An error between a sequence program and a machine.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The address is not one of a machine.
    #[error("{address} is not an address of a machine: {reason}")]
    Address {
        /// As given, without a password.
        address: String,
        /// What is wrong with it, and what to write.
        reason: String,
    },
    /// The machine cannot be reached.
    #[error("no connection to {address}: {reason}")]
    Connect {
        /// The address, without a password.
        address: String,
        /// What happened.
        reason: String,
    },
    /// The machine refused a request; nothing has changed.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// A command was accepted, but something prevented its effect.
    #[error("{verb} in coordinate system {cs} failed: {text}")]
    CommandFailed {
        /// The command.
        verb: String,
        /// The coordinate system.
        cs: u8,
        /// Machine-readable reason.
        code: String,
        /// What prevented it.
        text: String,
    },
    /// A sequence program has a mistake, such as two handlers for one M code.
    #[error("{0}")]
    SequenceProgram(String),
    /// The machine has ended the connection for good.
    #[error("the machine has ended the connection")]
    Closed,
    /// A claim or reset was not accepted.
    #[error("M{m} (output {seq}) is {status:?} for this handler")]
    Handshake {
        /// M number.
        m: u16,
        /// Sequence number.
        seq: u64,
        /// The answer.
        status: crate::types::output::HandshakeStatus,
    },
}

/// Result of the crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl From<Error> for Alarm {
    fn from(error: Error) -> Self {
        Alarm::user(Alarm::CODE_OF_ERROR, error.to_string())
    }
}
