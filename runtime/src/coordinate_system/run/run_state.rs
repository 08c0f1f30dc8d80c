//! State machine of a run. Pure: it receives events, and returns the next state and the actions to perform. State word,
//! reason and transition are functions of the state alone. The state owns the data of its run: they exist only while the
//! run is active.

use plc_protocol::execution::wire_name;
use plc_protocol::types::state::{Execution, Reason, Transition};
use tandem_model::flow::{Output, ProgramStop};
use tandem_model::{Alarm, Origin};

use super::causes::{Cause, EarlyEndCause, StateWord};

/// State of a coordinate system: idle, running or ending a run. `R` is the data of an active run, and `E` the data of a
/// run that was ended early; the state machine moves both, but does not read them.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum RunState<R, E> {
    /// No run is active; the state word describes the end of the last run.
    Idle(StateWord),
    /// A run is active.
    Run(Hold, Progress, R),
    /// A run was ended early, and the machine has not stopped yet.
    Ending {
        /// Epoch with which the servo reports the rest.
        epoch: u32,
        why: EarlyEndCause,
        /// State word and reason that are published until the machine rests.
        from: StateWord,
        /// Data of the run for the time when the machine rests.
        remainder: E,
    },
}

/// Hold of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Hold {
    /// No hold: the run proceeds, or waits for an output or at a program stop.
    Off,
    /// The motion decelerates on its path because of a hold.
    Begun(Cause),
    /// The motion rests because of a hold.
    AtRest(Cause),
}

/// Next step of an active run, and the output for which it waits.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Progress {
    phase: Phase,
    /// Open output whose reset the program needs before it continues.
    awaited: Option<AwaitedOutput>,
    /// Last segment of the backward motion; `None` except during a back trace.
    back_to: Option<u64>,
}

/// Open output for which the program waits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct AwaitedOutput {
    pub seq: u64,
    /// True if the handler that had claimed the output is lost.
    pub is_lost: bool,
}

/// Next step of a run, or the event for which the run waits.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Phase {
    /// The next step requests an item from the interpreter.
    Interpret,
    /// The run waits until all motion is finished, in position and not held. Then it performs this action.
    Standstill(Then),
    /// The run waits for the reset of an issued output.
    Reset { seq: u64 },
    /// The run waits before it issues this output: its M number is still pending (D32), or the ledger is full.
    Room(Output),
    /// The run waits at M00, or at M01 with the optional stop on.
    Paused(ProgramStop),
    /// The run waits at M02 or M30 until all its outputs are reset.
    LastOutputs,
}

/// Action after the machine has reached a standstill.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Then {
    Interpret,
    /// Ends a block in single block.
    BlockEnd,
    Output(Output),
    Stop(ProgramStop),
    Alarm(Alarm),
    End(Origin),
}

/// Event that changes the state of a run.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum RunEvent<R, E> {
    /// A program was loaded.
    Loaded,
    /// This run has begun in this phase.
    Started { phase: Phase, run: R },
    /// The motion must be held for this cause.
    Hold(Cause),
    /// The run continues: the command resume, or the command that ends a back trace.
    Resume,
    /// A back trace starts and ends at the end of segment `to`.
    BackTrace { to: u64 },
    /// The run must end early. The servo reports the rest with `epoch`. `remainder` is kept until then if a run is
    /// active.
    End {
        why: EarlyEndCause,
        epoch: u32,
        remainder: E,
    },
    /// Preparation has reached this phase.
    Phase(Phase),
    /// The run waits for this output in its current phase; `None` if it waits for no output.
    Awaited(Option<AwaitedOutput>),
    /// The servo has passed the end of a segment.
    Passed { segment: u64 },
    /// The motion rests under a hold. `behind_block` is true for a hold at the end of a block in single block.
    ServoHeld { behind_block: bool },
    /// A block has ended at rest in single block.
    BlockEnded,
    /// The servo reports the rest after a stop, with the epoch of that stop.
    AtRest { epoch: u32 },
    /// The run is completed; the state becomes this one.
    Completed(Execution),
}

