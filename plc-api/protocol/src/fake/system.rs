//! State word and inputs of a coordinate system of the scripted machine. Both result from its outputs and
//! from commands.

use std::collections::{BTreeMap, BTreeSet};

use crate::execution::Situation;
use crate::handshake::{Ledger, OpenOutput, OutputOutcome};
use crate::lock_input::{LockInput, LockRules};
use crate::types::command::{Command, Verb};
use crate::types::handler::Departure;
use crate::types::message::Payload;
use crate::types::output::CancelReason;
use crate::types::request::{Input, Refusal, RefusalCode};
use crate::types::state::{Execution, OptionalSkip, Overrides, Reason, RunKind, State, Switch, WaitingOn};
use crate::types::topic::CsTopic;
use crate::types::{CoordinateSystemNumber, Timestamp};

use super::{OPEN_OUTPUTS_MAX, boot_id};

type Word = (Execution, Option<Reason>);

/// A coordinate system of the scripted machine, without motion.
#[derive(Debug)]
pub(super) struct System {
    pub(super) ledger: Ledger,
    /// Prefix of the run ids: boot id and number of the coordinate system.
    runs_of: String,
    /// Outcome of each closed output, by `seq`.
    pub(super) closed: BTreeMap<u64, OutputOutcome>,
    runs: u32,
    run: Option<FakeRun>,
    /// State word while no run is active.
    idle: Word,
    /// Fields of the published state, except those that [`System::state`] adds.
    shown: State,
    interlock: LockInput,
    start_lock: LockInput,
    overrides: Overrides,
}

#[derive(Debug, Default)]
struct FakeRun {
    paused: Option<Word>,
    /// True once the program has reached its end. The run ends when no output is open any more.
    at_end: bool,
}

impl System {
    /// Creates a coordinate system that is READY and has loaded program 1.
    pub(super) fn new(boot: u32, cs: CoordinateSystemNumber) -> Self {
        Self {
            ledger: Ledger::new(boot_id(boot), cs, OPEN_OUTPUTS_MAX),
            runs_of: format!("{}-{cs}", boot_id(boot).0),
            closed: BTreeMap::new(),
            runs: 0,
            run: None,
            idle: (Execution::Ready, None),
            shown: State {
                program: Some(1),
                ..State::default()
            },
            interlock: LockInput::new("interlock", LockRules::default()),
            start_lock: LockInput::new("start lock", LockRules::default()),
            overrides: Overrides::default(),
        }
    }

    /// Creates a coordinate system in its state after a restart of the runtime: STOPPED.
    pub(super) fn restarted(boot: u32, cs: CoordinateSystemNumber) -> Self {
        Self {
            idle: (Execution::Stopped, Some(Reason::Restarted)),
            ..Self::new(boot, cs)
        }
    }

    pub(super) fn run_id(&self) -> String {
        format!("{}-{}", self.runs_of, self.runs)
    }

    /// Returns the number of the loaded program, or 1 if no program is loaded.
    pub(super) fn program(&self) -> u16 {
        self.shown.program.unwrap_or(1)
    }

    /// Returns the active run. If no run is active, starts a run.
    fn run(&mut self) -> &mut FakeRun {
        self.runs += u32::from(self.run.is_none());
        self.run.get_or_insert_default()
    }

    pub(super) fn start_run(&mut self) {
        self.run();
    }

    pub(super) fn end_run(&mut self, word: Word) {
        self.run = None;
        self.idle = word;
    }

    /// Marks the end of the program as reached. If no run is active, starts a run.
    pub(super) fn end_program(&mut self) {
        self.run().at_end = true;
    }

    pub(super) fn is_paused(&self) -> bool {
        self.run.as_ref().is_some_and(|run| run.paused.is_some())
    }

    /// Adopts the program number and the state word of a state that the test publishes.
    pub(super) fn adopt_state(&mut self, state: &State) {
        use Execution::{ProgramCompleted, Ready, Stopped};
        let word = (state.execution, state.reason);
        self.shown.program = state.program.or(self.shown.program);
        match state.execution {
            Ready | Stopped | ProgramCompleted => self.end_run(word),
            Execution::Active | Execution::Wait => self.run().paused = None,
            _ => self.run().paused = Some(word),
        }
    }

    /// Returns the oldest open output, for which the run waits; `None` if the run waits for no output.
    fn awaited(&self) -> Option<&OpenOutput> {
        self.run.as_ref().and_then(|_| self.ledger.open().first())
    }

