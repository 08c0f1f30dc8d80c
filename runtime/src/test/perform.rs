//! Runs a test: the machine, its handlers and the script in simulated time, on a thread of their own.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::mpsc as std_mpsc;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use futures_util::FutureExt;
use parking_lot::Mutex;
use plc_api::hub::{Filter, Subscription};
use plc_api::types::CoordinateSystemNumber;
use plc_api::types::message::{Message, Payload};
use plc_api::types::output::OutputNotice;
use plc_api::types::request::typed::WriteProgram;
use plc_api::types::state::State;
use plc_api::types::topic::{CsTopic, Topic};
use plc_api::{Alarm, CoordinateSystem, Error, Execution, Params, Plc, SequenceProgram};
use tandem_model::variables::VariableArray;
use tokio::sync::Notify;
use tokio::task::{AbortHandle, JoinError, JoinSet};

use super::record::{Ended, NonZero, OutputRecord, Run, StateChange, Stopped, SystemEnd};
use super::trace::{Samples, Tracer};
use super::{Action, Bench, Cue, TestError};
use crate::coordinator::Runtime;
use crate::journal::{Event, Journal, Line, ResetOutcome};
use crate::simulation::{self, Simulation, SimulationOptions};

/// Real time in which simulated time must go on at least once. Reason: a handler that blocks the thread would let the
/// test stand for ever.
const STANDSTILL: Duration = Duration::from_secs(if cfg!(test) { 2 } else { 10 });

/// Turns given to all tasks so that handlers are known before the programs are loaded. Reason: more than any chain of
/// wake-ups from a sequence program's first poll to the answer that the machine knows it.
const SETTLE_TURNS: usize = 256;

/// Where the watching thread finds the simulation.
type Watched = Arc<OnceLock<Arc<Simulation>>>;

pub(super) fn on_a_thread_of_its_own(bench: Bench, main: u16) -> Result<Run, TestError> {
    let (ended, end) = std_mpsc::channel();
    let watched = Watched::default();
    let simulation = Arc::clone(&watched);
    let thread = std::thread::spawn(move || {
        let run = simulation::run(perform(bench, main, simulation));
        // Nobody listens any more when it stood for too long.
        let _ = ended.send(run.map_err(TestError::new).flatten());
    });
    let mut cycles = None;
    loop {
        match end.recv_timeout(STANDSTILL) {
            Ok(run) => return run,
            Err(std_mpsc::RecvTimeoutError::Disconnected) => match thread.join() {
                Err(panic) => std::panic::resume_unwind(panic),
                Ok(()) => return Err(TestError::new("the run ended without a result")),
            },
            Err(std_mpsc::RecvTimeoutError::Timeout) => {
                let now = watched.get().map(|simulation| simulation.cycles());
                if now == std::mem::replace(&mut cycles, now) {
                    return Err(TestError::new(format!(
                        "simulated time has stood for {} s: a handler or an action blocks its thread; \
                         let it sleep by plc.sleep and compute in short steps",
                        STANDSTILL.as_secs()
                    )));
                }
            }
        }
    }
}

/// The machine and its handlers, as a scripted action sees them.
#[derive(Debug, Clone)]
pub struct Scene {
    plc: Plc,
    handlers: Arc<Mutex<Vec<AbortHandle>>>,
}

impl Scene {
    /// The machine, with everything that can be asked of it.
    pub fn plc(&self) -> &Plc {
        &self.plc
    }

    /// One of its coordinate systems.
    pub fn cs(&self, number: CoordinateSystemNumber) -> CoordinateSystem {
        self.plc.coordinate_system(number)
    }

    /// All handlers die where they are, as when their process ends: their claims are given back.
    pub fn kill_handlers(&self) {
        for handler in self.handlers.lock().drain(..) {
            handler.abort();
        }
    }

    /// Another sequence program serves the machine from now on, such as after [`Scene::kill_handlers`].
    pub fn serve(&self, program: SequenceProgram) {
        let plc = self.plc.clone();
        let served = tokio::spawn(async move {
            if let Err(error) = program.run(&plc).await {
                tracing::error!(%error, "the sequence program ended");
            }
        });
        self.handlers.lock().push(served.abort_handle());
    }
}

