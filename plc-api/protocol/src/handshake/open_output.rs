//! An open output: its handshake state, with the data that exist only in this state.

use std::time::SystemTime;

use serde_json::Value;

use crate::types::Timestamp;
use crate::types::output::{OutputNotice, OutputState, PendingOutput, Progress, Redelivery};
use crate::types::question::Question;

use super::effect::Now;

/// An output that is queued, published or claimed.
#[derive(Debug, Clone, PartialEq)]
pub struct OpenOutput {
    /// The notice that handlers receive.
    pub notice: OutputNotice,
    /// Time at which the output entered its current state.
    pub since: SystemTime,
    /// Setting `redelivery` of the configuration. After a loss of the owner, this is the stricter of the
    /// configuration and the setting of the last owner.
    pub redelivery: Option<Redelivery>,
    pub(super) stage: OutputStage,
}

/// Part of the handshake that an output has reached.
#[derive(Debug, Clone, PartialEq)]
#[allow(
    clippy::large_enum_variant,
    reason = "nearly all open outputs are issued: a box would cost an allocation for each of them"
)]
pub(super) enum OutputStage {
    /// QUEUED: no handler has received the output.
    Queued {
        /// Time limit from the state OUTPUT to the reset, seconds (D36); `None` means no limit.
        timeout_s: Option<f64>,
    },
    /// OUTPUT or CLAIMED: the output has been published to handlers.
    Issued(IssuedOutput),
}

/// Data of an output that has been published to handlers.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct IssuedOutput {
    /// Time at which the output times out, seconds on the monotonic clock; `None` means no limit.
    pub deadline_s: Option<f64>,
    /// Last progress that an owner reported, or the text that explains why the output waits for a handler.
    pub progress: Option<Progress>,
    /// Last checkpoint of the owner or of an earlier owner.
    pub checkpoint: Option<Value>,
    pub ownership: Ownership,
}

/// Owner of a published output, with the data that depend on the owner.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Ownership {
    /// OUTPUT: no handler owns the output.
    Unclaimed(UnclaimedOutput),
    /// CLAIMED: a handler owns the output.
    Claimed(ClaimedOutput),
}

/// Data of a published output without an owner.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct UnclaimedOutput {
    /// The last owner, if it was lost; `None` if no handler has claimed the output.
    pub lost_owner: Option<OutputOwner>,
    /// Decision of an operator on how the next handler continues.
    pub decision: Option<Redelivery>,
}

/// Data of a claimed output.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ClaimedOutput {
    pub owner: OutputOwner,
    /// Current question of the owner to the operator.
    pub question: Option<Question>,
}

/// Handler that owns an output, or that owned the output when the handler was lost.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct OutputOwner {
    pub handler_id: String,
    /// Instance of the handler; `None` if it is unknown.
    pub instance: Option<String>,
}

impl OpenOutput {
    /// Returns the state of the output.
    pub fn state(&self) -> OutputState {
        match &self.stage {
            OutputStage::Queued { .. } => OutputState::Queued,
            OutputStage::Issued(issued) => match issued.ownership {
                Ownership::Unclaimed(_) => OutputState::Output,
                Ownership::Claimed(_) => OutputState::Claimed,
            },
        }
    }

    /// Returns the id of the handler that owns the output; `None` if the output is not claimed.
    pub fn handler_id(&self) -> Option<&str> {
        self.claimed().map(|claimed| &*claimed.owner.handler_id)
    }

    /// Returns true while the output waits because its owner was lost (`HANDLER_LOST`).
    pub fn is_lost(&self) -> bool {
        self.unclaimed()
            .is_some_and(|unclaimed| unclaimed.lost_owner.is_some())
    }

    /// Returns the last progress that an owner reported, or the text that explains why the output waits for a
    /// handler.
    pub fn progress(&self) -> Option<&Progress> {
        self.issued()?.progress.as_ref()
    }

    /// Returns the current question of the owner to the operator.
    pub fn question(&self) -> Option<&Question> {
        self.claimed()?.question.as_ref()
    }

    /// Returns the entry of the output in `m_code/pending`.
    pub fn to_pending(&self) -> PendingOutput {
        let (issued, unclaimed) = (self.issued(), self.unclaimed());
        let owner = self.claimed().map(|claimed| &claimed.owner);
        let lost_owner = unclaimed.and_then(|unclaimed| unclaimed.lost_owner.as_ref());
        PendingOutput {
            output: self.notice.clone(),
            state: self.state(),
            handler_id: owner.map(|owner| owner.handler_id.clone()),
            instance: owner.and_then(|owner| owner.instance.clone()),
            since: Timestamp::from_system_time(self.since),
            lost: lost_owner.is_some(),
            lost_instance: lost_owner.and_then(OutputOwner::own_instance).map(str::to_owned),
            redelivery: self.redelivery.filter(|_| lost_owner.is_some()),
            progress: issued.and_then(|issued| issued.progress.clone()),
            checkpoint: issued.and_then(|issued| issued.checkpoint.clone()),
            how: unclaimed.and_then(|unclaimed| unclaimed.decision),
            question: self.question().cloned(),
        }
    }

