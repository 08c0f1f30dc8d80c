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

/// An output to be put out.
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
    /// What the configuration says of its redelivery.
    pub redelivery: Option<Redelivery>,
}

/// The queue is full: `open_outputs_max` outputs are open. Nothing has changed; ask again when one has been closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("as many outputs are open as open_outputs_max allows")]
pub struct Full;

/// An output that is queued, made or claimed.
#[derive(Debug, Clone, PartialEq)]
pub struct OpenOutput {
    /// What handlers receive.
    pub notice: OutputNotice,
    /// Its state.
    pub state: OutputState,
    /// Its owner once claimed.
    pub handler_id: Option<String>,
    /// Which instance of its owner, where it is known.
    pub instance: Option<String>,
    /// Since when it is in this state.
    pub since: SystemTime,
    /// True while it waits because its owner was lost (`HANDLER_LOST`).
    pub lost: bool,
    /// From whom it was lost: handler and instance.
    pub lost_by: Option<(String, Option<String>)>,
    /// What the configuration says of its redelivery, and once it is lost, its last owner; the stricter.
    pub redelivery: Option<Redelivery>,
    /// The decision of an operator on how to continue.
    pub how: Option<Redelivery>,
    /// The last progress of its owner.
    pub progress: Option<Progress>,
    /// What its owner, or one before, has noted of how far it has come.
    pub checkpoint: Option<Value>,
    /// The question of its owner to the operator.
    pub question: Option<Question>,
    /// When it times out, seconds on the monotonic clock; none while queued.
    pub deadline_s: Option<f64>,
    pub(super) timeout_s: Option<f64>,
}

impl OpenOutput {
    /// Sequence number, M number and state.
    pub(super) fn in_short(&self) -> (u64, u16, OutputState) {
        (self.notice.seq, self.notice.m, self.state)
    }

    /// Its entry in `m_code/pending`.
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

/// What the caller publishes or does, in this order.
#[derive(Debug, Clone, PartialEq)]
pub enum Effect {
    /// Publish [`Ledger::pending`](super::Ledger::pending). Comes before the output that it shows.
    PendingChanged,
    /// Publish on `m_code/{m}/output`.
    Output(OutputNotice),
    /// Publish on `m_code/{m}/result`: the answer to a claim or a reset.
    Result {
        /// M number of the topic: that of the request, else the output's.
        m: u16,
        /// The answer.
        result: HandshakeResult,
    },
    /// Publish on `m_code/{m}/cancel`.
    Cancel {
        /// M number.
        m: u16,
        /// What is cancelled and why.
        cancel: Cancel,
    },
    /// An output is no longer open.
    Closed {
        /// Sequence number.
        seq: u64,
        /// M number.
        m: u16,
        /// How it ended.
        how: Closed,
    },
}

/// How an output ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Closed {
    /// Reset: the program may continue.
    Reset,
    /// Failed: the alarm stops the coordinate system.
    Failed {
        /// Raised as it is.
        alarm: Alarm,
    },
    /// Not reset in its time: an alarm of the runtime stops the coordinate system (D36).
    TimedOut,
    /// Cancelled (D34).
    Cancelled(CancelReason),
}
