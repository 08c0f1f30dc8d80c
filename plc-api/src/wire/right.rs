//! The right that a request needs.

/// What a request asks of its user.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Right {
    /// To see: needs a user where there are tokens.
    Read,
    /// To command a machine and set its inputs and values.
    Operate,
    /// To claim an output, report progress and be present, in one's own name.
    Handle,
    /// To reset an output: a handler its own, an operator any.
    Reset,
    /// To select a tool, set the spindle and write variables: an operator anywhere, a handler in a coordinate system in
    /// which it serves an M code.
    Set,
    /// To set inputs: an operator any, a handler its own sources of interlock and start lock, and inputs and outputs of the plant
    /// in its own name.
    SetInput,
    /// To stop a machine by an alarm.
    Raise,
    /// To change what the machine keeps: its programs.
    Administrate,
}

impl Right {
    /// True where a request changes something beyond what a handler says of its own outputs: the journal records who has
    /// made it.
    pub fn is_recorded(self) -> bool {
        !matches!(self, Right::Read | Right::Handle)
    }

    /// True for the rights of requests after which something can move.
    pub(super) const fn takes_not_after(self) -> bool {
        matches!(self, Right::Operate | Right::Reset | Right::Set | Right::SetInput)
    }

    /// The name of the right in the documents of the interface.
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
