//! Answers of the ledger to requests about outputs.

use crate::alarm::{Alarm, USER_CODE_MAX};
use crate::text::cut;
use crate::types::BootId;
use crate::types::handler::{INSTANCE_MAX, is_own_instance};
use crate::types::ids::CLIENT_ID_MAX;
use crate::types::output::{HandshakeResult, HandshakeStatus, OutputAct, Reset, ResetResult};
use crate::types::refusal::{Refusal, RefusalCode};

use super::identity::Denial;

pub(super) fn status_of<T>(changed: &Result<T, Denial>) -> HandshakeStatus {
    match changed {
        Ok(_) => HandshakeStatus::Accepted,
        Err((status, _)) => *status,
    }
}

/// Returns the answer to a request about an output.
pub(super) fn result_of(
    of: OutputAct,
    (seq, handler_id, instance): (u64, &str, &Option<String>),
    changed: &Result<(), Denial>,
) -> HandshakeResult {
    let mut handler_id = handler_id.to_owned();
    cut(&mut handler_id, CLIENT_ID_MAX);
    let own = instance.as_ref().filter(|named| is_own_instance(named));
    HandshakeResult {
        of: Some(of),
        instance: own.map(|named| {
            let mut named = named.clone();
            cut(&mut named, INSTANCE_MAX);
            named
        }),
        text: changed.as_ref().err().and_then(|(_, text)| text.clone()),
        ..HandshakeResult::new(seq, handler_id, status_of(changed))
    }
}

/// Refuses a fault whose code is out of range. Reason: the alarm number is 10000 + code, and a larger code
/// would give the number of another alarm.
pub(super) fn check_code(reset: &Reset) -> Result<(), Refusal> {
    match reset.code {
        Some(code) if code > USER_CODE_MAX => Err(Refusal::new(
            RefusalCode::Invalid,
            format!("reset: code {code} is not a code of a handler alarm; write 0 to {USER_CODE_MAX}"),
        )),
        _ => Ok(()),
    }
}

/// Returns the alarm for a reset by which a handler reports a fault.
pub(super) fn fault_alarm(m: u16, reset: &Reset) -> Alarm {
    let text = reset.text.clone().unwrap_or_else(|| {
        let mut handler_id = reset.handler_id.clone();
        cut(&mut handler_id, CLIENT_ID_MAX);
        format!("M{m} failed; {handler_id} gave no reason")
    });
    Alarm::user(reset.code.unwrap_or(0), text)
}

/// Creates the reset with the result of a handler; `alarm` is the fault, if the handler failed.
pub fn reset_of(boot_id: &BootId, seq: u64, handler_id: &str, alarm: Option<Alarm>) -> Reset {
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
        instance: None,
    }
}
