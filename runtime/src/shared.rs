//! What all coordinate systems, the port and the server ends share.

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use parking_lot::Mutex;
use plc_api::alarm::USER_ALARM_BASE;
use plc_api::execution::wire_name;
use plc_api::handler_registry::{HandlerRegistry, Registered};
use plc_api::handshake::Now;
use plc_api::hub::Hub;
use plc_api::io_points::IoPoints;
use plc_api::types::alarm_text::AlarmText;
use plc_api::types::command::{CommandMeta, CommandReply, CommandStatus};
use plc_api::types::data::{PublishedVariables, VariableArea};
use plc_api::types::handler::HandlerResult;
use plc_api::types::machine::{AlarmRecord, AlarmSeverity, BrokerInUse, Presence};
use plc_api::types::message::{Message, Payload};
use plc_api::types::output::HandlerPresence;
use plc_api::types::request::Refusal;
use plc_api::types::topic::{CsTopic, Topic};
use plc_api::types::{BootId, CoordinateSystemNumber, Timestamp};
use tandem_model::alarm::AlarmEntry;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use crate::alarms::{Alarms, Raised};
use crate::birth::birth;
use crate::clock::Clock;
use crate::command_memory::{Asked, CommandMemory, Recalled};
use crate::config::Machine;
use crate::declared::Declared;
use crate::disk::{Health, Part};
use crate::journal::{Event, Journal};
use crate::planned::OnPlan;
use crate::program_store::ProgramStore;
use crate::runs::RunBook;
use crate::servo_thread::ServoStatistics;
use crate::tables::Tables;

/// Shared state of a machine.
#[derive(Debug)]
pub(crate) struct Shared {
    pub machine: Machine,
    pub boot_id: BootId,
    pub hub: Hub,
    pub clock: Clock,
    pub store: ProgramStore,
    pub journal: Journal,
    /// Called with what is planned, in simulated time.
    pub on_plan: Option<OnPlan>,
    /// What of the data folder cannot be written.
    pub health: Arc<Health>,
    /// How punctual the servo thread is; nothing in simulated time.
    pub servo: Arc<ServoStatistics>,
    pub tables: Arc<Tables>,
    /// False while the connection to the MQTT broker is lost.
    pub bus_connected: AtomicBool,
    /// How often the server end for MQTT has connected again.
    pub bus_reconnections: AtomicU64,
    /// Cancelled when the runtime stops.
    pub closing: CancellationToken,
    /// How long programs have waited for M codes lately, s.
    m_code_waits: Mutex<BTreeMap<(CoordinateSystemNumber, u16), f64>>,
    alarms: Mutex<Alarms>,
    handlers: Mutex<HandlerRegistry>,
    /// Held while its states are published: what is published last is what is so.
    pub io: Mutex<IoPoints>,
    /// Held while `birth` is published: what is published last is what is so.
    birth: Mutex<()>,
    /// The variables that were published last. Held while these, tools and offsets are published.
    pub published_variables: Mutex<BTreeMap<VariableArea, PublishedVariables>>,
    pub runs: Arc<Mutex<RunBook>>,
    commands: Mutex<CommandMemory>,
    /// Wakes the task of each coordinate system.
    wakes: Mutex<Vec<Arc<Notify>>>,
    sent: AtomicU64,
}

impl Shared {
    pub fn new(
        machine: Machine,
        boot_id: BootId,
        clock: Clock,
        store: ProgramStore,
        journal: Journal,
        tables: Tables,
    ) -> Self {
        Self {
            tables: Arc::new(tables),
            io: Mutex::new(IoPoints::new(&machine.io)),
            machine,
            boot_id,
            hub: Hub::new(),
            clock,
            store,
            journal,
            health: Arc::default(),
            on_plan: None,
            servo: Arc::default(),
            bus_connected: AtomicBool::new(true),
            bus_reconnections: AtomicU64::new(0),
            closing: CancellationToken::new(),
            m_code_waits: Mutex::default(),
            alarms: Mutex::default(),
            handlers: Mutex::default(),
            birth: Mutex::default(),
            published_variables: Mutex::default(),
            runs: Arc::default(),
            commands: Mutex::default(),
            wakes: Mutex::default(),
            sent: AtomicU64::new(0),
        }
    }

    /// From now on [`Shared::wake_all`] wakes this task, too.
    pub fn wakes(&self, task: Arc<Notify>) {
        self.wakes.lock().push(task);
    }

