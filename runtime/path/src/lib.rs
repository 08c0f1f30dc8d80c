//! Blocks to path segments: transforms, offsets, geometry.

mod stage;

pub use stage::{PathStage, work_position};
