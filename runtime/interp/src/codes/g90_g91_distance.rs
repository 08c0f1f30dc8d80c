//! G90 Absolute command, in force at start-up, and G91 Incremental command.

use tandem_model::flow::Distance;

use super::{Code, ModalGroup};
use crate::meaning::ModalValue;

/// G90: axis words are positions.
pub static G90: Code = Code {
    code: "G90",
    tenths: 900,
    name: "Absolute command",
    group: ModalGroup::Distance,
    sets: Some(ModalValue::Distance(Distance::Absolute)),
    docs: "Axis words are positions in the coordinates in force, for all axes. In force at start-up.",
    ..Code::BASE
};

/// G91: axis words are distances.
pub static G91: Code = Code {
    code: "G91",
    tenths: 910,
    name: "Incremental command",
    group: ModalGroup::Distance,
    sets: Some(ModalValue::Distance(Distance::Incremental)),
    docs: "Axis words are distances from the last commanded position, for all axes.",
    ..Code::BASE
};
