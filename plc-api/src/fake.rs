//! A machine of paper for unit tests of handlers: a scripted [`Port`] over the ledger, with its own clock.
//!
//! It makes outputs when told ([`FakePort::put_out`]), remembers how each ended ([`FakePort::closed`]) and what else
//! was asked ([`FakePort::requests`]). Time stands still until [`FakePort::advance`]. Made for current-thread tokio
//! runtimes, the default of `#[tokio::test]`, where each run is the same.

mod data;

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime};

use tokio::sync::oneshot;

use crate::handshake::{Closed, Effect, Ledger, Now, OutputSpec};
use crate::hub::{Filter, Hub, Subscription};
use crate::plc::Plc;
use crate::port::{BoxFuture, Port};
use crate::types::command::{CommandMeta, CommandReply, CommandStatus};
use crate::types::lease::{LEASE_TTL_DEFAULT_MS, Lease, LeaseRequest};
use crate::types::machine::{Birth, CoordinateSystemInfo, Presence};
use crate::types::message::{Message, Payload};
use crate::types::output::{
    CancelReason, HandlerPresence, HandshakeResult, HandshakeStatus, Params, PendingOutput, Redeliver,
    Redelivery, Timing,
};
use crate::types::question::{Validate, ValidateResult};
use crate::types::request::{Answer, Refusal, RefusalCode, Request};
use crate::types::state::{Spindle, Tool};
use crate::types::topic::{CsTopic, Topic};
use crate::types::{BootId, CoordinateSystemNumber, Timestamp};

/// Outputs that may be open at a time in one coordinate system.
const OPEN_OUTPUTS_MAX: usize = 64;

/// Turns that [`FakePort::settle`] gives to other tasks. Reason: more than any chain of wake-ups between an output and
/// its reset.
const SETTLE_TURNS: usize = 128;

/// A scripted machine. Cloning gives another handle to the same one.
#[derive(Debug, Clone)]
pub struct FakePort {
    inner: Arc<Mutex<Inner>>,
    hub: Hub,
}

#[derive(Debug)]
struct Inner {
    boot: u32,
    now_s: f64,
    ledgers: BTreeMap<CoordinateSystemNumber, Ledger>,
    closed: BTreeMap<(CoordinateSystemNumber, u64), Closed>,
    handlers: BTreeMap<String, HandlerPresence>,
    requests: Vec<Request>,
    validated: Vec<ValidateResult>,
    rev: u64,
    leases: u64,
    data: data::Data,
    sleepers: Vec<(f64, oneshot::Sender<()>)>,
}

impl FakePort {
    /// A machine with these coordinate systems, online.
    pub fn new(coordinate_systems: impl IntoIterator<Item = CoordinateSystemNumber>) -> Self {
        let ledgers = coordinate_systems
            .into_iter()
            .map(|cs| (cs, Ledger::new(boot_id(1), OPEN_OUTPUTS_MAX)));
        let fake = Self {
            inner: Arc::new(Mutex::new(Inner {
                boot: 1,
                now_s: 0.0,
                ledgers: ledgers.collect(),
                closed: BTreeMap::new(),
                handlers: BTreeMap::new(),
                requests: Vec::new(),
                validated: Vec::new(),
                rev: 0,
                leases: 0,
                data: data::Data::default(),
                sleepers: Vec::new(),
            })),
            hub: Hub::new(),
        };
        fake.publish_birth(&mut fake.lock());
        fake
    }

    /// The machine as a sequence program sees it.
    pub fn plc(&self) -> Plc {
        Plc::in_process(Arc::new(self.clone()))
    }

    /// Makes an output without a time limit, and gives its `seq`.
    ///
    /// # Panics
    /// There is no such coordinate system, or 64 outputs are open there: mistakes of the test.
    pub fn put_out(&self, cs: CoordinateSystemNumber, m: u16, params: Params) -> u64 {
        self.put_out_within(cs, m, params, None)
    }

