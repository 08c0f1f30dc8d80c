//! A scripted machine for unit tests of handlers: a [`Port`] with the real handshake and its own clock.
//!
//! The test issues outputs ([`FakePort::issue_output`]). It reads how each output ended
//! ([`FakePort::closed`]) and which other requests this machine received ([`FakePort::requests`]). The time
//! advances only when the test calls [`FakePort::advance`]. In a current-thread tokio runtime, the default of
//! `#[tokio::test]`, all runs of a test are identical.
//!
//! The state word changes as on a machine: READY with program 1 at first, WAIT while an output is open,
//! ACTIVE after the reset of the output, STOPPED with an alarm if the output fails, `PROGRAM_COMPLETED` after
//! [`FakePort::end_program`]. The same [table](crate::execution) as on a machine decides which commands are
//! allowed. An allowed command takes effect at once. Inputs, tool and spindle keep the values that requests
//! have set.
//!
//! ```
//! # use plc_api::{Execution, Params, fake::FakePort, types::request::Refusal};
//! # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
//! let fake = FakePort::new([1]);
//! let mill = fake.plc().coordinate_system(1);
//! mill.start().await?;
//! fake.issue_output(1, 100, Params::default());
//! assert_eq!(mill.state().await?.execution, Execution::Wait);
//! mill.hold().await?;
//! assert_eq!(mill.state().await?.execution, Execution::FeedHold);
//! assert!(mill.start().await.is_err(), "the program has been started");
//! mill.stop().await?;
//! assert_eq!(mill.state().await?.execution, Execution::Stopped);
//! # Ok(()) }
//! ```
//!
//! The scripted machine has no motion and reads no NC program. Positions, captured positions, modal codes,
//! and everything that depends on them (M00, M01, single block, `with_motion` outputs) exist only if a test
//! publishes them by [`FakePort::publish_message`]. For tests with NC programs and motion use
//! `tandem_testing`.

mod alarms;
mod data;
mod io;
mod publish;
mod requests;
mod system;

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime};

use tokio::sync::oneshot;

use crate::alarm::Alarm;
use crate::handler_registry::HandlerRegistry;
use crate::handshake::{Effect, Ledger, Now, OutputOutcome, OutputSpec};
use crate::hub::{Filter, Hub, Subscription};
use crate::io_points::IoPoints;
use crate::lock::lock;
use crate::port::{BoxFuture, Port};
use crate::types::data::VariableArea;
use crate::types::handler::Departure;
use crate::types::heartbeat::Heartbeat;
use crate::types::io::{IoDeclaration, IoDeclarations, IoPoint};
use crate::types::machine::AlarmRecord;
use crate::types::message::{Message, Payload};
use crate::types::not_after::NotAfter;
use crate::types::output::{
    CancelReason, HandlerPresence, Params, PendingOutput, Redeliver, Redelivery, Timing,
};
use crate::types::question::{Validate, ValidateResult};
use crate::types::request::{Answer, Refusal, Request};
use crate::types::topic::{CsTopic, Topic};
use crate::types::{BootId, CoordinateSystemNumber};

use system::System;

/// Largest number of open outputs of one coordinate system.
const OPEN_OUTPUTS_MAX: usize = 64;

/// Number of times that [`FakePort::settle`] yields to other tasks. Reason: the number of task wake-ups
/// between an output and its reset is smaller.
const SETTLE_TURNS: usize = 128;

/// A scripted machine. Clones are handles to the same machine.
#[derive(Debug, Clone)]
pub struct FakePort {
    inner: Arc<Mutex<FakeMachine>>,
    hub: Hub,
}

#[derive(Debug, Default)]
struct FakeMachine {
    boot: u32,
    now_s: f64,
    systems: BTreeMap<CoordinateSystemNumber, System>,
    requests: Vec<Request>,
    validated: Vec<ValidateResult>,
    alarms: Vec<AlarmRecord>,
    rev: u64,
    leases: u64,
    data: data::Data,
    handlers: HandlerRegistry,
    declared_io: IoDeclarations,
    io: IoPoints,
    sleepers: Vec<(f64, oneshot::Sender<()>)>,
}

