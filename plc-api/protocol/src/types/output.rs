//! Auxiliary function outputs and the messages about them: claim, reset, progress, redelivery.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::explained::explained;
use super::question::Question;
use super::refusal::{Refusal, RefusalCode};
use super::{BootId, Timestamp};

pub use super::handler::{HandledCode, HandlerPresence, HandlerResult, HandlerStatus};
pub use super::params::Params;
pub use super::redelivery::Redelivery;

/// Time at which the machine issues an output (D30).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Timing {
    /// After the earlier motion has ended in position; the next block waits for the reset.
    #[default]
    AfterMotion,
    /// When the block is interpreted: the program continues, but the output must still be reset.
    WithMotion,
}

explained! {
    "state of an output"
    /// State of an open output.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    #[non_exhaustive]
    pub enum OutputState {
        /// Not issued yet, because the program is held (D18).
        Queued = "QUEUED",
            "The output is issued when the program is resumed.";
        /// Issued, and waiting for the claim of a handler.
        Output = "OUTPUT",
            "A handler for the M code claims the output. If no such handler is online, start one, or reset the output by hand.";
        /// Owned by a handler; the reset of this handler is pending.
        Claimed = "CLAIMED",
            "The handler resets the output when the work is done; progress shows how far the work is.";
    }
}

/// One output, as in `m_code/{m}/output`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct OutputNotice {
    /// Identifies this output permanently, across all starts of the runtime. Use this id to record work that
    /// must be done only once, such as counting a part. Empty if an older runtime has published the output.
    #[serde(default)]
    pub id: String,
    /// Sequence number: strictly increasing in its coordinate system, never reused within a boot.
    pub seq: u64,
    /// Id of the program run that issued the output; never reused, across all starts of the runtime.
    pub run_id: String,
    /// M number, 0 to 191.
    pub m: u16,
    /// Parameters VA to VH.
    pub params: Params,
    /// Timing in force for this output.
    pub timing: Timing,
    /// Program number.
    pub program: u16,
    /// Line of the source file, from 1.
    pub line: u32,
    /// Number of this notice: 1 for the first notice, increased by one each time the output is published
    /// again.
    pub attempt: u32,
    /// True if the output was published before. It is published again after the loss of its handler (`lost`
    /// in `m_code/pending`), at the request of an operator, when a handler for its M code comes online, and
    /// when the connection to the broker is restored.
    pub redelivered: bool,
}

/// One open output, as in `m_code/pending`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PendingOutput {
    /// The notice of the output.
    #[serde(flatten)]
    pub output: OutputNotice,
    /// State of the output.
    pub state: OutputState,
    /// Owner of the output; null until a handler has claimed it.
    pub handler_id: Option<String>,
    /// Instance of the owner, if it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
    /// Time at which the output entered this state.
    pub since: Timestamp,
    /// True while the output waits because the handler that had claimed it was lost: that handler may have
    /// worked on the output.
    #[serde(default)]
    pub lost: bool,
    /// If `lost`: the instance that had claimed the output, if this instance named itself. Only this instance
    /// may claim the output without a decision of an operator. If it had never begun the work (H20), it may
    /// begin now.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lost_instance: Option<String>,
    /// If `lost`: the stricter of two values, that in the configuration of the M code and that of the lost
    /// handler. Together with the value of another handler, it decides whether that handler may claim the
    /// output.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub redelivery: Option<Redelivery>,
    /// Last progress report of the owner.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub progress: Option<Progress>,
    /// Last checkpoint of an owner; it is kept when that owner is lost.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub checkpoint: Option<Value>,
    /// Decision of an operator on how the work on the output continues.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub how: Option<Redelivery>,
    /// Question of the owner to the operator, with the answer once the operator has answered.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub question: Option<Question>,
}

/// Payload of `m_code/pending`: all open outputs, ascending by `seq`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Pending {
    /// Open outputs; empty if no output is open.
    pub outputs: Vec<PendingOutput>,
}

