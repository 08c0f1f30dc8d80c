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

/// When an output is made (D30).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Timing {
    /// When motion before it has come to a stop in position; the next block waits for the reset.
    #[default]
    AfterMotion,
    /// When the block is interpreted; the program continues, and the reset must still follow.
    WithMotion,
}

explained! {
    "state of an output"
    /// State of an open output.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    #[non_exhaustive]
    pub enum OutputState {
        /// Not made yet, because the program is held (D18).
        Queued = "QUEUED",
            "It is made when the program is resumed.";
        /// Made, and waiting for a handler to claim it.
        Output = "OUTPUT",
            "A handler for its M code claims it; without one, start it or reset the output by hand.";
        /// Owned by a handler, whose reset is awaited.
        Claimed = "CLAIMED",
            "Its handler resets it when the work is done; progress says how far it is.";
    }
}

/// One output, as in `m_code/{m}/output`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct OutputNotice {
    /// Identifies this output permanently, across all starts of the runtime. Use it to record work that must be done
    /// once, such as counting a part. Empty if an older runtime has written it.
    #[serde(default)]
    pub id: String,
    /// Sequence number: strictly increasing in its coordinate system, never reused within a boot.
    pub seq: u64,
    /// The program run that made it; never reused, across all starts of the runtime.
    pub run_id: String,
    /// M number, 0 to 191.
    pub m: u16,
    /// VA to VH.
    pub params: Params,
    /// Timing in force for this output.
    pub timing: Timing,
    /// Program number.
    pub program: u16,
    /// Line of the source file, from 1.
    pub line: u32,
    /// 1 for the first notice, increased by one each time it is published again.
    pub attempt: u32,
    /// True if it was published before: its handler was lost (`lost` in `m_code/pending`), an operator requested it, a
    /// handler for it came online, or the connection to the broker was restored.
    pub redelivered: bool,
}

/// One open output, as in `m_code/pending`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PendingOutput {
    /// The output.
    #[serde(flatten)]
    pub output: OutputNotice,
    /// State of the output.
    pub state: OutputState,
    /// Its owner, once it is claimed.
    pub handler_id: Option<String>,
    /// Instance of its owner, if it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
    /// Time when it entered this state.
    pub since: Timestamp,
    /// True while it waits after the handler that had claimed it was lost: that handler may have worked on it.
    #[serde(default)]
    pub lost: bool,
    /// If `lost`: the instance that had claimed the output, if it named itself. Only this instance may claim the output
    /// without a decision, and may begin work that it had never begun (H20).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lost_instance: Option<String>,
    /// If `lost`: the stricter of the values of the M code's configuration and of the lost handler. Together with the
    /// value of another handler, it decides whether that handler may claim the output.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub redelivery: Option<Redelivery>,
    /// Last progress report of the owner.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub progress: Option<Progress>,
    /// Last checkpoint of an owner; it is kept when that owner is lost.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub checkpoint: Option<Value>,
    /// How an operator requested that work on it continues.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub how: Option<Redelivery>,
    /// Question of the owner to the operator, with the answer once there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub question: Option<Question>,
}

/// Payload of `m_code/pending`: all open outputs, ascending by `seq`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Pending {
    /// Empty when nothing is open.
    pub outputs: Vec<PendingOutput>,
}

/// Progress of a handler, shown while the program waits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Progress {
    /// Current step of the work, at most 200 characters.
    pub text: String,
    /// 0 to 100.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub percent: Option<f64>,
}

/// A handler takes an output.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Claim {
    /// Boot that made the output.
    pub boot_id: BootId,
    /// Sequence number of the output.
    pub seq: u64,
    /// Handler that claims.
    pub handler_id: String,
    /// Identifies one process among all that were started with this `handler_id`: the id that the process made at its
    /// start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
}

/// A handler or an operator resets an output.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Reset {
    /// Boot that made the output.
    pub boot_id: BootId,
    /// Sequence number of the output.
    pub seq: u64,
    /// Handler or operator that resets.
    pub handler_id: String,
    /// Identifies one process among all that were started with this `handler_id`: the id that the process made at its
    /// start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
    /// Done, or failed.
    pub result: ResetResult,
    /// With `fault`: the handler's alarm code, 0 to 9999.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(range(max = 9999)))]
    pub code: Option<u16>,
    /// With `fault`: the alarm's text, unchanged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub text: Option<String>,
    /// An operator's reset: accepted for any owner of the output.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub force: Option<bool>,
}

/// How a handler ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum ResetResult {
    /// The work is done; the program continues.
    Ok,
    /// It failed; an alarm stops the program.
    Fault,
}

