//! G500 and G501: acceleration over several blocks. G501 is in force at start-up.

use tandem_model::flow::MultiBlock;

use super::{Code, ModalGroup};
use crate::meaning::ModalValue;

/// G500.
pub static G500: Code = Code {
    code: "G500",
    tenths: 5000,
    name: "Enables multi-block acceleration/deceleration rate",
    group: ModalGroup::MultiBlock,
    sets: Some(ModalValue::MultiBlock(MultiBlock::On)),
    docs: "Reads the path ahead and accelerates over several blocks within the limits of the motors.",
    ..Code::BASE
};

/// G501.
pub static G501: Code = Code {
    code: "G501",
    tenths: 5010,
    name: "Disables multi-block acceleration/deceleration rate",
    group: ModalGroup::MultiBlock,
    sets: Some(ModalValue::MultiBlock(MultiBlock::Off)),
    docs: "Ramps are planned within each block, without reading the path ahead. In force at start-up.",
    ..Code::BASE
};
