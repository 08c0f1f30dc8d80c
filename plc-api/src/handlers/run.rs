//! The loop of a sequence program: what the machine says, and the work on outputs.

use std::collections::{BTreeMap, HashMap};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use futures_util::StreamExt;
use futures_util::future::{AbortHandle, Abortable};
use futures_util::stream::FuturesUnordered;
use tokio::sync::watch;

use crate::ask::Asker;
use crate::error::Result;
use crate::hub::Filter;
use crate::plc::Plc;
use crate::port::BoxFuture;
use crate::presence::{Gone, gone, here, taken_up, tell};
use crate::types::message::{Message, Payload};
use crate::types::output::{
    CancelReason, Claim, HandledCode, HandshakeStatus, OutputState, Pending, PendingOutput, Redelivery,
};
use crate::types::question::{Validate, ValidateResult};
use crate::types::request::{Refusal, Request};
use crate::types::topic::{CsTopic, Topic};
use crate::types::{BootId, CoordinateSystemNumber};

use super::output::{AuxOutput, CancelState, Cancellation, cancel};
use super::table::Table;
use super::work::{Phase, Work, until_answered, words};

/// An output across boots.
type Key = (BootId, CoordinateSystemNumber, u64);

/// What a task of the loop was, when it has ended.
enum Ended {
    Work(Key),
    Reclaimed(Key, Option<HandshakeStatus>),
    Announced(Result<(), Refusal>),
    Validated,
}

struct Running {
    m: u16,
    abort: AbortHandle,
    cancel: watch::Sender<CancelState>,
    phase: Arc<Phase>,
    reclaiming: bool,
}

/// Whether the machine is being told of these handlers.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Telling {
    Idle,
    Busy,
    /// Once more after that.
    BusyAndAgain,
}

struct Runner<'a> {
    table: Table,
    on_redelivery: Redelivery,
    plc: &'a Plc,
    handler_id: Arc<str>,
    // the boot that is online now
    presence: Option<BootId>,
    systems: Vec<CoordinateSystemNumber>,
    pending: BTreeMap<CoordinateSystemNumber, (BootId, Pending)>,
    running: HashMap<Key, Running>,
    tasks: FuturesUnordered<BoxFuture<'static, Ended>>,
    announced: bool,
    telling: Telling,
    // the machine knows of these handlers; outputs are taken up from now on
    known: bool,
}

pub(super) async fn run(
    table: Table,
    on_redelivery: Redelivery,
    plc: &Plc,
    handler_id: Arc<str>,
) -> Result<()> {
    let mut subscription = plc.port().subscribe(Filter::Handshake);
    // dropped after the runner, and with it after the handlers
    let _gone = Gone {
        plc: plc.clone(),
        handler_id: Arc::clone(&handler_id),
    };
    let mut runner = Runner {
        table,
        on_redelivery,
        plc,
        handler_id,
        presence: None,
        systems: Vec::new(),
        pending: BTreeMap::new(),
        running: HashMap::new(),
        tasks: FuturesUnordered::new(),
        announced: false,
        telling: Telling::Idle,
        known: false,
    };
    loop {
        tokio::select! {
            // first what the machine says: a cancel reaches a handler before it is polled again
            biased;
            message = subscription.next() => match message {
                Some(message) => runner.hear(&message),
                None => return Ok(()),
            },
            Some(ended) = runner.tasks.next() => runner.end(ended)?,
        }
    }
}

impl Drop for Runner<'_> {
    fn drop(&mut self) {
        self.cancel_where(|_, _| true, Some(CancelReason::Shutdown));
    }
}

