//! Converts blocks to path segments: transforms, offsets, geometry.
//!
//! [`PathStage`] receives one block after another, and returns segments in machine coordinates. It is
//! deterministic: the same blocks give the same segments. It handles lines, arcs (G02, G03), G00, G04, G28,
//! G30, G31, G53 and threads (G74, G84), under all transforms of D20, with cutter compensation (G41, G42).
//!
//! Decisions where the manual is silent:
//! - A move shorter than [`LENGTH_MIN`] on every axis gives no segment and does not change the position. Its
//!   exact stop still takes effect, and G00 still ends a chain.
//! - A block without movement ends a chain of blended blocks (M1c, G501).
//! - A change of tool length takes effect in the next motion block in work coordinates; G53 with Z cancels it
//!   (D22).
//! - An axis that no word moves keeps its position to the last bit. Under a rotation, both axes of its plane
//!   are treated as moved if a word names one of them.
//! - An arc under a rotation in another plane is rejected, like an arc under unequal scale (D21): the arc
//!   would leave its plane.
//! - If an arc is blended, the soft limits apply to a bound of the blend. A program may thus be rejected
//!   although its motion would just stay within the limits.
//! - In G61, the machine also stops at both ends of an arc added by compensation. If the arc were blended
//!   with its line, the tool would cut the corner, as in G64.
//! - An arc whose centre is its end point has no end direction and is rejected.
//! - A thread in a direction other than the machine's Z is rejected; the pitch F / S is in machine
//!   coordinates.
//! - Only the servo knows the end of a G31: a caller must not push a block before the call of
//!   [`PathStage::skipped_to`] (see [`PathStage::is_skipping`]).
//! - Soft limits are checked for the axes that a block moves, on an arc also at its turning points. A machine
//!   that is beyond a limit may move back.

mod arc;
mod blend;
mod compensation;
mod length;
mod stage;
mod surface;
mod tapping;
mod target;
mod transform;

pub use compensation::LOOK_AHEAD_MAX;
pub use length::LENGTH_MIN;
pub use stage::{PathStage, work_position};
