//! The command table, which contains the commands that each state allows. The runtime and
//! [`FakePort`](crate::fake::FakePort) share the table.

use crate::types::command::Verb;
use crate::types::request::{Refusal, RefusalCode};
use crate::types::state::Execution;

/// The state of a coordinate system that determines which commands are allowed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Situation {
    /// The state word of the coordinate system.
    pub execution: Execution,
    /// True if a program has been loaded.
    pub program_loaded: bool,
    /// True while an alarm of the coordinate system, or of the whole machine, is active.
    pub alarm_active: bool,
}

const VERBS: [Verb; 13] = [
    Verb::Load,
    Verb::Start,
    Verb::Run,
    Verb::Hold,
    Verb::Resume,
    Verb::BackTrace,
    Verb::Stop,
    Verb::Abort,
    Verb::Reset,
    Verb::AlarmAcknowledge,
    Verb::Mdi,
    Verb::Jog,
    Verb::Home,
];

impl Situation {
    /// Returns true if this situation allows the command.
    pub fn allows(self, verb: Verb) -> bool {
        use Execution::{
            Active, FeedHold, Interrupted, OptionalStop, ProgramCompleted, ProgramStopped, Ready, Stopped,
        };
        match verb {
            Verb::Hold | Verb::Stop | Verb::Abort | Verb::AlarmAcknowledge => true,
            Verb::Load | Verb::Run | Verb::Mdi | Verb::Jog | Verb::Home => {
                matches!(self.execution, Ready | ProgramCompleted)
                    || self.execution == Stopped && !self.alarm_active
            }
            Verb::Start => matches!(self.execution, Ready | ProgramCompleted) && self.program_loaded,
            Verb::Resume => {
                matches!(
                    self.execution,
                    FeedHold | ProgramStopped | OptionalStop | Interrupted
                )
            }
            Verb::BackTrace => self.execution == FeedHold,
            Verb::Reset => self.execution != Active,
        }
    }

    /// Returns all commands that this situation allows.
    pub fn allowed(self) -> Vec<Verb> {
        VERBS.into_iter().filter(|verb| self.allows(*verb)).collect()
    }

    /// Refuses a command that this situation does not allow.
    ///
    /// # Errors
    /// Fails with `not_allowed`, with the state and the commands that are allowed in this state.
    pub fn check_allowed(self, verb: Verb) -> Result<(), Refusal> {
        if self.allows(verb) {
            return Ok(());
        }
        let (verb_word, state_word) = (wire_name(&verb), wire_name(&self.execution));
        let advice = match (verb, self.execution) {
            (Verb::Reset, _) => "hold or stop first",
            (Verb::Load | Verb::Run | Verb::Mdi | Verb::Jog | Verb::Home, Execution::Stopped) => {
                "an alarm is active; reset first"
            }
            (Verb::Start, Execution::Stopped) if self.program_loaded => "reset first",
            (Verb::Start, Execution::Stopped | Execution::Ready) => "load a program first",
            (Verb::Start, Execution::FeedHold | Execution::ProgramStopped | Execution::OptionalStop) => {
                "resume, or reset to start from the beginning"
            }
            (Verb::BackTrace, _) => "hold first",
            (Verb::Resume, _) => "there is nothing to resume",
            _ => "wait until the program ends, or stop it",
        };
        let text = format!("{verb_word} is not allowed in {state_word}: {advice}");
        Err(Refusal {
            state: Some(self.execution),
            allowed: self.allowed(),
            ..Refusal::new(RefusalCode::NotAllowed, text)
        })
    }
}

/// Returns the word that messages use for an enum value, such as `FEED_HOLD`; empty if the value has fields.
pub fn wire_name(value: &impl serde::Serialize) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(name)) => name,
        _ => String::new(),
    }
}

/// Returns the same word as [`wire_name`], which replaces this function.
#[deprecated(since = "0.2.0", note = "renamed to `wire_name`")]
pub fn word(value: &impl serde::Serialize) -> String {
    wire_name(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn allowed(execution: Execution, program_loaded: bool, alarm_active: bool) -> Vec<Verb> {
        let mut verbs = Situation {
            execution,
            program_loaded,
            alarm_active,
        }
        .allowed();
        verbs.retain(|verb| {
            !matches!(
                verb,
                Verb::Hold | Verb::Stop | Verb::Abort | Verb::AlarmAcknowledge
            )
        });
        verbs
    }

    #[test]
    fn each_command_is_allowed_in_the_states_of_its_row_and_no_other() {
        use Execution::*;
        use Verb::{BackTrace, Home, Jog, Load, Mdi, Reset, Resume, Run, Start};
        for idle in [Ready, ProgramCompleted] {
            assert_eq!(
                allowed(idle, true, false),
                [Load, Start, Run, Reset, Mdi, Jog, Home]
            );
        }
        assert_eq!(allowed(Active, true, false), []);
        assert_eq!(allowed(Wait, true, false), [Reset]);
        assert_eq!(allowed(FeedHold, true, false), [Resume, BackTrace, Reset]);
        for paused in [ProgramStopped, OptionalStop, Interrupted] {
            assert_eq!(allowed(paused, true, false), [Resume, Reset]);
        }
        assert_eq!(allowed(Stopped, true, false), [Load, Run, Reset, Mdi, Jog, Home]);
        assert_eq!(allowed(Stopped, true, true), [Reset]);
        assert_eq!(allowed(Ready, false, false), [Load, Run, Reset, Mdi, Jog, Home]);
    }

    #[test]
    fn hold_stop_and_abort_are_allowed_in_every_state() {
        for execution in [
            Execution::Active,
            Execution::Stopped,
            Execution::Wait,
            Execution::Ready,
        ] {
            let situation = Situation {
                execution,
                program_loaded: false,
                alarm_active: true,
            };
            assert!(
                [Verb::Hold, Verb::Stop, Verb::Abort]
                    .into_iter()
                    .all(|verb| situation.allows(verb))
            );
        }
    }

    #[test]
    fn a_refusal_names_the_state_and_what_is_allowed() {
        let situation = Situation {
            execution: Execution::Active,
            program_loaded: true,
            alarm_active: false,
        };
        let refusal = situation.check_allowed(Verb::Start).unwrap_err();
        assert_eq!(refusal.state, Some(Execution::Active));
        assert!(
            refusal.text.contains("start is not allowed in ACTIVE"),
            "{}",
            refusal.text
        );
        assert!(refusal.allowed.contains(&Verb::Stop));
    }
}
