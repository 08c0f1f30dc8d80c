//! G68 and G69 Coordinate System Rotation.

use tandem_model::flow::{Rotation, Transform};
use tandem_syntax::{Address, diagnostics};

use super::{Code, ModalGroup, Refusal, WordSpec, axis_word};
use crate::meaning::{ModalValue, Role, Shape};

/// Largest angle in the manual's table of instruction parameters; the manual's text on G68 gives no limit.
const ANGLE_OF_TABLE_DEG: f64 = 300.0;

fn is_beyond_table(angle_deg: f64) -> bool {
    angle_deg.abs() > ANGLE_OF_TABLE_DEG && angle_deg.abs() <= 360.0
}

/// G68: rotation on.
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
        WordSpec::new(Address::R, "angle, counter-clockwise", "deg", -360.0, 360.0).needed(),
    ],
    docs: "Turns the coordinates about the centre X, Y, Z by the angle R in the plane in force. The centre \
           is absolute; for an axis not written, it is the position of the tool. The manual's table ends \
           at 300 degrees; a larger angle gives a warning.",
    check: Some(|words| {
        let angle_deg = words.get(Address::R).filter(|angle| is_beyond_table(*angle))?;
        Some(Refusal {
            entry: &diagnostics::ANGLE_BEYOND_TABLE,
            address: Address::R,
            message: format!("R{angle_deg} is beyond the {ANGLE_OF_TABLE_DEG} degrees of the manual's table"),
            help: format!(
                "Write R{}, which gives the same rotation.",
                angle_deg - 360.0_f64.copysign(angle_deg)
            ),
        })
    }),
    select: |execution| {
        let angle_deg = execution.words.get(Address::R).unwrap_or_default();
        if is_beyond_table(angle_deg) {
            execution.warn(format!(
                "R{angle_deg} is beyond the {ANGLE_OF_TABLE_DEG} degrees of the manual's table; it is executed as written"
            ));
        }
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

/// G69: rotation off.
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