explained! {
    "answer to a claim or reset"
    /// Result of a claim or a reset.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    #[non_exhaustive]
    pub enum HandshakeStatus {
        /// It is accepted.
        Accepted = "accepted",
            "Nothing to do.";
        /// The output was reset before; nothing changed.
        Duplicate = "duplicate",
            "Nothing to do: the first reset counted, as after a message sent twice.";
        /// The output was cancelled, failed, timed out, or belongs to another boot; nothing changed.
        Stale = "stale",
            "Forget the output; the work that was begun for it counts for nothing any more.";
        /// This boot never made that output in that coordinate system with that M number.
        Unknown = "unknown",
            "Look at seq, coordinate system and M number; the handler may talk to another machine.";
        /// Another handler owns the output, another instance of this handler is online, or the handler is not
        /// registered; `text` says which.
        NotOwner = "not_owner",
            "Leave it to its owner; an operator may reset it with force.";
        /// The handler that had claimed the output was lost and may have worked on it: no handler may claim it before a
        /// decision.
        Withheld = "withheld",
            "An operator looks at the machine and decides: redeliver with redo or verify, or a reset. The key redelivery of the M code and of the handler decide beforehand.";
        /// The message itself is not valid, and `text` says why; nothing changed.
        Refused = "refused",
            "Correct what the text says, and send it again.";
    }
}

/// Message that a `result` answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum OutputAct {
    /// A claim, which is always answered.
    Claim,
    /// A reset, which is always answered.
    Reset,
    /// A progress report that is rejected.
    Progress,
    /// A checkpoint that is rejected.
    Checkpoint,
    /// A question that is rejected.
    Ask,
    /// A decision of an operator that is rejected.
    Redeliver,
    /// An answer of an operator that is rejected.
    Answer,
}

/// Payload of `m_code/{m}/result`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct HandshakeResult {
    /// Sequence number that the claim or reset named.
    pub seq: u64,
    /// Sender of the claim or reset.
    pub handler_id: String,
    /// Result of the message.
    pub status: HandshakeStatus,
    /// Kind of message that is answered. Left out by an older runtime.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub of: Option<OutputAct>,
    /// The instance that sent it, as named in its message.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
    /// With an accepted claim of an output that may have been worked on before: whether to inspect the machine first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub how: Option<Redelivery>,
    /// Reason for a rejection, and what to do.
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
            "End the work for it, as far as that is safe; the alarm says what happened.";
        /// Not reset within its time limit (D36).
        Timeout = "timeout",
            "End the work for it. Alarm 301 has stopped the run; raise timeout_ms if the work takes longer.";
        /// An operator reset or failed it; sent to its owner.
        Operator = "operator",
            "End the work for it: an operator has decided.";
        /// The runtime ends, another boot of it is online, or the sequence program itself ends.
        Shutdown = "shutdown",
            "End the work for it; after a new start outputs have another boot_id.";
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
    /// Boot that made the output.
    pub boot_id: BootId,
    /// Sequence number of the output.
    pub seq: u64,
    /// The owner.
    pub handler_id: String,
    /// Identifies one process among all that were started with this `handler_id`: the id that the process made at its
    /// start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
    /// Current step of the work, at most 200 characters.
    pub text: String,
    /// 0 to 100.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub percent: Option<f64>,
}

/// Largest size of a checkpoint as JSON, bytes. Reason: `m_code/pending` contains those of all open outputs.
pub const CHECKPOINT_MAX: usize = 4096;

/// Payload of `m_code/{m}/checkpoint`: progress of the work on an output, for the handler that continues it if the
/// owner is lost.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CheckpointReport {
    /// Boot that made the output.
    pub boot_id: BootId,
    /// Sequence number of the output.
    pub seq: u64,
    /// The owner.
    pub handler_id: String,
    /// Identifies one process among all that were started with this `handler_id`: the id that the process made at its
    /// start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
    /// Any JSON of at most 4096 bytes; replaces the previous checkpoint. `null` removes it.
    pub checkpoint: Value,
}

impl CheckpointReport {
    /// # Errors
    /// Fails if the checkpoint is too long.
    pub(crate) fn check(&self) -> Result<(), Refusal> {
        let bytes = self.checkpoint.to_string().len();
        if bytes <= CHECKPOINT_MAX {
            return Ok(());
        }
        let text =
            format!("a checkpoint has at most {CHECKPOINT_MAX} bytes as JSON, and this one has {bytes}");
        Err(Refusal::new(RefusalCode::Invalid, text))
    }
}

/// Payload of `m_code/{m}/redeliver`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Redeliver {
    /// Boot that made the output.
    pub boot_id: BootId,
    /// Sequence number of the output.
    pub seq: u64,
    /// How the handler shall continue.
    pub how: Redelivery,
}
