//! G68 and G69 Coordinate System Rotation.

use tandem_model::flow::{Rotation, Transform};
use tandem_syntax::Address;

use super::{Code, ModalGroup, WordSpec, axis_word};
use crate::meaning::{ModalValue, Role, Shape};

/// G68.
pub static G68: Code = Code {
    code: "G68",
    name: "Enables rotation",
    group: ModalGroup::Rotation,
    sets: Some(ModalValue::Shape(Shape::Rotation, true)),
    role: Role::Coordinates,
    words: &[
        axis_word(Address::X),
        axis_word(Address::Y),
        axis_word(Address::Z),
        WordSpec::new(Address::R, "angle, counter-clockwise", "deg", -300.0, 300.0).needed(),
    ],
    docs: "Turns the coordinates about the centre X, Y, Z by the angle R in the plane in force. The centre is absolute; \
           an axis that is not written has it where the tool is.",
    select: |execution| {
        let angle_deg = execution.words.get(Address::R).unwrap_or_default();
        let plane = execution.modal.plane();
        let centre = execution.centre(&plane.axes(), Transform::before_rotation);
        execution.transform(|transform| {
            transform.rotation = Some(Rotation {
                plane,
                centre,
                angle_deg,
            });
        });
    },
    ..Code::BASE
};

/// G69.
pub static G69: Code = Code {
    code: "G69",
    name: "Disables rotation",
    group: ModalGroup::Rotation,
    sets: Some(ModalValue::Shape(Shape::Rotation, false)),
    role: Role::Coordinates,
    docs: "Switches the rotation of coordinates off. In force at start-up.",
    select: |execution| {
        if execution.modal.transform.rotation.is_some() {
            execution.transform(|transform| transform.rotation = None);
        }
    },
    ..Code::BASE
};