async fn perform(bench: Bench, main: u16, watched: Watched) -> Result<Run, TestError> {
    for program in &bench.sequence_programs {
        program.check()?;
    }
    let lines = Arc::new(Lines::default());
    let sink = Arc::clone(&lines);
    let waits_for_blocks = bench.script.iter().any(|(cue, _)| matches!(cue, Cue::Line(_)));
    let journal = Journal::to_sink(Arc::new(std::sync::Mutex::new(move |line: &Line| {
        sink.put(line.clone());
        let is_waited_for = waits_for_blocks || !matches!(line.event, Event::Block { .. });
        if is_waited_for {
            sink.wake.notify_one();
        }
        is_waited_for
    })));
    let tracer = Tracer::default();
    let options = SimulationOptions {
        max_time_s: bench.max_time_s,
        on_cycle: bench
            .trace_every_s
            .map(|interval_s| tracer.on_cycle(&bench.machine, interval_s)),
        hardware: None,
    };
    let runtime = Runtime::start_simulated(bench.machine, journal, options).map_err(TestError::new)?;
    let simulation = runtime.simulation().ok_or(TestError::new("no simulation"))?;
    // The slot is empty: it was made for this run.
    let _ = watched.set(Arc::clone(&simulation));
    let scene = Scene {
        plc: Plc::in_process(runtime.port()),
        handlers: Arc::default(),
    };
    for program in bench.sequence_programs {
        scene.serve(program);
    }
    for _ in 0..SETTLE_TURNS {
        tokio::task::yield_now().await;
    }
    let mut jobs = vec![(1, main)];
    jobs.extend(bench.beside);
    load(&scene, bench.programs, &jobs).await?;
    let stage = Stage {
        start_s: scene.plc.now_s(),
        states: scene.plc.port().subscribe(Filter::All),
        scene,
        lines,
        script: bench.script.into_iter().map(Some).collect(),
        main,
        actions: JoinSet::new(),
        running: jobs.iter().map(|(cs, _)| *cs).collect(),
        run: Run::begun(&jobs),
    };
    let systems: Vec<_> = runtime.machine().coordinate_systems.iter().collect();
    let systems: Vec<_> = systems.iter().map(|system| system.settings.number).collect();
    let start_s = stage.start_s;
    let run = stage.play(&simulation, &jobs, &systems).await;
    let run = run.and_then(|run| {
        let samples = tracer.samples(start_s)?;
        Ok(with_variables(run, &runtime, &systems, samples))
    });
    runtime.shutdown().await;
    run
}

/// Adds what the machine keeps to what the run has shown.
fn with_variables(run: Run, runtime: &Runtime, systems: &[CoordinateSystemNumber], samples: Samples) -> Run {
    let variables = |cs: &CoordinateSystemNumber| Some((*cs, runtime.variables(*cs)?));
    let variables: Vec<_> = systems.iter().filter_map(variables).collect();
    let p = variables.first().map(|(_, of_cs)| non_zero(&of_cs.global));
    let q = variables
        .iter()
        .map(|(cs, of_cs)| (*cs, non_zero(&of_cs.coordinate_system)));
    Run {
        samples,
        p: p.unwrap_or_default(),
        q: q.collect(),
        ..run
    }
}

fn non_zero(variables: &VariableArray) -> NonZero {
    let all =
        (0..variables.len()).filter_map(|index| Some((u32::try_from(index).ok()?, variables.get(index)?)));
    all.filter(|(_, value)| *value != 0.0)
        .map(|(number, value)| (number, value.to_bits()))
        .collect()
}

/// Writes the programs, and loads those that are to run.
async fn load(
    scene: &Scene,
    programs: BTreeMap<u16, String>,
    jobs: &[(CoordinateSystemNumber, u16)],
) -> Result<(), TestError> {
    for (number, text) in programs {
        let check = scene.plc.port().ask(WriteProgram(number, text)).await;
        check.map_err(|refusal| TestError::new(format!("program {number} was not taken: {refusal:?}")))?;
    }
    for (cs, program) in jobs {
        let loaded = scene.cs(*cs).load(*program).await;
        loaded.map_err(|error| refused(*program, &error))?;
    }
    Ok(())
}

