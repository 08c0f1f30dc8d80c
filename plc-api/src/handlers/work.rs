//! The work on one output: claim, handler, reset.

use std::panic::AssertUnwindSafe;

use futures_util::FutureExt;

use crate::alarm::Alarm;
use crate::claim::until_answered;
use crate::text::panic_text;
use crate::types::output::HandshakeStatus;

use super::output::AuxOutput;
use super::table::Boxed;

/// Claims, runs the handler, resets. Returns when nothing is left to do.
pub(super) async fn work(output: AuxOutput, handler: Boxed) {
    let (plc, m, seq) = (output.plc(), output.m(), output.seq());
    let status = until_answered(plc, output.id().claim(m, output.handler_id())).await;
    if status != Some(HandshakeStatus::Accepted) {
        tracing::debug!(m, seq, ?status, "output left to others");
        return;
    }
    let result = call(&output, &handler).await;
    output.set_answering();
    let reset = output.id().reset(m, output.handler_id(), result.err());
    let status = until_answered(plc, reset).await;
    // a duplicate is this reset itself, sent twice because its answer was late
    if !matches!(
        status,
        Some(HandshakeStatus::Accepted | HandshakeStatus::Duplicate)
    ) {
        tracing::warn!(m, seq, ?status, "the reset did not count");
    }
}

async fn call(output: &AuxOutput, handler: &Boxed) -> Result<(), Alarm> {
    let work = output.worked_on(async { handler(output.clone(), output.plc().clone()).await });
    let panicked = match AssertUnwindSafe(work).catch_unwind().await {
        Ok(result) => return result,
        Err(panicked) => panicked,
    };
    let text = format!(
        "the handler of M{} panicked: {}",
        output.m(),
        panic_text(&*panicked)
    );
    tracing::error!("{text}");
    Err(Alarm::user(Alarm::CODE_OF_PANIC, text))
}
