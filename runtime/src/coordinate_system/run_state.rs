//! The state of a run, pure: events come in, the next state and what is to be done come out. State word, reason and
//! transition are functions of the state alone.

use plc_api::types::output::CancelReason;
use plc_api::types::state::{Execution, Reason, Transition};
use tandem_model::flow::{Output, ProgramStop};
use tandem_model::{Alarm, Origin};

/// State word and reason.
pub(super) type StateWord = (Execution, Option<Reason>);

/// Where a coordinate system is between one run and the next.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum RunState {
    /// There is no run.
    Idle(StateWord),
    /// A run goes on by itself, or waits for an output or at a program stop.
    Running(Progress),
    /// The motion of a run decelerates on the path.
    Holding(Cause, Progress),
    /// A run rests under a hold.
    Held(Cause, Progress),
    /// A run has been ended, and the machine comes to rest.
    Ending(Ending),
}

/// How far a run is.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Progress {
    phase: Phase,
    /// The output whose reset the program needs before anything else happens.
    awaited: Option<Awaited>,
    /// On the way back of a back trace: the segment that it ends with.
    back_to: Option<u64>,
}

/// An open output that the program waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Awaited {
    pub seq: u64,
    /// The handler that had claimed it has gone.
    pub is_lost: bool,
}

/// What a run does, or waits for, next.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Phase {
    /// The interpreter is asked for the next item.
    Interpret,
    /// All motion so far must be finished, in position, and not held; then this.
    Standstill(Then),
    /// An `after_motion` output was made, and is to be reset.
    Reset { seq: u64 },
    /// An output whose M number is still open (D32), or for which the ledger has no room.
    Room(Output),
    /// M00, or M01 with the optional stop on.
    Paused(ProgramStop),
    /// M02, M30: outputs of the run may still be open.
    LastOutputs,
}

/// What follows a standstill.
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

/// What holds a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Cause {
    /// The hold command.
    Operator,
    SingleBlock,
    Interlock,
    /// The connection to the MQTT broker is lost.
    BusLoss,
    /// Back trace has come to its end.
    WayBackEnded,
}

/// A run that is being ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ending {
    /// The servo's epoch that begins at rest.
    epoch: u32,
    why: End,
    /// State word and reason until then.
    from: StateWord,
}

/// Why a run is ended before its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum End {
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
    /// A jog was not refreshed.
    JogExpired,
}

impl End {
    /// What the outputs are told.
    pub fn cancel_reason(self) -> CancelReason {
        match self {
            End::Stop => CancelReason::Stop,
            End::Abort | End::JogExpired => CancelReason::Abort,
            End::Reset { .. } => CancelReason::Reset,
            End::Alarm => CancelReason::Alarm,
        }
    }

    /// State word and reason at rest.
    pub fn into(self) -> StateWord {
        match self {
            End::Stop => (Execution::Stopped, Some(Reason::Stop)),
            End::Abort => (Execution::Stopped, Some(Reason::Aborted)),
            End::Alarm => (Execution::Stopped, Some(Reason::Alarm)),
            End::Reset { has_program: false } => (Execution::Stopped, Some(Reason::NoProgram)),
            End::Reset { has_program: true } | End::JogExpired => (Execution::Ready, None),
        }
    }

    /// True: each motor brakes at its maximum acceleration; false: the motion comes to rest on its path.
    pub fn is_abort(self) -> bool {
        self.cancel_reason() == CancelReason::Abort
    }

    fn transition(self) -> Transition {
        match self {
            End::Reset { .. } => Transition::Resetting,
            _ => Transition::Stopping,
        }
    }
}

/// What changes the state.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum RunEvent {
    /// A program was loaded.
    Loaded,
    /// A run begins.
    Started(Phase),
    /// It is to rest, by a command or another cause.
    Hold(Cause),
    /// The resume command, or the end of back trace by command.
    Resume,
    /// Back along the path, to the end of this segment.
    BackTrace { to: u64 },
    /// It is to be ended before its end; the servo rests with this epoch.
    End { why: End, epoch: u32 },
    /// Preparation has come to this.
    Phase(Phase),
    /// This is the output that the phase waits for.
    Awaited(Option<Awaited>),
    /// The servo has passed the end of a segment.
    Passed { segment: u64 },
    /// The servo rests under a hold; `behind_block`: that it was told to make behind a block, for single block.
    ServoHeld { behind_block: bool },
    /// Single block: a block has ended at rest.
    BlockEnded,
    /// The servo rests after a stop.
    AtRest { epoch: u32 },
    /// The run has come to its end.
    Completed(Execution),
}