impl FakePort {
    /// Creates a machine that is online and has these coordinate systems.
    pub fn new(coordinate_systems: impl IntoIterator<Item = CoordinateSystemNumber>) -> Self {
        let systems = coordinate_systems.into_iter().map(|cs| (cs, System::new(1, cs)));
        let inner = FakeMachine {
            boot: 1,
            systems: systems.collect(),
            ..FakeMachine::default()
        };
        let fake = Self {
            inner: Arc::new(Mutex::new(inner)),
            hub: Hub::new(),
        };
        fake.publish_birth(&mut lock(&fake.inner));
        fake
    }

    /// Issues an output without a time limit, and returns its `seq`. The program waits for the reset of the
    /// output. If no run is active, starts a run. If the run is held, the output is issued when the run
    /// resumes.
    ///
    /// # Panics
    /// Panics if the coordinate system does not exist, or if 64 of its outputs are open. Both are mistakes of
    /// the test.
    pub fn issue_output(&self, cs: CoordinateSystemNumber, m: u16, params: Params) -> u64 {
        self.issue_output_within(cs, m, params, None)
    }

    /// Issues an output with a time limit, and returns its `seq`.
    ///
    /// # Panics
    /// Panics as [`FakePort::issue_output`].
    #[expect(clippy::expect_used, reason = "mistakes of the test, documented")]
    pub fn issue_output_within(
        &self,
        cs: CoordinateSystemNumber,
        m: u16,
        params: Params,
        timeout: Option<Duration>,
    ) -> u64 {
        let mut inner = lock(&self.inner);
        let system = inner.systems.get_mut(&cs).expect("no such coordinate system");
        system.start_run();
        let is_held = system.is_paused();
        let spec = OutputSpec {
            run_id: system.run_id(),
            m,
            params,
            timing: Timing::AfterMotion,
            program: system.program(),
            line: 1,
            timeout_s: timeout.map(|timeout| timeout.as_secs_f64()),
            redelivery: None,
        };
        self.use_ledger(&mut inner, cs, |ledger, now| {
            let seq = ledger.enqueue(now, spec).expect("64 outputs are open");
            if !is_held {
                ledger.issue_output(now, seq);
            }
            seq
        })
        .expect("no such coordinate system")
    }

    /// Marks the end of the program (M30) as reached. The state word changes to `PROGRAM_COMPLETED` as soon
    /// as no output is open and the program is not held.
    pub fn end_program(&self, cs: CoordinateSystemNumber) {
        let mut inner = lock(&self.inner);
        if let Some(system) = inner.systems.get_mut(&cs) {
            system.end_program();
        }
        self.publish_system(&mut inner, cs);
    }

    /// Returns how an output ended, or `None` while the output is open.
    pub fn closed(&self, cs: CoordinateSystemNumber, seq: u64) -> Option<OutputOutcome> {
        lock(&self.inner).systems.get(&cs)?.closed.get(&seq).cloned()
    }

    /// Returns the open outputs of a coordinate system, ascending by `seq`.
    pub fn pending(&self, cs: CoordinateSystemNumber) -> Vec<PendingOutput> {
        let inner = lock(&self.inner);
        let system = inner.systems.get(&cs);
        system
            .map(|system| system.ledger.pending().outputs)
            .unwrap_or_default()
    }

    /// Returns all requests that this machine has received so far, except those of the handshake, such as
    /// claims, resets and presences of handlers.
    pub fn requests(&self) -> Vec<Request> {
        lock(&self.inner).requests.clone()
    }

    /// Returns the last presence of each handler that has announced itself, by handler id.
    pub fn handlers(&self) -> BTreeMap<String, HandlerPresence> {
        self.hub.handlers()
    }

    /// Requests the handlers of an M code to check these parameters, as a program load does. A handler
    /// without a check accepts all parameters.
    ///
    /// # Errors
    /// Fails with the text of the first handler that refuses the parameters.
    pub async fn validate(&self, cs: CoordinateSystemNumber, m: u16, params: Params) -> Result<(), String> {
        let request_id = {
            let mut inner = lock(&self.inner);
            let request_id = format!("validate-{}", inner.rev);
            let asked = Validate {
                request_id: request_id.clone(),
                program: 1,
                line: 1,
                params,
            };
            self.publish(
                &mut inner,
                Topic::cs(cs, CsTopic::Validate(m)),
                Payload::Validate(asked),
            );
            request_id
        };
        self.settle().await;
        let inner = lock(&self.inner);
        let mut results = inner
            .validated
            .iter()
            .filter(|result| result.request_id == request_id);
        match results.find(|result| !result.ok) {
            Some(refused) => Err(refused.text.clone().unwrap_or_default()),
            None => Ok(()),
        }
    }

