//! Verbs of commands.

use serde::{Deserialize, Serialize};

/// A verb, for lists of allowed commands.
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
    /// Feed hold.
    Hold,
    /// Continues after a pause.
    Resume,
    /// Moves back along the passed path in a feed hold with G500, or forward again.
    BackTrace,
    /// Decelerates on the path and ends the run.
    Stop,
    /// Brakes each motor at once, and ends the run.
    Abort,
    /// Cancels outputs, ends the run, and clears alarms.
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
    /// Returns true for hold, stop and abort: these commands bypass every queue and have no further
    /// condition.
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
