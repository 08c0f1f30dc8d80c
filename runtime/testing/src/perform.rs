//! Runs a test on a separate thread: the machine, its handlers and the script in simulated time.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::mpsc as std_mpsc;
use std::time::Duration;

use futures_util::FutureExt;
use parking_lot::Mutex;
use plc_api::{Alarm, CoordinateSystem, Error, Execution, Params, Plc, SequenceProgram};
use plc_protocol::hub::{Filter, Subscription};
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::handler::HandlerStatus;
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::output::OutputNotice;
use plc_protocol::types::request::typed::WriteProgram;
use plc_protocol::types::state::State;
use plc_protocol::types::topic::{CsTopic, Topic};
use tandem_model::variables::VariableArray;
use tandem_runtime::Runtime;
use tandem_runtime::simulation::SimulationSlot;
use tandem_store::journal::{Event, Journal, Line, ResetOutcome};
use tokio::sync::mpsc;
use tokio::task::{AbortHandle, JoinError, JoinSet};

use super::background::{Failures, is_foreign, socket_error};
use super::record::{NonZero, OutputEnd, OutputRecord, Run, RunEndReason, StateChange, SystemEnd};
use super::trace::SampleTracer;
use super::{Bench, Cue, ScriptAction, TestError};

use super::tokio_clock::{Code, run_in};

/// Number of turns that all tasks get so that handlers register before the programs are loaded. Reason: no
/// chain of wake-ups from a sequence program's first poll to the answer to its registration is longer.
const SETTLE_TURNS: usize = 256;

/// The machine and its handlers, as accessible to a scripted action.
#[derive(Debug, Clone)]
pub struct Scene {
    plc: Plc,
    handlers: Arc<Mutex<Vec<AbortHandle>>>,
    failures: Failures,
}

impl Scene {
    /// Returns the machine with all its requests.
    pub fn plc(&self) -> &Plc {
        &self.plc
    }

    /// Returns a coordinate system of the machine.
    pub fn cs(&self, number: CoordinateSystemNumber) -> CoordinateSystem {
        self.plc.coordinate_system(number)
    }

    /// Ends all handlers immediately, as if their process had ended; the machine releases their claims.
    pub fn kill_handlers(&self) {
        for handler in self.handlers.lock().drain(..) {
            handler.abort();
        }
    }

    /// Starts another sequence program that serves the machine, for example after [`Scene::kill_handlers`].
    /// If the program ends with an error, for example because its `handler_id` is taken, the test ends with
    /// this error.
    pub fn serve(&self, program: SequenceProgram) {
        let (plc, failures) = (self.plc.clone(), self.failures.clone());
        let served = async move { failures.watch("a sequence program", program.run(&plc)).await };
        self.handlers.lock().push(tokio::spawn(served).abort_handle());
    }
}