/// Progress of a handler, shown while the program waits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Progress {
    /// Current step of the work, at most 200 characters.
    pub text: String,
    /// Completed share of the work, percent, 0 to 100.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub percent: Option<f64>,
}

/// Payload of `m_code/{m}/claim`: a handler claims an output.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Claim {
    /// Boot that issued the output.
    pub boot_id: BootId,
    /// Sequence number of the output.
    pub seq: u64,
    /// Handler that claims the output.
    pub handler_id: String,
    /// Identifies one process among all that were started with this `handler_id`: the id that the process
    /// made at its start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
}

/// Payload of `m_code/{m}/reset`: a handler or an operator resets an output.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Reset {
    /// Boot that issued the output.
    pub boot_id: BootId,
    /// Sequence number of the output.
    pub seq: u64,
    /// Handler or operator that resets the output.
    pub handler_id: String,
    /// Identifies one process among all that were started with this `handler_id`: the id that the process
    /// made at its start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
    /// Result of the work: done, or failed.
    pub result: ResetResult,
    /// With `fault`: the handler's alarm code, 0 to 9999.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(range(max = 9999)))]
    pub code: Option<u16>,
    /// With `fault`: the alarm's text, unchanged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub text: Option<String>,
    /// True for an operator's reset: it is accepted for any owner of the output.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force: Option<bool>,
}

/// Result of the work of a handler.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum ResetResult {
    /// The work is done; the program continues.
    Ok,
    /// The work failed; an alarm stops the program.
    Fault,
}

explained! {
    "answer to a claim or reset"
    /// Result of a claim or a reset.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    #[non_exhaustive]
    pub enum HandshakeStatus {
        /// The claim or reset is accepted.
        Accepted = "accepted",
            "Nothing to do.";
        /// The output was reset before; nothing changed.
        Duplicate = "duplicate",
            "Nothing to do: the first reset was accepted, and this message was sent twice.";
        /// The output was cancelled, failed, timed out, or belongs to another boot; nothing changed.
        Stale = "stale",
            "End the work for this output; its result is no longer needed.";
        /// This boot has not issued that output in that coordinate system with that M number.
        Unknown = "unknown",
            "Check seq, coordinate system and M number; the handler may be connected to another machine.";
        /// Another handler owns the output, another instance of this handler is online, or the handler is not
        /// registered; `text` gives the reason.
        NotOwner = "not_owner",
            "Leave the output to its owner; an operator may reset it with force.";
        /// The handler that had claimed the output was lost and may have worked on it: no handler may claim
        /// it before a decision.
        Withheld = "withheld",
            "An operator checks the machine and decides: redeliver with redo or verify, or a reset. If redelivery of the M code and of the handler is redo or verify, no decision is needed.";
        /// The message is not valid; `text` gives the reason. Nothing has changed.
        Refused = "refused",
            "Correct the mistake that the text names, and send the message again.";
    }
}

/// Message that a `result` answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum OutputAct {
    /// A claim; each claim is answered.
    Claim,
    /// A reset; each reset is answered.
    Reset,
    /// A progress report; it is answered only if it is rejected.
    Progress,
    /// A checkpoint; it is answered only if it is rejected.
    Checkpoint,
    /// A question; it is answered only if it is rejected.
    Ask,
    /// A decision of an operator; it is answered only if it is rejected.
    Redeliver,
    /// An operator's answer; it is answered only if it is rejected.
    Answer,
}

/// Payload of `m_code/{m}/result`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct HandshakeResult {
    /// Sequence number in the message that this result answers.
    pub seq: u64,
    /// Sender of the message that this result answers.
    pub handler_id: String,
    /// Result of the message.
    pub status: HandshakeStatus,
    /// Kind of the answered message. An older runtime omits this field.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub of: Option<OutputAct>,
    /// Instance of the sender, as named in the message.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
    /// With an accepted claim of an output on which a lost handler may have worked: `verify` if the handler
    /// must inspect the machine first, `redo` if it must start from the beginning.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub how: Option<Redelivery>,
    /// Reason of a rejection, and the remedy.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub text: Option<String>,
}

