//! Which codes' motion is built. The interpreter interprets all codes; the checker refuses those of this list, so that
//! nothing that cannot move is started. A code leaves the list when its motion is there.

use super::Code;

/// The codes whose motion is not built yet, ascending.
pub static MOTION_NOT_BUILT: &[&str] = &[
    "G02", "G03", "G28", "G30", "G31", "G41", "G42", "G43", "G44", "G51", "G51.1", "G52", "G53", "G68",
    "G74", "G84", "G500",
];

/// True when the motion of a code is built.
pub fn motion_is_built(code: &Code) -> bool {
    !MOTION_NOT_BUILT.contains(&code.code)
}
