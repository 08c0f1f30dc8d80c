//! Variable levels of topics.

use crate::types::command::Command;

/// A level of a topic for which the sender gives a value.
#[derive(Debug, Clone, Copy)]
pub struct TopicLevel {
    /// Name in the pattern of the topic.
    pub name: &'static str,
    /// Description, with the range of the values.
    pub description: &'static str,
    /// Some of the values.
    pub examples: &'static [&'static str],
    /// All values; empty if their number is not limited.
    pub values: &'static [&'static str],
}

impl TopicLevel {
    const fn new(name: &'static str, description: &'static str, examples: &'static [&'static str]) -> Self {
        Self {
            name,
            description,
            examples,
            values: &[],
        }
    }

    const fn one_of(mut self, values: &'static [&'static str]) -> Self {
        self.values = values;
        self
    }
}

/// All variable levels. A topic whose pattern has another one does not pass the tests.
pub const TOPIC_LEVELS: [TopicLevel; 9] = [
    TopicLevel::new("cs", "Number of the coordinate system, from 1.", &["1", "2"]),
    TopicLevel::new(
        "m",
        "Number of the M code, 0 to 191, without leading zeros.",
        &["6", "12", "100"],
    ),
    TopicLevel::new(
        "id",
        "Name of the sender: 1 to 64 characters without / + #; a program always uses one name.",
        &["changer", "panel"],
    ),
    TopicLevel::new(
        "client_id",
        "The client_id of the command that is answered: 1 to 64 characters without / + #.",
        &["panel"],
    ),
    TopicLevel::new(
        "name",
        "Its name in the configuration: 1 to 64 characters without / + #.",
        &["door_closed", "coolant_valve"],
    ),
    TopicLevel::new("side", "Selects inputs or outputs of the plant.", &["in", "out"]).one_of(&["in", "out"]),
    TopicLevel::new("number", "Number of the CNC motor, from 1.", &["1"]),
    TopicLevel::new("verb", "The command.", &["load", "start", "hold"]).one_of(&Command::VERBS),
    TopicLevel::new("input", "Name of the input.", &["optional_skip", "interlock"]).one_of(&[
        "optional_skip",
        "optional_stop",
        "single_block",
        "dry_run",
        "interlock",
        "start_lock",
    ]),
];
