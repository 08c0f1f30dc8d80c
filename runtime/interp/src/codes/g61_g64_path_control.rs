//! G61 Exact Stop Mode and G64 Continuous-path Mode, the mode at start-up.

use tandem_model::flow::PathControl;

use super::Code;
use crate::meaning::ModalValue;

/// G61: each cutting block ends at rest and in position.
pub static G61: Code = Code::setting(
    ModalValue::PathControl(PathControl::ExactStop),
    "G61",
    "Exact Stop Mode",
    "Each cutting block decelerates to its end and waits until the motors are in position, until G64.",
);

/// G64: cutting blocks may blend.
pub static G64: Code = Code::setting(
    ModalValue::PathControl(PathControl::ContinuousPath),
    "G64",
    "Continuous-path Mode",
    "Each cutting block is blended with the next one, until G61. The motion still stops at G00, at G09, and \
     before a block without motion; with G500, only before such a block that changes the tool length. In \
     force at start-up.",
);
