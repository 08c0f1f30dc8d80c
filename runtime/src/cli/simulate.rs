//! `tandem simulate`: runs a program in simulated time, as fast as the computer can.

mod exceeded;
mod losses;
mod measure;
mod recorder;
mod report;
mod steps;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, anyhow, bail, ensure};
use clap::Args;
use futures_util::FutureExt;
use futures_util::future::try_join_all;
use parking_lot::Mutex;
use plc_api::{CoordinateSystem, Error, Plc};
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::request::OverrideChange;
use plc_protocol::types::state::{Execution, State};
use serde_json::{Value, json};
use tandem_interp::{Dialect, dialects};
use tandem_model::alarm::{AlarmEntry, SIMULATION_LIMIT, SIMULATION_STALLED};
use tandem_model::limits::{PROGRAM_NUMBER_MAX, SUBPROGRAM_MIN};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_runtime::journal::{Journal, Line};
use tandem_runtime::program_store::{StoredProgram, program_number};
use tandem_runtime::simulation::{self, OnCycle, OnPlan, PlannedMotion, SimulationOptions};
use tandem_runtime::{ConfiguredSystem, Machine, Runtime, UnhandledReaction};
use tandem_syntax::Address;

use super::check::check_stored;
use super::{
    CommandResult, EXIT_FOUND, EXIT_OK, find_subprogram, print_line, read_config, read_program, shown,
};
use recorder::{CsvTrace, Recorder};
pub(super) use report::Outcome;

/// Number of the main program if the name of its file is not a number.
const MAIN_PROGRAM: u16 = 1;

/// Simulated time in s after which the simulation ends a program that still runs.
const MAX_TIME_S: f64 = 86_400.0;

#[derive(Args)]
pub struct SimulateCommandArguments {
    #[command(flatten)]
    simulation: SimulationArguments,
    /// Prints one JSON object instead of text
    #[arg(long)]
    json: bool,
    /// Writes the commanded positions of each servo period as CSV
    #[arg(long, value_name = "OUT.csv")]
    trace: Option<PathBuf>,
    /// Adds the spindle's angle to --trace, degrees from 0 to below 360, clockwise positive
    #[arg(long, requires = "trace")]
    trace_spindle: bool,
    /// Writes the events of the simulation, one JSON object a line
    #[arg(long, value_name = "OUT.jsonl")]
    events: Option<PathBuf>,
    /// Writes each block that moves, dwells, outputs or stops, one JSON object a line: its times, the modal values in
    /// force, and its end position
    #[arg(long, value_name = "OUT.jsonl")]
    steps: Option<PathBuf>,
}

/// Program to simulate and its conditions.
#[derive(Args, Clone)]
pub(super) struct SimulationArguments {
    /// NC program, - for standard input; subprograms are searched for in the folder of the file (for standard input:
    /// the current folder), then in the programs of the data folder
    pub file: PathBuf,
    /// Configuration file; default: the demo machine
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// NC dialect of the programs; default: that of the configuration
    #[arg(long, value_parser = dialects::find)]
    dialect: Option<&'static Dialect>,
    /// Optional block skip inputs that are on, such as 1,3
    #[arg(long, value_delimiter = ',', value_parser = clap::value_parser!(u8).range(1..=31))]
    skip: Vec<u8>,
    /// Turns the optional stop (M01) on
    #[arg(long)]
    optional_stop: bool,
    /// Feed override, percent
    #[arg(long, value_name = "PERCENT", default_value_t = 100.0)]
    feed_override: f64,
    /// Coordinate system that runs the program; default: the one of --config whose `programs` name the file, otherwise
    /// 1
    #[arg(long)]
    pub cs: Option<CoordinateSystemNumber>,
    /// Program that another coordinate system runs at the same time, such as 2=FILE2
    #[arg(long, value_name = "N=FILE", value_parser = parse_with)]
    with: Vec<(CoordinateSystemNumber, PathBuf)>,
    /// Ends a program that is still running after this simulated time, in seconds
    #[arg(long, value_name = "SECONDS", default_value_t = MAX_TIME_S)]
    max_time_s: f64,
}

impl SimulationArguments {
    /// Returns the arguments for a program without inputs, at 100 percent override.
    pub fn for_file(file: &Path, config: Option<&Path>, dialect: Option<&'static Dialect>) -> Self {
        Self {
            file: file.to_owned(),
            config: config.map(Path::to_owned),
            dialect,
            skip: Vec::new(),
            optional_stop: false,
            feed_override: 100.0,
            cs: None,
            with: Vec::new(),
            max_time_s: MAX_TIME_S,
        }
    }
}

