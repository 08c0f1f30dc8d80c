//! The coordinator: one task for each coordinate system, one servo for all of them, and the port to the whole machine.

mod opening;
mod servo_cycles;

use std::io;
use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use plc_protocol::port::Port;
use plc_protocol::server::ServedPort;
use plc_protocol::types::handler::REFRESHES;
use plc_protocol::types::machine::{ActiveAlarms, AlarmRecord, AlarmSeverity, Presence};
use plc_protocol::types::message::Payload;
use plc_protocol::types::planned::PlannedLocation;
use plc_protocol::types::run::{Run, TimeLeft};
use plc_protocol::types::state::{Execution, Reason};
use plc_protocol::types::topic::{CsTopic, Topic};
use plc_protocol::types::{BootId, CoordinateSystemNumber};
use serde_json::Value;
use tandem_config::{Config, ConfigError, Machine};
use tandem_model::Variables;
use tandem_model::alarm::SOFT_LIMIT;
use tandem_model::flow::Transform;
use tandem_servo::{Hardware, HardwareFactory, Servo};
use tandem_store::clock::Clock;
use tandem_store::disk::{Disk, Health};
use tandem_store::environment::Environment;
use tandem_store::journal::{Event, Journal};
use tandem_store::persistence::positions::KeptPositions;
use tandem_store::persistence::{LastRuns, RestoredState, cut_short, cut_short_between_parts};
use tandem_store::program_store::{HeldBack, PROGRAMS_BYTES_MAX, ProgramStore, Signers};
use tandem_store::runs::KeptRuns;
use tandem_store::tables::Tables;
use tokio::task::JoinSet;

use crate::coordinate_system::{CoordinateSystem, Mailbox};
use crate::port::{AccessLines, RuntimePort};
use crate::preview::Previews;
use crate::servo_thread::{RelayCallbacks, ServoStatistics, ServoThread};
use crate::shared::SharedState;
use crate::simulation::{self, Simulation, SimulationOptions};
use opening::{Data, Keepers, Programs, bring_up, new_boot_id, report_programs};
pub use servo_cycles::ServoCycles;

/// Interval at which positions, variables and the heartbeat are published. Program positions and spindles are published
/// at every second interval.
const PUBLISH_INTERVAL: Duration = Duration::from_millis(100);

/// Reason why a runtime cannot start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The configuration is invalid.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The data folder cannot be used.
    #[error("[machine] data_dir = {path}: {error}")]
    DataDir {
        /// Path of the data folder.
        path: String,
        /// Error of the operating system.
        error: io::Error,
    },
    /// A program of the configuration cannot be read.
    #[error("[[coordinate_system]] programs: {number} = {path}: {error}")]
    Program {
        /// Program number.
        number: u16,
        /// Path of the program file.
        path: String,
        /// Error of the operating system.
        error: io::Error,
    },
    /// The program store cannot be opened.
    #[error("the program store cannot be opened: {0}")]
    Store(String),
    /// The hardware cannot be started.
    #[error("the hardware cannot be started: {0}")]
    Hardware(io::Error),
    /// The operating system provides no servo thread.
    #[error("the servo thread cannot be started: {0}")]
    Servo(io::Error),
    /// The operating system provides no thread for the storage of changes.
    #[error("the thread that stores changes cannot be started: {0}")]
    Thread(io::Error),
    /// A simulated runtime was started outside of [`simulation::run`], or as the second one inside it.
    #[error("a runtime in simulated time must be started inside simulation::run, and only once")]
    NotInSimulation,
}

/// A running machine. Dropping it stops the servo; [`Runtime::shutdown`] also ends the runs, outputs and tasks in
/// order.
#[derive(Debug)]
pub struct Runtime {
    pub(crate) port: Arc<RuntimePort>,
    tasks: JoinSet<()>,
    servo: Option<ServoThread>,
    simulation: Option<Arc<Simulation>>,
    /// Writers of stored data and journal; `None` in simulated time or without a data folder.
    kept: Option<Keepers>,
}

impl Runtime {
    /// Starts the machine of a configuration in real time, with simulated hardware and without server ends.
    ///
    /// # Errors
    /// Returns an error if the configuration, its programs or its data folder are refused, or if the servo thread
    /// cannot be created.
    pub async fn start(config: Config) -> Result<Runtime, StartError> {
        Self::start_on(config, Hardware::simulated_factory()).await
    }