impl Bench {
    /// Runs `act` with the machine in simulated time, after the handlers are registered and the programs are
    /// stored. No program is loaded, and scripted events do not happen.
    ///
    /// ```
    /// # use plc_api::Execution;
    /// # use tandem_testing::{Bench, TestError};
    /// # fn main() -> Result<(), TestError> {
    /// let x = Bench::new().play(async |scene, _runtime| {
    ///     scene.cs(1).home(&['X']).await?;
    ///     scene.cs(1).wait_until(Execution::Ready).await?;
    ///     Ok::<_, TestError>(scene.cs(1).position().await?.machine["X"])
    /// })??;
    /// assert_eq!(x, 0.0);
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Returns an error if the machine does not start, a sequence program or an NC program is rejected, or a
    /// task blocks the thread.
    ///
    /// # Panics
    /// Panics if `act` panics, for example by a failed assertion.
    pub fn play<T: Send + 'static>(
        self,
        act: impl AsyncFnOnce(Scene, &Runtime) -> T + Send + 'static,
    ) -> Result<T, TestError> {
        self.play_with(Code::Foreign, act)
    }

    fn play_with<T: Send + 'static>(
        self,
        code: Code,
        act: impl AsyncFnOnce(Scene, &Runtime) -> T + Send + 'static,
    ) -> Result<T, TestError> {
        let standstill_max = self.standstill_max;
        let (ended, end) = std_mpsc::channel();
        let slot = SimulationSlot::default();
        let watched = Arc::clone(&slot);
        let thread = std::thread::spawn(move || {
            let failures = Failures::default();
            let (of_threads, of_test) = (failures.clone(), failures.clone());
            let on_thread = move || of_threads.on_other_thread();
            let played = run_in(slot, code, on_thread, self.play_here(of_test, act));
            // The receiver is closed if the test took too long.
            let _ = ended.send(played.map_err(TestError::new).flatten());
        });
        let mut cycles = None;
        loop {
            match end.recv_timeout(standstill_max) {
                Ok(played) => return played,
                Err(std_mpsc::RecvTimeoutError::Disconnected) => match thread.join() {
                    Err(panic) => std::panic::resume_unwind(panic),
                    Ok(()) => return Err(TestError::new("the run ended without a result")),
                },
                Err(std_mpsc::RecvTimeoutError::Timeout) => {
                    let now = watched.get().map(|simulation| simulation.cycles());
                    if now == std::mem::replace(&mut cycles, now) {
                        return Err(TestError::new(format!(
                            "simulated time has not advanced for {} s: a handler or an action blocks its \
                             thread; let it sleep by \
                             plc.sleep and compute in short steps",
                            standstill_max.as_secs()
                        )));
                    }
                }
            }
        }
    }

    async fn play_here<T>(
        self,
        failures: Failures,
        act: impl AsyncFnOnce(Scene, &Runtime) -> T,
    ) -> Result<T, TestError> {
        for program in &self.sequence_programs {
            program.check()?;
        }
        let runtime = Runtime::start_simulated(self.machine, self.journal, self.options);
        let runtime = runtime.map_err(TestError::new)?;
        let scene = Scene {
            plc: Plc::in_process(runtime.port()),
            handlers: Arc::default(),
            failures: failures.clone(),
        };
        // Dropping this set at the end of the test ends the tasks in it.
        let mut plants = JoinSet::new();
        for plant in self.plants {
            let (work, failures) = (plant(scene.clone()), failures.clone());
            plants.spawn(async move { failures.watch("a plant", work).await });
        }
        let results = scene.plc.port().subscribe(Filter::Handshake);
        for program in self.sequence_programs {
            scene.serve(program);
        }
        for _ in 0..SETTLE_TURNS {
            tokio::task::yield_now().await;
        }
        failures.raise_failure()?;
        check_presences(results)?;
        for (number, text) in self.programs {
            let check = scene.plc.port().ask(WriteProgram(number, text)).await;
            check.map_err(|refusal| {
                TestError::new(format!(
                    "program {number} was not accepted: \
                                                           {refusal:?}"
                ))
            })?;
        }
        let played = act(scene.clone(), &runtime).await;
        let judged = failures.raise_failure();
        plants.shutdown().await;
        runtime.shutdown().await;
        judged.map(|()| played)
    }

    /// Runs a program of the configuration, or one given by [`Bench::subprogram`].
    ///
    /// # Errors
    /// Returns the same errors as [`Bench::run`].
    pub fn run_program(mut self, number: u16) -> Result<Run, TestError> {
        let (sink, lines) = mpsc::unbounded_channel();
        let waits_for_blocks = self.script.iter().any(|(cue, _)| matches!(cue, Cue::Line(_)));
        let blocks = Arc::new(Mutex::new(Vec::new()));
        let kept = Arc::clone(&blocks);
        self.journal = Journal::to_sink(Arc::new(std::sync::Mutex::new(move |line: &Line| {
            let mut kept = kept.lock();
            let block = StartedBlock::from_line(line);
            kept.extend(block);
            let wakes = waits_for_blocks || block.is_none();
            if wakes {
                let (blocks, line) = (std::mem::take(&mut *kept), block.is_none().then(|| line.clone()));
                // The receiver is closed if the run has ended.
                let _ = sink.send((blocks, line));
            }
            wakes
        })));
        let tracer = SampleTracer::default();
        let interval_s = self.trace_every_s;
        self.options.on_cycle = interval_s.map(|interval_s| tracer.on_cycle(&self.machine, interval_s));
        let mut jobs = vec![(1, number)];
        jobs.append(&mut self.beside);
        let script = std::mem::take(&mut self.script);
        let is_own = script.is_empty() && self.plants.is_empty() && self.sequence_programs.is_empty();
        let code = if is_own { Code::Own } else { Code::Foreign };
        self.play_with(code, async move |scene, runtime| {
            for (cs, program) in &jobs {
                let loaded = scene.cs(*cs).load(*program).await;
                loaded.map_err(|error| refused(*program, &error))?;
            }
            let stage = Stage {
                start_s: scene.plc.now_s(),
                states: scene.plc.port().subscribe(Filter::All),
                scene,
                lines,
                blocks,
                script: script.into_iter().map(Some).collect(),
                main: number,
                actions: JoinSet::new(),
                running: jobs.iter().map(|(cs, _)| *cs).collect(),
                run: Run {
                    jobs: jobs.iter().map(|(cs, _)| *cs).collect(),
                    ..Run::default()
                },
            };
            let start_s = stage.start_s;
            let run = stage.play(runtime).await?;
            let samples = tracer.samples(start_s)?;
            Ok(Run { samples, ..run })
        })
        .flatten()
    }
}

