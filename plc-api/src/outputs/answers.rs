//! What is said of an output at its end, and whether it counted.

use crate::alarm::Alarm;
use crate::error::{Error, Result};
use crate::plc::unexpected;
use crate::types::BootId;
use crate::types::output::{HandshakeStatus, Reset, ResetResult};
use crate::types::request::Answer;

/// Whether the machine has accepted what was said of an output, as far as its answer tells.
pub(crate) fn accepted(m: u16, seq: u64, answer: &Answer) -> Result<()> {
    match answer {
        Answer::Handshake(result) if result.status == HandshakeStatus::Accepted => Ok(()),
        Answer::Handshake(result) => Err(Error::Handshake {
            m,
            seq,
            status: result.status,
        }),
        Answer::Done => Ok(()),
        other => Err(unexpected(other)),
    }
}

/// The reset that says how a handler ended.
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
