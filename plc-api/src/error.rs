//! Errors of the crate.

use crate::alarm::Alarm;
use crate::types::request::{Refusal, RefusalCode};

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
    /// The address is of a transport that this build of plc-api leaves out.
    #[error(
        "this build of plc-api has no {feature}, which {address} needs: add the feature {feature} to plc-api in Cargo.toml"
    )]
    Feature {
        /// As given, without a password.
        address: String,
        /// The feature that is missing.
        feature: &'static str,
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
    Refused(Refusal),
    /// No answer came in time: whether the request had its effect is not known. Look at the state, or send it again: a
    /// command with the same id ([`CoordinateSystem::command_as`](crate::CoordinateSystem::command_as)) is never done twice.
    #[error("{text}")]
    NoAnswer {
        /// The command, if it was one.
        command_id: Option<String>,
        /// Who did not answer, and within which time.
        text: String,
    },
    /// Work was not finished within a time on the machine's clock: [`Plc::timeout`](crate::Plc::timeout).
    #[error("it was not done within {limit:?}")]
    TimedOut {
        /// The time.
        limit: std::time::Duration,
    },
    /// Another instance of the sequence program has taken over its `handler_id`. Its handlers have been dropped.
    #[error("{text}")]
    TakenOver {
        /// The name of the sequence program.
        handler_id: String,
        /// Which instance, and since when.
        text: String,
    },
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

#[cfg(not(all(feature = "mqtt", feature = "rest")))]
impl Error {
    pub(crate) fn without_feature(address: &str, feature: &'static str) -> Self {
        // what stands before @ may hold a password
        let (scheme, rest) = address.split_once("://").unwrap_or_default();
        let host = rest.rsplit_once('@').map_or(rest, |(_, host)| host);
        Error::Feature {
            address: format!("{scheme}://{host}"),
            feature,
        }
    }
}

impl Error {
    /// True for an error of the connection, which may pass.
    pub(crate) fn may_pass(&self) -> bool {
        match self {
            Error::Refused(refusal) => refusal.code.may_pass(),
            Error::NoAnswer { .. } => true,
            _ => false,
        }
    }
}

/// Result of the crate.
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
