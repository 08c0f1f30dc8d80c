//! Causes of holds and of early ends of a run.

use plc_protocol::types::output::CancelReason;
use plc_protocol::types::state::{Execution, Reason, Transition};

/// State word and reason.
pub(crate) type StateWord = (Execution, Option<Reason>);

/// Cause of a hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Cause {
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
pub(crate) enum EarlyEndCause {
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
pub(crate) enum JogStop {
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

    /// Returns the transition until the machine rests.
    pub fn transition(self) -> Transition {
        match self {
            EarlyEndCause::Reset { .. } => Transition::Resetting,
            _ => Transition::Stopping,
        }
    }
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
    pub fn state_word(self) -> StateWord {
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
