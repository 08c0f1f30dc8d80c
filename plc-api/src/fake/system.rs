//! The state word and the inputs of a scripted coordinate system, as they follow from its outputs and from commands.

use std::collections::BTreeSet;

use crate::execution::Situation;
use crate::handshake::{Ledger, OpenOutput};
use crate::types::Timestamp;
use crate::types::command::{Command, Verb};
use crate::types::message::Payload;
use crate::types::output::CancelReason;
use crate::types::request::{Input, Refusal, RefusalCode};
use crate::types::state::{Execution, Lock, OptionalSkip, Overrides, Reason, State, Switch, WaitingOn};
use crate::types::topic::CsTopic;

/// State word and reason.
type Word = (Execution, Option<Reason>);

/// One coordinate system, without motion.
#[derive(Debug)]
pub(super) struct System {
    program: Option<u16>,
    runs: u32,
    run: Option<Run>,
    /// Its word without a run.
    idle: Word,
    inputs: Inputs,
    pub(super) last_command_id: Option<String>,
}

#[derive(Debug, Default)]
struct Run {
    paused: Option<Word>,
    /// The script has put the end of the program: it waits for open outputs.
    at_end: bool,
}

#[derive(Debug, Default)]
struct Inputs {
    optional_skip: BTreeSet<u8>,
    optional_stop: bool,
    single_block: bool,
    dry_run: bool,
    interlock: Lock,
    start_lock: Lock,
    overrides: Overrides,
}

impl System {
    /// READY, with program 1.
    pub(super) fn new() -> Self {
        Self {
            program: Some(1),
            runs: 0,
            run: None,
            idle: (Execution::Ready, None),
            inputs: Inputs::default(),
            last_command_id: None,
        }
    }

    /// The runtime was started again.
    pub(super) fn restart(&mut self) {
        *self = Self {
            idle: (Execution::Stopped, Some(Reason::Restarted)),
            ..Self::new()
        };
    }

    pub(super) fn run_id(&self) -> String {
        format!("run-{}", self.runs)
    }

    /// The program that is loaded; 1 where the script began a run without one.
    pub(super) fn program(&self) -> u16 {
        self.program.unwrap_or(1)
    }

    /// A run begins where there is none.
    pub(super) fn begin(&mut self) {
        if self.run.is_none() {
            self.runs += 1;
            self.run = Some(Run::default());
        }
    }

    /// The run ends with this word.
    pub(super) fn end(&mut self, word: Word) {
        self.run = None;
        self.idle = word;
    }

    /// The script puts the end of the program.
    pub(super) fn put_end(&mut self) {
        self.begin();
        if let Some(run) = &mut self.run {
            run.at_end = true;
        }
    }

    pub(super) fn is_paused(&self) -> bool {
        self.run.as_ref().is_some_and(|run| run.paused.is_some())
    }

    /// After outputs have changed: a program at its end has ended when none is open and nothing holds it.
    pub(super) fn follow(&mut self, ledger: &Ledger) {
        let ends = |run: &Run| run.at_end && run.paused.is_none() && ledger.is_empty();
        if self.run.as_ref().is_some_and(ends) {
            self.end((Execution::ProgramCompleted, None));
        }
    }

    /// Takes over a state that the script says.
    pub(super) fn take_over(&mut self, state: &State) {
        use Execution::{ProgramCompleted, Ready, Stopped};
        let word = (state.execution, state.reason);
        self.program = state.program.or(self.program);
        match state.execution {
            Ready | Stopped | ProgramCompleted => self.end(word),
            Execution::Active | Execution::Wait => self.pause(None),
            _ => self.pause(Some(word)),
        }
    }

    fn pause(&mut self, word: Option<Word>) {
        self.begin();
        if let Some(run) = &mut self.run {
            run.paused = word;
        }
    }

    fn word(&self, waited_for: Option<&OpenOutput>) -> Word {
        let Some(run) = &self.run else { return self.idle };
        match (run.paused, waited_for) {
            (Some(word), _) => word,
            (None, Some(output)) => (Execution::Wait, output.lost.then_some(Reason::HandlerLost)),
            (None, None) => (Execution::Active, None),
        }
    }

    pub(super) fn state(&self, ledger: &Ledger, alarm_count: u32) -> State {
        let first_open = || ledger.open().first();
        let waited_for = self.run.as_ref().and_then(|_| first_open());
        let (execution, reason) = self.word(waited_for);
        State {
            execution,
            reason,
            waiting_on: waited_for.map(waiting_on),
            program: self.program,
            run_id: (self.runs > 0).then(|| self.run_id()),
            single_block: self.inputs.single_block,
            dry_run: self.inputs.dry_run,
            optional_stop: self.inputs.optional_stop,
            optional_skip: self.inputs.optional_skip.iter().copied().collect(),
            alarm_count,
            last_command_id: self.last_command_id.clone(),
            ..State::default()
        }
    }

