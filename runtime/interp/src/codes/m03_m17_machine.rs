//! M03, M05, M06 and M12 to M17 of dialect dgshape: outputs in the manual's list of words (2-3, 2-7).

use tandem_syntax::Address;

use super::{Code, WordSpec, m_auxiliary};
use crate::meaning::{ModalValue, Role};

const fn output(code: &'static str, name: &'static str, docs: &'static str) -> Code {
    Code {
        code,
        name,
        role: Role::Auxiliary,
        docs,
        select: m_auxiliary::output,
        ..Code::BASE
    }
}

const fn spindle(turns: bool, code: &'static str, name: &'static str, docs: &'static str) -> Code {
    Code {
        sets: Some(ModalValue::Spindle(turns)),
        ..output(code, name, docs)
    }
}

/// M03: starts the spindle.
pub static M03: Code = spindle(
    true,
    "M03",
    "Rotate spindle",
    "Makes an output at the start of its block, together with the motion of the block. The spindle turns at \
     S. Fixed cycles need M03.",
);
/// M05: stops the spindle.
pub static M05: Code = spindle(
    false,
    "M05",
    "Stop spindle",
    "Makes an output at the start of its block, which stops the spindle.",
);
/// M06: changes the tool.
pub static M06: Code = Code {
    words: &[
        WordSpec::new(Address::T, "number of the stocker", "", 0.0, 65_535.0)
            .whole()
            .needed(),
    ],
    ..output(
        "M06",
        "Tool selection",
        "Makes an output at the start of its block. Its parameter VA is the number of T: the stocker of the \
         tool to take, or 0 to put the tool back. M06 sets no tool-length offset. T is allowed only with \
         M06.",
    )
};

/// Creates the code of an output that switches a device of the machine.
const fn switch(code: &'static str, name: &'static str) -> Code {
    output(code, name, "Makes an output at the start of its block.")
}

/// M12: air blower on.
pub static M12: Code = switch("M12", "Air blower on");
/// M13: air blower off.
pub static M13: Code = switch("M13", "Air blower off");
/// M14: chip cleaner on.
pub static M14: Code = switch("M14", "Chip cleaner on");
/// M15: chip cleaner off.
pub static M15: Code = switch("M15", "Chip cleaner off");
/// M16: illumination on.
pub static M16: Code = switch("M16", "Illumination on");
/// M17: illumination off.
pub static M17: Code = switch("M17", "Illumination off");
