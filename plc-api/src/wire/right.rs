//! What a route or topic asks of its user.

/// What a route or topic asks of its user.
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
    /// To stop a machine by an alarm.
    Raise,
    /// To change what the machine keeps: its programs.
    Administrate,
}

impl Right {
    /// The name of the right in the documents of the interface.
    pub fn word(self) -> &'static str {
        match self {
            Right::Read => "read",
            Right::Operate => "operate",
            Right::Handle => "handle",
            Right::Reset => "reset",
            Right::Raise => "raise",
            Right::Administrate => "administrate",
        }
    }
}
