//! A history: several starts of one machine, and the faults during each start.

use std::sync::Arc;
use std::time::{Duration, SystemTime};

use futures_util::FutureExt;
use parking_lot::Mutex;
use plc_protocol::port::Port;
use plc_protocol::server::ServedPort;
use plc_protocol::types::command::{Command, CommandMeta};
use plc_protocol::types::message::Payload;
use plc_protocol::types::request::{Answer, Request};
use plc_protocol::types::stored_data::StoredData;
use plc_protocol::types::topic::Topic;
use tandem_runtime::{Config, Machine, ProgramSource};
use tandem_testing::simulated_disk::SimulatedDisk;
use tandem_testing::simulated_disk::memory::Faults;
use tokio::time::Instant;

use super::MACHINE;
use super::broker::{Connector, ModelBroker, Network};
use super::handler::Handler;
use super::operator::{Current, Operator, PROGRAMS, change, program, read};
use super::oracle::{AtKill, BrokenRule, Oracle, Rule, SharedOracle};
use super::process::{Process, ProcessParts};
use super::random::Random;
use super::trace::Trace;

/// Clients whose connections break; `tandem-mill` is the machine.
const CLIENTS: [&str; 3] = ["gripper", "loader", "tandem-mill"];

/// Interval at which the world checks its machine.
const STEP: Duration = Duration::from_millis(5);

/// A variable that no client ever writes.
const UNTOUCHED: &str = "P1500";

/// Time in s before the end of a start: a value acknowledged in this time may be missing, if the machine
/// acknowledges it before it is on disk.
const BEHIND_S: f64 = 0.2;

/// A defect built into a world, so that a test proves that a rule of the oracle detects it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mutation {
    /// Syncs of the disk have no effect.
    ForgetsSyncs,
    /// The disk is reset to its content at the previous start.
    GoesBack,
    /// Lines in the ring of the journal are not written.
    ForgetsAhead,
    /// A handler treats a rejected claim as accepted.
    TakesAllClaims,
    /// A motor moves without a command.
    Moves,
    /// A program that the configuration names does not exist.
    NoProgram,
}

/// Result of the history of one seed.
#[derive(Debug)]
pub(super) struct HistoryOutcome {
    pub broken: Vec<BrokenRule>,
    /// A checksum of all events.
    pub sum: u32,
    /// Number of programs that were completed.
    pub completed: u32,
}

impl HistoryOutcome {
    pub fn panicked() -> Self {
        let broken = BrokenRule {
            rule: Rule::Whole,
            how: "a panic".to_owned(),
        };
        Self {
            broken: vec![broken],
            sum: 0,
            completed: 0,
        }
    }
}