/// Why a program was not loaded, with every finding.
fn refused(program: u16, error: &Error) -> TestError {
    let mut lines = vec![format!("program {program} is refused: {error}")];
    if let Error::Refused(refusal) = error {
        let findings = refusal.diagnostics.iter();
        lines.extend(findings.map(|found| format!("line {}: {} {}", found.line, found.code, found.message)));
    }
    TestError::new(lines.join("\n  "))
}

/// Lines of the journal that the stage has not taken.
#[derive(Default)]
struct Lines {
    queue: Mutex<VecDeque<Line>>,
    wake: Notify,
}

impl Lines {
    fn put(&self, line: Line) {
        self.queue.lock().push_back(line);
    }

    fn take(&self) -> Option<Line> {
        self.queue.lock().pop_front()
    }

    async fn next(&self) -> Line {
        loop {
            if let Some(line) = self.take() {
                return line;
            }
            self.wake.notified().await;
        }
    }
}

/// A run under way.
struct Stage {
    scene: Scene,
    start_s: f64,
    states: Subscription,
    lines: Arc<Lines>,
    script: Vec<Option<(Cue, Action)>>,
    main: u16,
    actions: JoinSet<(Cue, plc_api::Result<()>)>,
    /// Coordinate systems whose programs have not ended.
    running: BTreeSet<CoordinateSystemNumber>,
    run: Run,
}