/// Reports a sequence program whose presence the machine rejects. The test may end before the sequence
/// program itself gives up.
///
/// # Errors
/// Returns an error if the machine has rejected a presence.
fn check_presences(mut results: Subscription) -> Result<(), TestError> {
    while let Some(message) = results.try_next() {
        if let (Topic::HandlerResult(id), Payload::HandlerResult(result)) = (&message.topic, &message.payload)
            && result.status == HandlerStatus::Refused
        {
            let why = result.text.as_deref().unwrap_or_default();
            return Err(TestError::new(format!("sequence program {id} is refused: {why}")));
        }
    }
    Ok(())
}

/// Describes why the machine did not load a program, with all diagnostics.
fn refused(program: u16, error: &Error) -> TestError {
    let mut lines = vec![format!("program {program} is refused: {error}")];
    if let Error::Refused(refusal) = error {
        let findings = refusal.diagnostics.iter();
        lines.extend(findings.map(|found| format!("line {}: {} {}", found.line, found.code, found.message)));
    }
    TestError::new(lines.join("\n  "))
}

/// A block whose motion has begun.
#[derive(Debug, Clone, Copy)]
struct StartedBlock {
    cs: CoordinateSystemNumber,
    program: u16,
    line: u32,
}

impl StartedBlock {
    /// Creates the block from a line of the journal; returns `None` for other lines.
    fn from_line(line: &Line) -> Option<Self> {
        match line.event {
            Event::Block { program, line: at } => Some(Self {
                cs: line.cs,
                program,
                line: at,
            }),
            _ => None,
        }
    }
}

/// A run in progress.
struct Stage {
    scene: Scene,
    start_s: f64,
    states: Subscription,
    /// Journal entries for the test: the blocks that have begun, and the line after them.
    lines: mpsc::UnboundedReceiver<(Vec<StartedBlock>, Option<Line>)>,
    /// Blocks that have begun since the last entry in `lines`. They do not wake the test, because no action
    /// waits for them.
    blocks: Arc<Mutex<Vec<StartedBlock>>>,
    script: Vec<Option<(Cue, ScriptAction)>>,
    main: u16,
    actions: JoinSet<(Cue, plc_api::Result<()>)>,
    /// Coordinate systems whose programs have not ended.
    running: BTreeSet<CoordinateSystemNumber>,
    run: Run,
}

impl Stage {
    async fn play(mut self, runtime: &Runtime) -> Result<Run, TestError> {
        let simulation = runtime.simulation().ok_or(TestError::new("no simulation"))?;
        // Discards events before the start, which are not part of the run.
        while self.states.try_next().is_some() {}
        while self.lines.try_recv().is_ok() {}
        self.blocks.lock().clear();
        let _ = simulation.stalled().now_or_never();
        for cs in &self.run.jobs {
            self.scene.cs(*cs).start().await?;
        }
        self.run.stopped = loop {
            let next_s = self.next_time_cue_s();
            if self.running.is_empty() && next_s.is_none() && self.actions.is_empty() {
                break RunEndReason::ProgramsEnded;
            }
            let plc = self.scene.plc.clone();
            let wait_s = (next_s.unwrap_or_default() + self.start_s - plc.now_s()).max(0.0);
            tokio::select! {
                biased;
                Some((blocks, line)) = self.lines.recv() => {
                    self.on_blocks(blocks);
                    if let Some(line) = line {
                        self.on_line(&line);
                    }
                }
                Some(message) = self.states.next() => self.on_message(&message),
                () = self.scene.failures.noted() => {
                    self.scene.failures.raise_failure()?;
                }
                Some(ended) = self.actions.join_next(), if !self.actions.is_empty() => on_action_end(ended, &self.scene.failures)?,
                () = plc.sleep(Duration::from_secs_f64(wait_s)), if next_s.is_some() => {
                    self.cue(|cue| matches!(cue, Cue::Time(at_s) if Some(at_s) == next_s));
                }
                () = simulation.stalled() => {
                    break if simulation.is_at_limit() { RunEndReason::TimeLimit } else { RunEndReason::NothingMoves };
                }
            }
        };
        let rest = std::mem::take(&mut *self.blocks.lock());
        self.on_blocks(rest);
        self.run.time_s = self.now_s();
        if let Some(alarm) = self.run.alarms.iter().find(|alarm| is_foreign(&alarm.text)) {
            return Err(socket_error(
                alarm.text.split(" panicked").next().unwrap_or_default(),
            ));
        }
        if let Some((cue, _)) = self.script.iter().flatten().next() {
            let text = format!(
                "{cue} never occurred; the events were: {}",
                self.run.order(1).join(", ")
            );
            return Err(TestError::new(text));
        }
        if !self.actions.is_empty() {
            return Err(TestError::new(
                "an action had not ended when no further event was possible",
            ));
        }
        for system in &runtime.machine().coordinate_systems {
            let cs = system.settings.number;
            self.run.systems.insert(cs, self.end_of(cs).await?);
            if let Some(variables) = runtime.variables(cs) {
                self.run.p = non_zero(&variables.global);
                self.run.q.insert(cs, non_zero(&variables.coordinate_system));
            }
        }
        Ok(self.run)
    }

