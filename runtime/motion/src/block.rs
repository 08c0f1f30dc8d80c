//! A block of a chain: as input of the chain, and as planned before look-ahead sets its pace.

use std::sync::Arc;

use tandem_model::Origin;
use tandem_model::flow::Path;
use tandem_model::profile::{ChainPlace, Law, Pace, PacedMotion, Profile, RampedMotion};

use crate::ramped::SingleBlock;
use crate::smooth_block::SmoothBlock;

/// A segment, as input of a chain.
#[derive(Debug, Clone)]
pub(crate) struct ChainBlock {
    pub(crate) segment: u64,
    pub(crate) epoch: u32,
    pub(crate) origin: Origin,
    pub(crate) path: Path,
    /// The same block planned from rest to rest.
    pub(crate) alone: SingleBlock,
}

/// The contents of a profile of a chain without a pace. Tens of thousands of these blocks are held back and
/// recorded, so they must be small.
#[derive(Debug, Clone)]
pub(crate) struct PlannedBlock {
    pub(crate) segment: u64,
    pub(crate) epoch: u32,
    pub(crate) origin: Origin,
    pub(crate) motion: BlockMotion,
}

/// Motion of a block at its programmed speed.
#[allow(
    clippy::large_enum_variant,
    reason = "blocks are moved here by the ten thousand: none of them is allocated"
)]
#[derive(Debug, Clone)]
pub(crate) enum BlockMotion {
    /// A block with ramps to the blocks before and after it (M1b).
    Ramped { block: RampedMotion, place: ChainPlace },
    /// A block on a smoothed path. The block is shared, because replanning copies it.
    Smoothed(Arc<SmoothBlock>),
}

impl PlannedBlock {
    /// Returns the plan time at the end of the block, s.
    pub(crate) fn plan_s(&self) -> f64 {
        match &self.motion {
            BlockMotion::Ramped { block, .. } => block.plan_s,
            BlockMotion::Smoothed(block) => block.plan_s,
        }
    }

    /// Returns true if the block's own path is at rest at this plan time.
    pub(crate) fn begins_at_rest(&self, plan_s: f64) -> bool {
        match &self.motion {
            BlockMotion::Ramped { block, .. } => block.begun_s + plan_s == 0.0,
            BlockMotion::Smoothed(block) => block.begins_at_rest && plan_s == 0.0,
        }
    }

    pub(crate) fn ends_at_rest(&self) -> bool {
        match &self.motion {
            BlockMotion::Ramped { block, .. } => block.next.is_none(),
            BlockMotion::Smoothed(block) => block.ends_at_rest,
        }
    }

    /// Returns the profile of a block with G501: as planned, without look-ahead. A smoothed block has none.
    pub(crate) fn profile(&self) -> Option<Profile> {
        let BlockMotion::Ramped { block, place } = &self.motion else {
            return None;
        };
        let law = Law::Ramped {
            block: block.clone(),
            place: *place,
        };
        Some(self.by(law, block.plan_s, self.ends_at_rest()))
    }

    /// Converts a part of the block to a profile that passes it at this pace, in this time.
    #[inline]
    pub(crate) fn paced(&self, block: PacedMotion, pace: Pace, duration_s: f64, exact_stop: bool) -> Profile {
        self.by(Law::Paced { block, pace }, duration_s, exact_stop)
    }

    #[inline]
    fn by(&self, law: Law, duration_s: f64, exact_stop: bool) -> Profile {
        Profile {
            segment: self.segment,
            epoch: self.epoch,
            origin: self.origin,
            law,
            duration_s,
            exact_stop,
        }
    }
}