    /// Starts the machine as [`Runtime::start`] does, with the hardware that `hardware` creates.
    ///
    /// # Errors
    /// Returns an error in the cases of [`Runtime::start`], or if the hardware does not start.
    pub async fn start_on(config: Config, hardware: HardwareFactory) -> Result<Runtime, StartError> {
        let machine = config.resolve()?;
        let boot_id = new_boot_id();
        let environment = Environment::default();
        let (of_opening, opening, of_journal) = (environment.clone(), machine.clone(), boot_id.clone());
        let open = move || OpenedResources::open(&of_opening, &opening, of_journal, hardware);
        let opened = tokio::task::spawn_blocking(open)
            .await
            .map_err(|error| StartError::Store(error.to_string()))??;
        let (mut runtime, servo) = opened.put_together(machine, boot_id, environment)?;
        let shared = Arc::clone(&runtime.port.shared);
        let (period, missed_max) = (shared.machine.servo_period(), shared.machine.missed_cycles_max());
        let statistics = Arc::clone(&shared.servo);
        let of_failure = Arc::clone(&shared);
        let told = RelayCallbacks {
            wake: move || {
                shared.supervisor.fault_point("servo-relay");
                shared.wake_all();
            },
            failed: move |why: &str| of_failure.on_servo_failed(why),
        };
        let servo = ServoThread::start(servo, period, missed_max, told, statistics);
        runtime.servo = Some(servo.map_err(StartError::Servo)?);
        Ok(runtime)
    }

    /// Starts a machine as [`Runtime::start`] does, but in an environment: with its disk, its threads and its clock. The
    /// caller executes the servo cycles. `boot_id` identifies this start. Blocks until the disk operations are done.
    ///
    /// # Errors
    /// Returns an error in the cases of [`Runtime::start`].
    pub fn start_in_environment(
        environment: Environment,
        machine: Machine,
        boot_id: BootId,
    ) -> Result<(Runtime, ServoCycles), StartError> {
        let hardware = Hardware::simulated_factory();
        let opened = OpenedResources::open(&environment, &machine, boot_id.clone(), hardware)?;
        let (runtime, servo) = opened.put_together(machine, boot_id, environment)?;
        let cycles = ServoCycles::new(servo, &runtime.port.shared);
        Ok((runtime, cycles))
    }

    /// Starts a machine in simulated time, inside [`simulation::run`]. The machine stores nothing on disk.
    ///
    /// # Errors
    /// Returns an error if a program of the configuration cannot be read, if the hardware does not start, or outside of
    /// [`simulation::run`].
    pub fn start_simulated(
        machine: Machine,
        journal: Journal,
        mut options: SimulationOptions,
    ) -> Result<Runtime, StartError> {
        let slot = simulation::slot().ok_or(StartError::NotInSimulation)?;
        let machine = Machine {
            data_dir: None,
            signers: Signers::default(),
            programs_bytes_max: PROGRAMS_BYTES_MAX,
            takes_mdi: true,
            ..machine
        };
        let Programs {
            store, first_state, ..
        } = Programs::open(
            &Disk::default(),
            &machine,
            &Health::default(),
            &HeldBack::default(),
        )?;
        let factory = options.hardware.take();
        let factory = factory.unwrap_or_else(Hardware::simulated_factory);
        let hardware = bring_up(factory, &machine, &KeptPositions::default())?;
        let clock = Clock::simulated();
        let boot_id = BootId("simulation".into());
        let tables = Tables::new(machine.table_settings());
        let mut shared = SharedState::new(machine, boot_id, clock.clone(), store, journal, tables);
        shared.on_plan = options.on_plan.take();
        let shared = Arc::new(shared);
        let parts = RuntimeParts::new(&shared, first_state, &RestoredState::default(), hardware);
        let mailboxes = parts.mailboxes.clone();
        let simulation = Simulation::new(parts.servo, clock, mailboxes, &shared, options);
        let simulation = Arc::new(simulation);
        slot.set(Arc::clone(&simulation))
            .map_err(|_| StartError::NotInSimulation)?;
        let views = parts.mailboxes.iter().map(|mailbox| Arc::clone(&mailbox.view));
        let previews = Previews::on_demand(&shared, views);
        Ok(Runtime {
            port: Arc::new(RuntimePort {
                shared,
                previews,
                mailboxes: parts.mailboxes,
                writer: None,
                last_runs: LastRuns::new(),
                access: AccessLines::default(),
                io_turn: tokio::sync::Mutex::default(),
            }),
            tasks: parts.tasks,
            servo: None,
            simulation: Some(simulation),
            kept: None,
        })
    }

    /// Returns the sequence-control interface of the machine.
    pub fn port(&self) -> Arc<dyn Port> {
        Arc::<RuntimePort>::clone(&self.port)
    }

