//! What all coordinate systems, the port and the server ends share.

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use plc_api::handshake::Now;
use plc_api::hub::Hub;
use plc_api::types::command::CommandReply;
use plc_api::types::machine::{ActiveAlarms, AlarmRecord, AlarmSeverity};
use plc_api::types::message::{Message, Payload};
use plc_api::types::output::HandlerPresence;
use plc_api::types::topic::Topic;
use plc_api::types::{BootId, CoordinateSystemNumber, Timestamp};
use tandem_model::alarm::ALARMS;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use crate::clock::Clock;
use crate::command_memory::{Asked, CommandMemory, Recalled};
use crate::config::Machine;
use crate::journal::{Event, Journal};
use crate::persistence::{Keeper, Restored};
use crate::program_store::ProgramStore;
use crate::servo_thread::ServoStatistics;
use crate::tables::Tables;

/// Alarms kept after they were cleared. The oldest are forgotten.
pub const ALARM_HISTORY_MAX: usize = 1000;

/// Alarms that stand at the most in one coordinate system, and of the whole machine: the oldest. Further ones are events,
/// and in the history. Reason: all that stand are one message.
pub const ALARMS_ACTIVE_MAX: usize = 24;

/// Handlers that are or were there. A further one is refused.
pub const HANDLERS_MAX: usize = 256;

/// Shared state of a machine.
#[derive(Debug)]
pub(crate) struct Shared {
    pub machine: Machine,
    pub boot_id: BootId,
    pub hub: Hub,
    pub clock: Clock,
    pub store: ProgramStore,
    pub journal: Journal,
    /// How punctual the servo thread is; nothing in simulated time.
    pub servo: Arc<ServoStatistics>,
    pub tables: Tables,
    /// Writes what is kept; none in simulated time and without a data folder.
    pub keeper: OnceLock<Keeper>,
    /// Tools in the spindles and last runs, from before this start.
    pub restored: Restored,
    /// False while the connection to the MQTT broker is lost.
    pub bus_connected: AtomicBool,
    /// Cancelled when the runtime stops.
    pub closing: CancellationToken,
    alarms: Mutex<Alarms>,
    handlers: Mutex<BTreeMap<String, HandlerPresence>>,
    commands: Mutex<CommandMemory>,
    /// Wakes the task of each coordinate system.
    wakes: Mutex<Vec<Arc<Notify>>>,
    told: AtomicU64,
}

#[derive(Debug, Default)]
struct Alarms {
    next_id: u64,
    active: Vec<AlarmRecord>,
    history: VecDeque<AlarmRecord>,
}

impl Shared {
    pub fn new(
        machine: Machine,
        boot_id: BootId,
        clock: Clock,
        store: ProgramStore,
        journal: Journal,
        (tables, restored): (Tables, Restored),
    ) -> Self {
        Self {
            tables,
            keeper: OnceLock::new(),
            restored,
            machine,
            boot_id,
            hub: Hub::new(),
            clock,
            store,
            journal,
            servo: Arc::default(),
            bus_connected: AtomicBool::new(true),
            closing: CancellationToken::new(),
            alarms: Mutex::default(),
            handlers: Mutex::default(),
            commands: Mutex::default(),
            wakes: Mutex::default(),
            told: AtomicU64::new(0),
        }
    }

    /// From now on what concerns all coordinate systems wakes this task, too.
    pub fn wakes(&self, task: Arc<Notify>) {
        lock(&self.wakes).push(task);
    }

    /// Counts what was said to others, and may have woken a task.
    pub fn told(&self) -> u64 {
        self.told.load(Ordering::Relaxed)
    }

    fn tell(&self, message: Message) {
        self.told.fetch_add(1, Ordering::Relaxed);
        self.hub.publish(message);
    }

