//! The right that a request needs.

/// The right that the user of a request must have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Right {
    /// To read data of the machine. If the configuration has tokens, only identified users have this right.
    Read,
    /// To command a machine and set its inputs and values.
    Operate,
    /// To claim an output, report progress and publish a presence, in the user's own name.
    Handle,
    /// To reset an output: a handler may reset its own outputs, an operator any output.
    Reset,
    /// To select a tool, set the spindle and write variables: an operator anywhere, a handler in a coordinate
    /// system in which it serves an M code.
    Set,
    /// To set inputs: an operator may set any input; a handler may set its own sources of interlock and start
    /// lock, and inputs and outputs of the plant in its own name.
    SetInput,
    /// To stop a machine by an alarm.
    Raise,
    /// To change stored data of the machine: its programs.
    Administrate,
}

impl Right {
    /// Returns true if the journal records the sender of a request with this right: if the request changes
    /// more than the handler's own outputs.
    pub fn is_recorded(self) -> bool {
        !matches!(self, Right::Read | Right::Handle)
    }

    /// Returns true for the rights of requests that can cause a motion.
    pub(super) const fn takes_not_after(self) -> bool {
        matches!(self, Right::Operate | Right::Reset | Right::Set | Right::SetInput)
    }

    /// Returns the name of the right in the documents of the interface.
    pub fn wire_name(self) -> &'static str {
        match self {
            Right::Read => "read",
            Right::Operate => "operate",
            Right::Handle => "handle",
            Right::Reset => "reset",
            Right::Set => "set",
            Right::SetInput => "set_input",
            Right::Raise => "raise",
            Right::Administrate => "administrate",
        }
    }
}