    /// Makes an output with a time limit, and gives its `seq`.
    ///
    /// # Panics
    /// As [`FakePort::put_out`].
    #[expect(clippy::expect_used, reason = "mistakes of the test, documented")]
    pub fn put_out_within(
        &self,
        cs: CoordinateSystemNumber,
        m: u16,
        params: Params,
        timeout: Option<Duration>,
    ) -> u64 {
        let spec = OutputSpec {
            run_id: "run-1".to_owned(),
            m,
            params,
            timing: Timing::AfterMotion,
            program: 1,
            line: 1,
            timeout_s: timeout.map(|timeout| timeout.as_secs_f64()),
        };
        self.with(cs, |ledger, now| {
            let seq = ledger.enqueue(now, spec).expect("64 outputs are open");
            ledger.put_out(now, seq);
            seq
        })
        .expect("no such coordinate system")
    }

    /// How an output ended; `None` while it is open.
    pub fn closed(&self, cs: CoordinateSystemNumber, seq: u64) -> Option<Closed> {
        self.lock().closed.get(&(cs, seq)).cloned()
    }

    /// Open outputs of a coordinate system, ascending.
    pub fn pending(&self, cs: CoordinateSystemNumber) -> Vec<PendingOutput> {
        let inner = self.lock();
        let ledger = inner.ledgers.get(&cs);
        ledger.map(|ledger| ledger.pending().outputs).unwrap_or_default()
    }

    /// What was asked so far, other than claims, resets and presence of handlers.
    pub fn requests(&self) -> Vec<Request> {
        self.lock().requests.clone()
    }

    /// Handlers that have told of themselves, by id.
    pub fn handlers(&self) -> BTreeMap<String, HandlerPresence> {
        self.lock().handlers.clone()
    }

    /// Asks the handlers of an M code whether they take these parameters, as a program load does. `Err` has the text
    /// of the handler that refuses; handlers that do not validate take everything.
    ///
    /// # Errors
    /// A handler refuses.
    pub async fn validate(&self, cs: CoordinateSystemNumber, m: u16, params: Params) -> Result<(), String> {
        let request_id = self.ask_to_validate(Topic::cs(cs, CsTopic::Validate(m)), params);
        self.settle().await;
        let inner = self.lock();
        let mut results = inner
            .validated
            .iter()
            .filter(|result| result.request_id == request_id);
        match results.find(|result| !result.ok) {
            Some(refused) => Err(refused.text.clone().unwrap_or_default()),
            None => Ok(()),
        }
    }

    fn ask_to_validate(&self, topic: Topic, params: Params) -> String {
        let mut inner = self.lock();
        let request_id = format!("validate-{}", inner.rev);
        let asked = Validate {
            request_id: request_id.clone(),
            program: 1,
            line: 1,
            params,
        };
        self.publish(&mut inner, topic, Payload::Validate(asked));
        request_id
    }

    /// Cancels all open outputs, as a stop, a reset or an alarm does.
    pub fn cancel(&self, cs: CoordinateSystemNumber, reason: CancelReason) {
        let _none = self.with(cs, |ledger, now| ledger.cancel_all(now, reason));
    }

    /// The connection of a handler breaks: its claims are given back.
    pub fn lose_handler(&self, handler_id: &str) {
        let systems: Vec<_> = self.lock().ledgers.keys().copied().collect();
        for cs in systems {
            let _none = self.with(cs, |ledger, now| ledger.handler_lost(now, handler_id));
        }
    }

    /// An operator decides about an output whose handler was lost.
    pub fn redeliver(&self, cs: CoordinateSystemNumber, seq: u64, how: Redelivery) {
        let boot_id = self.boot_id();
        let redeliver = Redeliver { boot_id, seq, how };
        let _status = self.with(cs, |ledger, now| ledger.redeliver(now, None, &redeliver));
    }

    /// The runtime starts again: another boot, nothing open.
    pub fn restart(&self) {
        let mut inner = self.lock();
        inner.boot += 1;
        let boot_id = boot_id(inner.boot);
        for ledger in inner.ledgers.values_mut() {
            *ledger = Ledger::new(boot_id.clone(), OPEN_OUTPUTS_MAX);
        }
        inner.closed.clear();
        self.publish_birth(&mut inner);
    }

