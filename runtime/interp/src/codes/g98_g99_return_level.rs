//! G98 and G99: where a fixed cycle returns to. G98 is in force at start-up.

use super::Code;
use crate::meaning::{ModalValue, ReturnLevel};

/// G98.
pub static G98: Code = Code::setting(
    ModalValue::ReturnLevel(ReturnLevel::Initial),
    "G98",
    "Fixed Cycle Return to Initial Level",
    "A fixed cycle returns to the Z level at the start of its first block. In force at start-up.",
);

/// G99.
pub static G99: Code = Code::setting(
    ModalValue::ReturnLevel(ReturnLevel::RPoint),
    "G99",
    "Fixed Cycle Return to R Point Level",
    "A fixed cycle stays at the R point level.",
);
