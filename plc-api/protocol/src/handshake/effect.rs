//! Arguments and effects of calls of the ledger.

use std::time::SystemTime;

use crate::alarm::Alarm;
use crate::types::output::{Cancel, CancelReason, HandshakeResult, OutputNotice, Params, Redelivery, Timing};

/// Time at which the caller calls the ledger.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Now {
    /// Seconds since the start of the runtime, for time limits; simulated time in a simulation.
    pub monotonic_s: f64,
    /// Time of day, for the times in messages.
    pub time: SystemTime,
}

/// Description of an output that the caller adds to the ledger.
#[derive(Debug, Clone, PartialEq)]
pub struct OutputSpec {
    /// Identifier of the program run.
    pub run_id: String,
    /// M number, 0 to 191.
    pub m: u16,
    /// Parameters VA to VH.
    pub params: Params,
    /// Timing in force for this output (D30).
    pub timing: Timing,
    /// Number of the NC program.
    pub program: u16,
    /// Line in the file of the NC program, from 1.
    pub line: u32,
    /// Time limit from the state OUTPUT to the reset, seconds (D36); `None` means no limit.
    pub timeout_s: Option<f64>,
    /// Setting `redelivery` of the M code in the configuration.
    pub redelivery: Option<Redelivery>,
}

/// Error of a full ledger: `open_outputs_max` outputs are open. The call has changed nothing. The caller
/// tries again after an output has been closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the limit of open outputs, open_outputs_max, is reached")]
pub struct Full;

/// An action that the caller of the ledger must execute. The caller executes actions in their order.
#[derive(Debug, Clone, PartialEq)]
pub enum Effect {
    /// Publish [`Ledger::pending`](super::Ledger::pending). If a new output changes `pending`, this effect
    /// precedes the effect `Output`.
    PendingChanged,
    /// Publish this notice on `m_code/{m}/output`.
    Output(OutputNotice),
    /// Publish on `m_code/{m}/result`: the answer to a claim or a reset, or the rejection of another request.
    Result {
        /// M number of the topic: the M number in the request, otherwise that of the output.
        m: u16,
        /// The answer to the request.
        result: HandshakeResult,
    },
    /// Publish this cancel on `m_code/{m}/cancel`.
    Cancel {
        /// M number.
        m: u16,
        /// The cancelled output and the reason.
        cancel: Cancel,
    },
    /// Notice that an output is no longer open.
    Closed {
        /// Sequence number.
        seq: u64,
        /// M number.
        m: u16,
        /// How the output ended.
        how: OutputOutcome,
    },
}

/// How an output ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum OutputOutcome {
    /// Reset: the program may continue.
    Reset,
    /// Failed: the alarm stops the coordinate system.
    Failed {
        /// Alarm of the handler, which the caller raises unchanged.
        alarm: Alarm,
    },
    /// Not reset within its time limit: an alarm of the runtime stops the coordinate system (D36).
    TimedOut,
    /// Cancelled (D34).
    Cancelled(CancelReason),
}