/// Action that the coordinate system must perform after an event.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum RunAction<R, E> {
    /// Makes the servo hold on the path; with `in_phase` also within a thread (tapping).
    HoldServo { in_phase: bool },
    /// Makes the servo continue.
    ResumeServo,
    /// Ends a back trace: the motion goes forward again from its current position.
    GoForward,
    /// Does the work that the hold has delayed.
    GoOn,
    /// Lets single block apply from the next block on.
    BeginBlock,
    /// Cancels the outputs and stops the machine with this epoch. `run` is the ended run, if a run was active.
    End {
        why: EarlyEndCause,
        epoch: u32,
        run: Option<R>,
    },
    /// Completes the early end of the run, because the machine rests.
    Ended { why: EarlyEndCause, remainder: E },
    /// Completes this run, which has reached its end.
    Complete { run: R, outcome: Execution },
    /// Reports an event that the state does not expect, and that has changed nothing. `run` is the run that could not
    /// begin.
    ReportUnexpected { text: String, run: Option<R> },
}

impl Progress {
    fn new(phase: Phase) -> Self {
        Self {
            phase,
            awaited: None,
            back_to: None,
        }
    }

    /// Returns the reason to publish during a back trace; otherwise `None`.
    fn back(&self) -> Option<Reason> {
        self.back_to.map(|_| Reason::BackTrace)
    }

    fn is_paused(&self) -> bool {
        matches!(self.phase, Phase::Paused(_))
    }

    /// Returns the state word and reason unless the run rests under a hold.
    fn state_word(&self) -> StateWord {
        match (&self.phase, self.awaited) {
            (Phase::Paused(stop), _) if stop.optional => (Execution::OptionalStop, None),
            (Phase::Paused(_), _) => (Execution::ProgramStopped, None),
            (_, Some(awaited)) => (Execution::Wait, awaited.is_lost.then_some(Reason::HandlerLost)),
            (_, None) => (Execution::Active, self.back()),
        }
    }
}

impl<R, E> Default for RunState<R, E> {
    /// Returns the state of a coordinate system without a loaded program.
    fn default() -> Self {
        Self::Idle((Execution::Stopped, Some(Reason::NoProgram)))
    }
}

impl<R, E> RunState<R, E> {
    /// Returns the data of the active run.
    pub fn run(&self) -> Option<&R> {
        match self {
            RunState::Run(_, _, run) => Some(run),
            _ => None,
        }
    }

    /// Returns the data of the active run.
    pub fn run_mut(&mut self) -> Option<&mut R> {
        match self {
            RunState::Run(_, _, run) => Some(run),
            _ => None,
        }
    }

    /// Sets the state after a fault whose recovery waits for a reset. Returns true if a run was active.
    pub fn give_up(&mut self) -> bool {
        let had_run = self.has_run();
        *self = RunState::Idle((Execution::Stopped, Some(Reason::Alarm)));
        had_run
    }

    /// Returns the state word and reason.
    pub fn state_word(&self) -> StateWord {
        match self {
            RunState::Idle(word) => *word,
            RunState::Run(Hold::AtRest(cause), progress, _) => {
                let (execution, reason) = cause.state_word();
                (execution, reason.or(progress.back()))
            }
            RunState::Run(_, progress, _) => progress.state_word(),
            RunState::Ending { from, .. } => *from,
        }
    }

    /// Returns the state word and reason against which commands are validated. While a run is ending, these are the
    /// ones after the machine has come to rest.
    pub fn state_word_at_rest(&self) -> StateWord {
        match self {
            RunState::Ending { why, .. } => why.at_rest(),
            _ => self.state_word(),
        }
    }

