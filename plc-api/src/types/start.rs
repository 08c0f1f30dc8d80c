//! What prevents a start of the loaded program.

use serde::{Deserialize, Serialize};

use super::planned::PlannedPlace;

/// Payload of `cs/{n}/start_conditions`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct StartConditions {
    /// What prevents a start of the loaded program, or would end its run in an alarm, the first to be removed first; empty: a
    /// start runs the program.
    pub obstacles: Vec<StartObstacle>,
}

/// One obstacle of a start.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct StartObstacle {
    /// Which one.
    pub kind: StartObstacleKind,
    /// What it is, and what to do.
    pub text: String,
    /// The part of it that comes from elsewhere: text of the input, holder of the lease, or why; empty without.
    #[serde(default)]
    pub detail: String,
    /// True: a start is refused. False: it is accepted, and an alarm ends the run.
    pub refuses: bool,
    /// With `m_code`: M numbers, ascending.
    #[serde(default)]
    pub m_codes: Vec<u16>,
    /// With `prediction`: the block; null: it has none.
    #[serde(default)]
    pub at: Option<PlannedPlace>,
}

/// What an obstacle of a start is.
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
    /// The interlock is on, such as by an open door.
    Interlock,
    /// The start lock is on.
    StartLock,
    /// A client has the control lease, which only that client may use.
    Lease,
    /// The program does not run here: it has errors, is not signed, is damaged, or was changed since it was loaded.
    Program,
    /// No handler is online for M codes that raise an alarm then.
    MCode,
    /// The rehearsal ends in an alarm.
    Prediction,
}

impl StartObstacle {
    /// An obstacle for which a start is refused.
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
