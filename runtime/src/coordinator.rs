//! The coordinator: one task for each CNC coordinate system, one servo for all, and the port to all of it.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use plc_api::port::Port;
use plc_api::server::ServedPort;
use plc_api::types::machine::{Birth, CoordinateSystemInfo, Limits, MCodeInfo, MotorInfo, Presence};
use plc_api::types::message::Payload;
use plc_api::types::state::{Execution, Reason};
use plc_api::types::topic::{CsTopic, Topic};
use plc_api::types::{BootId, CoordinateSystemNumber};
use tandem_model::Variables;
use tandem_model::limits::PROGRAM_BYTES_MAX;
use tandem_model::settings::{MotorKind, Unit};
use tandem_servo::{Hardware, HardwareFactory, Servo};
use tokio::sync::Notify;
use tokio::task::JoinSet;

use crate::clock::Clock;
use crate::config::{Config, ConfigError, Machine, ProgramSource};
use crate::coordinate_system::{CoordinateSystem, Handle, Mailbox};
use crate::journal::{Event, Journal};
use crate::persistence::journal_file::{JOURNAL_FOLDER, JournalThread, newest};
use crate::persistence::{
    Image, LastRuns, REPLAYED_LINES_MAX, Restored, Source, StateWriterThread, Store, cut_short,
    replay_last_runs, restore,
};
use crate::port::RuntimePort;
use crate::program_store::{ProgramStore, check_readable, read_text};
use crate::servo_thread::{ServoStatistics, ServoThread};
use crate::shared::Shared;
use crate::simulation::{self, Simulation, SimulationOptions};
use crate::tables::Tables;

/// How often positions are published, at the most; program places and spindles half as often.
const PUBLISH_INTERVAL: Duration = Duration::from_millis(100);

/// Why a runtime does not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The configuration is refused.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// What is kept on disk cannot be reached.
    #[error("[machine] data_dir = {path}: {error}")]
    DataDir {
        /// Which folder.
        path: String,
        /// Why.
        error: io::Error,
    },
    /// A program of the configuration cannot be read.
    #[error("[[coordinate_system]] programs: {number} = {path}: {error}")]
    Program {
        /// Program number.
        number: u16,
        /// Which file.
        path: String,
        /// Why.
        error: io::Error,
    },
    /// The store could not be opened.
    #[error("the program store does not open: {0}")]
    Store(String),
    /// The hardware does not come up.
    #[error("the hardware does not start: {0}")]
    Hardware(io::Error),
    /// The operating system gives no thread.
    #[error("the servo thread does not start: {0}")]
    Servo(io::Error),
    /// The operating system gives no thread.
    #[error("the thread that keeps what changes does not start: {0}")]
    Thread(io::Error),
    /// A simulated runtime was started outside of [`simulation::run`], or a second one inside it.
    #[error("a runtime in simulated time starts once inside simulation::run")]
    NotInSimulation,
}

/// A running machine. Dropping it stops the servo; [`Runtime::shutdown`] stops it in order.
#[derive(Debug)]
pub struct Runtime {
    shared: Arc<Shared>,
    port: Arc<RuntimePort>,
    tasks: JoinSet<()>,
    servo: Option<ServoThread>,
    simulation: Option<Arc<Simulation>>,
    /// What is kept, and the journal; `None` in simulated time.
    kept: Option<(StateWriterThread, JournalThread)>,
}

impl Runtime {
    /// Starts the machine of a configuration in real time, with simulated hardware and without server ends.
    ///
    /// # Errors
    /// The configuration, its programs or its data folder are refused, or there is no thread for the servo.
    pub async fn start(config: Config) -> Result<Runtime, StartError> {
        Self::start_on(config, Hardware::simulated_factory()).await
    }

