//! G39 of dialect dgshape: an arc about the corner in cutter compensation (2-2).

use tandem_model::flow::Action;
use tandem_syntax::Address;

use super::{Code, axis_word};
use crate::meaning::Role;

/// G39: an arc about an outside corner.
pub static G39: Code = Code {
    code: "G39",
    name: "Corner-offset Circular Interpolation",
    role: Role::Corner,
    words: &[axis_word(Address::X), axis_word(Address::Y)],
    docs: "Rounds the outside corner between the motions before and after it by an arc of the tool's radius \
           about the corner. X and Y give the direction of the next motion: its target in G90, its distance \
           in G91; without them, the direction of the next motion is used. It applies to this corner only, \
           and has no motion of its own.",
    select: |execution| {
        let direction = execution.own_axis_words();
        execution.act(Action::Corner(direction));
    },
    ..Code::BASE
};
