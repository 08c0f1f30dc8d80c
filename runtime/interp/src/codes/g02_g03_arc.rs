//! G02 and G03 Circular Interpolation: arcs, full circles, spirals, helices and cones (D26).

use tandem_model::flow::{Action, Arc, ArcShape, AxisWords};
use tandem_model::plane::Turn;
use tandem_syntax::Address;

use super::{Code, ModalGroup, POSITION_MAX, WordSpec, axis_word};
use crate::execution::Execution;
use crate::meaning::{MotionKind, Role};

const fn centre(address: Address) -> WordSpec {
    WordSpec::new(
        address,
        "centre, from the start point",
        "mm",
        -POSITION_MAX,
        POSITION_MAX,
    )
}

static WORDS: [WordSpec; 10] = [
    axis_word(Address::X),
    axis_word(Address::Y),
    axis_word(Address::Z),
    axis_word(Address::A),
    axis_word(Address::B),
    axis_word(Address::C),
    centre(Address::I),
    centre(Address::J),
    centre(Address::K),
    WordSpec::new(Address::R, "radius", "mm", -POSITION_MAX, POSITION_MAX),
];

/// Words of arcs in dialect dgshape, whose arcs move no rotary axis.
static WORDS_OF_ORTHOGONAL: [WordSpec; 7] = [
    axis_word(Address::X),
    axis_word(Address::Y),
    axis_word(Address::Z),
    centre(Address::I),
    centre(Address::J),
    centre(Address::K),
    WordSpec::new(Address::R, "radius", "mm", -POSITION_MAX, POSITION_MAX),
];

/// G02 of dialect dgshape, with X, Y and Z only.
pub static G02_ORTHOGONAL: Code = Code {
    words: &WORDS_OF_ORTHOGONAL,
    ..G02
};

/// G03 of dialect dgshape, with X, Y and Z only.
pub static G03_ORTHOGONAL: Code = Code {
    words: &WORDS_OF_ORTHOGONAL,
    ..G03
};

/// G02: a clockwise arc.
pub static G02: Code = Code {
    code: "G02",
    name: "Circular Interpolation in CW direction",
    group: ModalGroup::Motion,
    role: Role::Motion(MotionKind::Arc),
    words: &WORDS,
    docs: "Moves clockwise on an arc of the selected plane, with the centre I, J, K from the start point, or \
           the radius R: positive for up to a half circle, negative for more, 0 for a straight line. Without \
           a target in the plane I, J, K give a full circle. Axes outside the plane move linearly in the \
           angle; a different radius at the end makes a spiral. With R, I, J and K have no effect.",
    motion: Some(|execution, words| arc(execution, words, Turn::Clockwise)),
    ..Code::BASE
};

/// G03: a counter-clockwise arc.
pub static G03: Code = Code {
    code: "G03",
    name: "Circular Interpolation in CCW direction",
    group: ModalGroup::Motion,
    role: Role::Motion(MotionKind::Arc),
    words: &WORDS,
    docs: "As G02, counter-clockwise.",
    motion: Some(|execution, words| arc(execution, words, Turn::CounterClockwise)),
    ..Code::BASE
};

fn arc(execution: &mut Execution<'_>, target: AxisWords, turn: Turn) {
    let centre = [Address::I, Address::J, Address::K].map(|address| execution.length(address));
    let shape = match execution.length(Address::R) {
        Some(radius) => {
            if centre.iter().any(Option::is_some) {
                execution.warn("the arc has R and a centre: R is used".to_owned());
            }
            ArcShape::Radius(radius)
        }
        None => ArcShape::Centre(centre.map(Option::unwrap_or_default)),
    };
    let plane = execution.modal.plane();
    execution.act(Action::Arc(Box::new(Arc {
        target,
        plane,
        turn,
        shape,
    })));
}