    /// As [`Runtime::start`], on this hardware.
    ///
    /// # Errors
    /// Those of [`Runtime::start`], or the hardware does not come up.
    pub async fn start_on(config: Config, hardware: HardwareFactory) -> Result<Runtime, StartError> {
        let machine = config.resolve()?;
        let opening = machine.clone();
        let open = move || {
            let (data, store) = (open_data(&opening)?, open_store(&opening)?);
            Ok::<_, StartError>((data, store, bring_up(hardware, &opening)?))
        };
        let (mut data, (store, first_state), hardware) = tokio::task::spawn_blocking(open)
            .await
            .map_err(|error| StartError::Store(error.to_string()))??;
        let journal =
            (data.as_ref()).map_or_else(Journal::to_log, |data| Journal::to_disk(data.journal.writer()));
        let (tables, mut restored) = (Tables::new(&machine), Restored::default());
        if let Some(data) = &mut data {
            restored = data.restore(&tables).map_err(|error| data.refused(error))?;
        }
        let shared = Shared::new(machine, new_boot_id(), Clock::real(), store, journal, tables);
        let mut parts = Parts::new(Arc::new(shared), first_state, &restored, hardware);
        let last_runs = restored.last_runs;
        let kept = match data {
            Some(data) => Some(data.keep(&parts, last_runs.clone())?),
            None => None,
        };
        tell_of_last_runs(&parts.shared, &last_runs);
        let writer = kept.as_ref().map(|(thread, _)| thread.writer());
        let port = RuntimePort::new(
            Arc::clone(&parts.shared),
            parts.handles.clone(),
            writer,
            last_runs,
        );
        let period = Duration::from_micros(parts.shared.machine.servo_period_us);
        let statistics = Arc::clone(&parts.shared.servo);
        let servo =
            ServoThread::start(parts.servo, period, parts.wake, statistics).map_err(StartError::Servo)?;
        parts
            .tasks
            .spawn(publish_positions(Arc::clone(&parts.shared), parts.handles));
        Ok(Runtime {
            shared: parts.shared,
            port: Arc::new(port),
            tasks: parts.tasks,
            servo: Some(servo),
            simulation: None,
            kept,
        })
    }

    /// Starts a machine in simulated time, inside [`simulation::run`]. It keeps nothing on disk.
    ///
    /// # Errors
    /// A program of the configuration cannot be read, the hardware does not come up, or this is not inside
    /// [`simulation::run`].
    pub fn start_simulated(
        machine: Machine,
        journal: Journal,
        mut options: SimulationOptions,
    ) -> Result<Runtime, StartError> {
        let slot = simulation::slot().ok_or(StartError::NotInSimulation)?;
        let machine = Machine {
            data_dir: None,
            ..machine
        };
        let (store, first_state) = open_store(&machine)?;
        let factory = options.hardware.take();
        let hardware = bring_up(factory.unwrap_or_else(Hardware::simulated_factory), &machine)?;
        let clock = Clock::simulated();
        let boot_id = BootId("simulation".into());
        let tables = Tables::new(&machine);
        let shared = Shared::new(machine, boot_id, clock.clone(), store, journal, tables);
        let parts = Parts::new(Arc::new(shared), first_state, &Restored::default(), hardware);
        let period_ns = parts.shared.machine.servo_period_us * 1000;
        let mailboxes = parts
            .handles
            .iter()
            .map(|handle| Arc::clone(&handle.mailbox))
            .collect();
        let simulation = Arc::new(Simulation::new(parts.servo, clock, mailboxes, period_ns, options));
        slot.set(Arc::clone(&simulation))
            .map_err(|_| StartError::NotInSimulation)?;
        Ok(Runtime {
            port: Arc::new(RuntimePort::new(
                Arc::clone(&parts.shared),
                parts.handles,
                None,
                LastRuns::new(),
            )),
            shared: parts.shared,
            tasks: parts.tasks,
            servo: None,
            simulation: Some(simulation),
            kept: None,
        })
    }

    /// The whole sequence-control interface of the machine.
    pub fn port(&self) -> Arc<dyn Port> {
        Arc::<RuntimePort>::clone(&self.port)
    }

    /// The same for server ends.
    pub fn served_port(&self) -> Arc<dyn ServedPort> {
        Arc::<RuntimePort>::clone(&self.port)
    }

    /// The machine as configured.
    pub fn machine(&self) -> &Machine {
        &self.shared.machine
    }

    /// P variables, and the Q variables of a coordinate system; `None`: there is no such coordinate system.
    pub fn variables(&self, cs: CoordinateSystemNumber) -> Option<Variables> {
        let handle = self.port.handles().iter().find(|handle| handle.number == cs)?;
        Some(handle.variables.clone())
    }

