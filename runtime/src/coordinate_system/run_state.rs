//! State machine of a run. Pure: it receives events, and returns the next state and the actions to perform. State word,
//! reason and transition are functions of the state alone.

use plc_api::types::output::CancelReason;
use plc_api::types::state::{Execution, Reason, Transition};
use tandem_model::flow::{Output, ProgramStop};
use tandem_model::{Alarm, Origin};

/// State word and reason.
pub(super) type StateWord = (Execution, Option<Reason>);

/// State of a coordinate system: idle, running or ending a run.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum RunState {
    /// No run is active; the state word describes the end of the last run.
    Idle(StateWord),
    /// A run is active.
    Run(Hold, Progress),
    /// A run was ended early, and the machine has not stopped yet.
    Ending {
        /// Epoch with which the servo reports the rest.
        epoch: u32,
        why: EarlyEndCause,
        /// State word and reason that are published until the machine rests.
        from: StateWord,
    },
}

/// Hold of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Hold {
    /// No hold: the run proceeds, or waits for an output or at a program stop.
    Off,
    /// The motion decelerates on its path because of a hold.
    Begun(Cause),
    /// The motion rests because of a hold.
    AtRest(Cause),
}

/// Next step of an active run, and the output for which it waits.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Progress {
    phase: Phase,
    /// Open output whose reset the program needs before it continues.
    awaited: Option<AwaitedOutput>,
    /// Last segment of the backward motion; `None` except during a back trace.
    back_to: Option<u64>,
}

/// Open output for which the program waits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct AwaitedOutput {
    pub seq: u64,
    /// True if the handler that had claimed the output is lost.
    pub is_lost: bool,
}

/// Next step of a run, or the event for which the run waits.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Phase {
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
pub(super) enum Then {
    Interpret,
    /// Ends a block in single block.
    BlockEnd,
    Output(Output),
    Stop(ProgramStop),
    Alarm(Alarm),
    End(Origin),
}

/// Cause of a hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Cause {
    /// The hold command.
    Operator,
    SingleBlock,
    Interlock,
    /// Loss of the connection to the MQTT broker.
    BusLoss,
    /// Late servo thread while motors moved.
    ServoLate,
    /// Loss of a watched client: no heartbeat within its interval.
    ClientLost,
    /// End of the path of a back trace.
    WayBackEnded,
}

/// Cause of an early end of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum EarlyEndCause {
    /// The stop command.
    Stop,
    /// The abort command.
    Abort,
    /// The reset command.
    Reset {
        /// True if a program is loaded.
        has_program: bool,
    },
    Alarm,
    /// Early end of a jog, after which the state is READY.
    JogEnded(JogStop),
}

/// Cause of the early end of a jog.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum JogStop {
    /// The client of the jog has commanded its end.
    Commanded,
    /// No refresh arrived within its time limit.
    NotRefreshed,
    /// A cause that holds other runs. A jog is ended instead, because it must never continue without a new command.
    Held(Cause),
}

impl EarlyEndCause {
    /// Returns the reason with which the outputs of the run are cancelled.
    pub fn cancel_reason(self) -> CancelReason {
        match self {
            EarlyEndCause::Stop => CancelReason::Stop,
            EarlyEndCause::Abort | EarlyEndCause::JogEnded(_) => CancelReason::Abort,
            EarlyEndCause::Reset { .. } => CancelReason::Reset,
            EarlyEndCause::Alarm => CancelReason::Alarm,
        }
    }

    /// Returns the state word and reason after the machine has come to rest.
    pub fn at_rest(self) -> StateWord {
        match self {
            EarlyEndCause::Stop => (Execution::Stopped, Some(Reason::Stop)),
            EarlyEndCause::Abort => (Execution::Stopped, Some(Reason::Aborted)),
            EarlyEndCause::Alarm => (Execution::Stopped, Some(Reason::Alarm)),
            EarlyEndCause::Reset { has_program: false } => (Execution::Stopped, Some(Reason::NoProgram)),
            EarlyEndCause::Reset { has_program: true } | EarlyEndCause::JogEnded(_) => {
                (Execution::Ready, None)
            }
        }
    }

    /// Returns true if each motor brakes at its maximum acceleration; false if the motion stops on its path.
    pub fn is_abort(self) -> bool {
        self.cancel_reason() == CancelReason::Abort
    }

    fn transition(self) -> Transition {
        match self {
            EarlyEndCause::Reset { .. } => Transition::Resetting,
            _ => Transition::Stopping,
        }
    }
}

/// Event that changes the state of a run.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum RunEvent {
    /// A program was loaded.
    Loaded,
    /// A run has begun in this phase.
    Started(Phase),
    /// The motion must be held for this cause.
    Hold(Cause),
    /// The run continues: the command resume, or the command that ends a back trace.
    Resume,
    /// A back trace starts and ends at the end of segment `to`.
    BackTrace { to: u64 },
    /// The run must end early. The servo reports the rest with `epoch`.
    End { why: EarlyEndCause, epoch: u32 },
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
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum RunAction {
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
    /// Cancels the outputs and stops the machine with this epoch.
    End { why: EarlyEndCause, epoch: u32 },
    /// Completes the early end of the run, because the machine rests.
    Ended(EarlyEndCause),
}

