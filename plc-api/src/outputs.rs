//! The raw queue of outputs.

mod owner;
mod raw;

pub use raw::RawOutput;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use futures_util::FutureExt;

use crate::claim::{OutputId, taken_up};
use crate::error::{Error, Result};
use crate::hub::{Filter, Subscription};
use crate::m_codes::{M_CODE_MAX, MCodes};
use crate::names::mistake_in_id;
use crate::plc::Plc;
use crate::presence::{Change, OpenOutputs, Presence, shown};
use crate::types::CoordinateSystemNumber;
use crate::types::message::Message;
use crate::types::output::{OutputState, PendingOutput, Redelivery};

use owner::Owner;

/// Unclaimed outputs of all coordinate systems, in order of each coordinate system.
///
/// The queue is a handler: from the first [`Outputs::next`] the machine knows that it is there, and when the queue and
/// all outputs taken from it are dropped, when their process dies or its connection breaks, what they have claimed is
/// given back, and the program waits with reason `HANDLER_LOST`. As long as the queue is there, an output dropped
/// without an answer stays claimed, until its time limit, an operator, a stop or a reset ends it.
///
/// It needs a tokio runtime. Over MQTT each connection has one handler: connect once for this queue, and once for a
/// [`SequenceProgram`](crate::SequenceProgram) beside it.
///
/// ```
/// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
/// # let fake = plc_api::fake::FakePort::new([1]);
/// # fake.put_out(1, 100, plc_api::Params::default());
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
    // all where nothing was chosen
    codes: Option<BTreeSet<u16>>,
    on_redelivery: Redelivery,
    owner: Option<Arc<Owner>>,
    subscription: Subscription,
    open: OpenOutputs,
    // the attempt that was given out last
    given: BTreeMap<(CoordinateSystemNumber, u64), u32>,
    ready: VecDeque<RawOutput>,
}

impl Plc {
    /// The raw queue of auxiliary function outputs of all coordinate systems, for programs that are not made of
    /// handlers. [`SequenceProgram`](crate::SequenceProgram) is the usual way.
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
            on_redelivery: Redelivery::default(),
            owner: None,
            open: OpenOutputs::default(),
            given: BTreeMap::new(),
            ready: VecDeque::new(),
        }
    }

    /// Gives out these M codes only, and tells the machine that they are handled. Without it the queue gives out all
    /// that nobody owns, and the machine does not know for which it is there: their `unhandled` setting must be `wait`.
    #[must_use]
    pub fn on(mut self, codes: impl MCodes) -> Self {
        let within = codes.m_codes().into_iter().flatten();
        let within = within.take_while(|m| *m <= M_CODE_MAX);
        self.codes.get_or_insert_default().extend(within);
        self
    }

    /// Claims and resets by this name: 1 to 64 characters without `/ + #`, one queue or program at a time by each.
    /// Default: the user's name where it connects with one, else a random one.
    #[must_use]
    pub fn handler_id(mut self, handler_id: impl Into<String>) -> Self {
        self.handler_id = Some(handler_id.into());
        self
    }

    /// What happens with an output whose handler has gone without an answer. Default [`Redelivery::Ask`]: it is not
    /// given out until an operator decides.
    #[must_use]
    pub fn on_redelivery(mut self, on_redelivery: Redelivery) -> Self {
        self.on_redelivery = on_redelivery;
        self
    }

    /// The next output that nobody owns; one that was dropped without a claim comes again when it is published again.
    /// Safe to drop while it waits.
    ///
    /// # Errors
    /// [`Error::Closed`] when the machine's side has ended; [`Error::SequenceProgram`] when the name is none;
    /// [`Error::Refused`] when the machine does not take it, or the connection serves another sequence program.
    pub async fn next(&mut self) -> Result<RawOutput> {
        let owner = self.owner()?;
        owner.known().await?;
        loop {
            // what the machine has said since may have ended what is ready
            while let Some(message) = self.subscription.next().now_or_never() {
                let message = message.ok_or(Error::Closed)?;
                self.on_message(&owner, &message);
            }
            if let Some(output) = self.ready.pop_front() {
                return Ok(output);
            }
            let message = self.subscription.next().await.ok_or(Error::Closed)?;
            self.on_message(&owner, &message);
        }
    }

    fn owner(&mut self) -> Result<Arc<Owner>> {
        if let Some(owner) = &self.owner {
            return Ok(Arc::clone(owner));
        }
        let id = self.handler_id.clone();
        let id = id.unwrap_or_else(|| self.plc.default_handler_id());
        if let Some(mistake) = mistake_in_id(&id) {
            return Err(Error::SequenceProgram(mistake));
        }
        let codes = self.codes.iter().flatten().map(|&m| (None, m)).collect();
        let presence = Presence::new(&self.plc, id.into(), codes, false);
        let owner = Arc::new(Owner::start(presence));
        Ok(Arc::clone(self.owner.insert(owner)))
    }

    fn on_message(&mut self, owner: &Arc<Owner>, message: &Arc<Message>) {
        let Some(change) = self.open.on_message(message) else {
            return;
        };
        if change == Change::Boot {
            self.given.clear();
            self.ready.clear();
        }
        for (cs, message) in self.open.all() {
            let outputs = shown(message);
            let find = |seq: u64| outputs.iter().find(|output| output.output.seq == seq);
            self.given
                .retain(|(given_cs, seq), _| *given_cs != cs || find(*seq).is_some());
            self.ready.retain(|raw| {
                raw.coordinate_system() != cs
                    || find(raw.notice().seq).is_some_and(|output| output.state == OutputState::Output)
            });
            for output in outputs {
                let id = OutputId::of(message, cs, output);
                let Some(verify) = self.gives(output).filter(|_| !owner.holds(&id)) else {
                    continue;
                };
                let attempt = output.output.attempt;
                if self.given.insert((cs, output.output.seq), attempt) != Some(attempt) {
                    let raw = RawOutput::new(owner, id, output.output.clone(), verify);
                    self.ready.push_back(raw);
                }
            }
        }
    }

    /// Whether it gives an output out, and then whether the machine must be looked at first.
    fn gives(&self, output: &PendingOutput) -> Option<bool> {
        let m = output.output.m;
        let is_ours = self.codes.as_ref().is_none_or(|codes| codes.contains(&m));
        if output.state != OutputState::Output || !is_ours {
            return None;
        }
        taken_up(output.lost, output.how, self.on_redelivery)
    }
}