    /// Cancels all open outputs of a coordinate system and ends its run, as a stop, a reset or an alarm does.
    /// With [`CancelReason::Operator`] the run continues.
    pub fn cancel(&self, cs: CoordinateSystemNumber, reason: CancelReason) {
        let mut inner = lock(&self.inner);
        self.end_run(&mut inner, cs, reason);
        self.publish_system(&mut inner, cs);
    }

    /// Raises an alarm of a coordinate system. The state word changes to STOPPED, and all open outputs of the
    /// coordinate system are cancelled.
    pub fn raise(&self, cs: CoordinateSystemNumber, alarm: Alarm) {
        self.raise_alarm(&mut lock(&self.inner), Some(cs), alarm);
    }

    /// Breaks the connection of a handler. The machine releases the claims of the handler at once, because
    /// this machine has no grace time.
    pub fn disconnect_handler(&self, handler_id: &str) {
        let until_s = self.now_s();
        self.mark_handler_offline(handler_id, Departure::Unannounced { until_s });
    }

    /// Releases the claims of a handler that is offline, and applies the departure to locks, inputs and
    /// outputs.
    fn mark_handler_offline(&self, handler_id: &str, departure: Departure) {
        self.use_all_ledgers(|_, ledger, now| ledger.handler_lost(now, handler_id, None));
        let mut inner = lock(&self.inner);
        let now_s = inner.now_s;
        for cs in inner.numbers() {
            if let Some(system) = inner.systems.get_mut(&cs) {
                system.mark_handler_offline(handler_id, departure, now_s);
            }
            self.publish_system(&mut inner, cs);
        }
        self.mark_io_owner_offline(&mut inner, handler_id, departure);
    }

    /// Notifies locks, inputs and outputs of the plant that their owner is online again.
    fn mark_handler_online(&self, handler_id: &str) {
        let mut inner = lock(&self.inner);
        inner.io.mark_handler_online(handler_id);
        for system in inner.systems.values_mut() {
            system.mark_handler_online(handler_id);
        }
    }

    /// Sets the levels of each handler that did not return within its waiting time to their `on_loss`.
    fn expire_absences(&self) {
        let mut inner = lock(&self.inner);
        let now_s = inner.now_s;
        for cs in inner.numbers() {
            if let Some(system) = inner.systems.get_mut(&cs)
                && system
                    .next_lock_deadline_s()
                    .is_some_and(|until_s| until_s <= now_s)
            {
                system.expire_locks(now_s);
                self.publish_system(&mut inner, cs);
            }
        }
        self.expire_io(&mut inner);
    }

    /// Declares an input or output of the plant. Afterwards all inputs and outputs have their initial values.
    ///
    /// ```
    /// use plc_api::fake::FakePort;
    /// use plc_api::types::io::{IoDeclaration, IoPoint};
    ///
    /// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
    /// let fake = FakePort::new([1]);
    /// fake.declare_io(IoPoint::input("door_closed"), IoDeclaration::new(false));
    /// fake.plc().io_in("door_closed").set(true).await?;
    /// assert!(fake.plc().io_in("door_closed").value().await?.is_on());
    /// # Ok(()) }
    /// ```
    pub fn declare_io(&self, point: IoPoint, declaration: IoDeclaration) {
        let mut inner = lock(&self.inner);
        inner.declared_io.insert(point, declaration);
        inner.io = IoPoints::new(&inner.declared_io);
        self.publish_birth(&mut inner);
    }

    /// Publishes these variables from now on whenever one of them changes, as `[[variables.published]]` of a
    /// configuration does.
    pub fn publish_variables(&self, area: VariableArea, from: u32, count: u32) {
        let mut inner = lock(&self.inner);
        inner.data.publish(area, from, count);
        self.publish_data(&mut inner);
    }

