//! The G codes that dialect nj has and this version does not run. Each is an error of its own at check time.

use super::{ModalGroup, NotSupported};

const fn code(code: &'static str, tenths: u16, name: &'static str, group: ModalGroup) -> NotSupported {
    NotSupported {
        code,
        tenths,
        name,
        group,
    }
}

/// All of them, ascending by number.
pub static NOT_SUPPORTED: &[NotSupported] = &[
    code(
        "G02",
        20,
        "Circular Interpolation in CW direction",
        ModalGroup::Motion,
    ),
    code(
        "G03",
        30,
        "Circular Interpolation in CCW direction",
        ModalGroup::Motion,
    ),
    code("G18", 180, "Z-X Plane Selection", ModalGroup::Plane),
    code("G19", 190, "Y-Z Plane Selection", ModalGroup::Plane),
    code("G20", 200, "Inch input", ModalGroup::Unit),
    code("G28", 280, "Return to Reference Point", ModalGroup::NonModal),
    code(
        "G30",
        300,
        "Return to 2nd, 3rd or 4th Reference Point",
        ModalGroup::NonModal,
    ),
    code("G31", 310, "Skip Function", ModalGroup::NonModal),
    code("G41", 410, "Tool Compensation, left", ModalGroup::ToolRadius),
    code("G42", 420, "Tool Compensation, right", ModalGroup::ToolRadius),
    code("G43", 430, "Tool Offset, positive", ModalGroup::ToolLength),
    code("G44", 440, "Tool Offset, negative", ModalGroup::ToolLength),
    code("G51", 510, "Scaling", ModalGroup::Scaling),
    code("G51.1", 511, "Mirroring", ModalGroup::Mirroring),
    code("G52", 520, "Local Coordinate System Set", ModalGroup::NonModal),
    code("G53", 530, "Dimension Shift Cancel", ModalGroup::NonModal),
    code("G68", 680, "Enables rotation", ModalGroup::Rotation),
    code("G74", 740, "Left-handed Tapping Cycle", ModalGroup::FixedCycle),
    code("G84", 840, "Tapping Cycle", ModalGroup::FixedCycle),
    code(
        "G99",
        990,
        "Fixed Cycle Return to R Point Level",
        ModalGroup::ReturnLevel,
    ),
    code(
        "G500",
        5000,
        "Enables multi-block acceleration/deceleration rate",
        ModalGroup::MultiBlock,
    ),
];
