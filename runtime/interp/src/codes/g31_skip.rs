//! G31 Skip Function (D40, D41).

use tandem_model::flow::Action;

use super::{AXIS_WORDS, Code};
use crate::meaning::Role;

/// G31: moves until the skip inputs come.
pub static G31: Code = Code {
    code: "G31",
    name: "Skip Function",
    role: Role::Skip,
    words: &AXIS_WORDS,
    docs: "Moves each named axis alone at its skip velocity until its skip input comes or the target is reached; the \
           motor then stands at the captured position. The program is read on meanwhile, up to a read of \
           `_CNC_CapturedPosition` (D15); what moves behind it begins where the motors have ended. The captured position \
           is a machine position in mm or degrees, with G20 too (D41). Never blended.",
    select: |execution| {
        let words = execution.own_axis_words();
        if !words.named.is_empty() {
            execution.act(Action::Skip(words));
        }
    },
    ..Code::BASE
};