    fn now_s(&self) -> f64 {
        self.scene.plc.now_s() - self.start_s
    }

    fn next_time_cue_s(&self) -> Option<f64> {
        let times = self.script.iter().flatten().filter_map(|(cue, _)| match cue {
            Cue::Time(at_s) => Some(*at_s),
            _ => None,
        });
        times.reduce(f64::min)
    }

    /// Starts the scripted actions whose cue is due now.
    fn cue(&mut self, is_now: impl Fn(Cue) -> bool) {
        for place in &mut self.script {
            if let Some((cue, action)) = place.take_if(|(cue, _)| is_now(*cue)) {
                let work = action(self.scene.clone());
                self.actions.spawn(async move { (cue, work.await) });
            }
        }
    }

    /// Records blocks whose motion has begun, and starts the actions for their lines.
    fn on_blocks(&mut self, blocks: Vec<StartedBlock>) {
        for block in blocks {
            let what = format!("block {}", block.line);
            let mut before = self.run.order.iter().rev();
            let last = before.find(|(of, _)| *of == block.cs);
            if last.is_none_or(|(_, last)| *last != what) {
                self.run.order.push((block.cs, what));
            }
            self.cue_line(block.program, block.line);
        }
    }

    /// Starts the actions for a line of the main program whose block has begun.
    fn cue_line(&mut self, program: u16, line: u32) {
        if program == self.main {
            self.cue(|cue| cue == Cue::Line(line));
        }
    }

    /// Handles a line of the journal that is not about the start of a block.
    fn on_line(&mut self, line: &Line) {
        let (cs, at_s) = (line.cs, line.t_s - self.start_s);
        // Program and line of the block that has begun.
        let mut begun = None;
        let what = match &line.event {
            Event::Output(notice) => {
                begun = Some((notice.program, notice.line));
                self.on_output(cs, notice, at_s);
                format!("output M{:02}{}", notice.m, words(&notice.params))
            }
            Event::Reset { seq, m, outcome, .. } => {
                let (ended, word) = match outcome {
                    ResetOutcome::Ok => (OutputEnd::Reset, "reset"),
                    ResetOutcome::Fault { code, text } => {
                        let alarm = Alarm::user(code.unwrap_or_default(), text.clone().unwrap_or_default());
                        (OutputEnd::Failed(alarm), "fail")
                    }
                };
                self.end_output(cs, *seq, at_s, ended);
                format!("{word} M{:02}", m.unwrap_or_default())
            }
            Event::Stop { m, program, line, .. } => {
                begun = program.zip(*line);
                format!("stop M{:02}", m.unwrap_or_default())
            }
            Event::Alarm(alarm) => format!("alarm {}", alarm.number()),
            // A subscriber of the topic would receive only the latest value, so the journal line is used.
            Event::Capture(captured) => {
                self.run.captured.push((**captured).clone());
                "capture".to_owned()
            }
            Event::Resume => "resume".to_owned(),
            Event::Warning { .. } => "warning".to_owned(),
            Event::End(_) => "end".to_owned(),
            _ => return,
        };
        self.run.order.push((cs, what));
        if let Some((program, line)) = begun {
            self.cue_line(program, line);
        }
        if let Event::Output(notice) = &line.event {
            self.cue(|cue| cue == Cue::Output(notice.m));
        }
    }

