//! G500 and G501: acceleration over several blocks. G501 is in force at start-up.

use tandem_model::flow::MultiBlock;

use super::Code;
use crate::meaning::ModalValue;

/// G500: acceleration over several blocks.
pub static G500: Code = Code::setting(
    ModalValue::MultiBlock(MultiBlock::On),
    "G500",
    "Enables multi-block acceleration/deceleration rate",
    "Reads the path ahead and accelerates over several blocks within the limits of the motors.",
);

/// G501: acceleration within each block.
pub static G501: Code = Code::setting(
    ModalValue::MultiBlock(MultiBlock::Off),
    "G501",
    "Disables multi-block acceleration/deceleration rate",
    "Ramps are planned within each block, without reading the path ahead. In force at start-up.",
);