impl Cause {
    /// Returns true if this cause stops the motion even in a thread (tapping). The operator's hold waits until the tool
    /// has left the thread, as the manual demands.
    pub fn acts_in_thread(self) -> bool {
        matches!(
            self,
            Cause::Interlock | Cause::BusLoss | Cause::ServoLate | Cause::ClientLost
        )
    }

    /// Returns the state word and reason while the motion rests for this cause.
    fn state_word(self) -> StateWord {
        match self {
            Cause::Operator => (Execution::FeedHold, None),
            Cause::SingleBlock => (Execution::Interrupted, Some(Reason::SingleBlock)),
            Cause::BusLoss => (Execution::FeedHold, Some(Reason::BusLost)),
            Cause::ServoLate => (Execution::FeedHold, Some(Reason::ServoLate)),
            Cause::ClientLost => (Execution::FeedHold, Some(Reason::ClientLost)),
            Cause::Interlock => (Execution::Interrupted, Some(Reason::Interlock)),
            Cause::WayBackEnded => (Execution::FeedHold, Some(Reason::BackTraceEnd)),
        }
    }
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

impl Default for RunState {
    /// Returns the state of a coordinate system without a loaded program.
    fn default() -> Self {
        Self::Idle((Execution::Stopped, Some(Reason::NoProgram)))
    }
}

impl RunState {
    /// Returns the state word and reason.
    pub fn state_word(&self) -> StateWord {
        match self {
            RunState::Idle(word) => *word,
            RunState::Run(Hold::AtRest(cause), progress) => {
                let (execution, reason) = cause.state_word();
                (execution, reason.or(progress.back()))
            }
            RunState::Run(_, progress) => progress.state_word(),
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
            RunState::Run(Hold::Begun(_), _) => Some(Transition::Holding),
            RunState::Ending { why, .. } => Some(why.transition()),
            _ => None,
        }
    }

    fn progress(&self) -> Option<&Progress> {
        match self {
            RunState::Run(_, progress) => Some(progress),
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

    /// Returns true while a run is ending.
    pub fn is_ending(&self) -> bool {
        matches!(self, RunState::Ending { .. })
    }

    /// Returns true while no hold or stop prevents the run from proceeding.
    pub fn is_running(&self) -> bool {
        matches!(self, RunState::Run(Hold::Off, _))
    }

    /// Returns true while a hold is active that stops the motion even in a thread (tapping).
    pub fn holds_in_thread(&self) -> bool {
        let Self::Run(Hold::Begun(cause) | Hold::AtRest(cause), _) = self else {
            return false;
        };
        cause.acts_in_thread()
    }

    /// Takes the action that follows a standstill. Afterwards the phase is [`Phase::Interpret`].
    pub fn take_then(&mut self) -> Option<Then> {
        let RunState::Run(_, Progress { phase, .. }) = self else {
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

    /// Returns the state after an event, and the actions to perform in order.
    pub fn on(self, event: RunEvent) -> (Self, Vec<RunAction>) {
        let state = match (self, event) {
            (RunState::Idle(_), RunEvent::Loaded) => RunState::Idle((Execution::Ready, None)),
            (RunState::Idle(_), RunEvent::Started(phase)) => RunState::Run(Hold::Off, Progress::new(phase)),
            (RunState::Ending { epoch, why, .. }, RunEvent::AtRest { epoch: at }) if epoch == at => {
                return (RunState::Idle(why.at_rest()), vec![RunAction::Ended(why)]);
            }
            // without a run a stop has no effect, and a stop that is in progress is not started again
            (
                state @ RunState::Idle(_),
                RunEvent::End {
                    why: EarlyEndCause::Stop | EarlyEndCause::Abort | EarlyEndCause::JogEnded(_),
                    ..
                },
            )
            | (
                state @ RunState::Ending { .. },
                RunEvent::End {
                    why: EarlyEndCause::Stop | EarlyEndCause::JogEnded(_),
                    ..
                },
            ) => state,
            (state, RunEvent::End { why, epoch }) => {
                let from = state.state_word();
                let ending = RunState::Ending { epoch, why, from };
                return (ending, vec![RunAction::End { why, epoch }]);
            }
            (RunState::Run(hold, progress), event) => return progress.on(hold, event),
            (state, _) => state,
        };
        (state, Vec::new())
    }
}

impl Progress {
    fn on(mut self, hold: Hold, event: RunEvent) -> (RunState, Vec<RunAction>) {
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
                if self.back_to.is_some() && hold != Hold::Off {
                    self.back_to = None;
                    actions.push(RunAction::GoForward);
                }
                if is_paused {
                    self.phase = Phase::Interpret;
                    actions.push(RunAction::BeginBlock);
                }
                if hold != Hold::Off {
                    actions.extend([RunAction::ResumeServo, RunAction::GoOn]);
                }
                Hold::Off
            }
            (_, RunEvent::Completed(into)) => return (RunState::Idle((into, None)), actions),
            (hold, RunEvent::Phase(phase)) => {
                (self.phase, self.awaited) = (phase, None);
                hold
            }
            (hold, RunEvent::Awaited(awaited)) => {
                self.awaited = awaited;
                hold
            }
            (hold, _) => hold,
        };
        (RunState::Run(hold, self), actions)
    }
}

#[cfg(test)]
mod tests;