    /// Returns the sequence-control interface with the additional functions for server ends.
    pub fn served_port(&self) -> Arc<dyn ServedPort> {
        Arc::<RuntimePort>::clone(&self.port)
    }

    /// Returns the configuration of the machine.
    pub fn machine(&self) -> &Machine {
        &self.port.shared.machine
    }

    /// Returns the P variables and the Q variables of a coordinate system; `None` if the coordinate system does not
    /// exist.
    pub fn variables(&self, cs: CoordinateSystemNumber) -> Option<Variables> {
        let tables = &self.port.shared.tables;
        let is_there = tables.coordinate_systems().any(|number| number == cs);
        is_there.then(|| tables.variables(cs))
    }

    /// Returns a function that gives the transform in force, from the programmed point to the machine position, for the
    /// current position of a coordinate system. Returns `None` if the coordinate system does not exist.
    pub fn transform_of(&self, cs: CoordinateSystemNumber) -> Option<impl Fn() -> Transform + Send + use<>> {
        let mut mailboxes = self.port.mailboxes.iter();
        let view = Arc::clone(&mailboxes.find(|mailbox| mailbox.number == cs)?.view);
        Some(move || view.transform())
    }

    /// Waits until a fault in a task or a thread requires the end of the runtime, and returns the reason. The caller
    /// must then call [`Runtime::shutdown`].
    pub async fn failed(&self) -> String {
        let supervisor = self.port.shared.supervisor.clone();
        supervisor.exit().await
    }

    /// Returns the program store.
    pub fn store(&self) -> &ProgramStore {
        &self.port.shared.store
    }

    /// Returns the punctuality of the servo thread; `None` in simulated time.
    pub fn servo_statistics(&self) -> Option<Arc<ServoStatistics>> {
        self.servo.as_ref().map(|_| Arc::clone(&self.port.shared.servo))
    }

    /// Returns the simulation; `None` in real time.
    pub fn simulation(&self) -> Option<Arc<Simulation>> {
        self.simulation.clone()
    }

    /// Stops the machine in order: motion stops on its path, outputs are cancelled, the tasks end.
    pub async fn shutdown(mut self) {
        self.port.stop_all().await;
        self.port.shared.closing.cancel();
        let ended = async { while self.tasks.join_next().await.is_some() {} };
        let clock = &self.port.shared.clock;
        let _ = clock.within_real(Duration::from_secs(2), ended).await;
        self.tasks.shutdown().await;
        let presence = presence(&self.port.shared, false);
        (self.port.shared).publish(Topic::Presence, Payload::Presence(presence));
        let kept = self.kept.take();
        // Dropping it writes all pending data; an error is logged.
        let _ = tokio::task::spawn_blocking(move || drop(kept)).await;
        self.port.shared.hub.close();
    }
}

/// Resources that a start opens before it creates the runtime.
struct OpenedResources {
    data: Option<Data>,
    programs: Programs,
    health: Arc<Health>,
    hardware: Hardware,
}

impl OpenedResources {
    /// Opens the data folder, the programs and the hardware. Blocks until the disk operations are done.
    fn open(
        environment: &Environment,
        machine: &Machine,
        boot_id: BootId,
        hardware: HardwareFactory,
    ) -> Result<Self, StartError> {
        let data = Data::open(environment, machine, boot_id)?;
        let health = data
            .as_ref()
            .map(|data| Arc::clone(&data.health))
            .unwrap_or_default();
        let none = HeldBack::default();
        let held = data.as_ref().map_or(&none, |data| &data.held);
        let programs = Programs::open(&environment.disk, machine, &health, held)?;
        let kept = data.as_ref().map(Data::positions).unwrap_or_default();
        Ok(Self {
            programs,
            health,
            hardware: bring_up(hardware, machine, &kept)?,
            data,
        })
    }