    fn word(&self) -> Word {
        let Some(run) = &self.run else { return self.idle };
        match (run.paused, self.awaited()) {
            (Some(word), _) => word,
            (None, Some(output)) => (Execution::Wait, output.is_lost().then_some(Reason::HandlerLost)),
            (None, None) => (Execution::Active, None),
        }
    }

    fn state(&self, alarm_count: u32) -> State {
        let (execution, reason) = self.word();
        State {
            execution,
            reason,
            waiting_on: self.awaited().map(waiting_on),
            run_id: (self.runs > 0).then(|| self.run_id()),
            run_kind: self.run.as_ref().map(|_| RunKind::Program),
            alarm_count,
            ..self.shown.clone()
        }
    }

    /// Executes a command if it is allowed. If the command ends the run, returns the reason with which the
    /// caller must cancel the open outputs.
    ///
    /// # Errors
    /// Fails if the command is not allowed now, or if a lock forbids the command.
    pub(super) fn command(
        &mut self,
        command: &Command,
        alarm_active: bool,
    ) -> Result<Option<CancelReason>, Refusal> {
        let situation = Situation {
            execution: self.word().0,
            program_loaded: self.shown.program.is_some(),
            alarm_active,
        };
        let verb = command.verb();
        if let Command::JogEnd { .. } = command {
            // a jog of this machine ends as soon as it begins
            return Ok(None);
        }
        situation.check_allowed(verb)?;
        self.check_locks(verb)?;
        match command {
            Command::Load { program } => {
                self.shown.program = Some(*program);
                self.idle = (Execution::Ready, None);
            }
            Command::Start | Command::StartFrom(_) => self.start_run(),
            Command::Run(order) => {
                self.shown.program = order.program.or(self.shown.program);
                self.start_run();
            }
            Command::Hold => self.hold((Execution::FeedHold, None)),
            Command::Resume => self.run().paused = None,
            Command::Stop if self.run.is_some() => return Ok(Some(CancelReason::Stop)),
            Command::Abort if self.run.is_some() => return Ok(Some(CancelReason::Abort)),
            Command::Reset => return Ok(Some(CancelReason::Reset)),
            Command::Stop | Command::Abort | Command::AlarmAcknowledge { .. } => {}
            Command::BackTrace { .. } => {
                let text = "a machine without motion has no way to go back";
                return Err(Refusal::new(RefusalCode::NotAllowed, text));
            }
            Command::Mdi { .. } | Command::Jog { .. } | Command::JogEnd { .. } | Command::Home { .. } => {
                self.idle = (Execution::Ready, None);
            }
        }
        Ok(None)
    }

    pub(super) fn set_last_command(&mut self, id: &str) {
        self.shown.last_command_id = Some(id.to_owned());
    }

    /// Pauses the run with the state word `word`. Has no effect if the run is already paused or no run is
    /// active.
    fn hold(&mut self, word: Word) {
        if let Some(run) = &mut self.run {
            run.paused.get_or_insert(word);
        }
    }

    /// Sets an input of the coordinate system.
    ///
    /// # Errors
    /// Fails if a lock refuses the write of its source, or if `check_writer` rejects the instance that writes
    /// for a handler.
    pub(super) fn set_input(
        &mut self,
        input: Input,
        judge_writer: impl Fn(&str, Option<&String>) -> Result<(), Refusal>,
    ) -> Result<(), Refusal> {
        let shown = &mut self.shown;
        match input {
            Input::OptionalSkip(numbers) => {
                let mut on: BTreeSet<u8> = shown.optional_skip.iter().copied().collect();
                on.extend(numbers.keys());
                on.retain(|number| numbers.get(number) != Some(&false));
                shown.optional_skip = on.into_iter().collect();
            }
            Input::OptionalStop(value) => shown.optional_stop = value,
            Input::SingleBlock(value) => shown.single_block = value,
            Input::DryRun(value) => shown.dry_run = value,
            Input::StartLock(set) => self.start_lock.set(set, judge_writer)?,
            Input::Override(change) => {
                let overrides = &mut self.overrides;
                overrides.feed = change.feed.unwrap_or(overrides.feed);
                overrides.rapid = change.rapid.unwrap_or(overrides.rapid);
                overrides.spindle = change.spindle.unwrap_or(overrides.spindle);
            }
            Input::Interlock(set) => {
                self.interlock.set(set, judge_writer)?;
                self.follow_interlock();
            }
        }
        Ok(())
    }

