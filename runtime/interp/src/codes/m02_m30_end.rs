//! M02 and M30 End of Program. Both have the same effect.

use super::Code;
use crate::execution::Flow;
use crate::meaning::Role;

const fn end_of_program(code: &'static str) -> Code {
    Code {
        code,
        name: "End of Program",
        role: Role::End,
        docs: "Ends the program, from a subprogram too. Blocks after it are not executed; the next start \
               begins at line 1 of the main program.",
        select: |execution| execution.draft.flow = Flow::End,
        ..Code::BASE
    }
}

/// M02: end of the program.
pub static M02: Code = end_of_program("M02");
/// M30: end of the program.
pub static M30: Code = end_of_program("M30");