    /// The program store.
    pub fn store(&self) -> &ProgramStore {
        &self.shared.store
    }

    /// How punctual the servo thread is; `None` in simulated time.
    pub fn servo_statistics(&self) -> Option<Arc<ServoStatistics>> {
        self.servo.as_ref().map(|_| Arc::clone(&self.shared.servo))
    }

    /// The simulation; `None` in real time.
    pub fn simulation(&self) -> Option<Arc<Simulation>> {
        self.simulation.clone()
    }

    /// Stops the machine in order: motion comes to rest on its path, outputs are cancelled, the tasks end.
    pub async fn shutdown(mut self) {
        self.port.stop_all().await;
        self.shared.closing.cancel();
        let ended = async { while self.tasks.join_next().await.is_some() {} };
        let _ = tokio::time::timeout(Duration::from_secs(2), ended).await;
        self.tasks.shutdown().await;
        let presence = Presence {
            online: false,
            ..presence(&self.shared)
        };
        self.shared.publish(Topic::Presence, Payload::Presence(presence));
        let kept = self.kept.take();
        // What is left is written; whether that fails is told in the log.
        let _ = tokio::task::spawn_blocking(move || drop(kept)).await;
        self.shared.hub.close();
    }
}

/// What both kinds of time have in common.
struct Parts {
    shared: Arc<Shared>,
    handles: Vec<Handle>,
    tasks: JoinSet<()>,
    servo: Servo,
    wake: Vec<Arc<Notify>>,
}

impl Parts {
    fn new(
        shared: Arc<Shared>,
        first_state: (Execution, Option<Reason>),
        restored: &Restored,
        hardware: Hardware,
    ) -> Self {
        let mut tasks = JoinSet::new();
        let (mut handles, mut wake) = (Vec::new(), Vec::new());
        let configured = shared.machine.coordinate_systems.clone();
        let of_servo: Vec<_> = (configured.iter())
            .map(|system| (&system.settings, system.pre_read_blocks))
            .collect();
        let period_s = shared.machine.servo_period_us as f64 / 1e6;
        let (servo, task_ends) = Servo::new(&of_servo, period_s, hardware);
        for (configured, task_end) in configured.into_iter().zip(task_ends) {
            let number = configured.settings.number;
            let tool = restored.tools_in_spindle.get(&number).copied().unwrap_or(0);
            let system = CoordinateSystem::new(Arc::clone(&shared), configured, task_end, first_state, tool);
            let notify = Arc::new(Notify::new());
            let (view, variables) = (system.view(), system.variables());
            let mailbox = Arc::new(Mailbox::new(Arc::clone(&shared), system, Arc::clone(&notify)));
            shared.wakes(Arc::clone(&notify));
            wake.push(notify);
            let of_task = Arc::clone(&mailbox);
            tasks.spawn(async move { of_task.run().await });
            handles.push(Handle {
                number,
                mailbox,
                view,
                variables,
            });
        }
        shared.publish(Topic::Birth, Payload::Birth(birth(&shared.machine)));
        shared.publish(
            Topic::AlarmActive,
            Payload::AlarmActive(plc_api::types::machine::ActiveAlarms::default()),
        );
        shared.publish(Topic::Presence, Payload::Presence(presence(&shared)));
        Self {
            shared,
            handles,
            tasks,
            servo,
            wake,
        }
    }
}

async fn publish_positions(shared: Arc<Shared>, handles: Vec<Handle>) {
    let mut interval = tokio::time::interval(PUBLISH_INTERVAL);
    interval.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
    let mut odd = false;
    loop {
        tokio::select! {
            () = shared.closing.cancelled() => return,
            _ = interval.tick() => {}
        }
        odd = !odd;
        for handle in &handles {
            let topic = |topic| Topic::cs(handle.number, topic);
            shared.publish(
                topic(CsTopic::Position),
                Payload::Position(handle.view.position()),
            );
            if odd {
                let place = handle.view.program(&shared.store);
                shared.publish(topic(CsTopic::Program), Payload::Program(place));
                handle.mailbox.tell_spindle();
            }
        }
    }
}