    /// Returns the current transition, if any.
    pub fn transition(&self) -> Option<Transition> {
        match self {
            RunState::Run(Hold::Begun(_), ..) => Some(Transition::Holding),
            RunState::Ending { why, .. } => Some(why.transition()),
            _ => None,
        }
    }

    fn progress(&self) -> Option<&Progress> {
        match self {
            RunState::Run(_, progress, _) => Some(progress),
            _ => None,
        }
    }

    /// Returns the phase of the run; `None` if no run is active.
    pub fn phase(&self) -> Option<&Phase> {
        self.progress().map(|progress| &progress.phase)
    }

    /// Returns the output whose reset the program needs before it continues.
    pub fn awaited(&self) -> Option<AwaitedOutput> {
        self.progress()?.awaited
    }

    /// Returns true from the start of a back trace until the motion goes forward again.
    pub fn retraces(&self) -> bool {
        self.progress().is_some_and(|progress| progress.back_to.is_some())
    }

    /// Returns true if no run is active or ending.
    pub fn is_idle(&self) -> bool {
        matches!(self, RunState::Idle(_))
    }

    /// Returns true while a run is active: it has begun, and has neither ended nor started to end.
    pub fn has_run(&self) -> bool {
        matches!(self, RunState::Run(..))
    }

    /// Returns true while a run is ending.
    pub fn is_ending(&self) -> bool {
        matches!(self, RunState::Ending { .. })
    }

    /// Returns true while no hold or stop prevents the run from proceeding.
    pub fn is_running(&self) -> bool {
        matches!(self, RunState::Run(Hold::Off, ..))
    }

    /// Returns true while a hold may wait for the end of a thread (tapping). A hold that acts in the thread then stops
    /// the motion at once.
    pub fn hold_may_wait(&self) -> bool {
        matches!(self, Self::Run(Hold::Begun(cause), ..) if !cause.acts_in_thread())
    }

    /// Returns true while a hold is active that stops the motion even in a thread (tapping).
    pub fn holds_in_thread(&self) -> bool {
        let Self::Run(Hold::Begun(cause) | Hold::AtRest(cause), ..) = self else {
            return false;
        };
        cause.acts_in_thread()
    }

    /// Takes the action that follows a standstill. Afterwards the phase is [`Phase::Interpret`].
    pub fn take_then(&mut self) -> Option<Then> {
        let RunState::Run(_, Progress { phase, .. }, _) = self else {
            return None;
        };
        match std::mem::replace(phase, Phase::Interpret) {
            Phase::Standstill(then) => Some(then),
            other => {
                *phase = other;
                None
            }
        }
    }

    /// Returns the state after an event, and the actions to perform in order. An event that the state does not expect
    /// changes nothing and is reported.
    pub fn on(self, event: RunEvent<R, E>) -> (Self, Vec<RunAction<R, E>>)
    where
        E: Default,
    {
        match (self, event) {
            (
                state,
                RunEvent::End {
                    why,
                    epoch,
                    remainder,
                },
            ) => state.end_early(why, epoch, remainder),
            (RunState::Run(hold, progress, run), event) => progress.on(hold, event, run),
            (RunState::Idle(_), RunEvent::Loaded) => (RunState::Idle((Execution::Ready, None)), Vec::new()),
            (RunState::Idle(_), RunEvent::Started { phase, run }) => {
                (RunState::Run(Hold::Off, Progress::new(phase), run), Vec::new())
            }
            // Without a run there is no motion to hold. A late servo also holds a motion that has just ended.
            (state @ RunState::Idle(_), RunEvent::Hold(_) | RunEvent::ServoHeld { .. }) => {
                (state, Vec::new())
            }
            (
                RunState::Ending {
                    epoch,
                    why,
                    remainder,
                    ..
                },
                RunEvent::AtRest { epoch: at },
            ) if epoch == at => (
                RunState::Idle(why.at_rest()),
                vec![RunAction::Ended { why, remainder }],
            ),
            // The machine already brakes. Reports of the servo may cross the stop: about the motion before the stop, or
            // about the rest after an earlier stop.
            (
                state @ RunState::Ending { .. },
                RunEvent::Hold(_)
                | RunEvent::ServoHeld { .. }
                | RunEvent::Passed { .. }
                | RunEvent::AtRest { .. },
            ) => (state, Vec::new()),
            (state, event) => {
                let action = state.report_unexpected(event);
                (state, vec![action])
            }
        }
    }

