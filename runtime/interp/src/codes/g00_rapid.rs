//! G00 Rapid Positioning.

use tandem_model::flow::Action;

use super::{AXIS_WORDS, Code, ModalGroup};
use crate::meaning::{MotionKind, Role};

/// G00: a rapid, in which each motor moves alone in its shortest time.
pub static G00: Code = Code {
    code: "G00",
    name: "Rapid Positioning",
    group: ModalGroup::Motion,
    role: Role::Motion(MotionKind::Rapid),
    words: &AXIS_WORDS,
    docs: "Moves each named axis to its target in the shortest time that its motor's rapid velocity and acceleration \
           allow. The path is not a straight line. It is never blended with another motion.",
    motion: Some(|execution, words| execution.act(Action::Rapid(words))),
    ..Code::BASE
};
