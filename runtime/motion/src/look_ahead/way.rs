//! Motion of a block in plan time, on a programmed or on a smoothed path.

use tandem_model::AxisVector;
use tandem_model::profile::CubicMotion;

use super::blended_block::{BlendedBlock, Passage, PieceEnd, PieceMotion};
use super::course::Course;
use super::limits::{Bounds, Motors};
use crate::block::BlockMotion;
use crate::smooth_block::{SmoothBlock, Stretch};

/// The motion of a block. Plan time is measured in the direction of the motion.
#[derive(Debug, Clone, Copy)]
pub(super) enum Way<'a> {
    /// A block with ramps to the blocks before and after it.
    Blended(BlendedBlock<'a>),
    Smoothed(SmoothedWay<'a>),
}

/// The motion of a block on a smoothed path.
#[derive(Debug, Clone, Copy)]
pub(super) struct SmoothedWay<'a> {
    pub(super) block: &'a SmoothBlock,
    passage: Passage,
}

impl<'a> Way<'a> {
    pub(super) fn new(motion: &'a BlockMotion, passage: Passage) -> Self {
        match motion {
            BlockMotion::Ramped { block, .. } => Self::Blended(BlendedBlock::new(block, passage)),
            BlockMotion::Smoothed(block) => Self::Smoothed(SmoothedWay { block, passage }),
        }
    }

    pub(super) fn plan_s(&self) -> f64 {
        match self {
            Self::Blended(way) => way.block.plan_s,
            Self::Smoothed(way) => way.block.plan_s,
        }
    }

    /// Returns the limits of the block; `cap` is the largest square of the rate.
    pub(super) fn bounds<'m>(&self, motors: &'m Motors, cap: f64) -> Bounds<'m> {
        Bounds {
            motors,
            cap,
            is_within_velocity: self.has_ramps(),
            change: match self {
                Self::Smoothed(way) if way.block.ramp_s > 0.0 => 2.0 / way.block.ramp_s,
                _ => f64::INFINITY,
            },
        }
    }

    /// Returns the plan time at which the motion begins, s.
    pub(super) fn begins_s(&self) -> f64 {
        match self {
            Self::Blended(way) => way.passage.from_s,
            Self::Smoothed(way) => way.passage.from_s,
        }
    }

    /// Returns true if ramps of the block begin and end the chain at rest at any rate. Otherwise only the rate does.
    pub(super) fn has_ramps(&self) -> bool {
        matches!(self, Self::Blended(_))
    }

    /// Returns true if the direction of the motion may change between the joints with other blocks.
    pub(super) fn bends(&self) -> bool {
        match self {
            Self::Blended(way) => way.bends(),
            Self::Smoothed(_) => true,
        }
    }

    /// Returns one end of a piece at `t_s`, by the formula of the part that contains `within_s`.
    pub(super) fn piece_end(&self, t_s: f64, within_s: f64) -> PieceEnd {
        match self {
            Self::Blended(way) => way.piece_end(t_s, within_s),
            Self::Smoothed(way) => way.piece_end(t_s, within_s),
        }
    }

    /// Returns the motion over a piece between two ends that lie in one part of the block.
    pub(super) fn between(&self, from: &PieceEnd, to: &PieceEnd) -> PieceMotion {
        match self {
            Self::Blended(way) => way.between(from, to),
            Self::Smoothed(way) => way.between(from, to),
        }
    }

    /// Returns the course of a piece within one part of the block, by plan time.
    pub(super) fn by_plan_time(&self, from_s: f64, to_s: f64) -> Course {
        let within_s = f64::midpoint(from_s, to_s);
        let (from, to) = (self.piece_end(from_s, within_s), self.piece_end(to_s, within_s));
        Course::by_plan_time(&self.between(&from, &to), to_s - from_s)
    }

    /// Returns the course of a piece within one part of the block, by distance. Returns `None` outside of ramps
    /// between different speeds.
    pub(super) fn by_distance(&self, from_s: f64, to_s: f64) -> Option<Course> {
        match self {
            Self::Blended(way) => way.by_distance(from_s, to_s),
            Self::Smoothed(_) => None,
        }
    }
}

impl<'a> SmoothedWay<'a> {
    /// Returns the stretches in the order of the motion, with the range of plan time of each, s.
    pub(super) fn stretches(self) -> impl Iterator<Item = (&'a Stretch, [f64; 2])> {
        let count = self.block.stretches.len();
        (0..count).filter_map(move |k| {
            let index = if self.passage.is_backward {
                count - 1 - k
            } else {
                k
            };
            let (stretch, to_s) = self.block.stretch(index)?;
            let [from_s, to_s] = [stretch.from_s, to_s].map(|t_s| self.forward_s(t_s));
            Some((stretch, [from_s.min(to_s), from_s.max(to_s)]))
        })
    }

    /// Returns the motion along a stretch with this range of plan time, for a profile.
    pub(super) fn motion(&self, stretch: &Stretch, [from_s, to_s]: [f64; 2]) -> CubicMotion {
        let to_s = self.forward_s(if self.passage.is_backward { from_s } else { to_s });
        self.block.motion(stretch, to_s)
    }

    pub(super) fn is_backward(&self) -> bool {
        self.passage.is_backward
    }

    /// Returns the plan time of the block for a plan time of the motion, s.
    pub(super) fn forward_s(&self, t_s: f64) -> f64 {
        if self.passage.is_backward {
            self.block.plan_s - t_s
        } else {
            t_s
        }
    }

    fn piece_end(&self, t_s: f64, within_s: f64) -> PieceEnd {
        let stretch = self.block.stretch_at(self.forward_s(within_s));
        let [velocity, acceleration] = stretch.motion_at(self.forward_s(t_s));
        let end = PieceEnd::of_motion(t_s, velocity, acceleration);
        if self.passage.is_backward {
            end.reversed()
        } else {
            end
        }
    }

    fn between(&self, from: &PieceEnd, to: &PieceEnd) -> PieceMotion {
        let within_s = f64::midpoint(from.t_s, to.t_s);
        let stretch = self.block.stretch_at(self.forward_s(within_s));
        let [.., third] = stretch.derivatives;
        PieceMotion {
            third: AxisVector(third.0.map(f64::abs)),
            ..PieceMotion::from_ends(from, to)
        }
    }
}
