//! Verbs of commands.

use serde::{Deserialize, Serialize};

/// A verb, for lists of what is allowed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Verb {
    /// Takes a program of the store.
    Load,
    /// From the head, as a new run.
    Start,
    /// Loads a program, if one is named, and runs it as many times as parts are ordered.
    Run,
    /// Feed hold.
    Hold,
    /// Goes on after a pause.
    Resume,
    /// Back along the passed path, in a feed hold with G500; or forward again.
    BackTrace,
    /// Decelerates on the path and ends the run.
    Stop,
    /// Each motor brakes at once; ends the run.
    Abort,
    /// Cancels outputs, ends the run, clears alarms.
    Reset,
    /// Acknowledges an alarm.
    AlarmAcknowledge,
    /// Manual data input: runs lines of NC text, then READY.
    Mdi,
    /// Moves one axis by hand, then READY.
    Jog,
    /// Moves axes to their first reference points, each motor alone as G28 does, then READY.
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
            Verb::Start | Verb::Run | Verb::Resume | Verb::BackTrace | Verb::Mdi | Verb::Home | Verb::Jog
        )
    }
}
