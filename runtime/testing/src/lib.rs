//! A whole runtime in simulated time, for unit tests of machine builders.
//!
//! A [`Bench`] runs an NC program and a sequence program on a machine with simulated motors, as fast as the computer
//! can. The resulting [`Run`] contains the outputs with their times and order, the end of the run, and the positions of
//! the machine. The same test always gives the same [`Run`], to the last bit. The load of the computer has no effect.
//!
//! ```
//! use std::time::Duration;
//! use plc_api::{Alarm, AuxOutput, Plc, SequenceProgram};
//! use tandem_testing::{Bench, TestError};
//!
//! /// M110 VA: the magazine turns for ten minutes, then tool VA is in the spindle.
//! async fn change_tool(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
//!     let tool = output.params().a().ok_or(Alarm::user(1, "M110 needs VA"))? as u16;
//!     plc.sleep(Duration::from_secs(600)).await;
//!     plc.coordinate_system(output.coordinate_system()).select_tool(tool).await?;
//!     Ok(())
//! }
//!
//! fn machine() -> Bench {
//!     Bench::new().serve(SequenceProgram::new().on(110, change_tool))
//! }
//!
//! // #[test]
//! fn the_program_waits_for_the_tool() -> Result<(), TestError> {
//!     let run = machine().run("G90 G01 X10 F6000\nM110 VA3\nG01 X0\nM30")?.completed()?;
//!     assert_eq!(run.order(1), ["block 1", "output M110 VA3", "reset M110", "block 3", "end"]);
//!     let change = run.output(110)?;
//!     assert!((change.took_s()? - 600.0).abs() < 0.01);
//!     assert_eq!(run.system(1)?.tool, 3);
//!     assert_eq!(run.system(1)?.machine["X"], 0.0);
//!     Ok(())
//! }
//!
//! // #[test]
//! fn without_a_tool_number_the_program_stops() -> Result<(), TestError> {
//!     let run = machine().run("M110\nM30")?;
//!     assert_eq!(run.alarm()?.text, "M110 needs VA");
//!     Ok(())
//! }
//! # fn main() -> Result<(), TestError> {
//! #     the_program_waits_for_the_tool()?;
//! #     without_a_tool_number_the_program_stops()
//! # }
//! ```
//!
//! # Scripted events
//! Operators, inputs and faults are scripted: [`Bench::at_s`], [`Bench::at_line`], [`Bench::at_output`] and
//! [`Bench::at_state`] run an async closure at that moment. It receives a [`Scene`]: the machine with every command and
//! input, and its handlers, which it can kill.
//!
//! ```
//! # use std::time::Duration;
//! # use plc_api::{Alarm, AuxOutput, CancelReason, Execution, Plc, SequenceProgram};
//! # use tandem_testing::{Bench, OutputEnd, TestError};
//! # async fn clamp(_output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
//! #     plc.sleep(Duration::from_secs(10)).await;
//! #     Ok(())
//! # }
//! # fn main() -> Result<(), TestError> {
//! let run = Bench::new()
//!     .serve(SequenceProgram::new().on(10, clamp))
//!     .at_line(2, |scene| async move { scene.cs(1).hold().await })
//!     .at_state(1, Execution::FeedHold, |scene| async move {
//!         scene.plc().sleep(Duration::from_secs(1)).await;
//!         scene.cs(1).resume().await
//!     })
//!     .at_output(10, |scene| async move { scene.cs(1).stop().await })
//!     .run("G91 G01 X10 F600\nX10\nM10\nM30")?;
//! assert_eq!(run.output(10)?.ended, OutputEnd::Cancelled(CancelReason::Stop));
//! assert_eq!(run.system(1)?.execution, Execution::Stopped);
//! # Ok(()) }
//! ```
//!
//! Code that runs next to the handlers, such as [tasks](SequenceProgram::task), also runs in a bench. The test does not
//! wait for the end of such code. For a model of the plant, see [`Bench::plant`].
//!
//! # One clock
//! Handlers sleep by [`Plc::sleep`](plc_api::Plc::sleep), [`Plc::timeout`](plc_api::Plc::timeout) and
//! [`Plc::interval`](plc_api::Plc::interval). Ten simulated minutes take milliseconds of real time. For motion this
//! applies if the motors have no `lag_ms`: then long lines and dwells take no computing time, only events such as new
//! blocks do. The clock of tokio (`tokio::time`, also in libraries) shows the same simulated time, in milliseconds. So
//! a `tokio::time::timeout` expires in simulated time, and `tokio::time::Instant` shows that time.
//!
//! Simulated time does not wait for sockets and other threads (`spawn_blocking`, `tokio::fs`). If code uses them, the
//! run ends with an error that names the cause. The run also ends with an error if a handler, a task or a plant blocks
//! for 0.4 s of real time, such as by `std::thread::sleep`. Only Linux detects this, because it can distinguish blocked
//! code from a busy computer.
//!
//! `std::time` shows real time, and its use cannot be detected. For example, a loop of `plc.sleep` until an `Instant`
//! of the standard library has passed runs through simulated hours within a real second. Use `tokio::time::Instant` or
//! [`Plc::now_s`](plc_api::Plc::now_s) instead. If code waits for any other event that does not occur, the run also
//! ends, and [`Run::completed`] reports the event for which the program waited.