impl HandshakeResult {
    /// Creates a result without further fields.
    pub fn new(seq: u64, handler_id: impl Into<String>, status: HandshakeStatus) -> Self {
        Self {
            seq,
            handler_id: handler_id.into(),
            status,
            of: None,
            instance: None,
            how: None,
            text: None,
        }
    }
}

explained! {
    "reason why an output was cancelled"
    /// Why an output was cancelled.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    #[non_exhaustive]
    pub enum CancelReason {
        /// The `reset` command.
        Reset = "reset",
            "End the work for it, as far as that is safe.";
        /// The `stop` command.
        Stop = "stop",
            "End the work for it, as far as that is safe.";
        /// The `abort` command.
        Abort = "abort",
            "End the work for it, as far as that is safe.";
        /// An alarm of the coordinate system or of the whole machine.
        Alarm = "alarm",
            "End the work for this output, as far as that is safe; see the alarm.";
        /// Not reset within its time limit (D36).
        Timeout = "timeout",
            "End the work for this output. Alarm 301 has stopped the run; raise timeout_ms if the work takes longer.";
        /// An operator has reset the output or ended it as failed; sent to the owner.
        Operator = "operator",
            "End the work for this output: an operator has ended it.";
        /// The runtime ends, another boot of the runtime is online, or the sequence program itself ends.
        Shutdown = "shutdown",
            "End the work for this output; after a restart, outputs have another boot_id.";
    }
}

/// Payload of `m_code/{m}/cancel`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Cancel {
    /// Sequence number of the output.
    pub seq: u64,
    /// Reason of the cancellation.
    pub reason: CancelReason,
}

/// Payload of `m_code/{m}/progress`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ProgressReport {
    /// Boot that issued the output.
    pub boot_id: BootId,
    /// Sequence number of the output.
    pub seq: u64,
    /// The owner of the output.
    pub handler_id: String,
    /// Identifies one process among all that were started with this `handler_id`: the id that the process
    /// made at its start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
    /// Current step of the work, at most 200 characters.
    pub text: String,
    /// Completed share of the work, percent, 0 to 100.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub percent: Option<f64>,
}

/// Largest size of a checkpoint as JSON, bytes. Reason: `m_code/pending` contains the checkpoints of all open
/// outputs.
pub const CHECKPOINT_MAX: usize = 4096;

/// Payload of `m_code/{m}/checkpoint`: progress of the work on an output, for the handler that continues it
/// if the owner is lost.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CheckpointReport {
    /// Boot that issued the output.
    pub boot_id: BootId,
    /// Sequence number of the output.
    pub seq: u64,
    /// The owner of the output.
    pub handler_id: String,
    /// Identifies one process among all that were started with this `handler_id`: the id that the process
    /// made at its start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
    /// Any JSON of at most 4096 bytes, which replaces the previous checkpoint. `null` removes the checkpoint.
    pub checkpoint: Value,
}

impl CheckpointReport {
    /// Validates the size of the checkpoint.
    ///
    /// # Errors
    /// Fails if the checkpoint is too long.
    pub fn check(&self) -> Result<(), Refusal> {
        let bytes = self.checkpoint.to_string().len();
        if bytes <= CHECKPOINT_MAX {
            return Ok(());
        }
        let text =
            format!("a checkpoint has at most {CHECKPOINT_MAX} bytes as JSON, but this one has {bytes}");
        Err(Refusal::new(RefusalCode::Invalid, text))
    }
}

/// Payload of `m_code/{m}/redeliver`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Redeliver {
    /// Boot that issued the output.
    pub boot_id: BootId,
    /// Sequence number of the output.
    pub seq: u64,
    /// Decision on how the next handler continues the work.
    pub how: Redelivery,
}
