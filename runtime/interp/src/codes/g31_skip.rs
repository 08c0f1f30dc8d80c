//! G31 Skip Function (D40, D41).

use tandem_model::flow::Action;

use super::{AXIS_WORDS, Code};
use crate::meaning::Role;

/// G31: moves each motor until its skip input turns on.
pub static G31: Code = Code {
    code: "G31",
    name: "Skip Function",
    role: Role::Skip,
    words: &AXIS_WORDS,
    docs: "Moves each named axis alone at its skip velocity until its skip input turns on or its target is \
           reached. After a skip, the motor stops at the captured position. Meanwhile the next blocks are \
           interpreted, up to a block that reads `_CNC_CapturedPosition` (D15); their motion begins where \
           the motors have stopped. The captured position is a machine position in mm or degrees, also in \
           G20 (D41). Never blended.",
    select: |execution| {
        let words = execution.own_axis_words();
        if !words.named.is_empty() {
            execution.act(Action::Skip(words));
        }
    },
    ..Code::BASE
};