    /// Wakes the task of each coordinate system.
    pub fn wake_all(&self) {
        for wake in self.wakes.lock().iter() {
            wake.notify_one();
        }
    }

    /// Counts the messages and journal lines that may have woken a task.
    pub fn sent(&self) -> u64 {
        self.sent.load(Ordering::Relaxed)
    }

    fn send(&self, message: Message) {
        self.sent.fetch_add(1, Ordering::Relaxed);
        self.hub.publish(message);
    }

    pub fn now(&self) -> Now {
        self.clock.now()
    }

    pub fn timestamp(&self) -> Timestamp {
        Timestamp::from_system_time(self.clock.wall())
    }

    /// A message of now.
    pub fn message(&self, topic: Topic, rev: Option<u64>, payload: Payload) -> Message {
        Message {
            topic,
            boot_id: self.boot_id.clone(),
            ts: self.timestamp(),
            rev,
            payload,
        }
    }

    /// Publishes an event, or a state that has changed; gives the topic's revision.
    pub fn publish(&self, topic: Topic, payload: Payload) -> u64 {
        if !topic.is_state() {
            self.send(self.message(topic, None, payload));
            return 0;
        }
        self.publish_state(topic, payload).rev.unwrap_or(0)
    }

    /// Publishes a state if it has changed; gives its message.
    pub fn publish_state(&self, topic: Topic, payload: Payload) -> Arc<Message> {
        let message = |topic, rev, payload| self.message(topic, Some(rev), payload);
        let (message, has_changed) = self.hub.publish_change(topic, payload, message);
        if has_changed {
            self.sent.fetch_add(1, Ordering::Relaxed);
        }
        message
    }

    /// Publishes a state as it is, with the time of now: it still holds.
    pub fn say_again(&self, topic: &Topic) {
        if let Some(last) = self.hub.read(topic) {
            let (rev, payload) = (last.rev, last.payload.clone());
            self.send(self.message(topic.clone(), rev, payload));
        }
    }

    /// Publishes which external broker is connected.
    pub fn tell_broker(&self, broker: Option<BrokerInUse>) {
        let last = self.hub.read(&Topic::Presence);
        let Some(Payload::Presence(presence)) = last.as_ref().map(|message| &message.payload) else {
            return;
        };
        let presence = Presence {
            broker,
            ..presence.clone()
        };
        self.publish(Topic::Presence, Payload::Presence(presence));
    }

    /// Notes whether a part of the data folder was written; gives the result. One that was asked for what cannot be done
    /// says nothing of the disk.
    pub fn note<T>(&self, part: Part, attempt: io::Result<T>) -> io::Result<T> {
        let is_asked_too_much = |error: &io::Error| {
            matches!(
                error.kind(),
                io::ErrorKind::InvalidInput | io::ErrorKind::QuotaExceeded
            )
        };
        if !attempt.as_ref().is_err_and(is_asked_too_much) {
            self.health.note(part, &attempt);
            if let Err(error) = &attempt {
                self.stand(part.alarm(), Some(&error.to_string()));
            }
        }
        attempt
    }

    /// Writes a line of the journal.
    pub fn record(&self, cs: CoordinateSystemNumber, event: Event) {
        let now = self.now();
        let learned = RunBook::learns_from(&event).then(|| {
            let mut runs = self.runs.lock();
            runs.on(cs, &event, now).then(|| runs.state(cs))
        });
        if self.journal.record(now, cs, event) {
            self.sent.fetch_add(1, Ordering::Relaxed);
        }
        if let Some(run) = learned.flatten() {
            self.publish(Topic::cs(cs, CsTopic::Run), Payload::Run(run));
        }
    }

    /// Raises an alarm or a warning; a warning is in the history only.
    pub fn raise(&self, record: AlarmRecord) -> AlarmRecord {
        let is_active = record.severity == AlarmSeverity::Alarm;
        self.raise_for(record, is_active)
    }

    /// Raises a warning that is among the active alarms until a reset, and prevents nothing.
    pub fn raise_standing(&self, record: AlarmRecord) -> AlarmRecord {
        self.raise_for(record, true)
    }