impl Runner<'_> {
    fn hear(&mut self, message: &Message) {
        match (&message.topic, &message.payload) {
            (_, Payload::Presence(presence)) => {
                let boot = presence.online.then(|| message.boot_id.clone());
                if let Some(boot) = &boot {
                    self.cancel_where(|(other, _, _), _| other != boot, Some(CancelReason::Shutdown));
                }
                let changed = boot.is_some() && boot != self.presence;
                self.presence = boot;
                if changed {
                    self.announce();
                    self.look_at_all();
                }
            }
            (_, Payload::Birth(birth)) => {
                let systems = birth.coordinate_systems.iter().map(|system| system.number);
                let systems: Vec<_> = systems.collect();
                if systems != self.systems || !self.announced {
                    self.systems = systems;
                    self.announce();
                }
            }
            // the last will of a connection that is no more came after these handlers were announced
            (Topic::HandlerPresence(id), Payload::HandlerPresence(presence))
                if **id == *self.handler_id && !presence.online && self.announced =>
            {
                self.announce();
            }
            (Topic::CoordinateSystem(cs, CsTopic::Cancel(_)), Payload::Cancel(told)) => {
                let key = (message.boot_id.clone(), *cs, told.seq);
                self.cancel_where(|other, _| *other == key, Some(told.reason));
            }
            (Topic::CoordinateSystem(cs, CsTopic::Validate(m)), Payload::Validate(asked)) => {
                self.validate(*cs, *m, asked);
            }
            (Topic::CoordinateSystem(cs, CsTopic::Pending), Payload::Pending(pending)) => {
                self.pending
                    .insert(*cs, (message.boot_id.clone(), pending.clone()));
                self.look_at(*cs);
            }
            _ => {}
        }
    }

    /// A program is being loaded that puts out this M code.
    fn validate(&mut self, cs: CoordinateSystemNumber, m: u16, asked: &Validate) {
        if !self.table.validates() || self.table.find(cs, m).is_none() {
            return;
        }
        let refused = self.table.validate(cs, m, &asked.params).err();
        let result = ValidateResult {
            request_id: asked.request_id.clone(),
            handler_id: self.handler_id.to_string(),
            ok: refused.is_none(),
            text: refused.map(|alarm| alarm.text),
        };
        let plc = self.plc.clone();
        self.tasks.push(Box::pin(async move {
            let request = Request::ValidateResult(cs, Some(m), result);
            if let Err(refusal) = plc.port().request(request).await {
                tracing::warn!(%refusal, m, "the result of a validation did not arrive");
            }
            Ended::Validated
        }));
    }

    fn look_at_all(&mut self) {
        let systems: Vec<_> = self.pending.keys().copied().collect();
        for cs in systems {
            self.look_at(cs);
        }
    }

    /// Ends what is no longer open or another's, takes up what is open.
    fn look_at(&mut self, cs: CoordinateSystemNumber) {
        let Some((boot_id, pending)) = self.pending.remove(&cs) else {
            return;
        };
        if self.known && self.presence.as_ref() == Some(&boot_id) {
            let ours = |seq: u64| {
                let output = pending.outputs.iter().find(|output| output.output.seq == seq);
                output.is_some_and(|output| {
                    output
                        .handler_id
                        .as_deref()
                        .is_none_or(|owner| owner == &*self.handler_id)
                })
            };
            let gone: Vec<Key> = self
                .running
                .keys()
                .filter(|(boot, key_cs, seq)| *boot == boot_id && *key_cs == cs && !ours(*seq))
                .cloned()
                .collect();
            self.cancel_where(|key, _| gone.contains(key), None);
            for output in &pending.outputs {
                if output.state == OutputState::Output {
                    self.take_up((boot_id.clone(), cs, output.output.seq), output);
                }
            }
        }
        self.pending.insert(cs, (boot_id, pending));
    }

    fn take_up(&mut self, key: Key, pending: &PendingOutput) {
        if let Some(running) = self.running.get(&key) {
            if pending.lost && !running.abort.is_aborted() {
                self.claim_again(&key);
            }
            return;
        }
        let (boot_id, cs, _) = &key;
        let Some(handler) = self.table.find(*cs, pending.output.m) else {
            return;
        };
        let Some(verify) = taken_up(pending.lost, pending.how, self.on_redelivery) else {
            return;
        };
        let (cancel, cancellation) = Cancellation::new();
        let phase = Arc::new(Phase::default());
        let plc = self.plc.of_output(Asker {
            handler_id: Arc::clone(&self.handler_id),
            boot_id: boot_id.clone(),
            cs: *cs,
            m: pending.output.m,
            seq: pending.output.seq,
            cancellation: cancellation.clone(),
            turn: tokio::sync::Mutex::default(),
        });
        let work = Work {
            handler_id: Arc::clone(&self.handler_id),
            boot_id: boot_id.clone(),
            cs: *cs,
            output: AuxOutput::new(
                &plc,
                &self.handler_id,
                (boot_id, *cs),
                &pending.output,
                verify,
                cancellation,
            ),
            handler: Arc::clone(handler),
            phase: Arc::clone(&phase),
            plc,
        };
        let (abort, registration) = AbortHandle::new_pair();
        let running = Running {
            m: pending.output.m,
            abort,
            cancel,
            phase,
            reclaiming: false,
        };
        self.running.insert(key.clone(), running);
        let work = Box::pin(Abortable::new(work.run(), registration));
        self.tasks.push(Box::pin(worked(work, key)));
    }

    /// This side is still at work, and only its connection was lost: it takes its claim back.
    fn claim_again(&mut self, key: &Key) {
        let Some(running) = self.running.get_mut(key) else {
            return;
        };
        if running.reclaiming || running.phase.is_answering() {
            return;
        }
        running.reclaiming = true;
        let (key, plc, m) = (key.clone(), self.plc.clone(), running.m);
        let claim = Claim {
            boot_id: key.0.clone(),
            seq: key.2,
            handler_id: self.handler_id.to_string(),
        };
        self.tasks.push(Box::pin(async move {
            let status = until_answered(&plc, || Request::Claim(key.1, Some(m), claim.clone())).await;
            Ended::Reclaimed(key, status)
        }));
    }

    fn cancel_where(&mut self, which: impl Fn(&Key, &Running) -> bool, reason: Option<CancelReason>) {
        for (key, running) in &self.running {
            if which(key, running) && !running.phase.is_answering() && !running.abort.is_aborted() {
                cancel(&running.cancel, reason);
                running.abort.abort();
            }
        }
    }

    fn end(&mut self, ended: Ended) -> Result<(), Refusal> {
        match ended {
            Ended::Work(key) => {
                let ended = self.running.remove(&key);
                if ended.is_some_and(|running| running.abort.is_aborted()) {
                    self.look_at(key.1);
                }
            }
            Ended::Reclaimed(key, status) => {
                if let Some(running) = self.running.get_mut(&key) {
                    running.reclaiming = false;
                }
                if status != Some(HandshakeStatus::Accepted) {
                    self.cancel_where(|other, _| *other == key, None);
                }
            }
            Ended::Validated => {}
            Ended::Announced(told) => {
                told?;
                if !std::mem::replace(&mut self.known, true) {
                    self.look_at_all();
                }
                if std::mem::replace(&mut self.telling, Telling::Idle) == Telling::BusyAndAgain {
                    self.announce();
                }
            }
        }
        Ok(())
    }

    fn announce(&mut self) {
        if self.systems.is_empty() || self.presence.is_none() {
            return;
        }
        if self.telling != Telling::Idle {
            self.telling = Telling::BusyAndAgain;
            return;
        }
        self.telling = Telling::Busy;
        let handled = self.table.handled(&self.systems).into_iter();
        let handles = handled.map(|(cs, m)| HandledCode { cs, m }).collect();
        let online = here(handles, self.table.validates());
        // claims of an earlier program of the same name that died unseen are given back first
        let first = !std::mem::replace(&mut self.announced, true);
        let (plc, id) = (self.plc.clone(), self.handler_id.to_string());
        self.tasks.push(Box::pin(async move {
            let told = async {
                if first {
                    tell(&plc, &id, gone()).await?;
                }
                tell(&plc, &id, online).await
            };
            Ended::Announced(told.await)
        }));
    }
}

/// The future, and with it the handler, is dropped before the end is known; its clean-up ends no other.
async fn worked(mut work: std::pin::Pin<Box<Abortable<impl Future<Output = ()>>>>, key: Key) -> Ended {
    let _aborted = (&mut work).await;
    if let Err(panicked) = catch_unwind(AssertUnwindSafe(|| drop(work))) {
        tracing::error!(
            seq = key.2,
            "the clean-up of a handler panicked: {}",
            words(&*panicked)
        );
    }
    Ended::Work(key)
}
