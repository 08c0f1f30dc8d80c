//! State machine of a run, pure: it takes events and returns the next state and the actions to take. State word, reason
//! and transition are functions of the state alone.

use plc_api::types::output::CancelReason;
use plc_api::types::state::{Execution, Reason, Transition};
use tandem_model::flow::{Output, ProgramStop};
use tandem_model::{Alarm, Origin};

/// State word and reason.
pub(super) type StateWord = (Execution, Option<Reason>);

/// Progress of a coordinate system from one run to the next.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum RunState {
    /// There is no run.
    Idle(StateWord),
    /// A run is active.
    Run(Hold, Progress),
    /// A run was ended, and the machine is stopping.
    Ending {
        /// The servo's epoch that begins at rest.
        epoch: u32,
        why: EarlyEndCause,
        /// State word and reason until the machine rests.
        from: StateWord,
    },
}

/// Whether something holds a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Hold {
    /// The run proceeds, or waits for an output or at a program stop.
    Off,
    /// The motion decelerates on the path.
    Begun(Cause),
    /// The motion rests.
    AtRest(Cause),
}

/// Progress of a run.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Progress {
    phase: Phase,
    /// The output whose reset the program needs before anything else happens.
    awaited: Option<AwaitedOutput>,
    /// During a back trace: the segment with which it ends.
    back_to: Option<u64>,
}

/// An open output that the program waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct AwaitedOutput {
    pub seq: u64,
    /// The handler that had claimed it is lost.
    pub is_lost: bool,
}

/// Next step of a run, or the event that it waits for.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Phase {
    /// The interpreter is asked for the next item.
    Interpret,
    /// All motion so far must be finished, in position, and not held; then this action follows.
    Standstill(Then),
    /// An `after_motion` output was issued and waits for its reset.
    Reset { seq: u64 },
    /// An output whose M number is still pending (D32), or for which the ledger has no room.
    Room(Output),
    /// M00, or M01 with the optional stop on.
    Paused(ProgramStop),
    /// M02, M30: outputs of the run may still be pending.
    LastOutputs,
}

/// Action at a standstill.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Then {
    Interpret,
    /// Single block: the block has ended.
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
    /// The connection to the MQTT broker is lost.
    BusLoss,
    /// The servo thread was late while motors moved.
    ServoLate,
    /// No heartbeat of a watched client arrived within its interval.
    ClientLost,
    /// Back trace has reached its end.
    WayBackEnded,
}

/// Cause that ends a run early.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum EarlyEndCause {
    /// The stop command.
    Stop,
    /// The abort command.
    Abort,
    /// The reset command.
    Reset {
        /// A program is loaded.
        has_program: bool,
    },
    Alarm,
    /// A jog is ended while the machine stays ready.
    JogEnded(JogStop),
}

/// Why a jog is ended while the machine stays ready.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum JogStop {
    /// Its end was commanded.
    Commanded,
    /// No refresh arrived within its time limit.
    NotRefreshed,
    /// A cause that holds other runs. A jog is ended instead: it never continues without a new command.
    Held(Cause),
}

impl EarlyEndCause {
    /// Returns the reason with which its outputs are cancelled.
    pub fn cancel_reason(self) -> CancelReason {
        match self {
            EarlyEndCause::Stop => CancelReason::Stop,
            EarlyEndCause::Abort | EarlyEndCause::JogEnded(_) => CancelReason::Abort,
            EarlyEndCause::Reset { .. } => CancelReason::Reset,
            EarlyEndCause::Alarm => CancelReason::Alarm,
        }
    }

    /// Returns the state word and reason at rest.
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

    /// Returns true if each motor brakes at its maximum acceleration, false if the motion stops on its path.
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

/// Event that changes the state.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum RunEvent {
    /// A program was loaded.
    Loaded,
    /// A run begins.
    Started(Phase),
    /// The motion must stop.
    Hold(Cause),
    /// The resume command, or the end of back trace by command.
    Resume,
    /// The motion goes back along the path, to the end of this segment.
    BackTrace { to: u64 },
    /// The run must end early; the servo rests with this epoch.
    End { why: EarlyEndCause, epoch: u32 },
    /// Preparation has reached this phase.
    Phase(Phase),
    /// The phase waits for this output.
    Awaited(Option<AwaitedOutput>),
    /// The servo has passed the end of a segment.
    Passed { segment: u64 },
    /// The servo rests under a hold. `behind_block` is true for a hold at the end of a block, armed by single block.
    ServoHeld { behind_block: bool },
    /// Single block: a block has ended at rest.
    BlockEnded,
    /// The servo rests after a stop.
    AtRest { epoch: u32 },
    /// The run has reached its end.
    Completed(Execution),
}

/// Actions to take, in order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum RunAction {
    /// The servo holds on the path; `in_phase`: also in a thread.
    HoldServo { in_phase: bool },
    /// The servo continues.
    ResumeServo,
    /// The motion reverses and goes forward again from its current position.
    GoForward,
    /// Performs the actions that the hold has delayed.
    GoOn,
    /// Single block applies from the next block on.
    BeginBlock,
    /// Outputs are cancelled, and the machine stops with this epoch.
    End { why: EarlyEndCause, epoch: u32 },
    /// The machine rests after the end of the run.
    Ended(EarlyEndCause),
}

impl Cause {
    /// Returns true if the motion stops at once even in a thread. The operator's hold waits until the tool has left the
    /// thread, as the manual demands.
    pub fn acts_in_thread(self) -> bool {
        matches!(
            self,
            Cause::Interlock | Cause::BusLoss | Cause::ServoLate | Cause::ClientLost
        )
    }

    /// Returns the state word and reason at rest.
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

    /// Returns the reason during a back trace.
    fn back(&self) -> Option<Reason> {
        self.back_to.map(|_| Reason::BackTrace)
    }

    fn is_paused(&self) -> bool {
        matches!(self.phase, Phase::Paused(_))
    }

    /// Returns the state word and reason while the run does not rest under a hold.
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
    /// Returns the state without a program.
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

    /// Returns the state word and reason against which commands are validated: for a run that is ending, those at rest.
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

    /// Returns the next step of the run; `None` if no run is active.
    pub fn phase(&self) -> Option<&Phase> {
        self.progress().map(|progress| &progress.phase)
    }

    /// Returns the output whose reset the program needs before anything else happens.
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

    /// Returns true while a hold is active that stops the motion even in a thread.
    pub fn holds_in_thread(&self) -> bool {
        let Self::Run(Hold::Begun(cause) | Hold::AtRest(cause), _) = self else {
            return false;
        };
        cause.acts_in_thread()
    }

    /// Takes the action that follows the standstill reached by the run; afterwards the run interprets.
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

    /// Returns the state after an event, and the actions to take.
    pub fn on(self, event: RunEvent) -> (Self, Vec<RunAction>) {
        let state = match (self, event) {
            (RunState::Idle(_), RunEvent::Loaded) => RunState::Idle((Execution::Ready, None)),
            (RunState::Idle(_), RunEvent::Started(phase)) => RunState::Run(Hold::Off, Progress::new(phase)),
            (RunState::Ending { epoch, why, .. }, RunEvent::AtRest { epoch: at }) if epoch == at => {
                return (RunState::Idle(why.at_rest()), vec![RunAction::Ended(why)]);
            }
            // without a run there is nothing to stop; a stop in progress is not started again
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
            // a hold that waits for the end of a thread now acts at once
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
            // Single block was switched off after the hold at the end of the block had begun.
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
