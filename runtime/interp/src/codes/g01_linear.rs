//! G01 Linear Interpolation, the motion at start-up.

use tandem_model::flow::Action;

use super::{AXIS_WORDS, Code, ModalGroup};
use crate::meaning::{MotionKind, Role};

/// G01: a straight line at the feedrate F.
pub static G01: Code = Code {
    code: "G01",
    name: "Linear Interpolation",
    group: ModalGroup::Motion,
    role: Role::Motion(MotionKind::Linear),
    words: &AXIS_WORDS,
    docs: "Moves along a straight line at the feedrate F with the ramps of ta, td and ts. F is the speed \
           along X, Y and Z; rotary axes of the same block end at the same time. In force at start-up.",
    motion: Some(|execution, words| execution.act(Action::Linear(words))),
    ..Code::BASE
};
