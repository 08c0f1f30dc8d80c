//! G50.1 and G51.1 Mirroring.

use tandem_model::AxisSet;
use tandem_model::flow::Mirror;
use tandem_syntax::Address;

use super::{Code, ModalGroup, WordSpec, axis_word};
use crate::meaning::{ModalValue, Role, Shape};

static CENTRE: [WordSpec; 3] = [
    axis_word(Address::X),
    axis_word(Address::Y),
    axis_word(Address::Z),
];

/// G50.1: mirroring off.
pub static G50_1: Code = Code {
    code: "G50.1",
    name: "Cancel Mirroring",
    group: ModalGroup::Mirroring,
    sets: Some(ModalValue::Shape(Shape::Mirroring, false)),
    role: Role::Coordinates,
    words: &CENTRE,
    docs: "Ends the mirroring of the named axes, or of all axes if none is named. The values have no effect. \
           In force at start-up.",
    select: |execution| {
        let named = execution.own_axis_words().named;
        let Some(mirror) = execution.modal.transform.mirror else {
            return;
        };
        let axes: AxisSet = mirror.axes.iter().filter(|axis| !named.contains(*axis)).collect();
        let rest = (!named.is_empty() && !axes.is_empty()).then_some(Mirror { axes, ..mirror });
        execution.transform(|transform| transform.mirror = rest);
    },
    ..Code::BASE
};

/// G51.1: mirroring on.
pub static G51_1: Code = Code {
    code: "G51.1",
    name: "Mirroring",
    group: ModalGroup::Mirroring,
    sets: Some(ModalValue::Shape(Shape::Mirroring, true)),
    role: Role::Coordinates,
    words: &CENTRE,
    docs: "Mirrors the named axes about the values, which are absolute. An axis that is not named is not mirrored.",
    select: |execution| {
        let centre = execution.own_axis_words();
        let mirror = (!centre.named.is_empty()).then_some(Mirror {
            axes: centre.named,
            centre: centre.values,
        });
        execution.transform(|transform| transform.mirror = mirror);
    },
    ..Code::BASE
};