fn parse_with(text: &str) -> Result<(CoordinateSystemNumber, PathBuf), String> {
    let (number, file) = text.split_once('=').ok_or("write N=FILE, such as 2=loader.nc")?;
    let number = number
        .parse()
        .map_err(|_| format!("{number} is not a coordinate system"))?;
    Ok((number, file.into()))
}

/// A program and the coordinate system that runs it.
struct SimulationJob {
    cs: CoordinateSystemNumber,
    program: u16,
}

/// Callback that receives each line of the journal.
pub(super) type JournalCallback = Box<dyn FnMut(&Line) + Send>;

/// Callback that receives each planned motion.
pub(super) type Watcher = Box<dyn FnMut(PlannedMotion<'_>) + Send>;

/// Output files and callbacks of one simulation.
#[derive(Default)]
pub(super) struct SimulationWatch<'a> {
    /// File to write the events into, one JSON object per line.
    pub events: Option<&'a Path>,
    /// File to write the blocks into, one JSON object per line.
    pub steps: Option<&'a Path>,
    pub on_cycle: Option<OnCycle>,
    /// True if `on_cycle` is also called for cycles in which the motors keep their speeds.
    pub every_cycle: bool,
    pub on_plan: Option<Watcher>,
    /// Callback for each line of the journal.
    pub on_line: Option<JournalCallback>,
}

/// Programs to simulate, which have been read and checked.
pub(super) struct SimulationPlan {
    arguments: SimulationArguments,
    machine: Machine,
    jobs: Vec<SimulationJob>,
    programs: BTreeMap<u16, StoredProgram>,
}

pub(super) fn run(arguments: &SimulateCommandArguments) -> CommandResult {
    let plan = match SimulationPlan::read(&arguments.simulation, arguments.json)? {
        Ok(plan) => plan,
        Err(diagnostics) => {
            if arguments.json {
                print_line(json!({"outcome": "errors", "diagnostics": diagnostics}));
            }
            return Ok(EXIT_FOUND);
        }
    };
    let outcome = traced(arguments, plan)?;
    if arguments.json {
        print_line(json!(outcome));
    } else {
        outcome.print();
    }
    Ok(if outcome.is_completed() {
        EXIT_OK
    } else {
        EXIT_FOUND
    })
}

fn traced(arguments: &SimulateCommandArguments, plan: SimulationPlan) -> anyhow::Result<Outcome> {
    let files = [
        ("--trace", &arguments.trace),
        ("--events", &arguments.events),
        ("--steps", &arguments.steps),
    ];
    for (index, (name, file)) in files.iter().enumerate() {
        let same = files[..index]
            .iter()
            .find(|(_, other)| file.is_some() && other == file);
        if let Some((other, _)) = same {
            bail!("{other} and {name} name the same file");
        }
    }
    if arguments.trace_spindle && plan.first_system().1.spindle.is_none() {
        bail!("--trace-spindle: the coordinate system has no spindle; give it one in the configuration");
    }
    let trace = CsvTrace::new(arguments.trace.as_deref(), arguments.trace_spindle, &plan)?;
    let outcome = plan.simulate(SimulationWatch {
        events: arguments.events.as_deref(),
        steps: arguments.steps.as_deref(),
        on_cycle: trace.on_cycle(),
        every_cycle: trace.is_written(),
        ..SimulationWatch::default()
    })?;
    trace.finish()?;
    Ok(outcome)
}

impl SimulationPlan {
    /// Reads the configuration and the programs. With `json`, errors in a program are returned without being
    /// printed.
    pub fn read(arguments: &SimulationArguments, json: bool) -> anyhow::Result<Result<Self, Vec<Value>>> {
        let (mut config, mut machine) = read_config(arguments.config.as_deref())?;
        if let Some(dialect) = arguments.dialect {
            for system in &mut config.coordinate_system {
                system.dialect = dialect;
            }
            machine = config.resolve()?;
        }
        let assigned = machine.system_of_program(&arguments.file);
        let assigned = assigned.map(|system| system.settings.number);
        machine.unhandled = UnhandledReaction::AutoReset;
        machine.forget_locks();
        if config.is_demo {
            for system in &mut machine.coordinate_systems {
                system.programs.clear();
            }
        }
        if !(0.0..=200.0).contains(&arguments.feed_override) {
            bail!("--feed-override {}: write 0 to 200", arguments.feed_override);
        }
        ensure!(arguments.max_time_s > 0.0, "--max-time-s: write a time above 0");
        let mut plan = Self {
            arguments: arguments.clone(),
            machine,
            jobs: Vec::new(),
            programs: BTreeMap::new(),
        };
        let mut diagnostics = Vec::new();
        let assigned = || assigned.unwrap_or(1);
        let first = (arguments.cs.unwrap_or_else(assigned), arguments.file.clone());
        for (cs, file) in std::iter::once(&first).chain(&arguments.with) {
            plan.add(*cs, file, json, &mut diagnostics)?;
        }
        Ok(if diagnostics.is_empty() {
            Ok(plan)
        } else {
            Err(diagnostics)
        })
    }

