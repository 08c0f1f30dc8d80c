//! Blocks to path segments: transforms, offsets, geometry.
//!
//! [`PathStage`] is asked with one block after the other and answers segments in machine coordinates. It is pure:
//! the same blocks give the same segments. Lines, arcs (G02, G03), G00, G04, G28, G30, G31 and G53 so far, under all
//! transforms of D20. What is not built is refused with an alarm: G500, cutter compensation and tapping.
//!
//! Decisions of ours, where the manual is silent:
//! - A move shorter than [`LENGTH_MIN`] on every axis is no move: no segment, the position stays. Its exact stop
//!   still counts, and G00 still ends a chain.
//! - A block without movement ends a chain of blended blocks (motion-semantics 1c, G501).
//! - A change of tool length is made good by the next motion block in work coordinates; G53 with Z makes it void (D22).
//! - An axis that no word moves stays to the last bit; under a rotation both axes of its plane count as moved when a
//!   word names one of them.
//! - An arc under a rotation of another plane is refused as one under unequal scale is (D21): it would leave its plane.
//! - An arc whose centre is its end point has no end direction and is refused.
//! - Where G31 ends only the servo knows: no block may be pushed before [`PathStage::skipped_to`] has told it.
//! - Soft limits are checked for the axes that a block moves, on an arc at its turning points, too; a
//!   machine that stands beyond a limit may come back.

mod arc;
mod stage;
mod target;
mod transform;

pub use stage::{LENGTH_MIN, PathStage, work_position};