    fn on_output(&mut self, cs: CoordinateSystemNumber, notice: &OutputNotice, at_s: f64) {
        self.run.outputs.push(OutputRecord {
            cs,
            seq: notice.seq,
            m: notice.m,
            params: notice.params,
            program: notice.program,
            line: notice.line,
            output_s: at_s,
            ended_s: None,
            ended: OutputEnd::Open,
        });
    }

    fn end_output(&mut self, cs: CoordinateSystemNumber, seq: u64, at_s: f64, ended: OutputEnd) {
        let mut outputs = self.run.outputs.iter_mut();
        if let Some(output) = outputs.find(|output| (output.cs, output.seq) == (cs, seq))
            && output.ended == OutputEnd::Open
        {
            output.ended_s = Some(at_s);
            output.ended = ended;
        }
    }

    fn on_message(&mut self, message: &Message) {
        match (&message.topic, &message.payload) {
            (Topic::CoordinateSystem(cs, CsTopic::State), Payload::State(state)) => self.on_state(*cs, state),
            (Topic::CoordinateSystem(cs, CsTopic::Cancel(_)), Payload::Cancel(cancel)) => {
                let at_s = self.now_s();
                self.end_output(*cs, cancel.seq, at_s, OutputEnd::Cancelled(cancel.reason));
            }
            (Topic::AlarmEvent, Payload::AlarmEvent(alarm))
                if !self.run.alarms.iter().any(|known| known.id == alarm.id) =>
            {
                self.run.alarms.push(alarm.clone());
            }
            _ => {}
        }
    }

    fn on_state(&mut self, cs: CoordinateSystemNumber, state: &State) {
        let is_over = matches!(
            state.execution,
            Execution::ProgramCompleted | Execution::Stopped | Execution::Ready
        ) && state.transition.is_none();
        if is_over {
            self.running.remove(&cs);
        } else {
            self.running.insert(cs);
        }
        let last = self.run.states.iter().rev().find(|change| change.cs == cs);
        if last.is_some_and(|last| (last.execution, last.reason) == (state.execution, state.reason)) {
            return;
        }
        self.run.states.push(StateChange {
            at_s: self.now_s(),
            cs,
            execution: state.execution,
            reason: state.reason,
        });
        self.cue(|cue| cue == Cue::State(cs, state.execution));
    }

    async fn end_of(&self, cs: CoordinateSystemNumber) -> Result<SystemEnd, TestError> {
        let system = self.scene.cs(cs);
        let (state, position) = (system.state().await?, system.position().await?);
        let waiting_on = state.waiting_on.map(|waiting| {
            let said = waiting.progress.map(|progress| progress.text);
            (waiting.m, said)
        });
        Ok(SystemEnd {
            execution: state.execution,
            reason: state.reason,
            waiting_on,
            machine: position.machine,
            work: position.work,
            tool: system.tool().await?.id,
        })
    }
}

fn on_action_end(
    ended: Result<(Cue, plc_api::Result<()>), JoinError>,
    failures: &Failures,
) -> Result<(), TestError> {
    match ended {
        Ok((_, Ok(()))) => Ok(()),
        Ok((cue, Err(error))) => Err(TestError::new(format!("{cue}: {error}"))),
        Err(error) => match error.try_into_panic() {
            Ok(panic) => {
                failures.panicked("an action", panic);
                failures.raise_failure()
            }
            Err(error) => Err(TestError::new(error)),
        },
    }
}

fn non_zero(variables: &VariableArray) -> NonZero {
    let all =
        (0..variables.len()).filter_map(|index| Some((u32::try_from(index).ok()?, variables.get(index)?)));
    all.filter(|(_, value)| *value != 0.0)
        .map(|(number, value)| (number, value.to_bits()))
        .collect()
}

/// Formats parameters as ` VA3 VB0.5`.
fn words(params: &Params) -> String {
    let Params {
        a,
        b,
        c,
        d,
        e,
        f,
        g,
        h,
    } = *params;
    let given = ('A'..).zip([a, b, c, d, e, f, g, h]);
    given
        .filter_map(|(letter, value)| Some(format!(" V{letter}{}", value?)))
        .collect()
}