mod background;
mod perform;
mod record;
pub mod simulated_disk;
mod standstill;
#[cfg(test)]
mod tests;
mod tokio_clock;
mod trace;

use std::collections::BTreeMap;
use std::future::Future;
use std::path::Path;
use std::time::Duration;

use plc_api::{Execution, SequenceProgram};
use plc_protocol::port::BoxFuture;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::data::VariableArea;
use plc_protocol::types::io::{IoDeclaration, IoPoint};

use tandem_servo::{HardwareFactory, Servo};

use tandem_runtime::simulation::SimulationOptions;
use tandem_runtime::{Config, Machine};
use tandem_store::journal::Journal;
use tandem_store::program_store::program_number;

pub use perform::Scene;
pub use record::{OutputEnd, OutputRecord, Run, RunEndReason, StateChange, SystemEnd, kept_journal};
pub use trace::Sample;

/// Program number of a text or a file without a number.
const MAIN_PROGRAM: u16 = 1;

/// Default of the time limit of a run, in simulated seconds; [`Bench::max_time_s`] sets another limit.
const MAX_TIME_S: f64 = 3600.0;

/// Reason why a test cannot run or has failed, as text. `Debug` shows the same text, so that a test may return this
/// error.
#[derive(Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct TestError(String);

impl std::fmt::Debug for TestError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl TestError {
    fn new(text: impl std::fmt::Display) -> Self {
        Self(text.to_string())
    }
}

impl From<plc_api::Error> for TestError {
    fn from(error: plc_api::Error) -> Self {
        Self::new(error)
    }
}

/// Moment of a scripted event.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Cue {
    /// This number of seconds after the start of the programs.
    Time(f64),
    /// A line of the main program starts to move, issues an output, or stops.
    Line(u32),
    /// An output with this M number is issued in any coordinate system.
    Output(u16),
    /// This coordinate system enters this state.
    State(CoordinateSystemNumber, Execution),
}

impl std::fmt::Display for Cue {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Cue::Time(at_s) => write!(f, "at_s({at_s})"),
            Cue::Line(line) => write!(f, "at_line({line})"),
            Cue::Output(m) => write!(f, "at_output({m})"),
            Cue::State(cs, execution) => write!(f, "at_state({cs}, {execution:?})"),
        }
    }
}

type ScriptAction = Box<dyn FnOnce(Scene) -> BoxFuture<'static, plc_api::Result<()>> + Send>;

/// A machine, its sequence programs, and the scripted events of a run. See the [module](self).
#[must_use = "nothing happens before `run`"]
pub struct Bench {
    machine: Machine,
    programs: BTreeMap<u16, String>,
    beside: Vec<(CoordinateSystemNumber, u16)>,
    sequence_programs: Vec<SequenceProgram>,
    plants: Vec<ScriptAction>,
    script: Vec<(Cue, ScriptAction)>,
    trace_every_s: Option<f64>,
    options: SimulationOptions,
    journal: Journal,
    /// Real time within which simulated time must advance. Reason: otherwise a handler that blocks the thread would
    /// block the test without limit.
    standstill_max: Duration,
}

