//! G98 and G99: the level to which a fixed cycle returns. G98 is in force at start-up.

use super::Code;
use crate::meaning::{ModalValue, ReturnLevel};

/// G98: return to the initial level.
pub static G98: Code = Code::setting(
    ModalValue::ReturnLevel(ReturnLevel::Initial),
    "G98",
    "Fixed Cycle Return to Initial Level",
    "A fixed cycle returns to the Z level at the start of its first block. In force at start-up.",
);

/// G99: return to the R point.
pub static G99: Code = Code::setting(
    ModalValue::ReturnLevel(ReturnLevel::RPoint),
    "G99",
    "Fixed Cycle Return to R Point Level",
    "A fixed cycle stays at the R point level.",
);
