//! G92 of dialect dgshape: sets the work coordinates of the tool's position (2-2).

use super::{Code, axis_word, work_offset};
use crate::execution::Execution;
use crate::meaning::Role;
use tandem_syntax::Address;

/// G92: gives the tool's position new work coordinates.
pub static G92: Code = Code {
    code: "G92",
    name: "Coordinate System",
    role: Role::Coordinates,
    words: &[
        axis_word(Address::X),
        axis_word(Address::Y),
        axis_word(Address::Z),
        axis_word(Address::A),
    ],
    docs: "Shifts all work coordinate systems so that the present position of the tool has the coordinates \
           of the words; axes not written do not change. In G91, the words are coordinates too. The shift \
           is valid until the next program begins.",
    select: set,
    ..Code::BASE
};

fn set(execution: &mut Execution<'_>) {
    let words = execution.own_axis_words();
    if words.named.is_empty() {
        return;
    }
    let machine = execution.position();
    let transform = execution.modal.transform;
    let mut wanted = transform.inverse(machine);
    for axis in words.named.iter() {
        wanted[axis] = words.values[axis];
    }
    let missing = machine.minus(transform.forward(wanted));
    for axis in words.named.iter() {
        execution.retained_mut().shift[axis] += missing[axis];
    }
    work_offset::activate_selected(execution);
}
