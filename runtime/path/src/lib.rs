//! Blocks to path segments: transforms, offsets, geometry.
//!
//! [`PathStage`] is asked with one block after the other and answers segments in machine coordinates. It is pure:
//! the same blocks give the same segments. Straight lines, G00 and G04 so far; the transform is the work offset.
//!
//! Decisions of ours, where the manual is silent:
//! - A move shorter than [`LENGTH_MIN`] on every axis is no move: no segment, the position stays. Its exact stop
//!   still counts, and G00 still ends a chain.
//! - A block without movement ends a chain of blended blocks (motion-semantics 1c, G501).
//! - Soft limits are checked for the axes that a block moves.

mod stage;

pub use stage::{LENGTH_MIN, PathStage, work_position};
