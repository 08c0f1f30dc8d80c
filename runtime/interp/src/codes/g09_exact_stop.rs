//! G09 Exact Stop. The position of G09 in the block selects the stop (D27): before the axis words, G09 stops
//! before the block's motion; after the first axis word, at the end of the motion. A block without motion
//! ends the chain of blocks before it.

use super::Code;
use crate::execution::Execution;

/// G09: one stop in position, also in continuous-path mode.
pub static G09: Code = Code {
    code: "G09",
    name: "Exact Stop",
    docs: "Stops once in position. Before the axis words of its block, G09 stops before the motion of the \
           block; after them, at the end of the motion. In a block without motion, it stops before the \
           block, also with G500.",
    select: exact_stop,
    ..Code::BASE
};

fn exact_stop(execution: &mut Execution<'_>) {
    let behind = execution
        .words
        .first_axis_place
        .is_some_and(|axis| axis < execution.place);
    execution.draft.exact_stops[usize::from(behind)] = true;
}