#[derive(Debug, Clone)]
enum Fault {
    Cut(Option<&'static str>),
    BrokerDies(Duration),
    DiskRefuses(std::io::ErrorKind, Duration),
    /// The process ends at an operation on the disk.
    Dies(u64),
    /// A task or thread of the runtime panics.
    Panics(&'static str),
}

/// Tasks and threads in which a fault causes a panic.
const TASKS: [&str; 9] = [
    "coordinate system 1",
    "coordinate system 1",
    "coordinate system 2",
    "journal",
    "state-writer",
    "publisher of positions",
    "watch over outputs of the plant",
    "request over MQTT",
    "link to the MQTT broker",
];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ProcessEnd {
    Shutdown,
    Kill,
    PowerCut,
}

pub(super) struct History {
    mutation: Option<Mutation>,
    random: Random,
}

/// The parts of the world that continue to exist between the starts of the machine.
struct World {
    machine: Machine,
    disk: SimulatedDisk,
    broker: ModelBroker,
    truth: SharedOracle,
    trace: Trace,
    current: Current,
    day: SystemTime,
    begun: Instant,
    /// Outputs of the killed start that the next start must report.
    at_kill: Option<AtKill>,
    ended_s: f64,
    /// Time since which the disk has rejected writes, s; `None` after it has accepted all values again.
    unkept_s: Option<f64>,
}

fn machine() -> Machine {
    let motor = |number| {
        format!(
            "[[motor]]\nnumber = {number}\nkind = \"linear\"\nmax_velocity = 500.0\nmax_acceleration = 5000.0\n\
             rapid_velocity = 400.0\nrapid_acceleration = 2500.0\nsoft_limits = [-500.0, 500.0]\n"
        )
    };
    let text = format!(
        "[machine]\nname = \"{MACHINE}\"\ndata_dir = \"/simulated/data\"\n[mqtt]\nbroker = \"mqtt://broker:1883\"\n{}{}\
         [[coordinate_system]]\nnumber = 1\naxes = {{ X = 1 }}\nmax_feedrate = 30000.0\n\
         [[coordinate_system]]\nnumber = 2\naxes = {{ X = 2 }}\nmax_feedrate = 30000.0\n\
         [[tool]]\nid = 1\nradius = 1.0\nlength = 0.0\n\
         [m_code.8]\ntiming = \"with_motion\"\n[m_code.9]\ntiming = \"with_motion\"\n\
         [m_code.100]\nunhandled = \"wait\"\n[m_code.101]\nunhandled = \"wait\"\n[m_code.102]\nunhandled = \"wait\"\n",
        motor(1),
        motor(2)
    );
    Config::from_toml(&text, "/").unwrap().resolve().unwrap()
}

impl History {
    pub fn new(seed: u64, mutation: Option<Mutation>) -> Self {
        Self {
            mutation,
            random: Random::new(seed),
        }
    }

    pub fn play(mut self) -> HistoryOutcome {
        let executor = tokio::runtime::Builder::new_current_thread()
            .enable_time()
            .start_paused(true)
            .build()
            .unwrap();
        executor.block_on(async {
            let mut world = self.create_world();
            for number in 1..=1 + u32::try_from(self.random.below(4)).unwrap() {
                self.start(&mut world, number).await;
            }
            self.check_recovery(&mut world).await;
            let truth = world.truth.lock();
            HistoryOutcome {
                broken: truth.broken.clone(),
                sum: world.trace.checksum(),
                completed: truth.completed,
            }
        })
    }

    fn create_world(&mut self) -> World {
        let trace = Trace::new();
        let truth = Arc::new(Mutex::new(Oracle::new(trace.clone())));
        let network = Network {
            delay_ms: *self.random.pick(&[1, 5, 30, 200]),
            duplicates: *self.random.pick(&[0, 5, 30]),
        };
        // No client writes this variable, so it must never be reported as lost, even if the first start
        // fails.
        truth.lock().acknowledge(UNTOUCHED, "0");
        truth.lock().takes_all_claims = self.mutation == Some(Mutation::TakesAllClaims);
        let broker = ModelBroker::start(self.random.fork(), network, trace.clone());
        let day = SystemTime::UNIX_EPOCH + Duration::from_secs(1_700_000_000);
        let world = World {
            machine: machine(),
            disk: SimulatedDisk::new(self.random.next(), day),
            current: Current::default(),
            day,
            begun: Instant::now(),
            at_kill: None,
            ended_s: 0.0,
            unkept_s: None,
            broker,
            truth,
            trace,
        };
        for (id, codes) in [
            ("gripper", &[100, 8, 9][..]),
            ("loader", &[101]),
            ("second", &[100, 101]),
        ] {
            let handler = Handler::new(id, codes, &world.broker, &world.truth, self.random.fork());
            tokio::spawn(handler.run());
        }
        tokio::spawn(
            Operator {
                current: world.current.clone(),
                truth: world.truth.clone(),
                random: self.random.fork(),
                trace: world.trace.clone(),
                count: 0,
                pace_ms: *self.random.pick(&[50, 200, 600]),
            }
            .run(),
        );
        world
    }

    /// Returns the faults during a start, each with its time from the start.
    fn faults(&mut self, length: Duration) -> Vec<(Duration, Fault)> {
        let mut faults = Vec::new();
        let count = self.random.below(5);
        for _ in 0..count {
            let at = self.random.ms(0, u64::try_from(length.as_millis()).unwrap());
            let fault = match self.random.below(12) {
                0..3 => Fault::Cut(Some(*self.random.pick(&CLIENTS))),
                3 => Fault::Cut(None),
                4..6 => Fault::BrokerDies(self.random.ms(10, 4000)),
                6..8 => {
                    let kinds = [std::io::ErrorKind::StorageFull, std::io::ErrorKind::Other];
                    Fault::DiskRefuses(*self.random.pick(&kinds), self.random.ms(1, 1500))
                }
                8..10 => {
                    let task: &&str = self.random.pick(&TASKS);
                    Fault::Panics(task)
                }
                _ => Fault::Dies(self.random.below(60)),
            };
            faults.push((at, fault));
        }
        faults.sort_by_key(|(at, _)| *at);
        faults
    }

    /// Moves the wall clock forwards or back in 40 percent of the starts.
    fn set_day(&mut self, world: &mut World) {
        if self.random.percent(40) {
            let by = Duration::from_secs(self.random.below(200_000));
            if self.random.percent(50) {
                world.day += by;
            } else {
                world.day -= by;
            }
        }
    }

    async fn start(&mut self, world: &mut World, number: u32) {
        self.set_day(world);
        if self.mutation == Some(Mutation::NoProgram) {
            let missing = ProgramSource::File("/simulated/none.nc".into());
            world.machine.coordinate_systems[0].programs.insert(1, missing);
        }
        let before = world.disk.lock().snapshot();
        if self.random.percent(10) {
            world.disk.lock().faults.dies_at = Some(self.random.below(80));
        }
        let Some(process) = world.start(number, &mut self.random) else {
            return;
        };
        world.settle(&process).await;
        world.disk.lock().faults.forgets_syncs = self.mutation == Some(Mutation::ForgetsSyncs);
        world.disk.lock().faults.forgets_ahead = self.mutation == Some(Mutation::ForgetsAhead);
        let length = self.random.ms(500, 12_000);
        let faults = self.faults(length);
        let must_end = world.run(&process, length, faults).await;
        let end = match self.random.below(10) {
            _ if must_end => ProcessEnd::Shutdown,
            0..2 => ProcessEnd::Shutdown,
            2..6 => ProcessEnd::Kill,
            _ => ProcessEnd::PowerCut,
        };
        if end == ProcessEnd::Kill && self.random.percent(60) {
            world.wait_for_receipt().await;
        }
        world.finish(process, end).await;
        if self.mutation == Some(Mutation::GoesBack) {
            world.disk.lock().restore(&before);
        }
        self.damage(world);
    }

    fn damage(&mut self, world: &mut World) {
        // A second flip could hide the first: one in the checksum of a program and one in the program.
        if !self.random.percent(15) || world.truth.lock().may_lose {
            return;
        }
        let flipped = world.disk.lock().flip(|_| true);
        world.trace.line(format_args!("a bit flips in {flipped:?}"));
        world.truth.lock().damaged();
        world.at_kill = None;
    }

    /// Checks that the machine works after all faults have ended.
    async fn check_recovery(&mut self, world: &mut World) {
        world.broker.calm();
        world.disk.lock().faults = Faults::default();
        let Some(process) = world.start(99, &mut self.random) else {
            return;
        };
        world.settle(&process).await;
        world.current.set(None);
        // Handlers may stay disconnected for 6 s, and the broker notices a loss within 8 s.
        tokio::time::sleep(Duration::from_secs(15)).await;
        if self.mutation == Some(Mutation::Moves) {
            world.truth.lock().moved(1);
        }
        world.works(&process).await;
        process.shutdown().await;
    }
}

impl World {
    fn start(&mut self, number: u32, random: &mut Random) -> Option<Process> {
        self.disk.lock().now = self.day + self.begun.elapsed();
        self.disk.lock().operations = 0;
        let disk = self.disk.mount();
        let connector = Connector {
            broker: self.broker.clone(),
            disk: self.disk.clone(),
            seed: random.next(),
        };
        let sum = self.disk.lock().content_checksum();
        self.trace
            .line(format_args!("start {number} on a disk of {sum:08x}"));
        let parts = ProcessParts {
            simulated: self.disk.clone(),
            disk,
            connector,
            truth: Arc::clone(&self.truth),
        };
        let started = Process::start(&self.machine, number, parts);
        match started {
            Ok(process) => {
                self.current.set(Some(Arc::clone(&process.witness)));
                Some(process)
            }
            Err(_) if self.disk.is_dead() => {
                self.trace.line(format_args!("it dies while it starts"));
                None
            }
            Err(error) => {
                self.truth.lock().broke(Rule::Starts, error.to_string());
                None
            }
        }
    }

    /// Checks that the stored values are the acknowledged ones, then stores the programs that operators run.
    async fn settle(&mut self, process: &Process) {
        self.check_stored_values(process).await;
        if self.disk.is_dead() {
            return;
        }
        let stored = process.witness.read(&Topic::StoredData).await;
        let stored = stored.map(|message| message.payload.clone());
        if let Some(Payload::StoredData(StoredData {
            question: Some(question),
        })) = stored
        {
            let texts = question.texts().join("; ");
            self.truth.lock().broke(Rule::Asks, texts);
        }
        self.truth.lock().may_lose = false;
        for (number, text) in PROGRAMS {
            if read(&*process.witness, &format!("O{number}")).await != text {
                change(&self.current, &self.truth, &self.trace, program(number, text)).await;
            }
        }
    }

    async fn check_stored_values(&mut self, process: &Process) {
        let names = self.truth.lock().names();
        for name in names {
            let value = read(&*process.witness, &name).await;
            // Variables are stored within [`BEHIND_S`] after their acknowledgement, all other values before
            // it.
            let sure_s = if name.starts_with('P') {
                let unkept_s = self.unkept_s.unwrap_or(f64::INFINITY);
                unkept_s.min(self.ended_s) - BEHIND_S
            } else {
                self.ended_s
            };
            if !self.disk.is_dead() {
                self.truth.lock().read(&name, &value, sure_s);
            }
        }
        if !self.disk.is_dead() {
            self.unkept_s = None;
        }
        let Some(at_kill) = self.at_kill.take() else {
            return;
        };
        for cs in [1, 2] {
            let answer = process.witness.request(Request::LastRun(cs)).await;
            if let (Ok(Answer::LastRun(last_run)), false) = (answer, self.disk.is_dead()) {
                self.truth.lock().check_last_run(&at_kill, cs, last_run.as_ref());
            }
        }
    }

    /// Lets time pass and applies the faults. Returns true if a fault requires an orderly end of the machine.
    async fn run(&mut self, process: &Process, length: Duration, faults: Vec<(Duration, Fault)>) -> bool {
        let supervisor = process.witness.supervisor();
        let begun = Instant::now();
        let mut faults = faults.into_iter().peekable();
        let (mut refuses_until, mut taken_at) = (None, None);
        let must_end = || supervisor.exit().now_or_never().is_some();
        while begun.elapsed() < length && !self.disk.is_dead() && !must_end() {
            tokio::time::sleep(STEP).await;
            self.disk.lock().now = self.day + self.begun.elapsed();
            if refuses_until.is_some_and(|until| Instant::now() >= until) {
                refuses_until = None;
                self.disk.lock().faults.refuses = None;
                taken_at = Some(Instant::now() + Duration::from_millis(500));
            }
            if refuses_until.is_none() && taken_at.is_some_and(|at| Instant::now() >= at) {
                self.unkept_s = None;
            }
            while let Some((_, fault)) = faults.next_if(|(at, _)| *at <= begun.elapsed()) {
                self.trace.line(format_args!("{fault:?}"));
                match fault {
                    Fault::Cut(client) => self.broker.cut(client),
                    Fault::BrokerDies(time) => {
                        let broker = self.broker.clone();
                        tokio::spawn(async move { broker.die(time).await });
                    }
                    Fault::DiskRefuses(kind, time) => {
                        refuses_until = Some(Instant::now() + time);
                        self.unkept_s.get_or_insert(self.trace.now_s());
                        self.disk.lock().faults.refuses = Some(kind);
                    }
                    Fault::Dies(operations) => {
                        let mut disk = self.disk.lock();
                        disk.faults.dies_at = Some(disk.operations + operations);
                    }
                    Fault::Panics(task) => supervisor.inject(task),
                }
            }
        }
        self.disk.lock().faults.refuses = None;
        must_end()
    }

    /// Waits until a client receives an output, for 4 s at most.
    async fn wait_for_receipt(&mut self) {
        let before = self.truth.lock().heard;
        for _ in 0..4000 {
            if self.disk.is_dead() || self.truth.lock().heard > before {
                return;
            }
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    async fn finish(&mut self, process: Process, end: ProcessEnd) {
        let end = if self.disk.is_dead() && end == ProcessEnd::Shutdown {
            ProcessEnd::Kill
        } else {
            end
        };
        self.trace.line(format_args!("{end:?}"));
        self.ended_s = self.trace.now_s();
        self.at_kill = None;
        if end == ProcessEnd::Shutdown {
            self.current.set(None);
            process.shutdown().await;
            self.disk.lock().kill();
            return;
        }
        if end == ProcessEnd::Kill {
            let boot = process.witness.boot_id().0;
            // While the disk rejects writes, the ring of the journal is not written, so the report may be
            // incomplete.
            self.at_kill = (self.unkept_s.is_none()).then(|| self.truth.lock().at_kill(boot));
            self.disk.lock().kill();
        } else {
            self.disk.lock().cut_power();
        }
        self.current.set(None);
        drop(process);
        // During this wait the aborted tasks of the process end; the disk rejects their operations.
        tokio::time::sleep(STEP).await;
    }

    /// Runs a program, and checks that it reaches its end.
    async fn works(&mut self, process: &Process) {
        let command = async |name: &str, command: Command| {
            let meta = CommandMeta {
                command_id: format!("end-{name}"),
                client_id: "end".to_owned(),
                ..CommandMeta::default()
            };
            let request = Request::Command {
                cs: 1,
                command,
                meta,
                wait: true,
            };
            let asked = process.witness.request(request);
            let answer = tokio::time::timeout(Duration::from_mins(1), asked).await;
            self.trace.line(format_args!("at the end {name}: {answer:?}"));
        };
        command("reset", Command::Reset).await;
        // If the position was lost, the machine rejects this motion, and the following reset homes the motor.
        let lost = "G91 G01 X0 F1000".to_owned();
        let lost = Command::Mdi {
            text: lost,
            is_macro: false,
        };
        command("home", lost).await;
        command("reset-home", Command::Reset).await;
        command("load", Command::Load { program: 81 }).await;
        let before = self.truth.lock().completed;
        command("start", Command::Start).await;
        for _ in 0..300 {
            if self.truth.lock().completed > before {
                break;
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        if self.truth.lock().completed == before {
            let state = process
                .witness
                .read(&plc_protocol::types::topic::Topic::cs(
                    1,
                    plc_protocol::types::topic::CsTopic::State,
                ))
                .await;
            let how = format!("program 81 did not come to its end: {state:?}");
            self.truth.lock().broke(Rule::Works, how);
        }
    }
}
