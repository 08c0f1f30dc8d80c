//! Verbs of commands.

use serde::{Deserialize, Serialize};

/// Verb of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Verb {
    /// Loads a program from the store.
    Load,
    /// Starts a new run at the beginning of the loaded program.
    Start,
    /// Loads a program, if the order names one, and runs it once for each ordered part.
    Run,
    /// Holds the motion on its path (feed hold).
    Hold,
    /// Continues a paused run.
    Resume,
    /// Moves back along the path already passed, during a feed hold with G500, or moves forward again.
    BackTrace,
    /// Decelerates on the path and ends the run.
    Stop,
    /// Brakes each motor at once, and ends the run.
    Abort,
    /// Cancels outputs, ends the run, and clears alarms.
    Reset,
    /// Acknowledges an alarm.
    AlarmAcknowledge,
    /// Manual data input: runs lines of NC text; the state word is READY after that.
    Mdi,
    /// Moves one axis by hand; the state word is READY after that.
    Jog,
    /// Moves axes to their first reference points, each motor alone as G28 does; the state word is READY
    /// after that.
    Home,
}

impl Verb {
    /// Returns true for hold, stop and abort: these commands bypass every queue, and every state allows them.
    pub fn is_urgent(self) -> bool {
        matches!(self, Verb::Hold | Verb::Stop | Verb::Abort)
    }

    /// Returns true for verbs that start or continue a motion.
    pub fn moves(self) -> bool {
        matches!(
            self,
            Verb::Start | Verb::Run | Verb::Resume | Verb::BackTrace | Verb::Mdi | Verb::Home | Verb::Jog
        )
    }
}
