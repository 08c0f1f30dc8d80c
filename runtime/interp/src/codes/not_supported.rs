//! The G codes that dialect nj has and this version does not run. Each is an error of its own at check time.

use super::NotSupported;

const fn code(code: &'static str, tenths: u16, name: &'static str) -> NotSupported {
    NotSupported { code, tenths, name }
}

/// All of them, ascending by number.
pub static NOT_SUPPORTED: &[NotSupported] = &[
    code("G02", 20, "Circular Interpolation in CW direction"),
    code("G03", 30, "Circular Interpolation in CCW direction"),
    code("G18", 180, "Z-X Plane Selection"),
    code("G19", 190, "Y-Z Plane Selection"),
    code("G20", 200, "Inch input"),
    code("G28", 280, "Return to Reference Point"),
    code("G30", 300, "Return to 2nd, 3rd or 4th Reference Point"),
    code("G31", 310, "Skip Function"),
    code("G41", 410, "Tool Compensation, left"),
    code("G42", 420, "Tool Compensation, right"),
    code("G43", 430, "Tool Offset, positive"),
    code("G44", 440, "Tool Offset, negative"),
    code("G51", 510, "Scaling"),
    code("G51.1", 511, "Mirroring"),
    code("G52", 520, "Local Coordinate System Set"),
    code("G53", 530, "Dimension Shift Cancel"),
    code("G68", 680, "Enables rotation"),
    code("G74", 740, "Left-handed Tapping Cycle"),
    code("G84", 840, "Tapping Cycle"),
    code("G99", 990, "Fixed Cycle Return to R Point Level"),
    code("G500", 5000, "Enables multi-block acceleration/deceleration rate"),
];