    /// Creates the runtime and its servo. The caller must execute the servo cycles.
    fn put_together(
        self,
        machine: Machine,
        boot_id: BootId,
        environment: Environment,
    ) -> Result<(Runtime, Servo), StartError> {
        let mut data = self.data;
        let tables = Tables::new(machine.table_settings());
        let (journal, mut restored) = match &mut data {
            Some(data) => (
                Journal::to_disk(data.journal.writer()),
                data.restore(&tables, &machine.io),
            ),
            None => (Journal::to_log(), RestoredState::default()),
        };
        let newest = restored.last_runs.values().map(|kept| kept.line).max();
        journal.continue_numbers_after(newest.unwrap_or(0));
        let Programs {
            store,
            findings,
            first_state,
        } = self.programs;
        let Environment { disk, clock, .. } = environment;
        let mut shared = SharedState::new(machine, boot_id, clock, store, journal, tables);
        shared.disk = disk;
        shared.supervisor = self.health.supervisor.clone();
        shared.health = self.health;
        shared.restore_outputs(std::mem::take(&mut restored.outputs));
        if let Some(data) = &mut data {
            shared.stored_data = Mutex::new(std::mem::take(&mut data.question));
        }
        let kept_runs = std::mem::take(&mut restored.runs);
        let lines = data.as_ref().map(|data| data.newest.lines.as_slice());
        let ended_runs = restore_runs(&shared, kept_runs, &restored.last_runs, lines.unwrap_or_default());
        let shared = Arc::new(shared);
        let mut parts = RuntimeParts::new(&shared, first_state, &restored, self.hardware);
        report_programs(findings, &shared);
        let last_runs = restored.last_runs;
        let positions = data.as_ref().map(Data::positions).unwrap_or_default();
        let kept = data.map(|data| data.keep(&shared, &parts.mailboxes, last_runs.clone()));
        let kept = kept.transpose()?;
        report_last_runs(&shared, &last_runs, &ended_runs);
        report_positions(&shared, &positions);
        shared.report_question();
        shared.warn_of_faults();
        parts.start_publishers(&shared);
        let views = parts.mailboxes.iter().map(|mailbox| Arc::clone(&mailbox.view));
        let mut previews = Previews::on_demand(&shared, views);
        if !shared.clock.is_simulated() {
            previews.start_thread();
            parts.tasks.spawn(previews.run_time_left_publisher());
        }
        let runtime = Runtime {
            port: Arc::new(RuntimePort {
                shared,
                previews,
                mailboxes: parts.mailboxes,
                writer: kept.as_ref().map(|kept| kept.state.writer()),
                last_runs,
                access: AccessLines::default(),
                io_turn: tokio::sync::Mutex::default(),
            }),
            tasks: parts.tasks,
            servo: None,
            simulation: None,
            kept,
        };
        Ok((runtime, parts.servo))
    }
}

/// Parts that a runtime needs in real and in simulated time.
struct RuntimeParts {
    mailboxes: Vec<Arc<Mailbox>>,
    tasks: JoinSet<()>,
    servo: Servo,
}

impl RuntimeParts {
    /// Starts the tasks that publish positions and presence at an interval.
    fn start_publishers(&mut self, shared: &Arc<SharedState>) {
        let supervisor = &shared.supervisor;
        let (of_positions, mailboxes) = (Arc::clone(shared), self.mailboxes.clone());
        let positions = move || publish_positions(Arc::clone(&of_positions), mailboxes.clone());
        self.tasks
            .spawn(supervisor.restarted("publisher of positions", positions));
        if !shared.clock.is_simulated() {
            let of_presence = Arc::clone(shared);
            let presence = move || publish_presence(Arc::clone(&of_presence));
            self.tasks
                .spawn(supervisor.restarted("publisher of presence", presence));
        }
    }

    fn new(
        shared: &Arc<SharedState>,
        first_state: (Execution, Option<Reason>),
        restored: &RestoredState,
        hardware: Hardware,
    ) -> Self {
        let (mut tasks, mut mailboxes) = (JoinSet::new(), Vec::new());
        let configured = shared.machine.coordinate_systems.clone();
        let of_servo: Vec<_> = (configured.iter())
            .map(|system| (&system.settings, system.pre_read_blocks))
            .collect();
        let period_s = shared.machine.servo_period_us as f64 / 1e6;
        let (servo, task_ends) = Servo::new(&of_servo, period_s, hardware);
        for (configured, task_end) in configured.into_iter().zip(task_ends) {
            let tool = restored.tools_in_spindle.get(&configured.settings.number);
            let tool = tool.copied().unwrap_or(Some(0));
            let system = CoordinateSystem::new(Arc::clone(shared), configured, task_end, first_state, tool);
            let mailbox = Arc::new(Mailbox::new(Arc::clone(shared), system));
            let of_task = Arc::clone(&mailbox);
            let task = async move { of_task.run().await };
            tasks.spawn(shared.supervisor.essential("task of a coordinate system", task));
            mailboxes.push(mailbox);
        }
        let of_io = Arc::clone(shared);
        let watching = move || {
            let of_io = Arc::clone(&of_io);
            async move { of_io.watch_io().await }
        };
        tasks.spawn(
            shared
                .supervisor
                .restarted("watch over outputs of the plant", watching),
        );
        for mailbox in &mailboxes {
            let run = shared.runs.lock().state(mailbox.number);
            shared.publish(Topic::cs(mailbox.number, CsTopic::Run), Payload::Run(run));
            let time_left = Payload::TimeLeft(TimeLeft::default());
            shared.publish(Topic::cs(mailbox.number, CsTopic::TimeLeft), time_left);
        }
        shared.publish_birth();
        shared.publish_io();
        shared.publish_areas();
        shared.publish_tables();
        shared.publish_stored_data();
        shared.publish(Topic::AlarmActive, Payload::AlarmActive(ActiveAlarms::default()));
        shared.publish(Topic::Presence, Payload::Presence(presence(shared, true)));
        Self {
            mailboxes,
            tasks,
            servo,
        }
    }
}