    /// Sends the decision of an operator about an output that has lost its handler.
    pub fn redeliver(&self, cs: CoordinateSystemNumber, seq: u64, how: Redelivery) {
        let boot_id = self.boot_id();
        let redeliver = Redeliver { boot_id, seq, how };
        let _status = self.with(cs, |ledger, now| ledger.redeliver(now, None, &redeliver));
    }

    /// Restarts the runtime of this machine. The new boot has no open outputs, alarms or registered handlers.
    pub fn restart(&self) {
        let mut inner = lock(&self.inner);
        inner.boot += 1;
        let boot = inner.boot;
        for (cs, system) in &mut inner.systems {
            *system = System::restarted(boot, *cs);
        }
        inner.alarms.clear();
        inner.handlers = HandlerRegistry::default();
        inner.io = IoPoints::new(&inner.declared_io);
        self.publish_birth(&mut inner);
    }

    /// Publishes a message of a coordinate system, such as its state or captured positions. The payload must
    /// be of the type of the topic. A published state also becomes the current state of this machine: this
    /// state decides which commands are allowed, and later commands and outputs change it.
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
    /// fake.publish_message(1, CsTopic::State, Payload::State(held));
    /// let mill = fake.plc().coordinate_system(1);
    /// assert_eq!(mill.state().await?.execution, Execution::FeedHold);
    /// # Ok(()) }
    /// ```
    pub fn publish_message(&self, cs: CoordinateSystemNumber, topic: CsTopic, payload: Payload) {
        let mut inner = lock(&self.inner);
        if let (Payload::State(state), Some(system)) = (&payload, inner.systems.get_mut(&cs)) {
            system.adopt_state(state);
        }
        self.publish(&mut inner, Topic::cs(cs, topic), payload);
    }

    /// Runs all other tasks as far as possible without advancing the time.
    pub async fn settle(&self) {
        for _ in 0..SETTLE_TURNS {
            tokio::task::yield_now().await;
        }
    }

    /// Advances the time by `by`: sleeping tasks wake in the order of their times, and outputs time out.
    pub async fn advance(&self, by: Duration) {
        self.settle().await;
        let end_s = self.now_s() + by.as_secs_f64();
        while self.step(end_s) {
            self.settle().await;
        }
    }

    /// Advances the time to the next deadline that is not after `end_s`, and returns true. If no such
    /// deadline exists, advances the time to `end_s` and returns false.
    fn step(&self, end_s: f64) -> bool {
        let mut inner = lock(&self.inner);
        let sleepers = inner.sleepers.iter().map(|(until_s, _)| *until_s);
        let ledgers = inner.systems.values().map(|system| &system.ledger);
        let deadlines = ledgers.filter_map(Ledger::next_deadline_s);
        let locks = inner.systems.values().filter_map(System::next_lock_deadline_s);
        let next_s = sleepers
            .chain(deadlines)
            .chain(locks)
            .chain(inner.io.next_deadline_s())
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
        drop(inner);
        self.use_all_ledgers(|_, ledger, now| ledger.expire(now));
        self.expire_absences();
        next_s.is_some()
    }

    fn with<T>(&self, cs: CoordinateSystemNumber, use_it: impl FnOnce(&mut Ledger, Now) -> T) -> Option<T> {
        self.use_ledger(&mut lock(&self.inner), cs, use_it)
    }

    fn use_all_ledgers(&self, use_it: impl Fn(CoordinateSystemNumber, &mut Ledger, Now)) {
        let mut inner = lock(&self.inner);
        for cs in inner.numbers() {
            self.use_ledger(&mut inner, cs, |ledger, now| use_it(cs, ledger, now));
        }
    }

    /// Calls `use_it` with the ledger of a coordinate system, and applies the effects of this call.
    fn use_ledger<T>(
        &self,
        inner: &mut FakeMachine,
        cs: CoordinateSystemNumber,
        use_it: impl FnOnce(&mut Ledger, Now) -> T,
    ) -> Option<T> {
        let now = inner.now();
        let ledger = &mut inner.systems.get_mut(&cs)?.ledger;
        let result = use_it(ledger, now);
        let effects: Vec<Effect> = ledger.take_effects().collect();
        let mut failed = None;
        for effect in effects {
            if let Effect::Closed { m, how, .. } = &effect {
                failed = failed.or_else(|| alarms::alarm_for_outcome(*m, how));
            }
            self.apply_effect(inner, cs, effect);
        }
        if let Some(alarm) = failed {
            self.raise_alarm(inner, Some(cs), alarm);
        }
        self.publish_system(inner, cs);
        Some(result)
    }

