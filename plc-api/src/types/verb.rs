//! Verbs of commands.

use serde::{Deserialize, Serialize};

/// A verb, for lists of what is allowed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Verb {
    /// See [`Command::Load`](crate::types::command::Command::Load).
    Load,
    /// See [`Command::Start`](crate::types::command::Command::Start).
    Start,
    /// See [`Command::Hold`](crate::types::command::Command::Hold).
    Hold,
    /// See [`Command::Resume`](crate::types::command::Command::Resume).
    Resume,
    /// See [`Command::BackTrace`](crate::types::command::Command::BackTrace).
    BackTrace,
    /// See [`Command::Stop`](crate::types::command::Command::Stop).
    Stop,
    /// See [`Command::Abort`](crate::types::command::Command::Abort).
    Abort,
    /// See [`Command::Reset`](crate::types::command::Command::Reset).
    Reset,
    /// See [`Command::AlarmAcknowledge`](crate::types::command::Command::AlarmAcknowledge).
    AlarmAcknowledge,
    /// See [`Command::Mdi`](crate::types::command::Command::Mdi).
    Mdi,
    /// See [`Command::Jog`](crate::types::command::Command::Jog).
    Jog,
    /// See [`Command::Home`](crate::types::command::Command::Home).
    Home,
}

impl Verb {
    /// True for hold, stop and abort: they pass every queue, and need nothing.
    pub fn is_urgent(self) -> bool {
        matches!(self, Verb::Hold | Verb::Stop | Verb::Abort)
    }

    /// True for those that begin motion, or let it go on.
    pub fn moves(self) -> bool {
        matches!(
            self,
            Verb::Start | Verb::Resume | Verb::BackTrace | Verb::Mdi | Verb::Home | Verb::Jog
        )
    }
}