    /// The machine says something of a coordinate system, such as its state or captured positions: subscribers get it,
    /// and whoever reads the topic gets it until something else is said. The payload is one of the topic.
    ///
    /// ```
    /// use plc_api::types::message::Payload;
    /// use plc_api::types::state::State;
    /// use plc_api::types::topic::CsTopic;
    /// use plc_api::{Execution, fake::FakePort};
    ///
    /// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
    /// let fake = FakePort::new([1]);
    /// let held = State {
    ///     execution: Execution::FeedHold,
    ///     ..State::default()
    /// };
    /// fake.say(1, CsTopic::State, Payload::State(held));
    /// let mill = fake.plc().coordinate_system(1);
    /// assert_eq!(mill.state().await?.execution, Execution::FeedHold);
    /// # Ok(()) }
    /// ```
    pub fn say(&self, cs: CoordinateSystemNumber, topic: CsTopic, payload: Payload) {
        self.publish(&mut self.lock(), Topic::cs(cs, topic), payload);
    }

    /// Lets every task do what it can do without time going on.
    pub async fn settle(&self) {
        for _ in 0..SETTLE_TURNS {
            tokio::task::yield_now().await;
        }
    }

    /// Lets time go on: sleepers wake in order, outputs past their time limit end, and every task does what it can.
    pub async fn advance(&self, by: Duration) {
        self.settle().await;
        let end_s = self.now_s() + by.as_secs_f64();
        while self.step(end_s) {
            self.settle().await;
        }
    }