    pub fn now(&self) -> Now {
        Now {
            monotonic_s: self.clock.now_s(),
            time: self.clock.wall(),
        }
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
            self.tell(self.message(topic, None, payload));
            return 0;
        }
        let last = self.hub.read(&topic);
        let last_rev = last.as_ref().and_then(|message| message.rev).unwrap_or(0);
        if last.is_some_and(|message| message.payload == payload) {
            return last_rev;
        }
        self.tell(self.message(topic, Some(last_rev + 1), payload));
        last_rev + 1
    }

    /// Writes a line of the journal.
    pub fn record(&self, cs: CoordinateSystemNumber, event: Event) {
        if self.journal.record(self.now(), cs, event) {
            self.told.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Raises an alarm or a warning; a warning is in the history only.
    pub fn raise(&self, record: AlarmRecord) -> AlarmRecord {
        let stands = record.severity == AlarmSeverity::Alarm;
        self.raise_for(record, stands)
    }

    /// Raises a warning that stands among the active alarms until a reset, and prevents nothing.
    pub fn raise_standing(&self, record: AlarmRecord) -> AlarmRecord {
        self.raise_for(record, true)
    }

    /// One that stands already is not raised again: its record is given back.
    fn raise_for(&self, record: AlarmRecord, stands: bool) -> AlarmRecord {
        let mut alarms = lock(&self.alarms);
        if let Some(same) = alarms.active.iter().find(|active| says_the_same(active, &record)) {
            return same.clone();
        }
        alarms.next_id += 1;
        let entry = ALARMS.iter().find(|entry| entry.number == record.number);
        let record = AlarmRecord {
            remedy: entry.map(|entry| entry.remedy.to_owned()),
            id: alarms.next_id,
            raised_at: self.timestamp(),
            ..record
        };
        alarms.history.push_back(record.clone());
        if alarms.history.len() > ALARM_HISTORY_MAX {
            alarms.history.pop_front();
        }
        let beside = alarms.active.iter().filter(|active| active.cs == record.cs);
        if stands && beside.count() < ALARMS_ACTIVE_MAX {
            alarms.active.push(record.clone());
        }
        self.publish_alarms(&alarms, &record);
        record
    }

    /// Clears the alarms of a coordinate system, and those of the whole machine; all are woken to tell of these.
    pub fn clear_alarms(&self, cs: CoordinateSystemNumber) {
        let mut alarms = lock(&self.alarms);
        let now = self.timestamp();
        let (cleared, active): (Vec<_>, Vec<_>) = std::mem::take(&mut alarms.active)
            .into_iter()
            .partition(|alarm| alarm.cs.is_none_or(|of| of == cs));
        alarms.active = active;
        if cleared.iter().any(|alarm| alarm.cs.is_none()) {
            for wake in lock(&self.wakes).iter() {
                wake.notify_one();
            }
        }
        for record in cleared {
            let record = AlarmRecord {
                cleared_at: Some(now.clone()),
                ..record
            };
            alarms.update_history(&record);
            self.publish_alarms(&alarms, &record);
        }
    }

    /// Notes who has acknowledged an alarm; false when there is no such active alarm.
    pub fn acknowledge_alarm(&self, id: u64, by: &str) -> bool {
        let mut alarms = lock(&self.alarms);
        let Some(record) = alarms.active.iter_mut().find(|alarm| alarm.id == id) else {
            return false;
        };
        record.acknowledged_by = Some(by.to_owned());
        let record = record.clone();
        alarms.update_history(&record);
        self.publish_alarms(&alarms, &record);
        true
    }

    fn publish_alarms(&self, alarms: &Alarms, changed: &AlarmRecord) {
        self.publish(
            Topic::AlarmActive,
            Payload::AlarmActive(ActiveAlarms {
                alarms: alarms.active.clone(),
            }),
        );
        self.publish(Topic::AlarmEvent, Payload::AlarmEvent(changed.clone()));
    }

    /// Alarms of a coordinate system that are active; warnings do not count.
    pub fn alarm_count(&self, cs: CoordinateSystemNumber) -> u32 {
        let of_cs = |alarm: &&AlarmRecord| {
            alarm.severity == AlarmSeverity::Alarm && alarm.cs.is_none_or(|number| number == cs)
        };
        u32::try_from(lock(&self.alarms).active.iter().filter(of_cs).count()).unwrap_or(u32::MAX)
    }

    pub fn alarm_history(&self) -> Vec<AlarmRecord> {
        lock(&self.alarms).history.iter().cloned().collect()
    }

    /// Notes a handler; false when there are too many.
    pub fn set_handler(&self, id: &str, presence: HandlerPresence) -> bool {
        let mut handlers = lock(&self.handlers);
        if handlers.len() >= HANDLERS_MAX && !handlers.contains_key(id) {
            let Some(gone) = handlers.iter().find(|(_, p)| !p.online).map(|(id, _)| id.clone()) else {
                return false;
            };
            handlers.remove(&gone);
            self.hub.forget(&Topic::HandlerPresence(gone));
        }
        handlers.insert(id.to_owned(), presence.clone());
        drop(handlers);
        self.publish(
            Topic::HandlerPresence(id.to_owned()),
            Payload::HandlerPresence(presence),
        );
        true
    }

    pub fn handlers(&self) -> BTreeMap<String, HandlerPresence> {
        lock(&self.handlers).clone()
    }

    /// True when a handler that is there serves this M code.
    pub fn is_handled(&self, cs: CoordinateSystemNumber, m: u16) -> bool {
        lock(&self.handlers)
            .values()
            .any(|handler| handler.online && handler.handles.iter().any(|code| code.cs == cs && code.m == m))
    }

    /// Looks a command up by its id, and notes it when it is new.
    pub fn recall(&self, command_id: &str, asked: Asked) -> Recalled {
        lock(&self.commands).recall(command_id, asked, self.clock.wall())
    }

    /// Keeps and publishes a reply.
    pub fn reply(&self, client_id: &str, reply: CommandReply) {
        lock(&self.commands).answered(&reply, self.clock.wall());
        self.publish(Topic::Reply(client_id.to_owned()), Payload::Reply(reply));
    }

    /// The last reply to a command.
    pub fn replied(&self, command_id: &str) -> Option<CommandReply> {
        lock(&self.commands).reply(command_id).cloned()
    }
}

fn says_the_same(a: &AlarmRecord, b: &AlarmRecord) -> bool {
    (a.severity, a.number, &a.text) == (b.severity, b.number, &b.text)
        && (a.cs, a.program, a.line, a.column) == (b.cs, b.program, b.line, b.column)
}

impl Alarms {
    fn update_history(&mut self, record: &AlarmRecord) {
        if let Some(place) = self.history.iter_mut().find(|other| other.id == record.id) {
            *place = record.clone();
        }
    }
}

// A poisoned lock means a panic elsewhere while a value was being stored; the values themselves are whole.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
