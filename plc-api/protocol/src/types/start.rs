//! Obstacles that prevent a start of the loaded program.

use serde::{Deserialize, Serialize};

use super::planned::PlannedLocation;

/// Payload of `cs/{n}/start_conditions`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct StartConditions {
    /// Obstacles that prevent a start of the loaded program, or would end its run by an alarm, in the order
    /// in which to remove them; empty if a start runs the program.
    pub obstacles: Vec<StartObstacle>,
}

/// One obstacle of a start.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct StartObstacle {
    /// Kind of the obstacle.
    pub kind: StartObstacleKind,
    /// Description and remedy.
    pub text: String,
    /// The part of `text` that is not fixed: text of the input, holder of the lease, or reason of the fault;
    /// otherwise empty.
    #[serde(default)]
    pub detail: String,
    /// True if a start is refused; false if a start is accepted but an alarm ends the run.
    pub refuses: bool,
    /// With `m_code`: M numbers, ascending.
    #[serde(default)]
    pub m_codes: Vec<u16>,
    /// With `prediction`: the block that causes the alarm; null if the alarm has no block.
    #[serde(default)]
    pub at: Option<PlannedLocation>,
}

/// Kind of an obstacle of a start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum StartObstacleKind {
    /// A run is under way, moving or paused.
    Running,
    /// An alarm is active.
    Alarm,
    /// No program is loaded.
    NoProgram,
    /// The coordinate system is STOPPED and needs a reset.
    Reset,
    /// The interlock is on, for example because a door is open.
    Interlock,
    /// The start lock is on.
    StartLock,
    /// A client holds the control lease; only this client may start.
    Lease,
    /// The program does not run here: it has errors, is not signed, is damaged, or was changed since it was
    /// loaded.
    Program,
    /// No handler is online for M codes that raise an alarm without a handler.
    MCode,
    /// The rehearsal ends in an alarm.
    Prediction,
}

impl StartObstacle {
    /// Creates an obstacle for which a start is refused.
    pub fn refusing(kind: StartObstacleKind, text: impl Into<String>) -> Self {
        Self {
            kind,
            text: text.into(),
            detail: String::new(),
            refuses: true,
            m_codes: Vec::new(),
            at: None,
        }
    }
}
