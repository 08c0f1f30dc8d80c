//! Codes that switch off what this version cannot switch on. They are in force at start-up, so that a program's
//! safety line (`G17 G21 G40 G49 G80 G98`) runs and changes nothing.

use super::{Code, ModalGroup, remembered};

const fn initial(
    code: &'static str,
    tenths: u16,
    name: &'static str,
    group: ModalGroup,
    docs: &'static str,
) -> Code {
    Code {
        code,
        tenths,
        name,
        group,
        words: &[],
        docs,
        check: None,
        select: remembered,
        motion: None,
    }
}

/// G40.
pub static G40: Code = initial(
    "G40",
    400,
    "Cancels tool compensation",
    ModalGroup::ToolRadius,
    "Switches cutter compensation off. In force at start-up.",
);
/// G49.
pub static G49: Code = initial(
    "G49",
    490,
    "Cancels tool offset",
    ModalGroup::ToolLength,
    "Switches the tool length offset off. In force at start-up.",
);
/// G50.
pub static G50: Code = initial(
    "G50",
    500,
    "Cancel scaling",
    ModalGroup::Scaling,
    "Switches scaling off. In force at start-up.",
);
/// G50.1.
pub static G50_1: Code = initial(
    "G50.1",
    501,
    "Cancel Mirroring",
    ModalGroup::Mirroring,
    "Switches mirroring off. In force at start-up.",
);
/// G69.
pub static G69: Code = initial(
    "G69",
    690,
    "Disables rotation",
    ModalGroup::Rotation,
    "Switches the rotation of coordinates off. In force at start-up.",
);
/// G80.
pub static G80: Code = initial(
    "G80",
    800,
    "Fixed Cycle Cancel",
    ModalGroup::FixedCycle,
    "Ends a fixed cycle. In force at start-up.",
);
/// G98.
pub static G98: Code = initial(
    "G98",
    980,
    "Fixed Cycle Return to Initial Level",
    ModalGroup::ReturnLevel,
    "A fixed cycle returns to the level where it began. In force at start-up.",
);
/// G501.
pub static G501: Code = initial(
    "G501",
    5010,
    "Disables multi-block acceleration/deceleration rate",
    ModalGroup::MultiBlock,
    "Ramps are planned from block to block, without reading the path ahead. In force at start-up.",
);
