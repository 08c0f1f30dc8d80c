//! G28 and G30: motions to a reference point through a middle point (D23, D24).

use tandem_model::Axis;
use tandem_model::flow::{Action, AxisWords, Distance};
use tandem_syntax::Address;

use super::{AXIS_WORDS, Code, WordSpec, axis_word};
use crate::execution::Execution;
use crate::meaning::Role;
use crate::modal::Middle;

/// G28: motion to the first reference point.
pub static G28: Code = Code {
    code: "G28",
    name: "Return to Reference Point",
    role: Role::ToMachine,
    words: &AXIS_WORDS,
    docs: "Moves the named axes, as G00, to the middle point and from there to the reference point; without \
           axis words, all axes move directly to the reference point. Scaling, mirroring and rotation end at \
           the middle point. Cutter compensation and tool offset must be off (D23).",
    select: |execution| reference(execution, 1),
    ..Code::BASE
};

/// G28 of dialect dgshape, which remembers the middle point of each axis.
pub static G28_REMEMBERED: Code = Code {
    role: Role::ToReference,
    words: &[
        axis_word(Address::X),
        axis_word(Address::Y),
        axis_word(Address::Z),
    ],
    docs: "Moves straight to the middle point and from there straight to the reference point, as fast as \
           G00. An axis not written uses the middle point of an earlier G28 of the program, in the \
           coordinates then in force. If that middle point was a distance (G91), the axis moves directly to \
           the reference point. An axis that no G28 has named does not move, nor does A. Tool-diameter \
           offset must be off.",
    select: remembered,
    ..G28
};

fn remembered(execution: &mut Execution<'_>) {
    let own = execution.own_axis_words();
    let position = execution.position();
    let here = execution.modal.transform.inverse(position);
    let mut words = AxisWords {
        distance: Distance::Absolute,
        ..own
    };
    for (axis, kept) in Axis::ORTHOGONAL
        .into_iter()
        .zip(&mut execution.retained_mut().middle)
    {
        let named = own.named.contains(axis);
        let by_distance = own.distance == Distance::Incremental;
        if named {
            *kept = Some(if by_distance {
                Middle::Here
            } else {
                Middle::At(own.values[axis])
            });
        }
        let Some(middle) = *kept else { continue };
        words.values[axis] = match middle {
            Middle::At(value) => value,
            Middle::Here => here[axis] + if named { own.values[axis] } else { 0.0 },
        };
        words.named.insert(axis);
    }
    if !words.named.is_empty() {
        execution.act(Action::Reference {
            middle: words,
            point: 1,
            with_tool_length: true,
        });
    }
}

/// G30: motion to the second, third or fourth reference point.
pub static G30: Code = Code {
    code: "G30",
    name: "Return to 2nd, 3rd or 4th Reference Point",
    role: Role::ToMachine,
    words: &[
        WordSpec::new(Address::P, "reference point", "", 2.0, 4.0).whole(),
        axis_word(Address::X),
        axis_word(Address::Y),
        axis_word(Address::Z),
        axis_word(Address::A),
        axis_word(Address::B),
        axis_word(Address::C),
    ],
    docs: "As G28, to the second reference point, or to the one that P selects.",
    select: |execution| {
        let point = match execution.words.get(Address::P) {
            Some(point) if point >= 4.0 => 4,
            Some(point) if point >= 3.0 => 3,
            _ => 2,
        };
        reference(execution, point);
    },
    ..Code::BASE
};

fn reference(execution: &mut Execution<'_>, point: u8) {
    let middle = execution.own_axis_words();
    execution.act(Action::Reference {
        middle,
        point,
        with_tool_length: false,
    });
    if execution.release_shape() {
        execution.draft.transform_after = true;
    }
}
