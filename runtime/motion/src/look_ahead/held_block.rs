//! The blocks that look-ahead holds back until their rate is final.

use super::blended_block::Passage;
use super::limits::{HalfPlane, Motors};
use super::rate::{BentPiece, Limits};
use super::way::Way;
use crate::block::{BlockMotion, PlannedBlock};

/// A block whose rate is not final.
#[derive(Debug, Clone)]
pub(super) struct HeldBlock {
    pub(super) block: PlannedBlock,
    pub(super) passage: Passage,
    /// True for the last block of its chain.
    pub(super) is_last: bool,
    pub(super) feed_override: f64,
    pub(super) pieces: usize,
    /// Largest square of the rate in the block that the override and the servo period allow.
    pub(super) cap: f64,
}

impl HeldBlock {
    /// Returns the square of the rate in this block that equals the square 1 in the next block. Rates are
    /// relative to the speed of a block, and in a chain with ramps to that of the plan.
    pub(super) fn square_of_next(&self, next: &HeldBlock) -> f64 {
        match (&self.block.motion, &next.block.motion) {
            (BlockMotion::Smoothed(own), BlockMotion::Smoothed(next)) => (next.speed / own.speed).powi(2),
            _ => 1.0,
        }
    }

    /// Returns the limits for the pieces of the block.
    pub(super) fn limits<'a>(&'a self, motors: &'a Motors, planes: &'a mut Vec<HalfPlane>) -> Limits<'a> {
        let way = Way::new(&self.block.motion, self.passage);
        Limits {
            way,
            bounds: way.bounds(motors, self.cap),
            planes,
            bent: BentPiece::default(),
        }
    }
}