    /// Notifies the interlock and the start lock that a handler is offline.
    pub(super) fn mark_handler_offline(&mut self, handler_id: &str, departure: Departure, now_s: f64) {
        for input in [&mut self.interlock, &mut self.start_lock] {
            input.mark_handler_offline(handler_id, departure);
        }
        self.expire_locks(now_s);
    }

    /// Notifies the interlock and the start lock that a handler is online.
    pub(super) fn mark_handler_online(&mut self, handler_id: &str) {
        for input in [&mut self.interlock, &mut self.start_lock] {
            input.mark_handler_online(handler_id);
        }
    }

    /// Sets the lock sources of each handler that did not return before `now_s` to their `on_loss`.
    pub(super) fn expire_locks(&mut self, now_s: f64) {
        for input in [&mut self.interlock, &mut self.start_lock] {
            input.expire(now_s, |_| false);
        }
        self.follow_interlock();
    }

    /// Returns the earliest time at which [`expire_locks`](Self::expire_locks) must be called.
    pub(super) fn next_lock_deadline_s(&self) -> Option<f64> {
        let deadlines = [&self.interlock, &self.start_lock].into_iter();
        deadlines.filter_map(LockInput::next_deadline_s).reduce(f64::min)
    }

    fn follow_interlock(&mut self) {
        if self.interlock.is_on() {
            self.hold((Execution::Interrupted, Some(Reason::Interlock)));
        }
    }

    /// Ends the run if the program has reached its end, no output is open and the run is not paused. Returns
    /// the current state and inputs as messages.
    pub(super) fn follow(&mut self, alarm_count: u32) -> [(CsTopic, Payload); 8] {
        let ends = |run: &FakeRun| run.at_end && run.paused.is_none() && self.ledger.is_empty();
        if self.run.as_ref().is_some_and(ends) {
            self.end_run((Execution::ProgramCompleted, None));
        }
        let requested = self.shown.optional_skip.clone();
        let skip = OptionalSkip {
            effective: requested.clone(),
            requested,
            effective_from_line: 0,
        };
        let switch = |value| Payload::Switch(Switch { value });
        [
            (CsTopic::State, Payload::State(self.state(alarm_count))),
            (CsTopic::OptionalSkip, Payload::OptionalSkip(skip)),
            (CsTopic::OptionalStop, switch(self.shown.optional_stop)),
            (CsTopic::SingleBlock, switch(self.shown.single_block)),
            (CsTopic::DryRun, switch(self.shown.dry_run)),
            (CsTopic::Interlock, Payload::Lock(self.interlock.state())),
            (CsTopic::StartLock, Payload::Lock(self.start_lock.state())),
            (CsTopic::Override, Payload::Override(self.overrides)),
        ]
    }

    /// Refuses a command while a lock that forbids the command is on.
    fn check_locks(&self, verb: Verb) -> Result<(), Refusal> {
        let begins = matches!(verb, Verb::Start | Verb::Run | Verb::Mdi);
        let moves = begins || matches!(verb, Verb::Resume | Verb::Jog | Verb::Home);
        let (what, lock) = if begins && self.start_lock.is_on() {
            ("the start lock", &self.start_lock)
        } else if moves && self.interlock.is_on() {
            ("the interlock", &self.interlock)
        } else {
            return Ok(());
        };
        let text = format!("{what} is on: {}", lock.text());
        Err(Refusal::new(RefusalCode::StartLocked, text))
    }
}

fn waiting_on(open: &OpenOutput) -> WaitingOn {
    let question = open.question().cloned();
    WaitingOn {
        m: open.notice.m,
        seq: open.notice.seq,
        since: Timestamp::from_system_time(open.since),
        progress: open.progress().cloned(),
        question: question
            .filter(|question| question.answer.is_none())
            .map(Box::new),
    }
}

/// Returns the state word after a cancellation for this reason, or `None` if the run continues.
pub(super) fn word_of(reason: CancelReason) -> Option<Word> {
    use CancelReason::{Abort, Alarm, Operator, Reset, Shutdown, Stop, Timeout};
    Some(match reason {
        Reset => (Execution::Ready, None),
        Stop | Shutdown => (Execution::Stopped, Some(Reason::Stop)),
        Abort => (Execution::Stopped, Some(Reason::Aborted)),
        Alarm | Timeout => (Execution::Stopped, Some(Reason::Alarm)),
        Operator => return None,
    })
}