impl std::fmt::Debug for Bench {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Bench")
            .field("machine", &self.machine.name)
            .finish_non_exhaustive()
    }
}

impl Default for Bench {
    fn default() -> Self {
        Self::new()
    }
}

impl Bench {
    /// Creates a bench with the demo machine (`examples/config/demo.toml`) without its NC programs and handlers: X, Y,
    /// Z and a spindle in coordinate system 1, X and Z in coordinate system 2. M codes without a handler are alarms.
    ///
    /// # Panics
    /// Never: the demo machine is valid.
    #[expect(
        clippy::expect_used,
        reason = "the text is part of the program; a test reads it"
    )]
    pub fn new() -> Self {
        let mut machine = Config::demo().resolve().expect("the demo machine is good");
        for system in &mut machine.coordinate_systems {
            system.programs.clear();
        }
        Self::on_machine(machine)
    }

    /// Creates a bench with the machine of a configuration file and its NC programs. The data folder of the machine is
    /// not used.
    ///
    /// # Errors
    /// Returns an error if the file cannot be read or is invalid.
    pub fn with_config(path: impl AsRef<Path>) -> Result<Self, TestError> {
        let path = path.as_ref();
        let refused = |error: &dyn std::fmt::Display| TestError::new(format!("{}: {error}", path.display()));
        let config = Config::read(path).map_err(|error| refused(&error))?;
        let machine = config.resolve().map_err(|error| refused(&error))?;
        Ok(Self::on_machine(machine))
    }

    /// Creates a bench with the given machine.
    pub fn on_machine(machine: Machine) -> Self {
        Self {
            machine,
            programs: BTreeMap::new(),
            beside: Vec::new(),
            sequence_programs: Vec::new(),
            plants: Vec::new(),
            script: Vec::new(),
            trace_every_s: None,
            options: SimulationOptions {
                max_time_s: MAX_TIME_S,
                ..SimulationOptions::default()
            },
            journal: Journal::to_log(),
            standstill_max: Duration::from_secs(10),
        }
    }

    /// Sets the factory of the hardware. The default is simulated hardware.
    pub fn hardware(mut self, hardware: HardwareFactory) -> Self {
        self.options.hardware = Some(hardware);
        self
    }

    /// Sets a function that is called after each servo cycle of [`Bench::play`].
    pub fn on_cycle(mut self, on_cycle: impl FnMut(&Servo) + Send + 'static) -> Self {
        self.options.on_cycle = Some(Box::new(on_cycle));
        self
    }

    /// Sets the journal of [`Bench::play`]. By default its lines go to the log.
    pub fn journal(mut self, journal: Journal) -> Self {
        self.journal = journal;
        self
    }

    /// Serves the machine with a sequence program. Its handlers are registered before the NC program is loaded.
    pub fn serve(mut self, program: SequenceProgram) -> Self {
        self.sequence_programs.push(program);
        self
    }

    /// Adds a model of the plant, such as of cylinders with their switches. The model is an async closure that starts
    /// before the handlers and runs next to them. The end of the test stops it; the test does not wait for its end. If
    /// it ends with an error, the test ends with this error. It sleeps in [simulated time](self#one-clock).
    ///
    /// ```
    /// # use plc_api::{Alarm, AuxOutput, SequenceProgram, handlers::with};
    /// # use std::time::Duration;
    /// # use tandem_testing::{Bench, TestError};
    /// # use tokio::sync::watch;
    /// /// Closes the valve, and waits for the switch.
    /// async fn clamp(cell: Cell) -> Result<(), Alarm> {
    ///     cell.valve.send_replace(true);
    ///     let closed = cell.switch.subscribe().wait_for(|closed| *closed).await.map(|_| ());
    ///     closed.map_err(|_| Alarm::user(10, "the switch does not exist any more"))
    /// }
    ///
    /// #[derive(Clone, Default)]
    /// struct Cell {
    ///     valve: watch::Sender<bool>,
    ///     switch: watch::Sender<bool>,
    /// }
    ///
    /// # fn main() -> Result<(), TestError> {
    /// let cell = Cell::default();
    /// let cylinder = cell.clone();
    /// let program = SequenceProgram::new().on(10, with(cell, |_, _, cell| clamp(cell)));
    /// let run = Bench::new()
    ///     .serve(program)
    ///     .plant(|scene| async move {
    ///         let mut valve = cylinder.valve.subscribe();
    ///         while valve.changed().await.is_ok() {
    ///             scene.plc().sleep(Duration::from_millis(300)).await; // its stroke
    ///             let is_open = *valve.borrow_and_update();
    ///             cylinder.switch.send_replace(is_open);
    ///         }
    ///         Ok(())
    ///     })
    ///     .run("M10\nM30")?
    ///     .completed()?;
    /// assert!((run.output(10)?.took_s()? - 0.3).abs() < 0.01);
    /// # Ok(()) }
    /// ```
    pub fn plant<F, Work>(mut self, plant: F) -> Self
    where
        F: FnOnce(Scene) -> Work + Send + 'static,
        Work: Future<Output = plc_api::Result<()>> + Send + 'static,
    {
        self.plants.push(Box::new(move |scene| Box::pin(plant(scene))));
        self
    }

    /// Declares an input or output of the plant, as `[io]` of a configuration does. A [plant](Bench::plant) may set
    /// inputs and react to outputs.
    ///
    /// ```
    /// # use plc_api::{Alarm, AuxOutput, Plc, SequenceProgram};
    /// # use plc_protocol::types::io::{IoDeclaration, IoPoint};
    /// # use std::time::Duration;
    /// # use tandem_testing::{Bench, TestError};
    /// async fn coolant_on(_output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    ///     plc.io_out("valve").set(true).await?;
    ///     plc.io_in("flows").wait_until(|value| value.is_on()).await?;
    ///     Ok(())
    /// }
    ///
    /// # fn main() -> Result<(), TestError> {
    /// let run = Bench::new()
    ///     .declare_io(IoPoint::output("valve"), IoDeclaration::new(false))
    ///     .declare_io(IoPoint::input("flows"), IoDeclaration::new(false))
    ///     .serve(SequenceProgram::new().on(8, coolant_on))
    ///     .plant(|scene| async move {
    ///         let (valve, flows) = (scene.plc().io_out("valve"), scene.plc().io_in("flows"));
    ///         let mut opens = valve.changes();
    ///         opens.next().await; // closed at first
    ///         while let Some(open) = opens.next().await {
    ///             scene.plc().sleep(Duration::from_millis(500)).await;
    ///             flows.set(open).await?;
    ///         }
    ///         Ok(())
    ///     })
    ///     .run("M08\nM30")?
    ///     .completed()?;
    /// assert!((run.output(8)?.took_s()? - 0.5).abs() < 0.01);
    /// # Ok(()) }
    /// ```
    pub fn declare_io(mut self, point: IoPoint, declaration: IoDeclaration) -> Self {
        self.machine.io.insert(point, declaration);
        self
    }

    /// Publishes `count` variables, the first of which is `from`, when one of them changes. Corresponds to
    /// `[[variables.published]]` of a configuration.
    pub fn publish_variables(mut self, area: VariableArea, from: u32, count: u32) -> Self {
        self.machine
            .published
            .entry(area)
            .or_default()
            .push((from, count));
        self
    }

    /// Adds a program with this number, which other programs can call.
    pub fn subprogram(mut self, number: u16, text: impl Into<String>) -> Self {
        self.programs.insert(number, text.into());
        self
    }

    /// Adds a program with this number, which coordinate system `cs` runs at the same time as the main program.
    pub fn beside(mut self, cs: CoordinateSystemNumber, number: u16, text: impl Into<String>) -> Self {
        self.beside.push((cs, number));
        self.subprogram(number, text)
    }

    /// Runs an action `at_s` seconds after the start of the programs.
    pub fn at_s<F, Work>(self, at_s: f64, action: F) -> Self
    where
        F: FnOnce(Scene) -> Work + Send + 'static,
        Work: Future<Output = plc_api::Result<()>> + Send + 'static,
    {
        self.at(Cue::Time(at_s), action)
    }

    /// Runs an action when a line of the main program begins: its motion, its output or its stop. A line without these
    /// never starts the action.
    pub fn at_line<F, Work>(self, line: u32, action: F) -> Self
    where
        F: FnOnce(Scene) -> Work + Send + 'static,
        Work: Future<Output = plc_api::Result<()>> + Send + 'static,
    {
        self.at(Cue::Line(line), action)
    }

    /// Runs an action when an output with this M number is issued for the first time.
    pub fn at_output<F, Work>(self, m: u16, action: F) -> Self
    where
        F: FnOnce(Scene) -> Work + Send + 'static,
        Work: Future<Output = plc_api::Result<()>> + Send + 'static,
    {
        self.at(Cue::Output(m), action)
    }

    /// Runs an action when a coordinate system enters this state for the first time after the start.
    pub fn at_state<F, Work>(self, cs: CoordinateSystemNumber, execution: Execution, action: F) -> Self
    where
        F: FnOnce(Scene) -> Work + Send + 'static,
        Work: Future<Output = plc_api::Result<()>> + Send + 'static,
    {
        self.at(Cue::State(cs, execution), action)
    }

    /// Sets the time limit of a run in simulated seconds. The default is 3600.
    pub fn max_time_s(mut self, max_time_s: f64) -> Self {
        self.options.max_time_s = max_time_s;
        self
    }

    /// Records the commanded positions of all coordinate systems at this interval, rounded up to the next servo cycle.
    /// See [`Run::trace`] and [`Run::at_s`]. Such a run computes every servo cycle, even cycles without events, so ten
    /// simulated minutes take seconds.
    pub fn trace_every_s(mut self, interval_s: f64) -> Self {
        self.trace_every_s = Some(interval_s);
        self
    }

    /// Runs this text as program 1 in coordinate system 1, until every program has ended or nothing further can happen.
    /// The times in the result count from the start of the programs.
    ///
    /// # Errors
    /// Returns an error if a program is rejected or a handler blocks the thread. Also returns an error if an action
    /// fails, is never started, or has not ended.
    ///
    /// # Panics
    /// Panics if an action panics, for example by a failed assertion.
    pub fn run(self, text: impl Into<String>) -> Result<Run, TestError> {
        self.subprogram(MAIN_PROGRAM, text).run_program(MAIN_PROGRAM)
    }

    /// Runs the program in a file. The program number is that of the file name, otherwise 1. The program can call the
    /// files `<number>.nc` in the same folder.
    ///
    /// # Errors
    /// Returns an error if the folder cannot be read, and in the cases of [`Bench::run`].
    pub fn run_file(mut self, path: impl AsRef<Path>) -> Result<Run, TestError> {
        let path = path.as_ref();
        let unreadable = |error: std::io::Error| TestError::new(format!("{}: {error}", path.display()));
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        for entry in std::fs::read_dir(folder.unwrap_or(Path::new("."))).map_err(unreadable)? {
            let file = entry.map_err(unreadable)?.path();
            let is_nc = file.extension().is_some_and(|extension| extension == "nc");
            if let Some(number) = program_number(&file).filter(|_| is_nc) {
                let text = std::fs::read_to_string(&file).map_err(unreadable)?;
                self.programs.entry(number).or_insert(text);
            }
        }
        let text = std::fs::read_to_string(path).map_err(unreadable)?;
        let number = program_number(path).unwrap_or(MAIN_PROGRAM);
        self.subprogram(number, text).run_program(number)
    }

    fn at<F, Work>(mut self, cue: Cue, action: F) -> Self
    where
        F: FnOnce(Scene) -> Work + Send + 'static,
        Work: Future<Output = plc_api::Result<()>> + Send + 'static,
    {
        self.script
            .push((cue, Box::new(move |scene| Box::pin(action(scene)))));
        self
    }
}
