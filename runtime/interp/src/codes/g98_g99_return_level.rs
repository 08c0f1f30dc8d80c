//! G98 and G99: where a fixed cycle returns to. G98 is in force at start-up.

use super::{Code, ModalGroup, remembered};

/// G98.
pub static G98: Code = Code {
    code: "G98",
    tenths: 980,
    name: "Fixed Cycle Return to Initial Level",
    group: ModalGroup::ReturnLevel,
    words: &[],
    docs: "A fixed cycle returns to the level where its block began. In force at start-up.",
    check: None,
    select: remembered,
    motion: None,
};

/// G99.
pub static G99: Code = Code {
    code: "G99",
    tenths: 990,
    name: "Fixed Cycle Return to R Point Level",
    group: ModalGroup::ReturnLevel,
    words: &[],
    docs: "A fixed cycle stays at the R point level.",
    check: None,
    select: remembered,
    motion: None,
};