    /// To the next event not after `end_s`; false when there is none, at `end_s` then.
    fn step(&self, end_s: f64) -> bool {
        let mut inner = self.lock();
        let sleepers = inner.sleepers.iter().map(|(until_s, _)| *until_s);
        let deadlines = inner.ledgers.values().filter_map(Ledger::next_deadline_s);
        let next_s = sleepers
            .chain(deadlines)
            .filter(|next_s| *next_s <= end_s)
            .reduce(f64::min);
        inner.now_s = next_s.unwrap_or(end_s).max(inner.now_s);
        let now_s = inner.now_s;
        let woken: Vec<_> = inner
            .sleepers
            .extract_if(.., |(until_s, _)| *until_s <= now_s)
            .collect();
        for (_, wake) in woken {
            let _sleeper_gone = wake.send(());
        }
        let systems: Vec<_> = inner.ledgers.keys().copied().collect();
        drop(inner);
        for cs in systems {
            let _none = self.with(cs, Ledger::expire);
        }
        next_s.is_some()
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Uses a ledger and publishes what comes of it.
    fn with<T>(&self, cs: CoordinateSystemNumber, use_it: impl FnOnce(&mut Ledger, Now) -> T) -> Option<T> {
        let mut inner = self.lock();
        let now = inner.now();
        let ledger = inner.ledgers.get_mut(&cs)?;
        let result = use_it(ledger, now);
        for effect in ledger.take_effects() {
            self.carry_out(&mut inner, cs, effect);
        }
        Some(result)
    }

    fn carry_out(&self, inner: &mut Inner, cs: CoordinateSystemNumber, effect: Effect) {
        let (topic, payload) = match effect {
            Effect::PendingChanged => {
                let pending = inner.ledgers.get(&cs).map(Ledger::pending).unwrap_or_default();
                (CsTopic::Pending, Payload::Pending(pending))
            }
            Effect::Output(notice) => (CsTopic::Output(notice.m), Payload::Output(notice)),
            Effect::Result { m, result } => (CsTopic::Result(m), Payload::Result(result)),
            Effect::Cancel { m, cancel } => (CsTopic::Cancel(m), Payload::Cancel(cancel)),
            Effect::Closed { seq, how, .. } => {
                inner.closed.insert((cs, seq), how);
                return;
            }
        };
        self.publish(inner, Topic::cs(cs, topic), payload);
    }

    fn publish_birth(&self, inner: &mut Inner) {
        let presence = Presence {
            online: true,
            started_at: Timestamp::from_system_time(inner.now().time),
            version: env!("CARGO_PKG_VERSION").to_owned(),
        };
        let systems = inner.ledgers.keys().map(|&number| CoordinateSystemInfo {
            number,
            ..CoordinateSystemInfo::default()
        });
        let birth = Birth {
            machine: "fake".to_owned(),
            coordinate_systems: systems.collect(),
            ..Birth::default()
        };
        self.publish(inner, Topic::Presence, Payload::Presence(presence));
        self.publish(inner, Topic::Birth, Payload::Birth(birth));
        let systems: Vec<_> = inner.ledgers.keys().copied().collect();
        for cs in systems {
            self.carry_out(inner, cs, Effect::PendingChanged);
        }
    }

    fn publish(&self, inner: &mut Inner, topic: Topic, payload: Payload) {
        inner.rev += 1;
        self.hub.publish(Message {
            rev: topic.is_state().then_some(inner.rev),
            topic,
            boot_id: boot_id(inner.boot),
            ts: Timestamp::from_system_time(inner.now().time),
            payload,
        });
    }

    fn answer(&self, request: Request) -> Result<Answer, Refusal> {
        let missing = |cs| {
            Refusal::new(
                RefusalCode::NotFound,
                format!("coordinate system {cs} does not exist"),
            )
        };
        match request {
            Request::Claim(cs, m, claim) => self
                .with(cs, |ledger, now| ledger.claim(now, m, &claim))
                .map(Answer::Handshake)
                .ok_or_else(|| missing(cs)),
            Request::Reset(cs, m, reset) => self
                .with(cs, |ledger, now| ledger.reset(now, m, &reset))
                .map(Answer::Handshake)
                .ok_or_else(|| missing(cs)),
            Request::Progress(cs, m, report) => self
                .with(cs, |ledger, now| ledger.progress(now, m, &report))
                .map(|status| handshake_answer(report.seq, &report.handler_id, status))
                .ok_or_else(|| missing(cs)),
            Request::Ask(cs, m, ask) => self
                .with(cs, |ledger, now| ledger.ask(now, m, &ask))
                .ok_or_else(|| missing(cs))?
                .map(|status| handshake_answer(ask.seq, &ask.handler_id, status)),
            Request::AnswerQuestion(cs, m, answer) => self
                .with(cs, |ledger, now| ledger.answer_question(now, m, &answer))
                .map(|status| handshake_answer(answer.seq, "", status))
                .ok_or_else(|| missing(cs)),
            Request::Redeliver(cs, m, redeliver) => self
                .with(cs, |ledger, now| ledger.redeliver(now, m, &redeliver))
                .map(|status| handshake_answer(redeliver.seq, "", status))
                .ok_or_else(|| missing(cs)),
            Request::Handler(id, presence) => {
                self.handler(&id, &presence);
                Ok(Answer::Done)
            }
            Request::ValidateResult(_, _, result) => {
                self.lock().validated.push(result);
                Ok(Answer::Done)
            }
            Request::Handlers => Ok(Answer::Handlers(self.handlers())),
            other => self.script(other),
        }
    }

    fn handler(&self, id: &str, presence: &HandlerPresence) {
        let mut inner = self.lock();
        inner.handlers.insert(id.to_owned(), presence.clone());
        let (topic, payload) = (
            Topic::HandlerPresence(id.to_owned()),
            Payload::HandlerPresence(presence.clone()),
        );
        self.publish(&mut inner, topic, payload);
        drop(inner);
        if !presence.online {
            self.lose_handler(id);
            return;
        }
        let systems: Vec<_> = self.lock().ledgers.keys().copied().collect();
        for cs in systems {
            let handles = |m| presence.handles.iter().any(|code| code.cs == cs && code.m == m);
            let _none = self.with(cs, |ledger, now| ledger.republish(now, handles));
        }
    }

    /// Remembers a request, and answers as a machine does where nothing goes wrong.
    fn script(&self, request: Request) -> Result<Answer, Refusal> {
        let mut inner = self.lock();
        inner.requests.push(request.clone());
        if let Some(answer) = inner.data.answer(&request) {
            return answer;
        }
        match request {
            Request::Command { meta, .. } => Ok(Answer::Command(inner.done(meta))),
            Request::Lease { request, meta, .. } => Ok(Answer::Command(CommandReply {
                lease: inner.granted(request, &meta),
                ..inner.done(meta)
            })),
            Request::Tool(cs, id) => {
                self.publish(
                    &mut inner,
                    Topic::cs(cs, CsTopic::Tool),
                    Payload::Tool(Tool { id }),
                );
                Ok(Answer::Done)
            }
            Request::Spindle(cs, command) => {
                let spindle = Spindle {
                    direction: command.direction,
                    rpm: command.rpm,
                    actual_rpm: command.rpm,
                    oriented: false,
                };
                self.publish(
                    &mut inner,
                    Topic::cs(cs, CsTopic::Spindle),
                    Payload::Spindle(spindle),
                );
                Ok(Answer::Done)
            }
            Request::Input(..) | Request::SkipInput(..) => Ok(Answer::Done),
            Request::Programs => Ok(Answer::Programs(Vec::new())),
            _ => Err(Refusal::new(
                RefusalCode::NotSupported,
                "the fake machine does not do this",
            )),
        }
    }
}

impl Inner {
    fn done(&self, meta: CommandMeta) -> CommandReply {
        CommandReply {
            command_id: meta.command_id,
            status: CommandStatus::Done,
            code: "ok".to_owned(),
            text: String::new(),
            state_rev: self.rev,
            variables: None,
            lease: None,
        }
    }

