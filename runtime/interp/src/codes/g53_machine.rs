//! G53 Dimension Shift Cancel: rapid positioning in machine coordinates (D23).

use tandem_model::AxisVector;
use tandem_model::flow::{Action, Distance, Frame};

use super::{AXIS_WORDS, Code};
use crate::execution::Execution;
use crate::meaning::Role;

/// G53 of dialect dgshape, which does not end scaling, mirroring, rotation and local coordinates.
pub static G53_ALONE: Code = Code {
    select: to_machine,
    docs: "Moves the named axes, as G00, to machine positions, in this block only; allowed only in G90. \
           Tool-diameter offset and tool-length offset must be off.",
    ..G53
};

fn to_machine(execution: &mut Execution<'_>) {
    let mut words = execution.own_axis_words();
    (words.distance, words.frame) = (Distance::Absolute, Frame::Machine);
    if !words.named.is_empty() {
        execution.act(Action::Rapid(words));
    }
}

/// G53: rapid to a machine position.
pub static G53: Code = Code {
    code: "G53",
    name: "Dimension Shift Cancel",
    role: Role::ToMachine,
    words: &AXIS_WORDS,
    docs: "Moves as G00 to machine positions, always absolute. Ends scaling, mirroring, rotation and the \
           local coordinate system; work offsets have no effect in this block. Cutter compensation and tool \
           offset must be off (D23).",
    select: |execution| {
        to_machine(execution);
        execution.release_shape();
        if execution.modal.transform.local != AxisVector::ZERO {
            execution.transform(|transform| transform.local = AxisVector::ZERO);
        }
    },
    ..Code::BASE
};
