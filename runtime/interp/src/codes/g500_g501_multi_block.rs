//! G500 and G501: acceleration over several blocks. G501 is in force at start-up.

use super::{Code, ModalGroup, remembered};

/// G500.
pub static G500: Code = Code {
    code: "G500",
    tenths: 5000,
    name: "Enables multi-block acceleration/deceleration rate",
    group: ModalGroup::MultiBlock,
    words: &[],
    docs: "Reads the path ahead and accelerates over several blocks within the limits of the motors.",
    check: None,
    select: remembered,
    motion: None,
};

/// G501.
pub static G501: Code = Code {
    code: "G501",
    tenths: 5010,
    name: "Disables multi-block acceleration/deceleration rate",
    group: ModalGroup::MultiBlock,
    words: &[],
    docs: "Ramps are planned within each block, without reading the path ahead. In force at start-up.",
    check: None,
    select: remembered,
    motion: None,
};
