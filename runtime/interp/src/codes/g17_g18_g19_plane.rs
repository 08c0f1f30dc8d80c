//! G17, G18 and G19 Plane Selection; G17 is in force at start-up.

use tandem_model::plane::Plane;

use super::Code;
use crate::meaning::ModalValue;

/// G17: the XY plane.
pub static G17: Code = Code::setting(
    ModalValue::Plane(Plane::Xy),
    "G17",
    "X-Y Plane Selection",
    "Selects the XY plane for arcs, cutter compensation and rotation. In force at start-up. The plane cannot change \
     during cutter compensation.",
);
/// G18: the ZX plane.
pub static G18: Code = Code::setting(
    ModalValue::Plane(Plane::Zx),
    "G18",
    "Z-X Plane Selection",
    "Selects the ZX plane for arcs, cutter compensation and rotation.",
);
/// G19: the YZ plane.
pub static G19: Code = Code::setting(
    ModalValue::Plane(Plane::Yz),
    "G19",
    "Y-Z Plane Selection",
    "Selects the YZ plane for arcs, cutter compensation and rotation.",
);
