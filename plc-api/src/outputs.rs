//! The raw queue of outputs.

mod owner;
mod raw;

pub use raw::RawOutput;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use futures_util::FutureExt;
use plc_protocol::error::{Error, Result};
use plc_protocol::hub::{Filter, Subscription};
use plc_protocol::names::mistake_in_id;
use plc_protocol::types::m_code::M_CODE_MAX;
use plc_protocol::types::message::Message;
use plc_protocol::types::output::{OutputState, PendingOutput, Redelivery};

use crate::claim::{OutputId, decide_start};
use crate::handler_session::{HandlerDeclaration, HandlerSession, OpenOutputs};
use crate::m_codes::MCodes;
use crate::plc::Plc;

use owner::OutputsOwner;

/// The raw queue: unclaimed outputs of all coordinate systems. Outputs of one coordinate system are returned
/// in their order.
///
/// The first call of [`Outputs::next`] registers the queue as a handler with the machine. If the queue and
/// all outputs from it are dropped, the process ends, or the connection breaks, the machine releases the
/// claims of the queue, and the NC program waits with reason `HANDLER_LOST`. While the queue exists, a
/// claimed [`RawOutput`] that is dropped without an answer stays claimed until its time limit, an operator, a
/// stop or a reset ends the output.
///
/// The queue needs a tokio runtime. Over MQTT each connection has one handler: use another connection for a
/// [`SequenceProgram`](crate::SequenceProgram).
///
/// ```
/// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
/// # let fake = plc_api::fake::FakePort::new([1]);
/// # fake.issue_output(1, 100, plc_api::Params::default());
/// # let plc = fake.plc();
/// let mut outputs = plc.outputs().on(100);
/// let output = outputs.next().await?;
/// output.claim().await?;
/// // ... work ...
/// output.reset().await?;
/// # Ok(()) }
/// ```
#[derive(Debug)]
pub struct Outputs {
    plc: Plc,
    handler_id: Option<String>,
    // `None` means all M codes
    codes: Option<BTreeSet<u16>>,
    on_redelivery: Option<Redelivery>,
    takes_over: bool,
    owner: Option<Arc<OutputsOwner>>,
    subscription: Subscription,
    open: OpenOutputs,
    // for each output: the attempt that the queue returned last
    given: BTreeMap<OutputId, u32>,
}

impl Plc {
    /// Returns the raw queue of the outputs of all coordinate systems, for programs that have their own loop.
    /// Most programs use a [`SequenceProgram`](crate::SequenceProgram) instead.
    pub fn outputs(&self) -> Outputs {
        Outputs::new(self)
    }
}

impl Outputs {
    fn new(plc: &Plc) -> Self {
        Self {
            subscription: plc.port().subscribe(Filter::Handshake),
            plc: plc.clone(),
            handler_id: None,
            codes: None,
            on_redelivery: None,
            takes_over: false,
            owner: None,
            open: OpenOutputs::default(),
            given: BTreeMap::new(),
        }
    }

    /// Limits the queue to these M codes, and registers them with the machine. Without this call the queue
    /// receives all outputs without an owner, and the machine knows no handler for the M codes of these
    /// outputs: the `unhandled` setting of these M codes must be `wait`.
    #[must_use]
    pub fn on<By>(mut self, codes: impl MCodes<By>) -> Self {
        let within = codes.m_codes().into_iter().flatten();
        let within = within.take_while(|m| *m <= M_CODE_MAX);
        self.codes.get_or_insert_default().extend(within);
        self
    }

    /// Sets the handler name for claims and resets: 1 to 64 characters without `/ + #`. Only one queue or
    /// program may use a name at a time. Default: the user name of the connection, otherwise a random name.
    #[must_use]
    pub fn handler_id(mut self, handler_id: impl Into<String>) -> Self {
        self.handler_id = Some(handler_id.into());
        self
    }

