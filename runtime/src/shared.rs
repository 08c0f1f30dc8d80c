//! State shared by all coordinate systems, the port and the server ends.

mod commands;

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use parking_lot::Mutex;
use plc_protocol::alarm::USER_ALARM_BASE;
use plc_protocol::handler_registry::{HandlerRegistry, PresenceEffect, Reach};
use plc_protocol::handshake::Now;
use plc_protocol::hub::Hub;
use plc_protocol::io_points::IoPoints;
use plc_protocol::supervisor::{Consequence, FaultReport, Supervisor};
use plc_protocol::types::alarm_text::AlarmText;
use plc_protocol::types::data::{PublishedVariables, VariableArea};
use plc_protocol::types::handler::HandlerResult;
use plc_protocol::types::machine::{AlarmRecord, AlarmSeverity, BrokerInUse, Presence};
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::output::HandlerPresence;
use plc_protocol::types::request::Refusal;
use plc_protocol::types::stored_data::StoredData;
use plc_protocol::types::topic::{CsTopic, Topic};
use plc_protocol::types::{BootId, CoordinateSystemNumber, Timestamp};
use tandem_config::Machine;
use tandem_config::declared::{SourcedDeclaration, refused_output};
use tandem_model::Alarm;
use tandem_model::alarm::{AlarmEntry, SERVO_FAILED, STORED_DATA_QUESTION, TASK_FAILED};
use tandem_model::flow::Output;
use tandem_store::clock::Clock;
use tandem_store::disk::{DataFolderPart, Disk, Health};
use tandem_store::journal::{Event, Journal};
use tandem_store::program_store::ProgramStore;
use tandem_store::runs::RunBook;
use tandem_store::stored_data::OpenQuestion;
use tandem_store::tables::Tables;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use crate::alarms::{Alarms, RaiseOutcome};
use crate::birth::birth;
use crate::command_memory::CommandMemory;
use crate::heartbeat_times::HeartbeatTimes;
use crate::planned::OnPlan;
use crate::servo_thread::ServoStatistics;

/// State of a machine that all of its parts share.
#[derive(Debug)]
pub(crate) struct SharedState {
    pub machine: Machine,
    pub boot_id: BootId,
    pub hub: Hub,
    pub clock: Clock,
    /// Disk with the data folder.
    pub disk: Disk,
    pub store: ProgramStore,
    pub journal: Journal,
    /// Function that receives each part of a plan, in simulated time only.
    pub on_plan: Option<OnPlan>,
    /// Health of the parts of the data folder: whether the last write succeeded.
    pub health: Arc<Health>,
    /// Supervisor of all tasks and threads.
    pub supervisor: Supervisor,
    /// Punctuality and failure of the servo.
    pub servo: Arc<ServoStatistics>,
    pub tables: Arc<Tables>,
    /// True unless the connection to the MQTT broker is lost.
    pub bus_connected: AtomicBool,
    /// Token that is cancelled when the runtime stops.
    pub closing: CancellationToken,
    /// Recent waiting time in s of each M code, by coordinate system and M number.
    m_code_waits: Mutex<BTreeMap<(CoordinateSystemNumber, u16), f64>>,
    alarms: Mutex<Alarms>,
    handlers: Mutex<HandlerRegistry>,
    /// Inputs and outputs of the plant. Locked while their states are published, so that the last message is the
    /// current one.
    pub io: Mutex<IoPoints>,
    /// Wakes [`SharedState::watch_io`] when an owner of an input or output has left, because its time limit may be the
    /// next.
    pub io_absences: Notify,
    /// Serializes the publication of `birth`, so that the last message is the current one.
    birth: Mutex<()>,
    /// Variables that were published last. Locked while variables, tools and offsets are published.
    pub published_variables: Mutex<BTreeMap<VariableArea, PublishedVariables>>,
    pub runs: Arc<Mutex<RunBook>>,
    /// The question about inconsistent stored files, if any.
    pub stored_data: Mutex<OpenQuestion>,
    commands: Mutex<CommandMemory>,
    /// Times at which heartbeats were sent.
    heartbeats: Mutex<HeartbeatTimes>,
    /// Notifications that wake the tasks of the coordinate systems.
    wakes: Mutex<Vec<Arc<Notify>>>,
    sent: AtomicU64,
}