    /// Every lease is granted, each with a fence of its own.
    fn granted(&mut self, request: LeaseRequest, meta: &CommandMeta) -> Option<Lease> {
        let LeaseRequest::Take(take) = request else {
            return None;
        };
        self.leases += u64::from(take.fence.is_none());
        let ttl = Duration::from_millis(take.ttl_ms.unwrap_or(LEASE_TTL_DEFAULT_MS));
        Some(Lease {
            holder: take.holder.unwrap_or_else(|| meta.client_id.clone()),
            fence: take.fence.unwrap_or(self.leases),
            expires_at: Timestamp::from_system_time(self.now().time + ttl),
        })
    }

    fn now(&self) -> Now {
        Now {
            monotonic_s: self.now_s,
            time: SystemTime::UNIX_EPOCH + Duration::from_secs_f64(self.now_s),
        }
    }
}

fn boot_id(boot: u32) -> BootId {
    BootId(format!("fake-{boot}"))
}

fn handshake_answer(seq: u64, handler_id: &str, status: HandshakeStatus) -> Answer {
    Answer::Handshake(HandshakeResult {
        seq,
        handler_id: handler_id.to_owned(),
        status,
    })
}

impl Port for FakePort {
    fn boot_id(&self) -> BootId {
        boot_id(self.lock().boot)
    }

    fn read<'a>(&'a self, topic: &'a Topic) -> BoxFuture<'a, Option<Arc<Message>>> {
        Box::pin(std::future::ready(self.hub.read(topic)))
    }

    fn subscribe(&self, filter: Filter) -> Subscription {
        self.hub.subscribe(filter)
    }

    fn request(&self, request: Request) -> BoxFuture<'_, Result<Answer, Refusal>> {
        Box::pin(async move { self.answer(request) })
    }

    fn sleep(&self, duration: Duration) -> BoxFuture<'_, ()> {
        let (wake, woken) = oneshot::channel();
        let mut inner = self.lock();
        let until_s = inner.now_s + duration.as_secs_f64();
        inner.sleepers.push((until_s, wake));
        Box::pin(async move {
            if woken.await.is_err() {
                std::future::pending::<()>().await;
            }
        })
    }

    fn now_s(&self) -> f64 {
        self.lock().now_s
    }
}
