//! Claims and resets of an output, each repeated until the machine has answered.

use plc_protocol::alarm::Alarm;
use plc_protocol::error::{Error, Result};
use plc_protocol::handshake::{reset_of, strictest};
use plc_protocol::types::message::Message;
use plc_protocol::types::output::{Claim, HandshakeResult, HandshakeStatus, PendingOutput, Redelivery};
use plc_protocol::types::request::{TypedRequest, typed};
use plc_protocol::types::{BootId, CoordinateSystemNumber};

use crate::identity::Identity;
use crate::plc::Plc;

pub(crate) use plc_protocol::port::RETRY;

/// Identifier of an output that is unique over all boots.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct OutputId {
    pub(crate) boot_id: BootId,
    pub(crate) cs: CoordinateSystemNumber,
    pub(crate) seq: u64,
}

impl OutputId {
    /// Returns the identifier of an output from a `pending` message of a coordinate system.
    pub(crate) fn from_pending(
        message: &Message,
        cs: CoordinateSystemNumber,
        output: &PendingOutput,
    ) -> Self {
        Self {
            boot_id: message.boot_id.clone(),
            cs,
            seq: output.output.seq,
        }
    }

    pub(crate) fn claim(&self, m: u16, by: &Identity) -> typed::Claim {
        let claim = Claim {
            boot_id: self.boot_id.clone(),
            seq: self.seq,
            handler_id: by.id(),
            instance: Some(by.instance()),
        };
        typed::Claim(self.cs, Some(m), claim)
    }

    pub(crate) fn reset(&self, m: u16, by: &Identity, alarm: Option<Alarm>) -> typed::Reset {
        let mut reset = reset_of(&self.boot_id, self.seq, &by.handler_id, alarm);
        reset.instance = Some(by.instance());
        typed::Reset(self.cs, Some(m), reset)
    }
}

/// Checks the answer to a claim or reset. If the transport returns no answer (`None`), this is not an error.
pub(crate) fn accepted(m: u16, seq: u64, answer: Option<HandshakeResult>) -> Result<()> {
    match answer.map(|result| result.status) {
        None | Some(HandshakeStatus::Accepted) => Ok(()),
        Some(status) => Err(Error::Handshake { m, seq, status }),
    }
}

/// Outcome of one attempt at a claim or reset.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum HandshakeAttempt {
    Answered(HandshakeResult),
    /// The machine permanently refuses the claim or reset.
    Refused,
    /// No answer has arrived. [`RETRY`] has passed since the attempt: the caller may repeat the claim or
    /// reset.
    NotYet,
}

/// Sends a claim or reset once, and waits for its answer.
pub(crate) async fn ask_once(
    plc: &Plc,
    request: impl TypedRequest<Answer = HandshakeResult>,
) -> HandshakeAttempt {
    match plc.port().ask(request).await {
        Ok(result) => HandshakeAttempt::Answered(result),
        Err(refusal) if refusal.code.may_pass() => {
            tracing::warn!(%refusal, "claim or reset not answered yet");
            plc.sleep(RETRY).await;
            HandshakeAttempt::NotYet
        }
        Err(refusal) => {
            tracing::warn!(%refusal, "claim or reset refused");
            HandshakeAttempt::Refused
        }
    }
}

/// Repeats a claim or reset until the machine answers; returns `None` if the machine refuses it permanently.
pub(crate) async fn until_answered(
    plc: &Plc,
    request: impl TypedRequest<Answer = HandshakeResult> + Clone,
) -> Option<HandshakeStatus> {
    loop {
        match ask_once(plc, request.clone()).await {
            HandshakeAttempt::Answered(result) => return Some(result.status),
            HandshakeAttempt::Refused => return None,
            HandshakeAttempt::NotYet => {}
        }
    }
}

/// Returns true if the handler that starts on an output must check the machine first. Returns `None` if an
/// operator must decide before a handler starts. The machine makes the same decision when it receives the
/// claim.
pub(crate) fn decide_start(output: &PendingOutput, on_redelivery: Option<Redelivery>) -> Option<bool> {
    let how = match (output.lost, output.how) {
        (false, _) => return Some(false),
        (true, Some(how)) => how,
        (true, None) => strictest(output.redelivery, on_redelivery).unwrap_or_default(),
    };
    match how {
        Redelivery::Ask => None,
        Redelivery::Redo => Some(false),
        Redelivery::Verify => Some(true),
    }
}