    /// Runs the simulation until all programs end, an alarm occurs or the time limit is reached.
    ///
    /// # Errors
    /// Returns an error if a file cannot be written or the machine rejects a command.
    pub fn simulate(self, watch: SimulationWatch<'_>) -> anyhow::Result<Outcome> {
        let recorder = Recorder::new(&self, watch.events, watch.steps)?;
        let on_line = watch.on_line;
        let recorder = Arc::new(Mutex::new(recorder));
        let (on_cycle, of_plan) = (watch.on_cycle, watch.on_plan);
        let options = SimulationOptions {
            max_time_s: self.arguments.max_time_s,
            on_cycle: Some(on_each_cycle(Arc::clone(&recorder), on_cycle)),
            passes_even_motion: !watch.every_cycle,
            on_plan: Some(on_plan(Arc::clone(&recorder), of_plan)),
            hardware: None,
        };
        simulation::run(simulate(self, recorder, options, on_line))?
    }

    /// Returns the coordinate systems that run a program, each with its index in the servo.
    fn systems(&self) -> impl Iterator<Item = (usize, &ConfiguredSystem)> {
        let systems = self.machine.coordinate_systems.iter().enumerate();
        systems.filter(|(_, system)| self.jobs.iter().any(|job| job.cs == system.settings.number))
    }

    /// Returns the M code that changes tools by its word T in this dialect. Returns `None` if the stock
    /// sequence program selects the tools.
    fn tool_changer(&self, dialect: &Dialect) -> Option<u16> {
        let mut codes = dialect.m_codes.codes.iter();
        let m = codes.find(|code| code.word(Address::T).is_some())?.tenths() / 10;
        let settings = self.machine.m_codes.get(&m);
        settings
            .is_none_or(|settings| settings.stock.is_none())
            .then_some(m)
    }

    /// Returns the index in the servo and the settings of the coordinate system that runs the first program.
    pub fn first_system(&self) -> (usize, &CoordinateSystemSettings) {
        let number = self.jobs[0].cs;
        let mut systems = self.machine.coordinate_systems.iter();
        let index = systems.position(|system| system.settings.number == number);
        let index = index.unwrap_or_default();
        (index, &self.machine.coordinate_systems[index].settings)
    }

    fn add(
        &mut self,
        cs: CoordinateSystemNumber,
        file: &Path,
        json: bool,
        diagnostics: &mut Vec<Value>,
    ) -> anyhow::Result<()> {
        let mut systems = self.machine.coordinate_systems.iter();
        let system = systems
            .find(|system| system.settings.number == cs)
            .with_context(|| format!("the machine has no coordinate system {cs}"))?;
        if self.jobs.iter().any(|job| job.cs == cs) {
            bail!("coordinate system {cs} can run one program at a time");
        }
        let wanted = program_number(file).unwrap_or(MAIN_PROGRAM);
        let number = (wanted..=PROGRAM_NUMBER_MAX)
            .chain(1..wanted)
            .find(|number| !self.programs.contains_key(number))
            .context("no program number is free")?;
        let rules = self.machine.text_rules_of(system.dialect);
        self.jobs.push(SimulationJob { cs, program: number });
        let mut left = vec![(number, file.to_owned())];
        while let Some((number, path)) = left.pop() {
            let text = read_program(&path)?;
            match self.programs.get(&number) {
                None => {}
                Some(known) if known.text() == text => continue,
                Some(_) => bail!(
                    "{}: another file already has program number {number}; programs of one simulation share \
                     the numbers",
                    shown(&path)
                ),
            }
            let program = StoredProgram::new(number, &text, rules);
            // Loading makes the same checks again; here, only a call of another program can still be an
            // error.
            let here = program.check_in(&system.settings);
            let called = &program.check.programs;
            if path == *file && !(here.errors.is_empty() && called.is_empty()) {
                for checked in check_stored(&path, &program, &self.machine, &system.settings) {
                    if !checked.has_errors() {
                        continue;
                    }
                    if !json {
                        checked.print();
                    }
                    diagnostics.extend(checked.with_file());
                }
            }
            let data_dir = self.machine.data_dir.as_deref();
            let any = (SUBPROGRAM_MIN..=PROGRAM_NUMBER_MAX).filter(|_| program.calls_any);
            let called = called.iter().copied().chain(any);
            left.extend(called.filter_map(|n| Some((n, find_subprogram(n, file, data_dir)?))));
            self.programs.insert(number, program);
        }
        Ok(())
    }
}

