//! From blocks to path segments: transforms, offsets, geometry.
//!
//! [`PathStage`] takes one block after another and returns segments in machine coordinates. It is pure: the same blocks
//! give the same segments. It covers lines, arcs (G02, G03), G00, G04, G28, G30, G31, G53 and threads (G74, G84), under
//! all transforms of D20, with cutter compensation (G41, G42).
//!
//! Decisions where the manual is silent:
//! - A move shorter than [`LENGTH_MIN`] on every axis gives no segment and leaves the position. Its exact stop still
//!   counts, and G00 still ends a chain.
//! - A block without movement ends a chain of blended blocks (M1c, G501).
//! - A change of tool length takes effect in the next motion block in work coordinates; G53 with Z makes it void (D22).
//! - An axis that no word moves keeps its position to the last bit; under a rotation both axes of its plane are treated
//!   as moved when a word names one of them.
//! - An arc under a rotation of another plane is rejected, as an arc under unequal scale is (D21): it would
//!   leave its plane.
//! - If an arc is blended, the soft limits apply to a bound of the blend, so that a program may be rejected
//!   although its motion would just stay within them.
//! - In G61 the machine also rests at both ends of an arc added by compensation: blended with its line it would cut the
//!   corner, as it does in G64.
//! - An arc whose centre is its end point has no end direction and is rejected.
//! - A thread along another direction than the machine's Z is rejected; its pitch F / S is in machine
//!   coordinates.
//! - Only the servo knows the end of a G31: no block may be pushed before [`PathStage::skipped_to`] has been
//!   called ([`PathStage::is_skipping`]).
//! - Soft limits are checked for the axes that a block moves, on an arc also at its turning points; a machine beyond a
//!   limit may return.

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
