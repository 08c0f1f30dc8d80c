//! Errors of the crate.

use crate::alarm::Alarm;
use crate::types::request::{Refusal, RefusalCode};

/// An error between a sequence program and a machine.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The address is not a valid address of a machine.
    #[error("{address} is not an address of a machine: {reason}")]
    Address {
        /// The given address, without a password.
        address: String,
        /// The mistake in the address, and the correct form.
        reason: String,
    },
    /// The address needs a transport that this build of plc-api does not contain.
    #[error(
        "this build of plc-api has no {feature}, which {address} needs: add the feature {feature} to plc-api in Cargo.toml"
    )]
    Feature {
        /// The given address, without a password.
        address: String,
        /// The missing feature.
        feature: &'static str,
    },
    /// The machine cannot be reached.
    #[error("no connection to {address}: {reason}")]
    Connect {
        /// The address, without a password.
        address: String,
        /// Cause of the failure.
        reason: String,
    },
    /// The machine refused a request; nothing has changed.
    #[error(transparent)]
    Refused(Refusal),
    /// No answer arrived within the time limit: it is unknown whether the request had its effect. Check the
    /// state, or send the request again: a command with the same id
    /// (`CoordinateSystem::command_as`) is never executed twice.
    #[error("{text}")]
    NoAnswer {
        /// Id of the command, if the request was a command.
        command_id: Option<String>,
        /// The side that did not answer, and the time limit.
        text: String,
    },
    /// Work took longer than the time limit of `Plc::timeout`, on the machine's clock.
    #[error("the work was not finished within {limit:?}")]
    TimedOut {
        /// The time limit.
        limit: std::time::Duration,
    },
    /// Another instance of the sequence program has taken over the `handler_id` of this program. The handlers
    /// of this program have been dropped.
    #[error("{text}")]
    TakenOver {
        /// The name of the sequence program.
        handler_id: String,
        /// Description of the other instance.
        text: String,
    },
    /// The machine accepted a command, but its effect was prevented.
    #[error("{verb} in coordinate system {cs} failed: {text}")]
    CommandFailed {
        /// The command.
        verb: String,
        /// The coordinate system.
        cs: u8,
        /// Machine-readable reason.
        code: String,
        /// Cause that prevented the effect.
        text: String,
    },
    /// A sequence program has a mistake, such as two handlers for one M code.
    #[error("{0}")]
    SequenceProgram(String),
    /// The machine has ended the connection for good.
    #[error("the machine has ended the connection")]
    Closed,
    /// The machine did not accept a claim or reset.
    #[error("M{m} (output {seq}) is {status:?} for this handler")]
    Handshake {
        /// M number.
        m: u16,
        /// Sequence number of the output.
        seq: u64,
        /// Answer of the machine.
        status: crate::types::output::HandshakeStatus,
    },
}

/// Result type of the crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl From<Refusal> for Error {
    fn from(refusal: Refusal) -> Self {
        match refusal.code {
            RefusalCode::NoAnswer => Error::NoAnswer {
                command_id: None,
                text: refusal.text,
            },
            _ => Error::Refused(refusal),
        }
    }
}

impl From<Error> for Alarm {
    fn from(error: Error) -> Self {
        Alarm::user(Alarm::CODE_OF_ERROR, error.to_string())
    }
}