fn presence(shared: &SharedState, online: bool) -> Presence {
    Presence {
        online,
        started_at: shared.timestamp(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        broker: None,
        expires_ms: online.then_some(shared.machine.presence_expires_ms),
        url: shared.machine.public_url.clone(),
    }
}

async fn publish_positions(shared: Arc<SharedState>, mailboxes: Vec<Arc<Mailbox>>) {
    let mut interval = tokio::time::interval(PUBLISH_INTERVAL);
    interval.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut odd = false;
    loop {
        tokio::select! {
            () = shared.closing.cancelled() => return,
            _ = interval.tick() => {}
        }
        odd = !odd;
        if let Some(first) = mailboxes.first() {
            let heartbeat = shared.note_heartbeat(first.view.heartbeat());
            shared.publish(Topic::Heartbeat, Payload::Heartbeat(heartbeat));
        }
        shared.publish_variables();
        for mailbox in &mailboxes {
            let topic = |topic| Topic::cs(mailbox.number, topic);
            let position = mailbox.view.position();
            shared.publish(topic(CsTopic::Position), Payload::Position(position));
            if odd {
                let place = mailbox.view.program(&shared.store);
                shared.publish(topic(CsTopic::Program), Payload::Program(place));
                mailbox.publish_spindle();
            }
        }
    }
}

/// Publishes the presence of the runtime again and again, each time before it expires.
async fn publish_presence(shared: Arc<SharedState>) {
    let every = Duration::from_millis(shared.machine.presence_expires_ms) / REFRESHES;
    loop {
        tokio::select! {
            () = shared.closing.cancelled() => return,
            () = tokio::time::sleep(every) => shared.republish_state(&Topic::Presence),
        }
    }
}

/// Writes the first journal lines of this start, and warns the operator of runs that ended with an earlier runtime.
fn report_last_runs(shared: &SharedState, last_runs: &LastRuns, ended: &[Run]) {
    for system in &shared.machine.coordinate_systems {
        let cs = system.settings.number;
        let boot = Event::Boot {
            boot_id: shared.boot_id.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
        };
        shared.record(cs, boot);
        let last_run = last_runs.get(&cs).map(|kept| &kept.run);
        if let Some(last_run) = last_run.filter(|last_run| last_run.is_under_way()) {
            shared.record(cs, Event::Interrupted(Box::new(last_run.clone())));
            shared.raise_standing(cut_short(cs, last_run));
        } else if let Some(run) = ended.iter().find(|run| run.cs == cs) {
            shared.raise_standing(cut_short_between_parts(run));
        }
    }
}

/// Restores the runs and their counters from the store and the journal. Returns the runs that ended because the runtime
/// ended.
fn restore_runs(shared: &SharedState, kept: KeptRuns, last_runs: &LastRuns, lines: &[Value]) -> Vec<Run> {
    let place_of = |run: &Run| {
        let last = &last_runs.get(&run.cs)?.run;
        let line = Some(last.line).filter(|line| *line > 0 && last.run_id == run.id)?;
        let program = last.running?;
        Some(PlannedLocation { program, line })
    };
    let now = shared.clock.wall();
    shared.runs.lock().restore(kept, lines, place_of, now)
}

/// Warns the operator of motors whose stored position is outside the soft limits.
fn report_positions(shared: &SharedState, kept: &KeptPositions) {
    for system in &shared.machine.coordinate_systems {
        for text in kept.outside(&system.settings) {
            shared.raise_standing(AlarmRecord {
                severity: AlarmSeverity::Warning,
                number: SOFT_LIMIT.number,
                text: format!("{text}; jog the axis back, or correct the limits"),
                cs: Some(system.settings.number),
                ..AlarmRecord::default()
            });
        }
    }
}

#[cfg(test)]
mod tests;