    /// Ends a run early. Without a run a stop has no effect, and a stop that is in progress is not started again.
    fn end_early(self, why: EarlyEndCause, epoch: u32, new: E) -> (Self, Vec<RunAction<R, E>>)
    where
        E: Default,
    {
        use EarlyEndCause::{Abort, JogEnded, Stop};
        let from = self.state_word();
        let (run, remainder) = match self {
            state @ RunState::Idle(_) if matches!(why, Stop | Abort | JogEnded(_)) => {
                return (state, Vec::new());
            }
            state @ RunState::Ending { .. } if matches!(why, Stop | JogEnded(_)) => {
                return (state, Vec::new());
            }
            RunState::Idle(_) => (None, E::default()),
            RunState::Run(_, _, run) => (Some(run), new),
            RunState::Ending { remainder, .. } => (None, remainder),
        };
        let ending = RunState::Ending {
            epoch,
            why,
            from,
            remainder,
        };
        (ending, vec![RunAction::End { why, epoch, run }])
    }

    /// Asserts the invariants of the state in debug builds.
    pub fn assert_invariants(&self) {
        if !cfg!(debug_assertions) {
            return;
        }
        let is_end = |execution| {
            matches!(
                execution,
                Execution::Ready | Execution::Stopped | Execution::ProgramCompleted
            )
        };
        match self {
            RunState::Idle((execution, reason)) => {
                assert!(is_end(*execution), "{execution:?} without a run");
                let is_stopped = *execution == Execution::Stopped;
                assert_eq!(is_stopped, reason.is_some(), "{execution:?} with {reason:?}");
            }
            RunState::Run(_, progress, _) => {
                let (phase, awaited) = (&progress.phase, progress.awaited);
                let may_await = matches!(phase, Phase::Reset { .. } | Phase::Room(_) | Phase::LastOutputs);
                assert!(may_await || awaited.is_none(), "{phase:?} awaits {awaited:?}");
                let (execution, _) = self.state_word();
                assert!(!is_end(execution), "{execution:?} in a run");
            }
            RunState::Ending { why, .. } => {
                let (execution, _) = why.at_rest();
                assert!(is_end(execution), "{why:?} ends with {execution:?}");
            }
        }
    }

    fn report_unexpected(&self, event: RunEvent<R, E>) -> RunAction<R, E> {
        let (execution, reason) = self.state_word();
        let words = [
            Some(wire_name(&execution)),
            reason.as_ref().map(wire_name),
            self.transition().as_ref().map(wire_name),
        ];
        let words: Vec<_> = words.into_iter().flatten().collect();
        RunAction::ReportUnexpected {
            text: format!(
                "the state {} does not expect the event: {}",
                words.join(" "),
                event.name()
            ),
            run: match event {
                RunEvent::Started { run, .. } => Some(run),
                _ => None,
            },
        }
    }
}

impl<R, E> RunEvent<R, E> {
    /// Returns the name of the event for the journal.
    fn name(&self) -> &'static str {
        match self {
            RunEvent::Loaded => "a program was loaded",
            RunEvent::Started { .. } => "a run has begun",
            RunEvent::Hold(_) => "hold the motion",
            RunEvent::Resume => "resume the run",
            RunEvent::BackTrace { .. } => "start a back trace",
            RunEvent::End { .. } => "end the run early",
            RunEvent::Phase(_) => "the preparation has reached a phase",
            RunEvent::Awaited(_) => "the run waits for an output",
            RunEvent::Passed { .. } => "the servo has passed a segment",
            RunEvent::ServoHeld { .. } => "the motion rests under a hold",
            RunEvent::BlockEnded => "a block has ended in single block",
            RunEvent::AtRest { .. } => "the machine rests after a stop",
            RunEvent::Completed(_) => "the run is completed",
        }
    }
}

