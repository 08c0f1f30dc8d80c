//! G21 Metric input.

use super::{Code, ModalGroup, remembered};

/// G21: lengths and feedrates are in mm.
pub static G21: Code = Code {
    code: "G21",
    tenths: 210,
    name: "Metric input",
    group: ModalGroup::Unit,
    words: &[],
    docs: "Later words of lengths and feedrates are in mm and mm/min. In force at start-up.",
    check: None,
    select: remembered,
    motion: None,
};
