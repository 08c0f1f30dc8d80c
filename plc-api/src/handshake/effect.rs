//! Arguments and effects of calls of the ledger.

use std::time::SystemTime;

use serde_json::Value;

use crate::alarm::Alarm;
use crate::types::Timestamp;
use crate::types::output::{
    Cancel, CancelReason, HandshakeResult, OutputNotice, OutputState, Params, PendingOutput, Progress,
    Redelivery, Timing,
};
use crate::types::question::Question;

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

/// An output that is queued, published or claimed.
#[derive(Debug, Clone, PartialEq)]
pub struct OpenOutput {
    /// The notice that handlers receive.
    pub notice: OutputNotice,
    /// State of the output.
    pub state: OutputState,
    /// Id of the handler that owns the output; `None` until a handler has claimed the output.
    pub handler_id: Option<String>,
    /// Instance of the owner; `None` if it is unknown.
    pub instance: Option<String>,
    /// Time at which the output entered its current state.
    pub since: SystemTime,
    /// True while the output waits because its owner was lost (`HANDLER_LOST`).
    pub lost: bool,
    /// Handler and instance that owned the output when the handler was lost.
    pub lost_by: Option<(String, Option<String>)>,
    /// Setting `redelivery` of the configuration. After a loss of the owner, this is the stricter of the
    /// configuration and the setting of the last owner.
    pub redelivery: Option<Redelivery>,
    /// Decision of an operator on how the next handler continues.
    pub how: Option<Redelivery>,
    /// Last progress that the owner reported.
    pub progress: Option<Progress>,
    /// Last checkpoint of the owner or of an earlier owner.
    pub checkpoint: Option<Value>,
    /// Current question of the owner to the operator.
    pub question: Option<Question>,
    /// Time at which the output times out, seconds on the monotonic clock; `None` while queued.
    pub deadline_s: Option<f64>,
    pub(super) timeout_s: Option<f64>,
}

impl OpenOutput {
    /// Returns the sequence number, the M number and the state of the output.
    pub(super) fn in_short(&self) -> (u64, u16, OutputState) {
        (self.notice.seq, self.notice.m, self.state)
    }

    /// Returns the entry of the output in `m_code/pending`.
    pub fn to_pending(&self) -> PendingOutput {
        PendingOutput {
            output: self.notice.clone(),
            state: self.state,
            handler_id: self.handler_id.clone(),
            instance: self.instance.clone(),
            since: Timestamp::from_system_time(self.since),
            lost: self.lost,
            lost_instance: self.lost_instance().map(str::to_owned),
            redelivery: self.redelivery.filter(|_| self.lost),
            progress: self.progress.clone(),
            checkpoint: self.checkpoint.clone(),
            how: self.how,
            question: self.question.clone(),
        }
    }
}

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