    /// Cancels the open outputs of a coordinate system. Ends its run, unless the run continues after this
    /// reason.
    fn end_run(&self, inner: &mut FakeMachine, cs: CoordinateSystemNumber, reason: CancelReason) {
        if let (Some(word), Some(system)) = (system::word_of(reason), inner.systems.get_mut(&cs)) {
            system.end_run(word);
        }
        let _none = self.use_ledger(inner, cs, |ledger, now| ledger.cancel_all(now, reason));
    }

    fn apply_effect(&self, inner: &mut FakeMachine, cs: CoordinateSystemNumber, effect: Effect) {
        let Some(system) = inner.systems.get_mut(&cs) else {
            return;
        };
        let (topic, payload) = match effect {
            Effect::PendingChanged => (CsTopic::Pending, Payload::Pending(system.ledger.pending())),
            Effect::Output(notice) => (CsTopic::Output(notice.m), Payload::Output(notice)),
            Effect::Result { m, result } => (CsTopic::Result(m), Payload::Result(result)),
            Effect::Cancel { m, cancel } => (CsTopic::Cancel(m), Payload::Cancel(cancel)),
            Effect::Closed { seq, how, .. } => {
                system.closed.insert(seq, how);
                return;
            }
        };
        self.publish(inner, Topic::cs(cs, topic), payload);
    }
}

impl FakeMachine {
    fn numbers(&self) -> Vec<CoordinateSystemNumber> {
        self.systems.keys().copied().collect()
    }

    /// Returns the number of active alarms of a coordinate system, including those of the whole machine.
    fn alarm_count(&self, cs: CoordinateSystemNumber) -> u32 {
        let active = self.alarms.iter().filter(|alarm| alarm.cleared_at.is_none());
        let count = active.filter(|alarm| alarm.cs.is_none_or(|of| of == cs)).count();
        u32::try_from(count).unwrap_or(u32::MAX)
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

impl Port for FakePort {
    fn boot_id(&self) -> BootId {
        boot_id(lock(&self.inner).boot)
    }

    fn read<'a>(&'a self, topic: &'a Topic) -> BoxFuture<'a, Option<Arc<Message>>> {
        if *topic == Topic::Heartbeat {
            let mut inner = lock(&self.inner);
            let cycle = Duration::try_from_secs_f64(inner.now_s).unwrap_or_default();
            let cycle = u64::try_from(cycle.as_millis()).unwrap_or(u64::MAX);
            self.publish(
                &mut inner,
                Topic::Heartbeat,
                Payload::Heartbeat(Heartbeat { cycle }),
            );
        }
        Box::pin(std::future::ready(self.hub.read(topic)))
    }

    fn subscribe(&self, filter: Filter) -> Subscription {
        self.hub.subscribe(filter)
    }

    fn request(&self, request: Request) -> BoxFuture<'_, Result<Answer, Refusal>> {
        Box::pin(async move { self.answer(request) })
    }

    fn request_not_after<'a>(
        &'a self,
        not_after: &'a NotAfter,
        _client: Option<&'a str>,
        request: Request,
    ) -> BoxFuture<'a, Result<Answer, Refusal>> {
        Box::pin(async move {
            self.check_age(not_after, &request)?;
            self.answer(request)
        })
    }

    fn sleep(&self, duration: Duration) -> BoxFuture<'_, ()> {
        let (wake, woken) = oneshot::channel();
        let mut inner = lock(&self.inner);
        let until_s = inner.now_s + duration.as_secs_f64();
        inner.sleepers.push((until_s, wake));
        Box::pin(async move {
            if woken.await.is_err() {
                std::future::pending::<()>().await;
            }
        })
    }

    fn now_s(&self) -> f64 {
        lock(&self.inner).now_s
    }
}
