//! G09 Exact Stop. Its place in the block tells where it stops (D27): before the axis words it stops before the
//! block's motion, after the first of them at the motion's end. A block that does not move ends the chain before it.

use super::Code;
use crate::execution::Execution;

/// G09: one stop in position, in continuous-path mode too.
pub static G09: Code = Code {
    code: "G09",
    name: "Exact Stop",
    docs: "Comes to rest in position once. Before the axis words of its block it stops before the motion of the \
           block, behind them at its end. In a block that does not move it stops there, with G500 too.",
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
