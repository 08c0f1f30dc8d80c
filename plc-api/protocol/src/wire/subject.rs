//! Subjects by which documents group the routes.

/// Subject of a route.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Subject {
    /// Commands to a coordinate system, and its control lease.
    Commands,
    /// States and positions of a coordinate system.
    States,
    /// Outputs of M codes, and their handlers.
    MCodes,
    /// Values that clients write.
    Inputs,
    /// Programs of the store.
    Programs,
    /// Variables, tools and work offsets.
    Values,
    /// Alarms and the journal.
    Alarms,
    /// The machine as a whole.
    Machine,
}

impl Subject {
    /// All subjects, in the order of the documents.
    pub const ALL: [Subject; 8] = [
        Subject::Commands,
        Subject::States,
        Subject::MCodes,
        Subject::Inputs,
        Subject::Programs,
        Subject::Values,
        Subject::Alarms,
        Subject::Machine,
    ];

    /// Returns the name of the subject in the documents.
    pub fn name(self) -> &'static str {
        match self {
            Subject::Commands => "commands",
            Subject::States => "states",
            Subject::MCodes => "m_codes",
            Subject::Inputs => "inputs",
            Subject::Programs => "programs",
            Subject::Values => "values",
            Subject::Alarms => "alarms",
            Subject::Machine => "machine",
        }
    }

    /// Returns the description of the subject in the documents.
    pub fn description(self) -> &'static str {
        match self {
            Subject::Commands => "Commands to a coordinate system, and its control lease.",
            Subject::States => "States and positions of a coordinate system.",
            Subject::MCodes => "Outputs of M codes, and the handlers that serve them.",
            Subject::Inputs => {
                "Values written to the machine: inputs, overrides, spindle, tool, inputs and outputs of the plant, \
                 and heartbeats of watched clients."
            }
            Subject::Programs => "The program store, and previews of its programs.",
            Subject::Values => "Variables, tools and work offsets.",
            Subject::Alarms => "Alarms and the journal.",
            Subject::Machine => "The machine as a whole, its users and its documents.",
        }
    }
}
