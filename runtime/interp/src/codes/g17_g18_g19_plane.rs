//! G17, G18 and G19 Plane Selection; G17 is in force at start-up.

use super::{Code, ModalGroup, remembered};

const fn plane(code: &'static str, tenths: u16, name: &'static str, docs: &'static str) -> Code {
    Code {
        code,
        tenths,
        name,
        group: ModalGroup::Plane,
        words: &[],
        docs,
        check: None,
        select: remembered,
        motion: None,
    }
}

/// G17.
pub static G17: Code = plane(
    "G17",
    170,
    "X-Y Plane Selection",
    "Selects the XY plane for arcs, cutter compensation and rotation. In force at start-up. The plane cannot change \
     during cutter compensation.",
);
/// G18.
pub static G18: Code = plane(
    "G18",
    180,
    "Z-X Plane Selection",
    "Selects the ZX plane for arcs, cutter compensation and rotation.",
);
/// G19.
pub static G19: Code = plane(
    "G19",
    190,
    "Y-Z Plane Selection",
    "Selects the YZ plane for arcs, cutter compensation and rotation.",
);
