//! State words of a coordinate system, and why a state is as it is.

use serde::{Deserialize, Serialize};

/// State words, after MTConnect Execution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum Execution {
    /// A program is loaded and at its head.
    Ready,
    /// A program, manual data input or a jog runs.
    Active,
    /// Waits for the reset of an auxiliary function output.
    Wait,
    /// Held by the operator.
    FeedHold,
    /// Stopped by M00.
    ProgramStopped,
    /// Stopped by M01.
    OptionalStop,
    /// Stopped between blocks, or held by an input; see the reason.
    Interrupted,
    /// Ended before its end; see the reason.
    #[default]
    Stopped,
    /// M02 or M30 has been reached and no output is open.
    ProgramCompleted,
}

/// Why a state is as it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
pub enum Reason {
    /// WAIT: the handler that owned the output has gone.
    HandlerLost,
    /// INTERRUPTED: single block.
    SingleBlock,
    /// INTERRUPTED: the interlock input is on.
    Interlock,
    /// `FEED_HOLD`: the connection to the MQTT broker was lost while the program waited for an output, or before.
    BusLost,
    /// `FEED_HOLD`: the servo was late while its motors moved.
    ServoLate,
    /// `FEED_HOLD`: a client that asked to be watched is not heard any more.
    ClientLost,
    /// ACTIVE, `FEED_HOLD`: on the way back of a back trace.
    BackTrace,
    /// `FEED_HOLD`: back trace has come to the end of its way.
    BackTraceEnd,
    /// STOPPED: an alarm.
    Alarm,
    /// STOPPED: the stop command.
    Stop,
    /// STOPPED: the abort command.
    Aborted,
    /// STOPPED: no program is loaded.
    NoProgram,
    /// STOPPED: the runtime was started again; nothing goes on by itself.
    Restarted,
}
