//! One output of the raw queue.

use std::sync::Arc;

use crate::alarm::Alarm;
use crate::claim::{OutputId, accepted};
use crate::error::Result;
use crate::types::CoordinateSystemNumber;
use crate::types::output::{HandshakeResult, OutputNotice};
use crate::types::request::TypedRequest;

use super::owner::Owner;

/// An output taken from the raw queue. Clones are handles to the same output.
#[derive(Debug, Clone)]
pub struct RawOutput {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    owner: Arc<Owner>,
    id: OutputId,
    notice: OutputNotice,
    verify: bool,
}

impl Drop for Inner {
    fn drop(&mut self) {
        if self.owner.forget(&self.id) {
            tracing::warn!(
                m = self.notice.m,
                seq = self.notice.seq,
                "an output was claimed and dropped without an answer; it stays claimed while its queue is there"
            );
        }
    }
}

impl RawOutput {
    pub(super) fn new(owner: &Arc<Owner>, id: OutputId, notice: OutputNotice, verify: bool) -> Self {
        let owner = Arc::clone(owner);
        owner.hold(&id, false);
        Self {
            inner: Arc::new(Inner {
                owner,
                id,
                notice,
                verify,
            }),
        }
    }

    /// Identifies this output permanently, across all starts of the runtime: note under it what must be done once. A redelivered
    /// output has the same name.
    pub fn id(&self) -> &str {
        &self.inner.notice.id
    }

    /// Coordinate system that put it out.
    pub fn coordinate_system(&self) -> CoordinateSystemNumber {
        self.inner.id.cs
    }

    /// M number, parameters, program and line.
    pub fn notice(&self) -> &OutputNotice {
        &self.inner.notice
    }

    /// True if the work may have been started before, and `verify` was chosen: check the machine first. False on the
    /// first delivery, and if `redo` was chosen.
    pub fn redelivered(&self) -> bool {
        self.inner.verify
    }

    /// Claims the output: from now on nobody else can reset it. A claim that was lost with the connection is repeated
    /// automatically, unless somebody else has claimed the output.
    ///
    /// # Errors
    /// [`Error::Handshake`](crate::Error::Handshake) if another handler owns it, or it is closed.
    pub async fn claim(&self) -> Result<()> {
        let Inner {
            owner, id, notice, ..
        } = &*self.inner;
        self.send(id.claim(notice.m, owner.by()), true).await
    }

    /// Resets the output: the program continues. No claim is needed before.
    ///
    /// # Errors
    /// [`Error::Handshake`](crate::Error::Handshake) if the reset is not accepted.
    pub async fn reset(&self) -> Result<()> {
        self.answer(None).await
    }

    /// Fails the output: the alarm stops the program.
    ///
    /// # Errors
    /// [`Error::Handshake`](crate::Error::Handshake) if it is not accepted.
    pub async fn fail(&self, alarm: Alarm) -> Result<()> {
        self.answer(Some(alarm)).await
    }

    async fn answer(&self, alarm: Option<Alarm>) -> Result<()> {
        let Inner {
            owner, id, notice, ..
        } = &*self.inner;
        self.send(id.reset(notice.m, owner.by(), alarm), false).await
    }

    async fn send(&self, request: impl TypedRequest<Answer = HandshakeResult>, claims: bool) -> Result<()> {
        let Inner {
            owner, id, notice, ..
        } = &*self.inner;
        let answer = owner.plc().request(request).await?;
        accepted(notice.m, notice.seq, Some(answer))?;
        owner.hold(id, claims);
        Ok(())
    }
}
