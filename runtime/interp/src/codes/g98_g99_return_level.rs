//! G98 and G99: where a fixed cycle returns to. G98 is in force at start-up.

use super::{Code, ModalGroup};
use crate::meaning::{ModalValue, ReturnLevel};

/// G98.
pub static G98: Code = Code {
    code: "G98",
    tenths: 980,
    name: "Fixed Cycle Return to Initial Level",
    group: ModalGroup::ReturnLevel,
    sets: Some(ModalValue::ReturnLevel(ReturnLevel::Initial)),
    docs: "A fixed cycle returns to the level where its block began. In force at start-up.",
    ..Code::BASE
};

/// G99.
pub static G99: Code = Code {
    code: "G99",
    tenths: 990,
    name: "Fixed Cycle Return to R Point Level",
    group: ModalGroup::ReturnLevel,
    sets: Some(ModalValue::ReturnLevel(ReturnLevel::RPoint)),
    docs: "A fixed cycle stays at the R point level.",
    ..Code::BASE
};