impl SharedState {
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
            handlers: Mutex::new(HandlerRegistry::with_grace(machine.handler_grace_s)),
            io_absences: Notify::new(),
            machine,
            boot_id,
            hub: Hub::new(),
            clock,
            disk: Disk::default(),
            store,
            journal,
            health: Arc::default(),
            on_plan: None,
            supervisor: Supervisor::default(),
            servo: Arc::default(),
            bus_connected: AtomicBool::new(true),
            closing: CancellationToken::new(),
            m_code_waits: Mutex::default(),
            alarms: Mutex::default(),
            birth: Mutex::default(),
            published_variables: Mutex::default(),
            runs: Arc::default(),
            stored_data: Mutex::default(),
            commands: Mutex::default(),
            heartbeats: Mutex::default(),
            wakes: Mutex::default(),
            sent: AtomicU64::new(0),
        }
    }

    /// Adds a task to those that [`SharedState::wake_all`] wakes.
    pub fn wakes(&self, task: Arc<Notify>) {
        self.wakes.lock().push(task);
    }

    /// Wakes the task of each coordinate system.
    pub fn wake_all(&self) {
        for wake in self.wakes.lock().iter() {
            wake.notify_one();
        }
    }

    /// Returns the number of messages and journal lines that may have woken a task.
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

    /// Creates a message with the current time.
    pub fn message(&self, topic: Topic, rev: Option<u64>, payload: Payload) -> Message {
        Message {
            topic,
            boot_id: self.boot_id.clone(),
            ts: self.timestamp(),
            rev,
            payload,
        }
    }

    /// Publishes an event, or a state that has changed. Returns the revision of a state; 0 for an event.
    pub fn publish(&self, topic: Topic, payload: Payload) -> u64 {
        if !topic.is_state() {
            self.send(self.message(topic, None, payload));
            return 0;
        }
        self.publish_state(topic, payload).rev.unwrap_or(0)
    }

    /// Publishes a state if it has changed. Returns the current message of the state.
    pub fn publish_state(&self, topic: Topic, payload: Payload) -> Arc<Message> {
        let message = |topic, rev, payload| self.message(topic, Some(rev), payload);
        let (message, has_changed) = self.hub.publish_change(topic, payload, message);
        if has_changed {
            self.sent.fetch_add(1, Ordering::Relaxed);
        }
        message
    }

    /// Publishes an unchanged state again with the current time.
    pub fn republish_state(&self, topic: &Topic) {
        if let Some(last) = self.hub.read(topic) {
            let (rev, payload) = (last.rev, last.payload.clone());
            self.send(self.message(topic.clone(), rev, payload));
        }
    }

    /// Publishes in the presence to which external broker the runtime is connected.
    pub fn publish_broker(&self, broker: Option<BrokerInUse>) {
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

    /// Records whether a write to a part of the data folder succeeded, and returns the result. An invalid or too large
    /// request says nothing about the disk and is not recorded.
    pub fn record_attempt<T>(&self, part: DataFolderPart, attempt: io::Result<T>) -> io::Result<T> {
        let is_asked_too_much = |error: &io::Error| {
            matches!(
                error.kind(),
                io::ErrorKind::InvalidInput | io::ErrorKind::QuotaExceeded
            )
        };
        if !attempt.as_ref().is_err_and(is_asked_too_much) {
            self.health.record_attempt(part, &attempt);
            if let Err(error) = &attempt {
                self.update_standing_warning(part.alarm(), Some(&error.to_string()));
            }
        }
        attempt
    }

    /// Publishes the question about inconsistent stored files, or that no question is open.
    pub fn publish_stored_data(&self) {
        let question = self.stored_data.lock().question().cloned();
        self.publish(Topic::StoredData, Payload::StoredData(StoredData { question }));
    }

    /// Writes the question about stored files to the journal, if a question is open, and raises its warning.
    pub fn report_question(&self) {
        let open = self.stored_data.lock();
        if let Some(question) = open.question() {
            let event = Event::StoredData {
                decision: None,
                findings: question.texts(),
            };
            self.record(0, event);
        }
        self.update_standing_warning(&STORED_DATA_QUESTION, open.text().as_deref());
    }

    /// Writes a line of the journal.
    ///
    /// The run book processes the event under its lock. So each run that is read or stored later includes the event.
    pub fn record(&self, cs: CoordinateSystemNumber, event: Event) {
        let now = self.now();
        let mut runs = RunBook::learns_from(&event).then(|| self.runs.lock());
        // a line about a block is not written to disk
        let n = if matches!(event, Event::Block { .. }) {
            0
        } else {
            self.journal.reserve()
        };
        let learned = runs.as_mut().and_then(|runs| {
            runs.note_line(cs, n);
            runs.on(cs, &event, now).then(|| runs.state(cs))
        });
        if self.journal.record(n, now, cs, event) {
            self.sent.fetch_add(1, Ordering::Relaxed);
        }
        drop(runs);
        if let Some(run) = learned {
            self.publish(Topic::cs(cs, CsTopic::Run), Payload::Run(run));
        }
    }

    /// Raises an alarm or a warning. A warning is not active and appears only in the history.
    pub fn raise(&self, record: AlarmRecord) -> AlarmRecord {
        let is_active = record.severity == AlarmSeverity::Alarm;
        self.raise_for(record, is_active)
    }

    /// Raises a warning that stays active until a reset. It stops nothing and refuses no start.
    pub fn raise_standing(&self, record: AlarmRecord) -> AlarmRecord {
        self.raise_for(record, true)
    }

    /// Raises a warning of the whole machine that stays active, also after resets, until `text` is `None`.
    pub fn update_standing_warning(&self, entry: &AlarmEntry, text: Option<&str>) {
        let mut alarms = self.alarms.lock();
        for record in alarms.update_standing_warning(entry, text, &self.timestamp()) {
            self.publish_alarms(&alarms, &record);
        }
    }

    /// Returns the text of the alarm with this code of sequence programs: from the configuration, otherwise from an
    /// online handler.
    pub fn alarm_text(&self, code: u16) -> Option<AlarmText> {
        let of_config = self.machine.alarms.get(&code).cloned();
        of_config.or_else(|| self.handlers.lock().alarm_text(code))
    }

    /// Raises an alarm and returns its record. An alarm that is already active is not raised again.
    fn raise_for(&self, mut record: AlarmRecord, is_active: bool) -> AlarmRecord {
        let code = record.number.checked_sub(USER_ALARM_BASE);
        if let Some(said) = code.and_then(|code| self.alarm_text(code)) {
            (record.remedy, record.languages) = (said.remedy, said.languages);
        }
        let mut alarms = self.alarms.lock();
        match alarms.raise(record, is_active, self.timestamp()) {
            RaiseOutcome::Active(record) => record,
            RaiseOutcome::New(record) => {
                self.publish_alarms(&alarms, &record);
                record
            }
        }
    }

    /// Clears the alarms of a coordinate system and of the whole machine. If one of the whole machine is cleared, wakes
    /// all tasks, which publish the change.
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

    /// Records the user that has acknowledged an active alarm. Returns false if no active alarm has this id.
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

    /// Returns the number of active alarms of a coordinate system and of the whole machine. Warnings do not count.
    pub fn alarm_count(&self, cs: CoordinateSystemNumber) -> u32 {
        self.alarms.lock().count(cs)
    }

    /// From now on, raises a warning after each fault of a task or thread that has no alarm of its own.
    pub fn warn_of_faults(self: &Arc<Self>) {
        let shared = Arc::downgrade(self);
        self.supervisor.listen(move |report| {
            let own_alarm = matches!(
                report.consequence,
                Consequence::StopsCoordinateSystem
                    | Consequence::CoordinateSystemNeedsRestart
                    | Consequence::StopsAll
            );
            tracing::error!("{}", report.message());
            if let (Some(shared), false) = (shared.upgrade(), own_alarm) {
                shared.raise_standing(AlarmRecord {
                    severity: AlarmSeverity::Warning,
                    number: TASK_FAILED.number,
                    text: format!("{}: {}", TASK_FAILED.title, report.message()),
                    ..AlarmRecord::default()
                });
            }
        });
    }

    /// Raises an alarm of the whole machine because the servo has failed. Each coordinate system reacts in its next
    /// turn.
    pub fn on_servo_failed(&self, why: &str) {
        self.raise(AlarmRecord {
            number: SERVO_FAILED.number,
            text: format!(
                "{}: {why}. All motion has stopped and outputs are cancelled. Make the machine safe, then restart the runtime",
                SERVO_FAILED.title
            ),
            ..AlarmRecord::default()
        });
        self.supervisor.report(&FaultReport {
            task: "servo".to_owned(),
            consequence: Consequence::StopsAll,
            text: why.to_owned(),
        });
        self.wake_all();
    }

    /// Returns true if an alarm with this number is active in this coordinate system.
    pub fn is_alarm_active(&self, number: u16, cs: CoordinateSystemNumber) -> bool {
        self.alarms.lock().is_active(number, cs)
    }

    pub fn alarm_history(&self) -> Vec<AlarmRecord> {
        self.alarms.lock().history()
    }

    /// Registers a handler, or records that it went offline, and publishes its presence.
    ///
    /// # Errors
    /// Returns an error if the registry refuses the handler.
    pub fn set_handler(
        &self,
        reach: Reach,
        id: &str,
        presence: &HandlerPresence,
    ) -> Result<PresenceEffect, Refusal> {
        let now = (self.clock.wall(), self.clock.now_s());
        let changed = self.handlers.lock().set_over(reach, id, presence, now)?;
        if let PresenceEffect::Online {
            forgotten: Some(gone),
            ..
        } = &changed
        {
            self.hub.forget(&Topic::HandlerPresence(gone.clone()));
        }
        if !matches!(changed, PresenceEffect::Nothing | PresenceEffect::Refreshed) {
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

    /// Publishes the description of the machine if it has changed.
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

    /// Returns the instance of a handler that must confirm its presence; `None` if no instance must.
    pub fn asked_handler(&self, id: &str) -> Option<String> {
        self.handlers.lock().instance_to_confirm(id).map(str::to_owned)
    }

    /// Publishes to a handler the result of its request.
    pub fn publish_handler_result(&self, id: &str, result: HandlerResult) {
        self.publish(
            Topic::HandlerResult(id.to_owned()),
            Payload::HandlerResult(result),
        );
    }

    pub fn handlers(&self) -> BTreeMap<String, HandlerPresence> {
        self.handlers.lock().all()
    }

    /// Returns all declarations of M codes in the configuration and by online handlers.
    pub fn declared(&self) -> Vec<SourcedDeclaration> {
        let of_config = self.machine.m_codes.values();
        let of_config =
            of_config.filter_map(|settings| settings.declared.clone().map(SourcedDeclaration::in_config));
        let handlers = self.handlers();
        let handlers = handlers.iter().filter(|(_, handler)| handler.online);
        let of_handlers = handlers.flat_map(|(id, handler)| {
            let said = handler.m_codes.iter().cloned();
            said.map(|declaration| SourcedDeclaration::by_handler(id, declaration))
        });
        of_config.chain(of_handlers).collect()
    }

    /// Returns the declarations of one M code in the configuration, by online handlers, and by absent handlers that may
    /// still return.
    pub fn declared_of(&self, cs: CoordinateSystemNumber, m: u16) -> Vec<SourcedDeclaration> {
        let settings = self.machine.m_codes.get(&m);
        let of_config = settings.and_then(|settings| settings.declared.clone());
        let mut declared: Vec<SourcedDeclaration> =
            of_config.map(SourcedDeclaration::in_config).into_iter().collect();
        let of_handlers = self.handlers.lock().declarations(cs, m, self.deadline_now_s());
        let by_handler = |(id, declaration): (String, _)| SourcedDeclaration::by_handler(&id, declaration);
        declared.extend(of_handlers.into_iter().map(by_handler));
        declared
    }

    /// Returns alarm 11 if a declaration does not accept the parameters of an output.
    pub fn refused_output(&self, cs: CoordinateSystemNumber, output: &Output) -> Option<Alarm> {
        let has_params = output.has_params();
        has_params
            .then(|| refused_output(output, &self.declared_of(cs, output.m)))
            .flatten()
    }

    /// Returns true if the handler with this id is online.
    pub fn is_online(&self, id: &str) -> bool {
        self.handlers.lock().is_online(id)
    }

    /// Checks that the sender of a value is the online instance of the handler with this id.
    ///
    /// # Errors
    /// Returns an error in the cases of [`HandlerRegistry::check_writer`].
    pub fn check_writer(&self, id: &str, instance: Option<&String>) -> Result<(), Refusal> {
        self.handlers.lock().check_writer(id, instance)
    }

    /// Returns true if an online handler serves this M code.
    pub fn is_handled(&self, cs: CoordinateSystemNumber, m: u16) -> bool {
        self.handlers.lock().serve(cs, m)
    }

    /// Returns the time in s since the start until which the offline handler of this M code is expected to return.
    pub fn handler_back_s(&self, cs: CoordinateSystemNumber, m: u16) -> Option<f64> {
        self.handlers.lock().back_s(cs, m, self.deadline_now_s())
    }

    /// Returns the current time for a comparison with a deadline. The surplus exceeds the rounding of a sleep until the
    /// deadline.
    fn deadline_now_s(&self) -> f64 {
        self.clock.now_s() + 1e-9
    }

    /// Returns the earliest time in s since the start at which an absent handler is no longer expected to return.
    pub fn next_absence_end_s(&self) -> Option<f64> {
        self.handlers.lock().next_absence_end_s(self.deadline_now_s())
    }

    /// Records the time in s from the issue of an M code to its reset. The newest value has a weight of one quarter.
    pub fn note_m_code_wait(&self, cs: CoordinateSystemNumber, m: u16, took_s: f64) {
        let mut waits = self.m_code_waits.lock();
        let known = waits.entry((cs, m)).or_insert(took_s);
        *known += (took_s - *known) / 4.0;
    }

    /// Returns the usual time in s until an M code is reset; `None` if it was never reset.
    pub fn m_code_wait(&self, cs: CoordinateSystemNumber, m: u16) -> Option<f64> {
        self.m_code_waits.lock().get(&(cs, m)).copied()
    }
}