/// What is kept in the data folder, opened.
struct Data {
    path: PathBuf,
    store: Store,
    image: Image,
    journal: JournalThread,
}

impl Data {
    fn refused(&self, error: io::Error) -> StartError {
        StartError::DataDir {
            path: self.path.display().to_string(),
            error,
        }
    }

    /// What was kept, and what the journal tells beyond it, which is kept then.
    fn restore(&mut self, tables: &Tables) -> io::Result<Restored> {
        let mut restored = restore(tables, &self.image)?;
        let lines = newest(&self.path.with_file_name(JOURNAL_FOLDER), 0, REPLAYED_LINES_MAX)?;
        let change = replay_last_runs(tables.coordinate_systems(), &mut restored.last_runs, &lines);
        if !change.is_empty() {
            self.store.commit(&change)?;
            self.image.take_over(change);
        }
        Ok(restored)
    }

    /// Begins to keep what changes.
    fn keep(
        self,
        parts: &Parts,
        last_runs: LastRuns,
    ) -> Result<(StateWriterThread, JournalThread), StartError> {
        let shared = Arc::clone(&parts.shared);
        let views = parts.handles.iter();
        let source = Source {
            boot_id: shared.boot_id.clone(),
            clock: shared.clock.clone(),
            tables: Arc::clone(&shared.tables),
            hub: shared.hub.clone(),
            views: views
                .map(|handle| (handle.number, Arc::clone(&handle.view)))
                .collect(),
            last_runs,
            warn: Box::new(move |warning| {
                shared.raise(warning);
            }),
        };
        let thread = StateWriterThread::start(self.path, self.store, self.image, source);
        Ok((thread.map_err(StartError::Thread)?, self.journal))
    }
}

fn bring_up(factory: HardwareFactory, machine: &Machine) -> Result<Hardware, StartError> {
    let systems: Vec<_> = (machine.coordinate_systems.iter())
        .map(|system| &system.settings)
        .collect();
    factory(&systems).map_err(StartError::Hardware)
}

/// Opens what is kept in the data folder, which is made if it is missing; no other runtime has it open then.
fn open_data(machine: &Machine) -> Result<Option<Data>, StartError> {
    let Some(folder) = &machine.data_dir else {
        return Ok(None);
    };
    let path = folder.join("state.redb");
    let opened = std::fs::create_dir_all(folder).and_then(|()| {
        let store = Store::open(&path)?;
        let image = store.load()?;
        Ok((store, image, JournalThread::start(&folder.join(JOURNAL_FOLDER))?))
    });
    match opened {
        Ok((store, image, journal)) => Ok(Some(Data {
            path,
            store,
            image,
            journal,
        })),
        Err(error) => Err(StartError::DataDir {
            path: folder.display().to_string(),
            error,
        }),
    }
}

/// The journal begins anew, and the operator is warned of runs that the end of an earlier start cut short.
fn tell_of_last_runs(shared: &Shared, last_runs: &LastRuns) {
    for system in &shared.machine.coordinate_systems {
        let cs = system.settings.number;
        let boot = Event::Boot {
            boot_id: shared.boot_id.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
        };
        shared.record(cs, boot);
        if let Some(last_run) = last_runs.get(&cs).filter(|last_run| last_run.is_under_way()) {
            shared.record(cs, Event::Interrupted(Box::new(last_run.clone())));
            shared.raise_standing(cut_short(cs, last_run));
        }
    }
}

fn new_boot_id() -> BootId {
    use std::hash::{BuildHasher, Hasher};
    // The standard library's hash keys are random for each process.
    let random = std::collections::hash_map::RandomState::new()
        .build_hasher()
        .finish();
    BootId(format!("{random:016x}"))
}

