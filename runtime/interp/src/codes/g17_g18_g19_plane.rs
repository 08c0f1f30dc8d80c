//! G17, G18 and G19 Plane Selection; G17 is in force at start-up.

use tandem_model::plane::Plane;

use super::{Code, ModalGroup};
use crate::meaning::ModalValue;

const fn select(
    code: &'static str,
    tenths: u16,
    plane: Plane,
    name: &'static str,
    docs: &'static str,
) -> Code {
    Code {
        code,
        tenths,
        name,
        group: ModalGroup::Plane,
        sets: Some(ModalValue::Plane(plane)),
        docs,
        ..Code::BASE
    }
}

/// G17.
pub static G17: Code = select(
    "G17",
    170,
    Plane::Xy,
    "X-Y Plane Selection",
    "Selects the XY plane for arcs, cutter compensation and rotation. In force at start-up. The plane cannot change \
     during cutter compensation.",
);
/// G18.
pub static G18: Code = select(
    "G18",
    180,
    Plane::Zx,
    "Z-X Plane Selection",
    "Selects the ZX plane for arcs, cutter compensation and rotation.",
);
/// G19.
pub static G19: Code = select(
    "G19",
    190,
    Plane::Yz,
    "Y-Z Plane Selection",
    "Selects the YZ plane for arcs, cutter compensation and rotation.",
);
