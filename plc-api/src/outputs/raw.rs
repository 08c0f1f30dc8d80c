//! One output of the raw queue.

use std::sync::Arc;

use crate::alarm::Alarm;
use crate::error::Result;
use crate::types::CoordinateSystemNumber;
use crate::types::output::{Claim, OutputNotice};
use crate::types::request::Request;

use super::owner::{Key, Owner};
use super::{accepted, reset_of};

/// An output taken from the raw queue. Cloning gives another handle to the same output.
#[derive(Debug, Clone)]
pub struct RawOutput {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    owner: Arc<Owner>,
    key: Key,
    notice: OutputNotice,
    verify: bool,
}

impl Drop for Inner {
    fn drop(&mut self) {
        if self.owner.forget(&self.key) {
            tracing::warn!(
                m = self.notice.m,
                seq = self.notice.seq,
                "an output was claimed and dropped without an answer; it stays claimed while its queue is there"
            );
        }
    }
}

impl RawOutput {
    pub(super) fn new(owner: &Arc<Owner>, key: Key, notice: OutputNotice, verify: bool) -> Self {
        let owner = Arc::clone(owner);
        owner.hold(&key, false);
        Self {
            inner: Arc::new(Inner {
                owner,
                key,
                notice,
                verify,
            }),
        }
    }

    /// Coordinate system that made it.
    pub fn coordinate_system(&self) -> CoordinateSystemNumber {
        self.inner.key.1
    }

    /// M number, parameters, program and line.
    pub fn notice(&self) -> &OutputNotice {
        &self.inner.notice
    }

    /// True when another handler, or this one before it died, may already have done part of the work and `verify` was
    /// chosen: look at the machine first. False on the first delivery, and when `redo` was chosen.
    pub fn redelivered(&self) -> bool {
        self.inner.verify
    }

    /// Takes the output: nobody else resets it from now on. A claim that a lost connection has given back is made
    /// again by itself where nobody else has taken the output.
    ///
    /// # Errors
    /// [`Error::Handshake`](crate::Error::Handshake) when it is not to be had: another handler owns it, or it is closed.
    pub async fn claim(&self) -> Result<()> {
        let (owner, (boot_id, cs, seq)) = (&self.inner.owner, &self.inner.key);
        let claim = Claim {
            boot_id: boot_id.clone(),
            seq: *seq,
            handler_id: owner.handler_id().to_owned(),
        };
        self.accepted(Request::Claim(*cs, Some(self.inner.notice.m), claim))
            .await?;
        owner.hold(&self.inner.key, true);
        Ok(())
    }

    /// Resets the output: the program goes on. Claims it first if nobody has.
    ///
    /// # Errors
    /// [`Error::Handshake`](crate::Error::Handshake) when the reset does not count.
    pub async fn reset(&self) -> Result<()> {
        self.answer(None).await
    }

    /// Fails the output: the alarm stops the program.
    ///
    /// # Errors
    /// [`Error::Handshake`](crate::Error::Handshake) when it does not count.
    pub async fn fail(&self, alarm: Alarm) -> Result<()> {
        self.answer(Some(alarm)).await
    }

    async fn answer(&self, alarm: Option<Alarm>) -> Result<()> {
        let (owner, (boot_id, cs, seq)) = (&self.inner.owner, &self.inner.key);
        let reset = reset_of(boot_id, *seq, owner.handler_id(), alarm);
        self.accepted(Request::Reset(*cs, Some(self.inner.notice.m), reset))
            .await?;
        owner.hold(&self.inner.key, false);
        Ok(())
    }

    async fn accepted(&self, request: Request) -> Result<()> {
        let answer = self.inner.owner.plc().request(request).await?;
        accepted(self.inner.notice.m, self.inner.notice.seq, &answer)
    }
}
