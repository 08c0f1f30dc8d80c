//! The work on one output: claim, handler, reset.

use std::any::Any;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use futures_util::FutureExt;

use crate::alarm::Alarm;
use crate::outputs::reset_of;
use crate::plc::Plc;
use crate::presence::RETRY;
use crate::types::output::{Claim, HandshakeResult, HandshakeStatus};
use crate::types::request::{Answer, RefusalCode, Request};
use crate::types::{BootId, CoordinateSystemNumber};

use super::output::AuxOutput;
use super::table::Boxed;

/// What the runner must know of the work while it goes on.
#[derive(Debug, Default)]
pub(super) struct Phase {
    answering: AtomicBool,
}

impl Phase {
    /// True once the handler has ended and its answer is on the way: then nothing is left to cancel.
    pub(super) fn is_answering(&self) -> bool {
        self.answering.load(Ordering::Relaxed)
    }
}

/// One output and who works on it.
pub(super) struct Work {
    pub(super) plc: Plc,
    pub(super) handler_id: Arc<str>,
    pub(super) boot_id: BootId,
    pub(super) cs: CoordinateSystemNumber,
    pub(super) output: AuxOutput,
    pub(super) handler: Boxed,
    pub(super) phase: Arc<Phase>,
}

impl Work {
    /// Claims, runs the handler, resets. Returns when nothing is left to do.
    pub(super) async fn run(self) {
        let claim = self.claim();
        let status = self
            .until_answered(|| Request::Claim(self.cs, Some(self.output.m()), claim.clone()))
            .await;
        if status != Some(HandshakeStatus::Accepted) {
            tracing::debug!(
                m = self.output.m(),
                seq = self.output.seq(),
                ?status,
                "output left to others"
            );
            return;
        }
        let result = self.call_handler().await;
        self.phase.answering.store(true, Ordering::Relaxed);
        let reset = reset_of(&self.boot_id, self.output.seq(), &self.handler_id, result.err());
        let status = self
            .until_answered(|| Request::Reset(self.cs, Some(self.output.m()), reset.clone()))
            .await;
        // a duplicate is this reset itself, sent twice because its answer was late
        if !matches!(
            status,
            Some(HandshakeStatus::Accepted | HandshakeStatus::Duplicate)
        ) {
            tracing::warn!(
                m = self.output.m(),
                seq = self.output.seq(),
                ?status,
                "the reset did not count"
            );
        }
    }

    pub(super) fn claim(&self) -> Claim {
        Claim {
            boot_id: self.boot_id.clone(),
            seq: self.output.seq(),
            handler_id: self.handler_id.to_string(),
        }
    }

    async fn call_handler(&self) -> Result<(), Alarm> {
        let work = async { (self.handler)(self.output.clone(), self.plc.clone()).await };
        let panicked = match AssertUnwindSafe(work).catch_unwind().await {
            Ok(result) => return result,
            Err(panicked) => panicked,
        };
        let text = format!(
            "the handler of M{} panicked: {}",
            self.output.m(),
            words(&*panicked)
        );
        tracing::error!("{text}");
        Err(Alarm::user(Alarm::CODE_OF_PANIC, text))
    }

    async fn until_answered(&self, request: impl Fn() -> Request) -> Option<HandshakeStatus> {
        until_answered(&self.plc, request).await
    }
}

/// Sends a claim or reset until it is answered; `None` when the machine refuses it for good.
pub(crate) async fn until_answered(plc: &Plc, request: impl Fn() -> Request) -> Option<HandshakeStatus> {
    loop {
        match plc.port().request(request()).await {
            Ok(Answer::Handshake(HandshakeResult { status, .. })) => return Some(status),
            Ok(answer) => {
                tracing::warn!(?answer, "an answer of another kind");
                return None;
            }
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

/// What a panic said.
pub(crate) fn words(panicked: &(dyn Any + Send)) -> &str {
    panicked
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| panicked.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("no text")
}