    /// Judges a command by the command table and carries it out. Gives why its outputs are to be cancelled, if they are.
    ///
    /// # Errors
    /// Not allowed now, or a lock is on.
    pub(super) fn command(
        &mut self,
        command: &Command,
        ledger: &Ledger,
        alarm_active: bool,
    ) -> Result<Option<CancelReason>, Refusal> {
        let waited_for = ledger.open().first();
        let situation = Situation {
            execution: self.word(waited_for).0,
            program_loaded: self.program.is_some(),
            alarm_active,
        };
        let verb = command.verb();
        situation.judge(verb)?;
        self.inputs.judge(verb)?;
        match command {
            Command::Load { program } => {
                self.program = Some(*program);
                self.idle = (Execution::Ready, None);
            }
            Command::Start => self.begin(),
            Command::Hold => self.hold((Execution::FeedHold, None)),
            Command::Resume => self.pause(None),
            Command::Stop if self.run.is_some() => return Ok(Some(CancelReason::Stop)),
            Command::Abort if self.run.is_some() => return Ok(Some(CancelReason::Abort)),
            Command::Reset => return Ok(Some(CancelReason::Reset)),
            Command::Stop | Command::Abort | Command::AlarmAcknowledge { .. } => {}
            Command::BackTrace { .. } => {
                return Err(Refusal::new(
                    RefusalCode::NotAllowed,
                    "a machine without motion has no way to go back",
                ));
            }
            Command::Mdi { .. } | Command::Jog { .. } | Command::Home { .. } => {
                self.idle = (Execution::Ready, None);
            }
        }
        Ok(None)
    }

    /// Without effect on a paused program and without a run.
    fn hold(&mut self, word: Word) {
        if let Some(run) = &mut self.run {
            run.paused.get_or_insert(word);
        }
    }

    /// Sets an input. Gives the topics that show it.
    pub(super) fn set_input(&mut self, input: Input) {
        let inputs = &mut self.inputs;
        match input {
            Input::OptionalSkip(numbers) => {
                for (number, value) in numbers {
                    if value {
                        inputs.optional_skip.insert(number);
                    } else {
                        inputs.optional_skip.remove(&number);
                    }
                }
            }
            Input::OptionalStop(value) => inputs.optional_stop = value,
            Input::SingleBlock(value) => inputs.single_block = value,
            Input::DryRun(value) => inputs.dry_run = value,
            Input::StartLock(lock) => inputs.start_lock = lock,
            Input::Override(change) => {
                let overrides = &mut inputs.overrides;
                overrides.feed = change.feed.unwrap_or(overrides.feed);
                overrides.rapid = change.rapid.unwrap_or(overrides.rapid);
                overrides.spindle = change.spindle.unwrap_or(overrides.spindle);
            }
            Input::Interlock(lock) => {
                let is_on = lock.value;
                inputs.interlock = lock;
                if is_on {
                    self.hold((Execution::Interrupted, Some(Reason::Interlock)));
                }
            }
        }
    }

    /// What its inputs say.
    pub(super) fn inputs(&self) -> [(CsTopic, Payload); 7] {
        let inputs = &self.inputs;
        let requested: Vec<_> = inputs.optional_skip.iter().copied().collect();
        let skip = OptionalSkip {
            effective: requested.clone(),
            requested,
            effective_from_line: 0,
        };
        let switch = |value| Payload::Switch(Switch { value });
        [
            (CsTopic::OptionalSkip, Payload::OptionalSkip(skip)),
            (CsTopic::OptionalStop, switch(inputs.optional_stop)),
            (CsTopic::SingleBlock, switch(inputs.single_block)),
            (CsTopic::DryRun, switch(inputs.dry_run)),
            (CsTopic::Interlock, Payload::Lock(inputs.interlock.clone())),
            (CsTopic::StartLock, Payload::Lock(inputs.start_lock.clone())),
            (CsTopic::Override, Payload::Override(inputs.overrides)),
        ]
    }
}

impl Inputs {
    /// Refuses what would begin or move while a lock is on.
    fn judge(&self, verb: Verb) -> Result<(), Refusal> {
        let begins = matches!(verb, Verb::Start | Verb::Mdi);
        let moves = begins || matches!(verb, Verb::Resume | Verb::Jog | Verb::Home);
        let refused = |what: &str, lock: &Lock| {
            let text = format!("{what} is on: {}", lock.text);
            Err(Refusal::new(RefusalCode::StartLocked, text))
        };
        if begins && self.start_lock.value {
            return refused("the start lock", &self.start_lock);
        }
        if moves && self.interlock.value {
            return refused("the interlock", &self.interlock);
        }
        Ok(())
    }
}

fn waiting_on(open: &OpenOutput) -> WaitingOn {
    let question = open.question.clone();
    WaitingOn {
        m: open.notice.m,
        seq: open.notice.seq,
        since: Timestamp::from_system_time(open.since),
        progress: open.progress.clone(),
        question: question
            .filter(|question| question.answer.is_none())
            .map(Box::new),
    }
}

/// The word in which a run ends whose outputs are cancelled; `None`: it goes on.
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
