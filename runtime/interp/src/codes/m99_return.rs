//! M99 Subprogram End; in a main program it acts as M30 (D12).

use super::Code;
use crate::execution::Flow;
use crate::meaning::Role;

/// M99: returns from a subprogram to its caller.
pub static M99: Code = Code {
    code: "M99",
    name: "Subprogram End",
    role: Role::Return,
    docs: "Ends a subprogram: the next repetition of the call begins, or the calling program continues. In a \
           main program it ends the program.",
    select: |execution| execution.draft.flow = Flow::Return,
    ..Code::BASE
};
