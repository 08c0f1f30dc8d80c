//! The raw queue of outputs.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use crate::alarm::Alarm;
use crate::error::{Error, Result};
use crate::hub::{Filter, Subscription};
use crate::plc::{Plc, unexpected};
use crate::types::message::{Message, Payload};
use crate::types::output::{
    Claim, HandshakeStatus, OutputNotice, OutputState, Pending, PendingOutput, Reset, ResetResult,
};
use crate::types::request::{Answer, Request};
use crate::types::topic::{CsTopic, Topic};
use crate::types::{BootId, CoordinateSystemNumber};

/// Unclaimed outputs of all coordinate systems, in order of each coordinate system.
///
/// It does not announce what it handles: the runtime's `unhandled` setting must be `wait` for M codes served this way.
/// So the machine does not hear either that it has gone: what it has claimed then stays claimed until the M code's
/// `timeout_ms`, an operator's reset, a stop or a reset of the run ends it. Handlers of a
/// [`SequenceProgram`](crate::SequenceProgram) give their claims back.
///
/// ```
/// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
/// # let fake = plc_api::fake::FakePort::new([1]);
/// # fake.put_out(1, 100, plc_api::Params::default());
/// # let plc = fake.plc();
/// let mut outputs = plc.outputs();
/// let output = outputs.next().await?;
/// output.claim().await?;
/// // ... work ...
/// output.reset().await?;
/// # Ok(()) }
/// ```
#[derive(Debug)]
pub struct Outputs {
    plc: Plc,
    handler_id: Arc<str>,
    subscription: Subscription,
    presence: Option<BootId>,
    pending: BTreeMap<CoordinateSystemNumber, (BootId, Pending)>,
    // the attempt that was given out last
    given: BTreeMap<(CoordinateSystemNumber, u64), u32>,
    ready: VecDeque<RawOutput>,
}

impl Outputs {
    pub(crate) fn new(plc: &Plc, handler_id: String) -> Self {
        Self {
            subscription: plc.port().subscribe(Filter::Handshake),
            plc: plc.clone(),
            handler_id: handler_id.into(),
            presence: None,
            pending: BTreeMap::new(),
            given: BTreeMap::new(),
            ready: VecDeque::new(),
        }
    }

    /// Claims and resets by this name instead of a random one: 1 to 64 characters.
    #[must_use]
    pub fn handler_id(mut self, handler_id: impl Into<String>) -> Self {
        self.handler_id = handler_id.into().into();
        self
    }

    /// The next output that nobody owns; again when it is published again. Safe to drop while it waits.
    ///
    /// # Errors
    /// [`Error::Closed`] when the machine's side has ended.
    pub async fn next(&mut self) -> Result<RawOutput> {
        loop {
            if let Some(output) = self.ready.pop_front() {
                return Ok(output);
            }
            let message = self.subscription.next().await.ok_or(Error::Closed)?;
            self.take(&message);
        }
    }

    fn take(&mut self, message: &Message) {
        match (&message.topic, &message.payload) {
            (_, Payload::Presence(presence)) => {
                let boot = presence.online.then(|| message.boot_id.clone());
                if boot != self.presence {
                    self.given.clear();
                }
                self.presence = boot;
            }
            (Topic::CoordinateSystem(cs, CsTopic::Pending), Payload::Pending(pending)) => {
                self.pending
                    .insert(*cs, (message.boot_id.clone(), pending.clone()));
            }
            _ => return,
        }
        let Some(boot_id) = self.presence.clone() else {
            return;
        };
        for (&cs, (pending_boot, pending)) in &self.pending {
            if *pending_boot != boot_id {
                continue;
            }
            let open = |seq: u64| pending.outputs.iter().any(|output| output.output.seq == seq);
            self.given
                .retain(|(given_cs, seq), _| *given_cs != cs || open(*seq));
            for output in &pending.outputs {
                let attempt = output.output.attempt;
                if output.state == OutputState::Output
                    && self.given.insert((cs, output.output.seq), attempt) != Some(attempt)
                {
                    let raw = RawOutput::new(&self.plc, &self.handler_id, &boot_id, cs, output);
                    self.ready.push_back(raw);
                }
            }
        }
    }
}

/// An output taken from the raw queue.
#[derive(Debug, Clone)]
pub struct RawOutput {
    plc: Plc,
    handler_id: Arc<str>,
    boot_id: BootId,
    cs: CoordinateSystemNumber,
    notice: OutputNotice,
}

impl RawOutput {
    fn new(
        plc: &Plc,
        handler_id: &Arc<str>,
        boot_id: &BootId,
        cs: CoordinateSystemNumber,
        pending: &PendingOutput,
    ) -> Self {
        Self {
            plc: plc.clone(),
            handler_id: Arc::clone(handler_id),
            boot_id: boot_id.clone(),
            cs,
            notice: pending.output.clone(),
        }
    }

    /// Coordinate system that made it.
    pub fn coordinate_system(&self) -> CoordinateSystemNumber {
        self.cs
    }

    /// M number, parameters, program and line.
    pub fn notice(&self) -> &OutputNotice {
        &self.notice
    }

    /// Takes the output: nobody else resets it from now on.
    ///
    /// # Errors
    /// [`Error::Handshake`] when it is not to be had: another handler owns it, or it is closed.
    pub async fn claim(&self) -> Result<()> {
        let claim = Claim {
            boot_id: self.boot_id.clone(),
            seq: self.notice.seq,
            handler_id: self.handler_id.to_string(),
        };
        self.accepted(Request::Claim(self.cs, Some(self.notice.m), claim))
            .await
    }

    /// Resets the output: the program goes on. Claims it first if nobody has.
    ///
    /// # Errors
    /// [`Error::Handshake`] when the reset does not count.
    pub async fn reset(&self) -> Result<()> {
        self.answer(None).await
    }

    /// Fails the output: the alarm stops the program.
    ///
    /// # Errors
    /// [`Error::Handshake`] when it does not count.
    pub async fn fail(&self, alarm: Alarm) -> Result<()> {
        self.answer(Some(alarm)).await
    }

    async fn answer(&self, alarm: Option<Alarm>) -> Result<()> {
        let reset = reset_of(&self.boot_id, self.notice.seq, &self.handler_id, alarm);
        self.accepted(Request::Reset(self.cs, Some(self.notice.m), reset))
            .await
    }

    async fn accepted(&self, request: Request) -> Result<()> {
        let answer = self.plc.request(request).await?;
        accepted(self.notice.m, self.notice.seq, &answer)
    }
}

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
