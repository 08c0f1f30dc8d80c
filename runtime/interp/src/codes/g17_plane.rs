//! G17 X-Y Plane Selection, the plane at start-up.

use super::{Code, ModalGroup, remembered};

/// G17: arcs, cutter compensation and rotation lie in the XY plane.
pub static G17: Code = Code {
    code: "G17",
    tenths: 170,
    name: "X-Y Plane Selection",
    group: ModalGroup::Plane,
    words: &[],
    docs: "Selects the XY plane for arcs, cutter compensation and rotation. In force at start-up.",
    check: None,
    select: remembered,
    motion: None,
};
