//! M00 Program Stop and M01 Optional Stop. They act when motion has come to them (D14).

use super::{Code, ModalGroup};
use crate::execution::Flow;

/// M00: stops the program until it is resumed.
pub static M00: Code = Code {
    code: "M00",
    tenths: 0,
    name: "Program Stop",
    group: ModalGroup::NonModal,
    words: &[],
    docs: "Stops the program at this block until it is resumed. Modal states stay.",
    check: None,
    select: |execution| execution.go_on_with(Flow::Stop { optional: false }),
    motion: None,
};

/// M01: the same, while the optional stop input is on.
pub static M01: Code = Code {
    code: "M01",
    tenths: 10,
    name: "Optional Stop",
    group: ModalGroup::NonModal,
    words: &[],
    docs: "Stops like M00 when the optional stop input is on at the time that motion has come to this block.",
    check: None,
    select: |execution| execution.go_on_with(Flow::Stop { optional: true }),
    motion: None,
};
