//! The blocks that look-ahead holds back until their rate is final.

use super::blended_block::{BlendedBlock, Passage};
use super::limits::{Bounds, HalfPlane, Motors};
use super::rate::{BentPiece, Limits};
use crate::block::RampedBlock;

/// A block whose rate is not final.
#[derive(Debug, Clone)]
pub(super) struct HeldBlock {
    pub(super) block: RampedBlock,
    pub(super) passage: Passage,
    /// True for the last block of its chain.
    pub(super) is_last: bool,
    pub(super) feed_override: f64,
    pub(super) pieces: usize,
    /// Largest square of the rate in the block that the override and the servo period allow.
    pub(super) cap: f64,
}

impl HeldBlock {
    /// Returns the limits for the pieces of the block.
    pub(super) fn limits<'a>(&'a self, motors: &'a Motors, planes: &'a mut Vec<HalfPlane>) -> Limits<'a> {
        Limits {
            way: BlendedBlock::new(&self.block.ramped, self.passage),
            bounds: Bounds {
                motors,
                cap: self.cap,
            },
            planes,
            bent: BentPiece::default(),
            is_even: [false; 2],
        }
    }
}