fn on_each_cycle(recorder: Arc<Mutex<Recorder>>, mut on_cycle: Option<OnCycle>) -> OnCycle {
    Box::new(move |servo| {
        recorder.lock().on_cycle(servo);
        if let Some(on_cycle) = &mut on_cycle {
            on_cycle(servo);
        }
    })
}

fn on_plan(recorder: Arc<Mutex<Recorder>>, mut watcher: Option<Watcher>) -> OnPlan {
    OnPlan::new(move |cs, planned| {
        recorder.lock().on_plan(cs, planned);
        if let Some(watcher) = &mut watcher {
            watcher(planned);
        }
    })
}

async fn simulate(
    plan: SimulationPlan,
    recorder: Arc<Mutex<Recorder>>,
    options: SimulationOptions,
    mut on_line: Option<JournalCallback>,
) -> anyhow::Result<Outcome> {
    let sink = Arc::clone(&recorder);
    let journal = Journal::to_sink(Arc::new(std::sync::Mutex::new(move |line: &_| {
        sink.lock().on_line(line);
        if let Some(on_line) = &mut on_line {
            on_line(line);
        }
        false
    })));
    let runtime = Runtime::start_simulated(plan.machine, journal, options)?;
    recorder.lock().look_at(&runtime);
    for program in plan.programs.into_values() {
        runtime.store().put(program)?;
    }
    let plc = Plc::in_process(runtime.port());
    let jobs = plan.jobs.iter();
    let systems: Vec<_> = jobs.map(|job| plc.coordinate_system(job.cs)).collect();
    for system in &systems {
        for number in &plan.arguments.skip {
            system.set_optional_skip(*number, true).await?;
        }
        system.set_optional_stop(plan.arguments.optional_stop).await?;
        let feed = Some(plan.arguments.feed_override);
        let overrides = OverrideChange {
            feed,
            ..OverrideChange::default()
        };
        system.set_overrides(overrides).await?;
    }
    for (system, job) in systems.iter().zip(&plan.jobs) {
        accepted(system.load(job.program).await)?;
    }
    for system in &systems {
        accepted(system.start().await)?;
    }
    let ended_by = run_to_end(&runtime, &systems).await?;
    let records = recorder.lock().finish()?;
    let outcome = Outcome::new(&runtime, records, &systems, ended_by).await;
    runtime.shutdown().await;
    Ok(outcome)
}

/// Converts the rejection of a command into an error with its first finding. If an accepted command has no
/// effect, the journal contains the reason.
fn accepted(result: plc_api::Result<()>) -> anyhow::Result<()> {
    match result {
        Ok(()) | Err(Error::CommandFailed { .. }) => Ok(()),
        Err(error) => {
            let text = match &error {
                Error::Refused(refusal) => refusal.diagnostics.first().map(|found| found.message.clone()),
                _ => None,
            };
            Err(text.map_or_else(|| anyhow!("{error}"), |text| anyhow!("{error}: {text}")))
        }
    }
}

/// Runs until all programs have ended. Returns the reason if the simulation ended earlier.
async fn run_to_end(
    runtime: &Runtime,
    systems: &[CoordinateSystem],
) -> anyhow::Result<Option<&'static AlarmEntry>> {
    let Some(simulation) = runtime.simulation() else {
        return Ok(None);
    };
    // Discards a stall before the start, which the programs have not caused.
    let _ = simulation.stalled().now_or_never();
    tokio::select! {
        biased;
        ended = try_join_all(systems.iter().map(resume_to_end)) => ended.map(|_| None),
        () = simulation.stalled() => {
            Ok(Some(if simulation.is_at_limit() { &SIMULATION_LIMIT } else { &SIMULATION_STALLED }))
        }
    }
}

/// Resumes the program after each program stop until the program has ended.
async fn resume_to_end(system: &CoordinateSystem) -> anyhow::Result<()> {
    loop {
        let state = system
            .wait_for(|state| is_paused(state) || is_over(state))
            .await?;
        if is_over(&state) {
            return Ok(());
        }
        accepted(system.resume().await)?;
    }
}

fn is_paused(state: &State) -> bool {
    matches!(
        state.execution,
        Execution::ProgramStopped | Execution::OptionalStop
    )
}

fn is_over(state: &State) -> bool {
    match state.execution {
        Execution::ProgramCompleted => true,
        Execution::Stopped => state.run_id.is_some() && state.transition.is_none(),
        _ => false,
    }
}
