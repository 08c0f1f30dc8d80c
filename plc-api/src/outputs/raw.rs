//! One output of the raw queue.

use std::sync::Arc;

use plc_protocol::alarm::Alarm;
use plc_protocol::error::Result;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::output::{HandshakeResult, OutputNotice};
use plc_protocol::types::request::TypedRequest;

use crate::claim::{OutputId, accepted};

use super::owner::OutputsOwner;

/// An output taken from the raw queue. Clones are handles to the same output.
#[derive(Debug, Clone)]
pub struct RawOutput {
    inner: Arc<OwnedOutput>,
}

#[derive(Debug)]
struct OwnedOutput {
    owner: Arc<OutputsOwner>,
    id: OutputId,
    notice: OutputNotice,
    verify: bool,
}

impl Drop for OwnedOutput {
    fn drop(&mut self) {
        if self.owner.forget(&self.id) {
            tracing::warn!(
                m = self.notice.m,
                seq = self.notice.seq,
                "an output was claimed and dropped without an answer; it stays claimed while its queue exists"
            );
        }
    }
}

impl RawOutput {
    pub(super) fn new(owner: &Arc<OutputsOwner>, id: OutputId, notice: OutputNotice, verify: bool) -> Self {
        let owner = Arc::clone(owner);
        owner.hold(&id, false);
        Self {
            inner: Arc::new(OwnedOutput {
                owner,
                id,
                notice,
                verify,
            }),
        }
    }

    /// Returns the permanent identifier of this output, unique across all starts of the runtime. If work must
    /// be done only once, record the work under this identifier. A redelivered output has the same
    /// identifier.
    pub fn id(&self) -> &str {
        &self.inner.notice.id
    }

    /// Returns the coordinate system that issued this output.
    pub fn coordinate_system(&self) -> CoordinateSystemNumber {
        self.inner.id.cs
    }

    /// Returns the M number, the parameters, the NC program and the line of this output.
    pub fn notice(&self) -> &OutputNotice {
        &self.inner.notice
    }

    /// Returns true if an earlier handler may have started the work, and the redelivery is `verify`. In this
    /// case check the machine first. Returns false on the first delivery, and if the redelivery is `redo`.
    pub fn redelivered(&self) -> bool {
        self.inner.verify
    }

    /// Claims the output: from now on no other handler can reset the output. If the claim is lost with the
    /// connection, this program repeats the claim, unless another handler has claimed the output meanwhile.
    ///
    /// # Errors
    /// [`Error::Handshake`](crate::Error::Handshake) if another handler owns the output, or the output is no
    /// longer open.
    pub async fn claim(&self) -> Result<()> {
        let OwnedOutput {
            owner, id, notice, ..
        } = &*self.inner;
        self.send(id.claim(notice.m, owner.by()), true).await
    }

    /// Resets the output: the NC program continues. The reset does not need a claim.
    ///
    /// # Errors
    /// [`Error::Handshake`](crate::Error::Handshake) if the machine does not accept the reset.
    pub async fn reset(&self) -> Result<()> {
        self.answer(None).await
    }

    /// Ends the output as failed: the alarm stops the NC program.
    ///
    /// # Errors
    /// [`Error::Handshake`](crate::Error::Handshake) if the machine does not accept the message.
    pub async fn fail(&self, alarm: Alarm) -> Result<()> {
        self.answer(Some(alarm)).await
    }

    async fn answer(&self, alarm: Option<Alarm>) -> Result<()> {
        let OwnedOutput {
            owner, id, notice, ..
        } = &*self.inner;
        self.send(id.reset(notice.m, owner.by(), alarm), false).await
    }

    async fn send(&self, request: impl TypedRequest<Answer = HandshakeResult>, claims: bool) -> Result<()> {
        let OwnedOutput {
            owner, id, notice, ..
        } = &*self.inner;
        let answer = owner.plc().request(request).await?;
        accepted(notice.m, notice.seq, Some(answer))?;
        owner.hold(id, claims);
        Ok(())
    }
}
