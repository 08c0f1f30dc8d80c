//! One output in the hands of its handler.

use std::sync::Arc;

use tokio::sync::watch;

use crate::error::Result;
use crate::plc::Plc;
use crate::types::output::{CancelReason, OutputNotice, Params, ProgressReport};
use crate::types::request::Request;
use crate::types::{BootId, CoordinateSystemNumber};

/// An auxiliary function output that a handler works on. Cloning gives another handle to the same output.
#[derive(Debug, Clone)]
pub struct AuxOutput {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    plc: Plc,
    handler_id: Arc<str>,
    boot_id: BootId,
    cs: CoordinateSystemNumber,
    notice: OutputNotice,
    verify: bool,
    cancellation: Cancellation,
}

impl AuxOutput {
    pub(super) fn new(
        plc: &Plc,
        handler_id: &Arc<str>,
        (boot_id, cs): (&BootId, CoordinateSystemNumber),
        notice: &OutputNotice,
        verify: bool,
        cancellation: Cancellation,
    ) -> Self {
        let inner = Inner {
            plc: plc.clone(),
            handler_id: Arc::clone(handler_id),
            boot_id: boot_id.clone(),
            cs,
            notice: notice.clone(),
            verify,
            cancellation,
        };
        Self {
            inner: Arc::new(inner),
        }
    }

    pub(crate) fn plc(&self) -> &Plc {
        &self.inner.plc
    }

    /// M number, 0 to 191.
    pub fn m(&self) -> u16 {
        self.inner.notice.m
    }

    /// Sequence number: names this output within the boot and the coordinate system.
    pub fn seq(&self) -> u64 {
        self.inner.notice.seq
    }

    /// VA to VH.
    pub fn params(&self) -> &Params {
        &self.inner.notice.params
    }

    /// Coordinate system that made it.
    pub fn coordinate_system(&self) -> CoordinateSystemNumber {
        self.inner.cs
    }

    /// Number of the program that it stands in.
    pub fn program(&self) -> u16 {
        self.inner.notice.program
    }

    /// Line of the source file, from 1.
    pub fn line(&self) -> u32 {
        self.inner.notice.line
    }

    /// The program run that made it.
    pub fn run_id(&self) -> &str {
        &self.inner.notice.run_id
    }

    /// True when another handler, or this one before it died, may already have done part of the work and `verify` was
    /// chosen: look at the machine first. False on the first delivery, and when `redo` was chosen.
    pub fn redelivered(&self) -> bool {
        self.inner.verify
    }

    /// Tells how far the work is; shown on panels while the program waits. `text` has at most 200 characters,
    /// `percent` is 0 to 100 or `None`. It shows nothing when the output is no longer this handler's.
    ///
    /// # Errors
    /// The machine cannot be reached.
    pub async fn progress(&self, text: impl Into<String>, percent: impl Into<Option<f64>>) -> Result<()> {
        let report = ProgressReport {
            boot_id: self.inner.boot_id.clone(),
            seq: self.seq(),
            handler_id: self.inner.handler_id.to_string(),
            text: text.into(),
            percent: percent.into(),
        };
        let request = Request::Progress(self.inner.cs, Some(self.m()), report);
        self.inner.plc.request(request).await.map(|_| ())
    }

    /// Tells when and why this output is cancelled. The handler's future is dropped then; what it has started
    /// elsewhere, and what its destructors do, can look here.
    pub fn cancellation(&self) -> Cancellation {
        self.inner.cancellation.clone()
    }
}

/// Tells that an output has been cancelled. Cloning gives another handle.
#[derive(Debug, Clone)]
pub struct Cancellation {
    state: watch::Receiver<CancelState>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct CancelState {
    cancelled: bool,
    reason: Option<CancelReason>,
}

impl Cancellation {
    pub(super) fn new() -> (watch::Sender<CancelState>, Self) {
        let (sender, state) = watch::channel(CancelState::default());
        (sender, Self { state })
    }

    /// True once the output is cancelled.
    pub fn is_cancelled(&self) -> bool {
        self.state.borrow().cancelled
    }

    /// Why it was cancelled; `None` while it is not, and when the reason was lost with a connection.
    pub fn reason(&self) -> Option<CancelReason> {
        self.state.borrow().reason
    }

    /// Waits until the output is cancelled or has ended otherwise.
    pub(crate) async fn ended(&self) {
        let mut state = self.state.clone();
        let _closed = state.wait_for(|state| state.cancelled).await.is_err();
    }

    /// Waits until the output is cancelled; for ever when it ends otherwise.
    pub async fn cancelled(&self) -> Option<CancelReason> {
        let mut state = self.state.clone();
        if let Ok(state) = state.wait_for(|state| state.cancelled).await {
            return state.reason;
        }
        std::future::pending().await
    }
}

pub(super) fn cancel(sender: &watch::Sender<CancelState>, reason: Option<CancelReason>) {
    sender.send_replace(CancelState {
        cancelled: true,
        reason,
    });
}