fn presence(shared: &Shared) -> Presence {
    Presence {
        online: true,
        started_at: shared.timestamp(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
    }
}

fn birth(machine: &Machine) -> Birth {
    let kind = |kind| match kind {
        MotorKind::Linear => "linear",
        MotorKind::Rotary => "rotary",
        MotorKind::Spindle => "spindle",
    };
    let systems = machine.coordinate_systems.iter().map(|system| {
        let axes = system.settings.axes();
        let motor = |axis: tandem_model::Axis| {
            let motor = system.settings.motors[axis.index()].as_ref()?;
            Some((axis.letter().to_string(), motor.number))
        };
        CoordinateSystemInfo {
            number: system.settings.number,
            axes: axes.iter().filter_map(motor).collect(),
            spindle: system.settings.spindle.as_ref().map(|motor| motor.number),
            dialect: system.dialect.name.to_owned(),
            units: match system.settings.unit {
                Unit::Millimetre => "mm".to_owned(),
                Unit::Inch => "inch".to_owned(),
            },
        }
    });
    let motors = machine.motors.iter().map(|motor| MotorInfo {
        number: motor.number,
        kind: kind(motor.kind).to_owned(),
        soft_limits: motor.soft_limits,
        max_velocity: motor.max_velocity,
    });
    let m_codes = machine.m_codes.iter().map(|(m, settings)| {
        let info = MCodeInfo {
            timing: settings.timing,
            timeout_ms: settings.timeout_ms,
            wait_state: settings.wait_state.clone(),
        };
        (*m, info)
    });
    let open_outputs_max = machine
        .coordinate_systems
        .iter()
        .map(|system| system.open_outputs_max)
        .max()
        .unwrap_or_default();
    Birth {
        machine: machine.name.clone(),
        servo_period_us: machine.servo_period_us,
        coordinate_systems: systems.collect(),
        motors: motors.collect(),
        m_codes: m_codes.collect(),
        limits: Limits {
            open_outputs_max: u32::try_from(open_outputs_max).unwrap_or(u32::MAX),
            program_bytes_max: PROGRAM_BYTES_MAX as u64,
        },
    }
}

impl Machine {
    /// The programs of the configuration that cannot be put into the store, each with why.
    pub fn unreadable_programs(&self) -> Vec<StartError> {
        let systems = self.coordinate_systems.iter();
        let programs = systems.flat_map(|system| &system.programs);
        let unreadable = programs.filter_map(|(number, source)| {
            let ProgramSource::File(path) = source else {
                return None;
            };
            let error = check_readable(path).err()?;
            Some(StartError::Program {
                number: *number,
                path: path.display().to_string(),
                error,
            })
        });
        unreadable.collect()
    }
}

/// Opens the store and puts the configuration's programs into it; tells what state a coordinate system begins in.
fn open_store(machine: &Machine) -> Result<(ProgramStore, (Execution, Option<Reason>)), StartError> {
    let (store, reason) = match &machine.data_dir {
        None => (ProgramStore::in_memory(machine.text_rules()), Reason::NoProgram),
        Some(folder) => {
            let refused = |error| StartError::DataDir {
                path: folder.display().to_string(),
                error,
            };
            let store =
                ProgramStore::open(&folder.join("programs"), machine.text_rules()).map_err(refused)?;
            let reason = mark_started(&folder.join("started")).map_err(refused)?;
            (store, reason)
        }
    };
    for system in &machine.coordinate_systems {
        for (number, source) in &system.programs {
            let path = match source {
                ProgramSource::File(path) => path.display().to_string(),
                ProgramSource::Text(_) => "built in".to_owned(),
            };
            put_program(&store, *number, source).map_err(|error| StartError::Program {
                number: *number,
                path,
                error,
            })?;
        }
    }
    Ok((store, (Execution::Stopped, Some(reason))))
}

/// The newer of the two wins: the configuration's file, or what was written to the store since.
fn put_program(store: &ProgramStore, number: u16, source: &ProgramSource) -> io::Result<()> {
    let in_store = store.get(number).is_some();
    match source {
        ProgramSource::Text(_) if in_store => {}
        ProgramSource::Text(text) => {
            store.write(number, text)?;
        }
        ProgramSource::File(path) => {
            let written = std::fs::metadata(path)?.modified()?;
            if !in_store || store.written_at(number).is_none_or(|stored| stored < written) {
                store.write(number, &read_text(path)?)?;
            }
        }
    }
    Ok(())
}

/// Leaves a mark in the data folder; tells whether it was there before.
fn mark_started(mark: &Path) -> io::Result<Reason> {
    if mark.exists() {
        return Ok(Reason::Restarted);
    }
    std::fs::write(mark, "A runtime has been started with this folder.\n")?;
    Ok(Reason::NoProgram)
}
