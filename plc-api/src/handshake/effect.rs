//! Inputs and effects of the ledger.

use std::time::SystemTime;

use serde_json::Value;

use crate::alarm::Alarm;
use crate::types::Timestamp;
use crate::types::output::{
    Cancel, CancelReason, HandshakeResult, OutputNotice, OutputState, Params, PendingOutput, Progress,
    Redelivery, Timing,
};
use crate::types::question::Question;

/// The time of a call.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Now {
    /// Seconds since the start, for time limits; simulated time in a simulation.
    pub monotonic_s: f64,
    /// Time of day, for messages.
    pub time: SystemTime,
}

/// An output to be issued.
#[derive(Debug, Clone, PartialEq)]
pub struct OutputSpec {
    /// The program run.
    pub run_id: String,
    /// M number, 0 to 191.
    pub m: u16,
    /// VA to VH.
    pub params: Params,
    /// Timing in force for this output (D30).
    pub timing: Timing,
    /// Program number.
    pub program: u16,
    /// Line of the source file, from 1.
    pub line: u32,
    /// Time limit of its reset from OUTPUT on, seconds (D36).
    pub timeout_s: Option<f64>,
    /// `redelivery` of the configuration.
    pub redelivery: Option<Redelivery>,
}

/// Error of a full ledger: `open_outputs_max` outputs are open. Nothing has changed; try again after an
/// output has been closed.
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
    /// Owner of the output; `None` until an owner has claimed it.
    pub handler_id: Option<String>,
    /// Instance of the owner, if it is known.
    pub instance: Option<String>,
    /// Time at which the output entered this state.
    pub since: SystemTime,
    /// True while the output waits because its owner was lost (`HANDLER_LOST`).
    pub lost: bool,
    /// Handler and instance that owned the output when they were lost.
    pub lost_by: Option<(String, Option<String>)>,
    /// `redelivery` of the configuration. After a loss of the owner: the stricter of the configuration and
    /// the setting of the last owner.
    pub redelivery: Option<Redelivery>,
    /// The decision of an operator on how to continue.
    pub how: Option<Redelivery>,
    /// The last progress that the owner reported.
    pub progress: Option<Progress>,
    /// Last checkpoint of the owner or of an earlier owner.
    pub checkpoint: Option<Value>,
    /// The question of the owner to the operator.
    pub question: Option<Question>,
    /// Time at which the output times out, seconds on the monotonic clock; `None` while queued.
    pub deadline_s: Option<f64>,
    pub(super) timeout_s: Option<f64>,
}

impl OpenOutput {
    /// Returns sequence number, M number and state.
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

/// An action of the caller; actions are executed in this order.
#[derive(Debug, Clone, PartialEq)]
pub enum Effect {
    /// Publish [`Ledger::pending`](super::Ledger::pending). This effect precedes the output that `pending`
    /// shows.
    PendingChanged,
    /// Publish on `m_code/{m}/output`.
    Output(OutputNotice),
    /// Publish on `m_code/{m}/result`: the answer to a claim or a reset.
    Result {
        /// M number of the topic: that of the request, otherwise that of the output.
        m: u16,
        /// The answer.
        result: HandshakeResult,
    },
    /// Publish on `m_code/{m}/cancel`.
    Cancel {
        /// M number.
        m: u16,
        /// The cancelled output and the reason.
        cancel: Cancel,
    },
    /// An output is no longer open.
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
        /// The alarm, raised unchanged.
        alarm: Alarm,
    },
    /// Not reset within its time limit: an alarm of the runtime stops the coordinate system (D36).
    TimedOut,
    /// Cancelled (D34).
    Cancelled(CancelReason),
}