    /// Sets the treatment of an output that loses its handler before the reset. The stricter of this setting
    /// and the configuration of the M code applies. If neither is set, the queue does not return the output
    /// until an operator decides.
    #[must_use]
    pub fn on_redelivery(mut self, on_redelivery: Redelivery) -> Self {
        self.on_redelivery = Some(on_redelivery);
        self
    }

    /// Replaces an online queue or program of the same name, which the machine notifies. Without this call
    /// the machine refuses the second queue or program of a name.
    #[must_use]
    pub fn take_over(mut self) -> Self {
        self.takes_over = true;
        self
    }

    /// Waits for the next output without an owner, and returns it. An output that was dropped without a claim
    /// is returned again when the machine publishes it again. Cancellation safe.
    ///
    /// # Errors
    /// [`Error::Closed`] if the machine has ended the connection for good; [`Error::TakenOver`] if another
    /// queue or program of this name has taken over; [`Error::SequenceProgram`] if the name is invalid;
    /// [`Error::Refused`] if the machine refuses the presence of the queue, or the connection already serves
    /// another sequence program.
    pub async fn next(&mut self) -> Result<RawOutput> {
        let owner = self.owner()?;
        owner.wait_until_known().await?;
        loop {
            // reads all waiting messages first, so that an output that was cancelled meanwhile is not
            // returned
            while let Some(message) = self.subscription.next().now_or_never() {
                self.on_message(&message.ok_or(Error::Closed)?);
            }
            if let Some(output) = self.take_next(&owner) {
                return Ok(output);
            }
            tokio::select! {
                message = self.subscription.next() => self.on_message(&message.ok_or(Error::Closed)?),
                error = owner.wait_until_refused() => return Err(error),
            }
        }
    }

    fn owner(&mut self) -> Result<Arc<OutputsOwner>> {
        if let Some(owner) = &self.owner {
            return Ok(Arc::clone(owner));
        }
        let id = self.handler_id.clone();
        let id = id.unwrap_or_else(|| self.plc.default_handler_id());
        if let Some(mistake) = mistake_in_id(&id) {
            return Err(Error::SequenceProgram(mistake));
        }
        let codes = self.codes.iter().flatten().map(|&m| (None, m)).collect();
        let said = HandlerDeclaration {
            codes,
            validates: false,
            takes_over: self.takes_over,
            redelivery: self.on_redelivery,
            ..HandlerDeclaration::default()
        };
        let presence = HandlerSession::new(&self.plc, id.into(), said);
        let owner = Arc::new(OutputsOwner::start(presence));
        Ok(Arc::clone(self.owner.insert(owner)))
    }

    fn on_message(&mut self, message: &Arc<Message>) {
        if self.open.on_message(message).is_some() {
            let open: BTreeSet<_> = self.open.outputs().map(|(id, _)| id).collect();
            self.given.retain(|id, _| open.contains(id));
        }
    }

    fn take_next(&mut self, owner: &Arc<OutputsOwner>) -> Option<RawOutput> {
        let Self { open, given, .. } = &*self;
        let is_new = |id: &OutputId, output: &PendingOutput| {
            given.get(id) != Some(&output.output.attempt) && !owner.holds(id)
        };
        let (id, output, verify) = open.outputs().find_map(|(id, output)| {
            let verify = self.decide_offer(output).filter(|_| is_new(&id, output))?;
            Some((id, output.output.clone(), verify))
        })?;
        self.given.insert(id.clone(), output.attempt);
        Some(RawOutput::new(owner, id, output, verify))
    }

    /// Returns `None` if the queue must not return an output. Otherwise returns true if the receiver must
    /// check the machine before it works.
    fn decide_offer(&self, output: &PendingOutput) -> Option<bool> {
        let m = output.output.m;
        let is_ours = self.codes.as_ref().is_none_or(|codes| codes.contains(&m));
        if output.state != OutputState::Output || !is_ours {
            return None;
        }
        decide_start(output, self.on_redelivery)
    }
}