impl Stage {
    async fn play(
        mut self,
        simulation: &Simulation,
        jobs: &[(CoordinateSystemNumber, u16)],
        systems: &[CoordinateSystemNumber],
    ) -> Result<Run, TestError> {
        // What came before the start is no part of the run.
        while self.states.try_next().is_some() {}
        while self.lines.take().is_some() {}
        let _ = simulation.stalled().now_or_never();
        for (cs, _) in jobs {
            self.scene.cs(*cs).start().await?;
        }
        self.run.stopped = loop {
            let next_s = self.next_time_cue_s();
            if self.running.is_empty() && next_s.is_none() && self.actions.is_empty() {
                break Stopped::ProgramsEnded;
            }
            let plc = self.scene.plc.clone();
            let wait_s = (next_s.unwrap_or_default() + self.start_s - plc.now_s()).max(0.0);
            tokio::select! {
                biased;
                line = self.lines.next() => self.journalled(&line),
                Some(message) = self.states.next() => self.said(&message),
                Some(ended) = self.actions.join_next(), if !self.actions.is_empty() => acted(ended)?,
                () = plc.sleep(Duration::from_secs_f64(wait_s)), if next_s.is_some() => {
                    self.cue(|cue| matches!(cue, Cue::Time(at_s) if Some(at_s) == next_s));
                }
                () = simulation.stalled() => {
                    break if simulation.is_at_limit() { Stopped::TimeLimit } else { Stopped::NothingMoves };
                }
            }
        };
        self.run.time_s = self.now_s();
        if let Some((cue, _)) = self.script.iter().flatten().next() {
            let text = format!("{cue} never came; it did: {}", self.run.order(1).join(", "));
            return Err(TestError::new(text));
        }
        if !self.actions.is_empty() {
            return Err(TestError::new(
                "an action had not ended when nothing could happen any more",
            ));
        }
        for cs in systems {
            let end = self.end_of(*cs).await?;
            self.run.systems.insert(*cs, end);
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

    /// Begins the actions whose moment is now.
    fn cue(&mut self, is_now: impl Fn(Cue) -> bool) {
        for place in &mut self.script {
            if place.as_ref().is_some_and(|(cue, _)| is_now(*cue))
                && let Some((cue, action)) = place.take()
            {
                let work = action(self.scene.clone());
                self.actions.spawn(async move { (cue, work.await) });
            }
        }
    }

    /// Takes a line of the journal.
    fn journalled(&mut self, line: &Line) {
        let (cs, at_s) = (line.cs, line.t_s - self.start_s);
        let is_block = matches!(line.event, Event::Block { .. });
        // of what begins: program, line
        let mut begun = None;
        let what = match &line.event {
            Event::Block { program, line } => {
                begun = Some((*program, *line));
                format!("block {line}")
            }
            Event::Output(notice) => {
                begun = Some((notice.program, notice.line));
                self.made(cs, notice, at_s)
            }
            Event::Reset { seq, m, outcome, .. } => {
                let word = self.answered(cs, *seq, outcome, at_s);
                format!("{word} M{:02}", m.unwrap_or_default())
            }
            Event::Stop { m, program, line, .. } => {
                begun = program.zip(*line);
                format!("stop M{:02}", m.unwrap_or_default())
            }
            Event::Alarm(alarm) => format!("alarm {}", alarm.number()),
            // of the topic a subscriber gets only the last value, and each only once
            Event::Capture(captured) => {
                self.run.captured.push((**captured).clone());
                "capture".to_owned()
            }
            Event::Resume => "resume".to_owned(),
            Event::Warning { .. } => "warning".to_owned(),
            Event::End(_) => "end".to_owned(),
            _ => return,
        };
        let mut before = self.run.order.iter().rev();
        let is_repeated = is_block
            && before
                .find(|(of, _)| *of == cs)
                .is_some_and(|(_, last)| *last == what);
        if !is_repeated {
            self.run.order.push((cs, what));
        }
        if let Some((_, line)) = begun.filter(|(program, _)| *program == self.main) {
            self.cue(|cue| cue == Cue::Line(line));
        }
        if let Event::Output(notice) = &line.event {
            self.cue(|cue| cue == Cue::Output(notice.m));
        }
    }

    fn made(&mut self, cs: CoordinateSystemNumber, notice: &OutputNotice, at_s: f64) -> String {
        self.run.outputs.push(OutputRecord {
            cs,
            seq: notice.seq,
            m: notice.m,
            params: notice.params,
            program: notice.program,
            line: notice.line,
            output_s: at_s,
            ended_s: None,
            ended: Ended::Open,
        });
        format!("output M{:02}{}", notice.m, words(&notice.params))
    }

    fn answered(
        &mut self,
        cs: CoordinateSystemNumber,
        seq: u64,
        outcome: &ResetOutcome,
        at_s: f64,
    ) -> &'static str {
        let (ended, word) = match outcome {
            ResetOutcome::Ok => (Ended::Reset, "reset"),
            ResetOutcome::Fault { code, text } => {
                let text = text.clone().unwrap_or_default();
                (Ended::Failed(Alarm::user(code.unwrap_or_default(), text)), "fail")
            }
        };
        self.end_output(cs, seq, at_s, ended);
        word
    }

    fn end_output(&mut self, cs: CoordinateSystemNumber, seq: u64, at_s: f64, ended: Ended) {
        let mut outputs = self.run.outputs.iter_mut();
        if let Some(output) = outputs.find(|output| (output.cs, output.seq) == (cs, seq))
            && output.ended == Ended::Open
        {
            output.ended_s = Some(at_s);
            output.ended = ended;
        }
    }

    /// Takes a message of the machine.
    fn said(&mut self, message: &Message) {
        match (&message.topic, &message.payload) {
            (Topic::CoordinateSystem(cs, CsTopic::State), Payload::State(state)) => self.state(*cs, state),
            (Topic::CoordinateSystem(cs, CsTopic::Cancel(_)), Payload::Cancel(cancel)) => {
                let at_s = self.now_s();
                self.end_output(*cs, cancel.seq, at_s, Ended::Cancelled(cancel.reason));
            }
            (Topic::AlarmEvent, Payload::AlarmEvent(alarm))
                if !self.run.alarms.iter().any(|known| known.id == alarm.id) =>
            {
                self.run.alarms.push(alarm.clone());
            }
            _ => {}
        }
    }

    fn state(&mut self, cs: CoordinateSystemNumber, state: &State) {
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

fn acted(ended: Result<(Cue, plc_api::Result<()>), JoinError>) -> Result<(), TestError> {
    match ended {
        Ok((_, Ok(()))) => Ok(()),
        Ok((cue, Err(error))) => Err(TestError::new(format!("{cue}: {error}"))),
        Err(error) => match error.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            Err(error) => Err(TestError::new(error)),
        },
    }
}

/// ` VA3 VB0.5`.
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
    let letters = ["A", "B", "C", "D", "E", "F", "G", "H"];
    let given = letters.into_iter().zip([a, b, c, d, e, f, g, h]);
    given
        .filter_map(|(letter, value)| Some(format!(" V{letter}{}", value?)))
        .collect()
}
