//! G90 Absolute command, in force at start-up, and G91 Incremental command.

use tandem_model::flow::Distance;

use super::Code;
use crate::meaning::ModalValue;

/// G90: axis words are positions.
pub static G90: Code = Code::setting(
    ModalValue::Distance(Distance::Absolute),
    "G90",
    "Absolute command",
    "Axis words are positions in the coordinates in force, for all axes. In force at start-up.",
);

/// G91: axis words are distances.
pub static G91: Code = Code::setting(
    ModalValue::Distance(Distance::Incremental),
    "G91",
    "Incremental command",
    "Axis words are distances from the last commanded position, for all axes.",
);