    /// A warning of the whole machine that stands, through resets, as long as there is a text.
    pub fn stand(&self, entry: &AlarmEntry, text: Option<&str>) {
        let mut alarms = self.alarms.lock();
        for record in alarms.stand(entry, text, &self.timestamp()) {
            self.publish_alarms(&alarms, &record);
        }
    }

    /// What the configuration, else a handler that is there, says of the alarm that sequence programs raise by this code.
    pub fn alarm_text(&self, code: u16) -> Option<AlarmText> {
        let of_config = self.machine.alarms.get(&code).cloned();
        of_config.or_else(|| self.handlers.lock().alarm_text(code))
    }

    /// One that is active already is not raised again: its record is given back.
    fn raise_for(&self, mut record: AlarmRecord, is_active: bool) -> AlarmRecord {
        let code = record.number.checked_sub(USER_ALARM_BASE);
        if let Some(said) = code.and_then(|code| self.alarm_text(code)) {
            (record.remedy, record.languages) = (said.remedy, said.languages);
        }
        let mut alarms = self.alarms.lock();
        match alarms.raise(record, is_active, self.timestamp()) {
            Raised::Active(record) => record,
            Raised::New(record) => {
                self.publish_alarms(&alarms, &record);
                record
            }
        }
    }

    /// Clears the alarms of a coordinate system, and those of the whole machine; of these all tasks are woken to publish it.
    pub fn clear_alarms(&self, cs: CoordinateSystemNumber) {
        let mut alarms = self.alarms.lock();
        let cleared = alarms.clear(cs, &self.timestamp());
        if cleared.iter().any(|alarm| alarm.cs.is_none()) {
            self.wake_all();
        }
        for record in cleared {
            self.publish_alarms(&alarms, &record);
        }
    }

    /// Notes who has acknowledged an alarm; false when there is no such active alarm.
    pub fn acknowledge_alarm(&self, id: u64, by: &str) -> bool {
        let mut alarms = self.alarms.lock();
        let acknowledged = alarms.acknowledge(id, by);
        if let Some(record) = &acknowledged {
            self.publish_alarms(&alarms, record);
        }
        acknowledged.is_some()
    }

    fn publish_alarms(&self, alarms: &Alarms, changed: &AlarmRecord) {
        self.publish(Topic::AlarmActive, Payload::AlarmActive(alarms.active()));
        self.publish(Topic::AlarmEvent, Payload::AlarmEvent(changed.clone()));
    }

    /// Alarms of a coordinate system that are active; warnings do not count.
    pub fn alarm_count(&self, cs: CoordinateSystemNumber) -> u32 {
        self.alarms.lock().count(cs)
    }

    pub fn alarm_history(&self) -> Vec<AlarmRecord> {
        self.alarms.lock().history()
    }

    /// Notes and publishes a handler.
    ///
    /// # Errors
    /// As of the registry.
    pub fn set_handler(&self, id: &str, presence: &HandlerPresence) -> Result<Registered, Refusal> {
        let (now, now_s) = (self.clock.wall(), self.clock.now_s());
        let changed = self.handlers.lock().set(id, presence, now, now_s)?;
        if let Registered::Online {
            forgotten: Some(gone),
            ..
        } = &changed
        {
            self.hub.forget(&Topic::HandlerPresence(gone.clone()));
        }
        if !matches!(changed, Registered::Nothing | Registered::Refreshed) {
            let shown = HandlerPresence {
                take_over: false,
                ..presence.clone()
            };
            self.publish(
                Topic::HandlerPresence(id.to_owned()),
                Payload::HandlerPresence(shown),
            );
            self.publish_birth();
        }
        Ok(changed)
    }

    /// Publishes what the machine is where that has changed.
    pub fn publish_birth(&self) {
        let _one_after_the_other = self.birth.lock();
        let birth = birth(&self.machine, &self.handlers());
        let known = self.hub.read(&Topic::Birth);
        let is_known = known
            .as_deref()
            .is_some_and(|known| matches!(&known.payload, Payload::Birth(known) if *known == birth));
        if !is_known {
            self.publish(Topic::Birth, Payload::Birth(birth));
        }
    }

    /// The instance of a handler that is to confirm that it is still there.
    pub fn asked_handler(&self, id: &str) -> Option<String> {
        self.handlers.lock().asked(id).map(str::to_owned)
    }

    /// Tells an instance of a handler what became of it.
    pub fn tell_handler(&self, id: &str, result: HandlerResult) {
        self.publish(
            Topic::HandlerResult(id.to_owned()),
            Payload::HandlerResult(result),
        );
    }