impl Progress {
    fn on<R, E>(
        mut self,
        hold: Hold,
        event: RunEvent<R, E>,
        run: R,
    ) -> (RunState<R, E>, Vec<RunAction<R, E>>) {
        let mut actions = Vec::new();
        let is_paused = self.is_paused();
        let hold = match (hold, event) {
            (Hold::Off, RunEvent::Hold(cause)) if !is_paused => {
                let in_phase = cause.acts_in_thread();
                actions.push(RunAction::HoldServo { in_phase });
                Hold::Begun(cause)
            }
            // the first hold waits for the end of a thread; this one acts at once
            (Hold::Begun(before), RunEvent::Hold(cause))
                if cause.acts_in_thread() && !before.acts_in_thread() =>
            {
                actions.push(RunAction::HoldServo { in_phase: true });
                Hold::Begun(cause)
            }
            (Hold::Off, RunEvent::Passed { segment }) if !is_paused && self.back_to == Some(segment) => {
                actions.push(RunAction::HoldServo { in_phase: false });
                Hold::Begun(Cause::WayBackEnded)
            }
            (Hold::Off, RunEvent::ServoHeld { behind_block: true } | RunEvent::BlockEnded) if !is_paused => {
                Hold::AtRest(Cause::SingleBlock)
            }
            // Single block was switched off after the servo had begun the hold at the end of the block.
            (Hold::Off, RunEvent::ServoHeld { .. }) => {
                actions.push(RunAction::ResumeServo);
                Hold::Off
            }
            (Hold::Begun(cause), RunEvent::ServoHeld { .. }) => Hold::AtRest(cause),
            (Hold::Begun(_) | Hold::AtRest(_), RunEvent::BlockEnded) => Hold::AtRest(Cause::SingleBlock),
            (Hold::AtRest(_), RunEvent::BackTrace { to }) => {
                self.back_to = Some(to);
                actions.push(RunAction::ResumeServo);
                Hold::Off
            }
            (Hold::Off | Hold::AtRest(_), RunEvent::Resume) => {
                self.resume(hold, &mut actions);
                Hold::Off
            }
            (_, RunEvent::Completed(outcome)) => {
                actions.push(RunAction::Complete { run, outcome });
                return (RunState::Idle((outcome, None)), actions);
            }
            (hold, RunEvent::Phase(phase)) => {
                (self.phase, self.awaited) = (phase, None);
                hold
            }
            (hold, RunEvent::Awaited(awaited)) => {
                self.awaited = awaited;
                hold
            }
            // The run already rests, or an earlier hold acts. A segment matters only at the end of a back trace. A block
            // may have ended at rest before the servo reports its hold.
            (hold, RunEvent::Hold(_) | RunEvent::Passed { .. })
            | (hold @ Hold::AtRest(_), RunEvent::ServoHeld { .. }) => hold,
            (hold, event) => {
                let state = RunState::Run(hold, self, run);
                let action = state.report_unexpected(event);
                return (state, vec![action]);
            }
        };
        (RunState::Run(hold, self, run), actions)
    }

    /// Continues the run after a program stop or a hold.
    fn resume<R, E>(&mut self, hold: Hold, actions: &mut Vec<RunAction<R, E>>) {
        if self.back_to.is_some() && hold != Hold::Off {
            self.back_to = None;
            actions.push(RunAction::GoForward);
        }
        if self.is_paused() {
            self.phase = Phase::Interpret;
            actions.push(RunAction::BeginBlock);
        }
        if hold != Hold::Off {
            actions.extend([RunAction::ResumeServo, RunAction::GoOn]);
        }
    }
}

#[cfg(test)]
mod tests;
