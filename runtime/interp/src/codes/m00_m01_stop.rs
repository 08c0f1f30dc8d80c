//! M00 Program Stop and M01 Optional Stop. They take effect when the motion has reached their block (D14).

use super::Code;
use crate::execution::Flow;
use crate::meaning::Role;

/// M00: stops the program until it is resumed.
pub static M00: Code = Code {
    code: "M00",
    name: "Program Stop",
    role: Role::Stop,
    docs: "Stops the program at this block until it is resumed. Modal states stay.",
    select: |execution| execution.draft.flow = Flow::Stop { optional: false },
    ..Code::BASE
};

/// M01: stops like M00 while the optional stop input is on.
pub static M01: Code = Code {
    code: "M01",
    name: "Optional Stop",
    role: Role::Stop,
    docs: "Stops like M00 if the optional stop input is on when the motion has reached this block.",
    select: |execution| execution.draft.flow = Flow::Stop { optional: true },
    ..Code::BASE
};