    pub fn handlers(&self) -> BTreeMap<String, HandlerPresence> {
        self.handlers.lock().all()
    }

    /// What the configuration, and handlers that are there, declare of M codes.
    pub fn declared(&self) -> Vec<Declared> {
        let of_config = self.machine.m_codes.values();
        let of_config = of_config.filter_map(|settings| settings.declared.clone().map(Declared::in_config));
        let handlers = self.handlers();
        let handlers = handlers.iter().filter(|(_, handler)| handler.online);
        let of_handlers = handlers.flat_map(|(id, handler)| {
            let said = handler.m_codes.iter().cloned();
            said.map(|declaration| Declared::by_handler(id, declaration))
        });
        of_config.chain(of_handlers).collect()
    }

    /// True while a handler is there.
    pub fn is_online(&self, id: &str) -> bool {
        self.handlers.lock().is_online(id)
    }

    /// True when a handler that is there serves this M code.
    pub fn is_handled(&self, cs: CoordinateSystemNumber, m: u16) -> bool {
        self.handlers.lock().serve(cs, m)
    }

    /// When the handler comes back that serves this M code and has left, seconds since the start.
    pub fn handler_back_s(&self, cs: CoordinateSystemNumber, m: u16) -> Option<f64> {
        self.handlers.lock().back_s(cs, m, self.clock.now_s())
    }

    /// Notes how long an M code took to be reset, s. What it took lately counts for a quarter.
    pub fn note_m_code_wait(&self, cs: CoordinateSystemNumber, m: u16, took_s: f64) {
        let mut waits = self.m_code_waits.lock();
        let known = waits.entry((cs, m)).or_insert(took_s);
        *known += (took_s - *known) / 4.0;
    }

    /// How long it takes as a rule, s; `None`: nobody knows yet.
    pub fn m_code_wait(&self, cs: CoordinateSystemNumber, m: u16) -> Option<f64> {
        self.m_code_waits.lock().get(&(cs, m)).copied()
    }

    /// Looks a command up by its id, and notes it when it is new.
    pub fn recall(&self, command_id: &str, asked: Asked) -> Recalled {
        self.commands.lock().recall(command_id, asked, self.clock.wall())
    }

    /// Revision of a coordinate system's state; 0 for none.
    pub fn state_rev(&self, cs: Option<CoordinateSystemNumber>) -> u64 {
        cs.and_then(|cs| self.hub.read(&Topic::cs(cs, CsTopic::State)))
            .and_then(|state| state.rev)
            .unwrap_or(0)
    }

    /// A reply to a command; `cs` is the coordinate system whose state revision it has.
    pub fn reply_to(
        &self,
        cs: Option<CoordinateSystemNumber>,
        meta: &CommandMeta,
        status: CommandStatus,
        code: &str,
        text: &str,
    ) -> CommandReply {
        CommandReply {
            command_id: meta.command_id.clone(),
            status,
            code: code.to_owned(),
            text: text.to_owned(),
            state_rev: self.state_rev(cs),
            variables: None,
            lease: None,
            hash: None,
            run_id: None,
        }
    }

    /// A refusal as the reply to a command.
    pub fn rejection(
        &self,
        cs: Option<CoordinateSystemNumber>,
        meta: &CommandMeta,
        refusal: &Refusal,
    ) -> CommandReply {
        let code = wire_name(&refusal.code);
        self.reply_to(cs, meta, CommandStatus::Rejected, &code, &refusal.text)
    }

    /// Keeps and publishes a refusal as the reply to a command.
    pub fn reject(
        &self,
        cs: Option<CoordinateSystemNumber>,
        meta: &CommandMeta,
        refusal: Refusal,
    ) -> Refusal {
        self.reply(&meta.client_id, self.rejection(cs, meta, &refusal));
        refusal
    }

    /// Keeps and publishes a reply.
    pub fn reply(&self, client_id: &str, reply: CommandReply) -> CommandReply {
        self.commands.lock().on_reply(&reply, self.clock.wall());
        self.publish(Topic::Reply(client_id.to_owned()), Payload::Reply(reply.clone()));
        reply
    }

    /// The last reply to a command.
    pub fn replied(&self, command_id: &str) -> Option<CommandReply> {
        self.commands.lock().reply(command_id).cloned()
    }
}