    /// Returns the sequence number, the M number and the state of the output.
    pub(super) fn in_short(&self) -> (u64, u16, OutputState) {
        (self.notice.seq, self.notice.m, self.state())
    }

    /// Returns the data of the output if it has been published.
    pub(super) fn issued(&self) -> Option<&IssuedOutput> {
        match &self.stage {
            OutputStage::Queued { .. } => None,
            OutputStage::Issued(issued) => Some(issued),
        }
    }

    pub(super) fn issued_mut(&mut self) -> Option<&mut IssuedOutput> {
        match &mut self.stage {
            OutputStage::Queued { .. } => None,
            OutputStage::Issued(issued) => Some(issued),
        }
    }

    /// Returns the data of the output if it has been published and has no owner.
    pub(super) fn unclaimed(&self) -> Option<&UnclaimedOutput> {
        match &self.issued()?.ownership {
            Ownership::Unclaimed(unclaimed) => Some(unclaimed),
            Ownership::Claimed(_) => None,
        }
    }

    /// Returns the data of the output if a handler owns it.
    pub(super) fn claimed(&self) -> Option<&ClaimedOutput> {
        self.issued()?.claimed()
    }

    /// Changes QUEUED to OUTPUT, or to CLAIMED for an owner at once (H20), and starts the time limit (H10).
    /// Returns false if the output is not QUEUED; then nothing changes.
    pub(super) fn issue(&mut self, now: Now, owner: Option<OutputOwner>) -> bool {
        let OutputStage::Queued { timeout_s } = self.stage else {
            return false;
        };
        self.stage = OutputStage::Issued(IssuedOutput {
            deadline_s: timeout_s.map(|timeout_s| now.monotonic_s + timeout_s),
            progress: None,
            checkpoint: None,
            ownership: owner.map_or_else(
                || Ownership::Unclaimed(UnclaimedOutput::default()),
                ClaimedOutput::by_owner,
            ),
        });
        self.notice.attempt = 1;
        self.since = now.time;
        true
    }

    /// Changes OUTPUT to CLAIMED. The progress of an earlier owner (H13) and the decision of an operator end.
    pub(super) fn set_owner(&mut self, now: Now, owner: OutputOwner) {
        let OutputStage::Issued(issued) = &mut self.stage else {
            debug_assert!(false, "a queued output cannot be claimed");
            return;
        };
        issued.ownership = ClaimedOutput::by_owner(owner);
        issued.progress = None;
        self.since = now.time;
    }

    /// Changes CLAIMED to OUTPUT, because the owner is lost (H11). The question of the owner ends.
    pub(super) fn lose_owner(&mut self, now: Now) {
        let OutputStage::Issued(IssuedOutput { ownership, .. }) = &mut self.stage else {
            debug_assert!(false, "a queued output has no owner");
            return;
        };
        let Ownership::Claimed(claimed) = ownership else {
            debug_assert!(false, "an output without an owner cannot lose its owner");
            return;
        };
        let owner = claimed.owner.clone();
        *ownership = Ownership::Unclaimed(UnclaimedOutput {
            lost_owner: Some(owner),
            decision: None,
        });
        self.since = now.time;
        self.notice.redelivered = true;
    }

    /// Returns the time at which the output times out, seconds on the monotonic clock; `None` while the output
    /// is queued, and without a time limit.
    pub(super) fn deadline_s(&self) -> Option<f64> {
        self.issued()?.deadline_s
    }
}

impl IssuedOutput {
    pub fn claimed(&self) -> Option<&ClaimedOutput> {
        match &self.ownership {
            Ownership::Unclaimed(_) => None,
            Ownership::Claimed(claimed) => Some(claimed),
        }
    }

    pub fn claimed_mut(&mut self) -> Option<&mut ClaimedOutput> {
        match &mut self.ownership {
            Ownership::Unclaimed(_) => None,
            Ownership::Claimed(claimed) => Some(claimed),
        }
    }
}

impl ClaimedOutput {
    fn by_owner(owner: OutputOwner) -> Ownership {
        Ownership::Claimed(Self {
            owner,
            question: None,
        })
    }
}
