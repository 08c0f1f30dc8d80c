//! The active program of OPC 40501: its state and its transitions.

use std::collections::VecDeque;

use plc_protocol::types::state::{Execution, RunKind, State};

/// States of `ProductionProgramStateMachineType`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProgramState {
    Initializing,
    Running,
    Ended,
    Interrupted,
    Aborted,
}

use ProgramState::{Aborted, Ended, Initializing, Interrupted, Running};

impl ProgramState {
    pub const fn name(self) -> &'static str {
        match self {
            Initializing => "Initializing",
            Running => "Running",
            Ended => "Ended",
            Interrupted => "Interrupted",
            Aborted => "Aborted",
        }
    }

    /// Returns its `StateNumber`.
    pub const fn number(self) -> u32 {
        match self {
            Initializing => 0,
            Running => 1,
            Ended => 2,
            Interrupted => 3,
            Aborted => 4,
        }
    }

    /// Returns the identifier of its node in the namespace of machine tools.
    pub const fn node(self) -> u32 {
        match self {
            Initializing => 5039,
            Running => 5041,
            Ended => 5038,
            Interrupted => 5040,
            Aborted => 5037,
        }
    }

    /// Returns the program state for the state of a coordinate system. While axes are moved by hand, the program is at
    /// line 1.
    fn from_state(state: &State) -> Self {
        if state.run_kind.is_some_and(|kind| kind != RunKind::Program) {
            return Initializing;
        }
        match state.execution {
            Execution::Ready => Initializing,
            Execution::Active | Execution::Wait => Running,
            Execution::FeedHold
            | Execution::ProgramStopped
            | Execution::OptionalStop
            | Execution::Interrupted => Interrupted,
            Execution::ProgramCompleted => Ended,
            Execution::Stopped if state.program.is_none() => Initializing,
            Execution::Stopped => Aborted,
        }
    }
}

/// A transition of `ProductionProgramStateMachineType`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Transition {
    pub name: &'static str,
    /// Its `TransitionNumber`.
    pub number: u32,
    /// The identifier of its node in the namespace of machine tools.
    pub node: u32,
    pub from: ProgramState,
    pub to: ProgramState,
}

const fn new_transition(
    name: &'static str,
    number: u32,
    node: u32,
    from: ProgramState,
    to: ProgramState,
) -> Transition {
    Transition {
        name,
        number,
        node,
        from,
        to,
    }
}

/// All transitions between two states.
const TRANSITIONS: [Transition; 9] = [
    new_transition("InitializingToRunning", 0, 91, Initializing, Running),
    new_transition("RunningToEnded", 1, 92, Running, Ended),
    new_transition("EndedToInitializing", 2, 106, Ended, Initializing),
    new_transition("RunningToInterrupted", 4, 109, Running, Interrupted),
    new_transition("InterruptedToRunning", 5, 107, Interrupted, Running),
    new_transition("RunningToAborted", 6, 108, Running, Aborted),
    new_transition("InterruptedToAborted", 7, 105, Interrupted, Aborted),
    new_transition("AbortedToInitializing", 8, 102, Aborted, Initializing),
    new_transition("InitializingToAborted", 9, 104, Initializing, Aborted),
];

/// Returns the shortest sequence of transitions from one state to another.
fn find_path(from: ProgramState, to: ProgramState) -> Vec<Transition> {
    let mut ways = VecDeque::from([(from, Vec::new())]);
    while let Some((at, way)) = ways.pop_front() {
        if at == to {
            return way;
        }
        // no sequence is longer than the number of states
        if way.len() < TRANSITIONS.len() {
            for transition in TRANSITIONS.iter().filter(|transition| transition.from == at) {
                let longer = way.iter().copied().chain([*transition]).collect();
                ways.push_back((transition.to, longer));
            }
        }
    }
    Vec::new()
}

/// Known data of a program.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ProgramStatus {
    /// Program number; empty without a program.
    pub name: String,
    /// Run that the program belongs to; empty before the first run.
    pub job: String,
    pub state: ProgramState,
}

/// The active program.
#[derive(Debug, Default)]
pub struct ActiveProgram {
    known: Option<ProgramStatus>,
    last: Option<Transition>,
}

impl ActiveProgram {
    /// Applies a state and returns the transitions that led to it, in order. If states were missed, these are the
    /// fewest transitions from the previous state to this one.
    pub fn follow(&mut self, state: &State) -> Vec<Transition> {
        let known = ProgramStatus {
            name: state
                .program
                .map_or_else(String::new, |number| number.to_string()),
            job: state.run_id.clone().unwrap_or_default(),
            state: ProgramState::from_state(state),
        };
        let passed = self
            .known
            .as_ref()
            .map_or_else(Vec::new, |before| find_path(before.state, known.state));
        self.last = passed.last().copied().or(self.last);
        self.known = Some(known);
        passed
    }

    /// Returns the program; `None` before the first state.
    pub fn status(&self) -> Option<&ProgramStatus> {
        self.known.as_ref()
    }

    /// Returns the last transition; `None` before the first one.
    pub fn last(&self) -> Option<Transition> {
        self.last
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(execution: Execution) -> State {
        State {
            execution,
            program: Some(7),
            ..State::default()
        }
    }

    fn names(passed: &[Transition]) -> Vec<&'static str> {
        passed.iter().map(|transition| transition.name).collect()
    }

    #[test]
    fn each_state_reaches_each_other_by_transitions_that_join() {
        let all = [Initializing, Running, Ended, Interrupted, Aborted];
        for (from, to) in all.into_iter().flat_map(|from| all.map(|to| (from, to))) {
            let way = find_path(from, to);
            assert_eq!(way.is_empty(), from == to);
            assert!(way.is_empty() || (way[0].from, way[way.len() - 1].to) == (from, to));
            assert!(way.windows(2).all(|two| two[0].to == two[1].from));
            assert!(
                way.iter()
                    .all(|one| one.name == format!("{}To{}", one.from.name(), one.to.name()))
            );
        }
    }

    #[test]
    fn a_run_from_its_start_through_a_pause_to_its_end() {
        let mut program = ActiveProgram::default();
        assert_eq!(names(&program.follow(&state(Execution::Ready))), [""; 0]);
        assert_eq!(program.last(), None);
        for (execution, passed) in [
            (Execution::Active, vec!["InitializingToRunning"]),
            (Execution::Wait, vec![]),
            (Execution::ProgramStopped, vec!["RunningToInterrupted"]),
            (Execution::Active, vec!["InterruptedToRunning"]),
            (Execution::ProgramCompleted, vec!["RunningToEnded"]),
            (
                Execution::Active,
                vec!["EndedToInitializing", "InitializingToRunning"],
            ),
            (Execution::Stopped, vec!["RunningToAborted"]),
            (Execution::Ready, vec!["AbortedToInitializing"]),
        ] {
            assert_eq!(names(&program.follow(&state(execution))), passed);
        }
        assert_eq!(program.last().map(|last| last.number), Some(8));
    }

    #[test]
    fn axes_that_are_moved_by_hand_are_no_run_of_the_program() {
        let jogged = State {
            run_kind: Some(RunKind::Jog),
            ..state(Execution::Active)
        };
        let mut program = ActiveProgram::default();
        program.follow(&jogged);
        assert_eq!(program.status().map(|known| known.state), Some(Initializing));
    }
}