/// What is to be done, in order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum RunAction {
    /// The servo holds on the path.
    HoldServo,
    /// The servo goes on.
    ResumeServo,
    /// The motion turns round: forward again, from where it is.
    GoForward,
    /// What the hold kept back is done.
    GoOn,
    /// Single block counts from the next block on.
    BeginBlock,
    /// Outputs are cancelled, the machine comes to rest with this epoch.
    End { why: End, epoch: u32 },
    /// The machine rests after that.
    Ended(End),
}

impl Cause {
    /// State word and reason at rest.
    fn word(self) -> StateWord {
        match self {
            Cause::Operator => (Execution::FeedHold, None),
            Cause::SingleBlock => (Execution::Interrupted, Some(Reason::SingleBlock)),
            Cause::BusLoss => (Execution::FeedHold, Some(Reason::BusLost)),
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

    /// `ACTIVE`, `BACK_TRACE` while it goes back.
    fn back(&self) -> Option<Reason> {
        self.back_to.map(|_| Reason::BackTrace)
    }

    fn is_paused(&self) -> bool {
        matches!(self.phase, Phase::Paused(_))
    }

    /// State word and reason while the run is not at rest under a hold.
    fn word(&self) -> StateWord {
        match (&self.phase, self.awaited) {
            (Phase::Paused(stop), _) if stop.optional => (Execution::OptionalStop, None),
            (Phase::Paused(_), _) => (Execution::ProgramStopped, None),
            (_, Some(awaited)) => (Execution::Wait, awaited.is_lost.then_some(Reason::HandlerLost)),
            (_, None) => (Execution::Active, self.back()),
        }
    }
}

impl Default for RunState {
    /// Without a program.
    fn default() -> Self {
        Self::Idle((Execution::Stopped, Some(Reason::NoProgram)))
    }
}

impl RunState {
    /// State word and reason.
    pub fn word(&self) -> StateWord {
        match self {
            RunState::Idle(word) => *word,
            RunState::Running(progress) | RunState::Holding(_, progress) => progress.word(),
            RunState::Held(cause, progress) => {
                let (execution, reason) = cause.word();
                (execution, reason.or(progress.back()))
            }
            RunState::Ending(ending) => ending.from,
        }
    }

    /// State word and reason by which commands are judged: of a run that is being ended those at rest.
    pub fn word_at_rest(&self) -> StateWord {
        match self {
            RunState::Ending(ending) => ending.why.into(),
            _ => self.word(),
        }
    }

    /// What it is on its way to, if it is not where its word says for good.
    pub fn transition(&self) -> Option<Transition> {
        match self {
            RunState::Holding(..) => Some(Transition::Holding),
            RunState::Ending(ending) => Some(ending.why.transition()),
            RunState::Idle(_) | RunState::Running(_) | RunState::Held(..) => None,
        }
    }

    fn progress(&self) -> Option<&Progress> {
        match self {
            RunState::Running(progress) | RunState::Holding(_, progress) | RunState::Held(_, progress) => {
                Some(progress)
            }
            RunState::Idle(_) | RunState::Ending(_) => None,
        }
    }

    fn progress_mut(&mut self) -> Option<&mut Progress> {
        match self {
            RunState::Running(progress) | RunState::Holding(_, progress) | RunState::Held(_, progress) => {
                Some(progress)
            }
            RunState::Idle(_) | RunState::Ending(_) => None,
        }
    }

    /// What the run does next; `None`: there is none.
    pub fn phase(&self) -> Option<&Phase> {
        self.progress().map(|progress| &progress.phase)
    }

    /// The output whose reset the program needs before anything else happens.
    pub fn awaited(&self) -> Option<Awaited> {
        self.progress()?.awaited
    }

    /// True from the begin of a back trace until the motion goes forward again.
    pub fn retraces(&self) -> bool {
        self.progress().is_some_and(|progress| progress.back_to.is_some())
    }

    /// True when there is no run, and none is being ended.
    pub fn is_idle(&self) -> bool {
        matches!(self, RunState::Idle(_))
    }

    /// True while a run is being ended.
    pub fn is_ending(&self) -> bool {
        matches!(self, RunState::Ending(_))
    }

    /// True while nothing keeps the run from going on by itself.
    pub fn is_running(&self) -> bool {
        matches!(self, RunState::Running(_))
    }

    /// What follows a standstill that the run has come to; from here on it interprets.
    pub fn take_then(&mut self) -> Option<Then> {
        let progress = self.progress_mut()?;
        let Phase::Standstill(then) = &progress.phase else {
            return None;
        };
        let then = then.clone();
        progress.phase = Phase::Interpret;
        Some(then)
    }

    /// The state after an event, and what is to be done.
    pub fn on(self, event: RunEvent) -> (Self, Vec<RunAction>) {
        let unchanged = |state| (state, Vec::new());
        match (self, event) {
            (RunState::Idle(_), RunEvent::Loaded) => unchanged(RunState::Idle((Execution::Ready, None))),
            (RunState::Idle(_), RunEvent::Started(phase)) => {
                unchanged(RunState::Running(Progress::new(phase)))
            }
            (RunState::Ending(ending), RunEvent::AtRest { epoch }) if ending.epoch == epoch => {
                let state = RunState::Idle(ending.why.into());
                (state, vec![RunAction::Ended(ending.why)])
            }
            (state, RunEvent::End { why, epoch }) => state.end(why, epoch),
            (RunState::Running(progress), event) => progress.on_while_running(event),
            (RunState::Holding(cause, progress), RunEvent::ServoHeld { .. }) => {
                unchanged(RunState::Held(cause, progress))
            }
            (RunState::Held(_, mut progress), RunEvent::Resume) => {
                let turns = progress.back_to.take().map(|_| RunAction::GoForward);
                let begins = progress.end_pause();
                let goes_on = [RunAction::ResumeServo, RunAction::GoOn];
                let actions = turns.into_iter().chain(begins).chain(goes_on);
                (RunState::Running(progress), actions.collect())
            }
            (RunState::Held(_, mut progress), RunEvent::BackTrace { to }) => {
                progress.back_to = Some(to);
                (RunState::Running(progress), vec![RunAction::ResumeServo])
            }
            (RunState::Holding(_, progress) | RunState::Held(_, progress), RunEvent::BlockEnded) => {
                unchanged(RunState::Held(Cause::SingleBlock, progress))
            }
            (RunState::Holding(..) | RunState::Held(..), RunEvent::Completed(into)) => {
                unchanged(RunState::Idle((into, None)))
            }
            (mut state, event) => {
                if let Some(progress) = state.progress_mut() {
                    progress.follow(event);
                }
                unchanged(state)
            }
        }
    }

    fn end(self, why: End, epoch: u32) -> (Self, Vec<RunAction>) {
        let is_without_effect = match (&self, why) {
            // without a run there is nothing to stop; a stop under way is not begun anew
            (RunState::Idle(_), End::Stop | End::Abort | End::JogExpired)
            | (RunState::Ending(_), End::Stop | End::JogExpired) => true,
            _ => false,
        };
        if is_without_effect {
            return (self, Vec::new());
        }
        let from = self.word();
        let ending = Ending { epoch, why, from };
        (RunState::Ending(ending), vec![RunAction::End { why, epoch }])
    }
}

impl Progress {
    fn on_while_running(mut self, event: RunEvent) -> (RunState, Vec<RunAction>) {
        match event {
            RunEvent::Hold(cause) if !self.is_paused() => {
                (RunState::Holding(cause, self), vec![RunAction::HoldServo])
            }
            RunEvent::Passed { segment } if self.back_to == Some(segment) => {
                self.on_while_running(RunEvent::Hold(Cause::WayBackEnded))
            }
            RunEvent::Resume => {
                let actions = self.end_pause().into_iter().collect();
                (RunState::Running(self), actions)
            }
            RunEvent::ServoHeld { behind_block: true } | RunEvent::BlockEnded if !self.is_paused() => {
                (RunState::Held(Cause::SingleBlock, self), Vec::new())
            }
            // Single block was switched off when the hold behind the block had begun.
            RunEvent::ServoHeld { .. } => (RunState::Running(self), vec![RunAction::ResumeServo]),
            RunEvent::Completed(into) => (RunState::Idle((into, None)), Vec::new()),
            event => {
                self.follow(event);
                (RunState::Running(self), Vec::new())
            }
        }
    }

    /// Goes on behind M00 or M01.
    fn end_pause(&mut self) -> Option<RunAction> {
        if !self.is_paused() {
            return None;
        }
        self.phase = Phase::Interpret;
        Some(RunAction::BeginBlock)
    }

    /// What is the same whether the run is held or not.
    fn follow(&mut self, event: RunEvent) {
        match event {
            RunEvent::Phase(phase) => (self.phase, self.awaited) = (phase, None),
            RunEvent::Awaited(awaited) => self.awaited = awaited,
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests;
