//! Claims and resets of an output, each repeated until the machine has answered.

use crate::alarm::Alarm;
use crate::error::{Error, Result};
use crate::plc::Plc;
use crate::types::message::Message;
use crate::types::output::{
    Claim, HandshakeResult, HandshakeStatus, PendingOutput, Redelivery, Reset, ResetResult,
};
use crate::types::refusal::RefusalCode;
use crate::types::request::{TypedRequest, typed};
use crate::types::{BootId, CoordinateSystemNumber};

pub(crate) use crate::port::RETRY;

/// Identifies an output across boots.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct OutputId {
    pub(crate) boot_id: BootId,
    pub(crate) cs: CoordinateSystemNumber,
    pub(crate) seq: u64,
}

impl OutputId {
    /// An output in a `pending` message of a coordinate system.
    pub(crate) fn of(message: &Message, cs: CoordinateSystemNumber, output: &PendingOutput) -> Self {
        Self {
            boot_id: message.boot_id.clone(),
            cs,
            seq: output.output.seq,
        }
    }

    pub(crate) fn claim(&self, m: u16, handler_id: &str) -> typed::Claim {
        let claim = Claim {
            boot_id: self.boot_id.clone(),
            seq: self.seq,
            handler_id: handler_id.to_owned(),
        };
        typed::Claim(self.cs, Some(m), claim)
    }

    pub(crate) fn reset(&self, m: u16, handler_id: &str, alarm: Option<Alarm>) -> typed::Reset {
        let reset = reset_of(&self.boot_id, self.seq, handler_id, alarm);
        typed::Reset(self.cs, Some(m), reset)
    }
}

/// The reset that reports how a handler has ended.
pub(crate) fn reset_of(boot_id: &BootId, seq: u64, handler_id: &str, alarm: Option<Alarm>) -> Reset {
    let (result, code, text) = match alarm {
        None => (ResetResult::Ok, None, None),
        Some(alarm) => (
            ResetResult::Fault,
            Some(alarm.user_code().unwrap_or(0)),
            Some(alarm.text),
        ),
    };
    Reset {
        boot_id: boot_id.clone(),
        seq,
        handler_id: handler_id.to_owned(),
        result,
        code,
        text,
        force: None,
    }
}

/// Checks the answer to a claim or reset; `None`, no answer, passes.
pub(crate) fn accepted(m: u16, seq: u64, answer: Option<HandshakeResult>) -> Result<()> {
    match answer.map(|result| result.status) {
        None | Some(HandshakeStatus::Accepted) => Ok(()),
        Some(status) => Err(Error::Handshake { m, seq, status }),
    }
}

/// Repeats a claim or reset until it is answered; `None` if the machine refuses it for good.
pub(crate) async fn until_answered(
    plc: &Plc,
    request: impl TypedRequest<Answer = HandshakeResult> + Clone,
) -> Option<HandshakeStatus> {
    loop {
        match plc.port().ask(request.clone()).await {
            Ok(HandshakeResult { status, .. }) => return Some(status),
            Err(refusal) if refusal.code == RefusalCode::Unavailable => {
                tracing::warn!(%refusal, "claim or reset not answered yet");
                plc.sleep(RETRY).await;
            }
            Err(refusal) => {
                tracing::warn!(%refusal, "claim or reset refused");
                return None;
            }
        }
    }
}

/// Whether the handler starts on an output, and then whether it must check the machine first; `None` leaves it to an
/// operator.
pub(crate) fn taken_up(lost: bool, told: Option<Redelivery>, on_redelivery: Redelivery) -> Option<bool> {
    match (lost, told) {
        (_, Some(Redelivery::Redo)) | (false, _) => Some(false),
        (_, Some(Redelivery::Verify)) => Some(true),
        (true, _) => match on_redelivery {
            Redelivery::Ask => None,
            Redelivery::Redo => Some(false),
            Redelivery::Verify => Some(true),
        },
    }
}
