//! A smoothed path within `path_tolerance` (M1d.8), for chains with G500.
//!
//! Three stages, each of which works on the blocks read so far and outputs what no later block can change:
//!
//! 1. [`chords`]: arcs become chords, and consecutive short lines become one chord.
//! 2. [`widths`]: each vertex between two chords receives the half width of a kernel, the largest with which the
//!    path stays within the tolerance.
//! 3. [`curve`]: the vertices become curves. The second derivative of the path by distance is the sum of the turns
//!    of all vertices, each spread over a triangle of its width. So the path is a polynomial of third degree between
//!    the corners of the triangles, its curvature is continuous, and its third derivative is bounded.
//!
//! A triangle moves the path at its vertex by a sixth of its half width times the turn, towards the inside of the
//! corner. The sum of these distances, without regard to their directions, is an upper bound of the deviation. So
//! the tolerance holds by construction, not because samples were checked.

mod chords;
mod curve;
mod widths;

use std::collections::VecDeque;
use std::sync::Arc;

use tandem_model::{AxisVector, Origin};

use self::chords::Chords;
use self::widths::Vertices;
use crate::block::{BlockMotion, ChainBlock, PlannedBlock};

/// A block of the chain whose curve is not final.
#[derive(Debug, Clone)]
struct WaitingBlock {
    segment: u64,
    epoch: u32,
    origin: Origin,
    /// Programmed start and end.
    programmed: [AxisVector; 2],
    /// Speed, path units per second.
    speed: f64,
    /// Time of the ramps from rest and to rest, s.
    ramps_s: [f64; 2],
    /// Distance along the chain at the start and at the end of the block.
    range: [f64; 2],
}

/// The smoothing of one chain.
#[derive(Debug, Clone, Default)]
pub(crate) struct Smoothing {
    tolerance: f64,
    chords: Chords,
    vertices: Vertices,
    waiting: VecDeque<WaitingBlock>,
    has_begun: bool,
}

impl Smoothing {
    /// Creates the smoothing for a tolerance in mm, and in degrees for rotary axes.
    pub(crate) fn new(tolerance: f64) -> Self {
        Self {
            tolerance,
            ..Self::default()
        }
    }

    pub(crate) fn clear(&mut self) {
        *self = Self::new(self.tolerance);
    }

    /// Adds a block to the chain, and outputs the blocks whose curves are final.
    pub(crate) fn push(&mut self, block: &ChainBlock, out: impl FnMut(PlannedBlock)) {
        let from = self.chords.length();
        self.chords
            .push(&block.path, block.alone.limit, self.tolerance, &mut self.vertices);
        self.waiting.push_back(WaitingBlock {
            segment: block.segment,
            epoch: block.epoch,
            origin: block.origin,
            programmed: [block.path.start(), block.path.end()],
            speed: block.alone.limit,
            ramps_s: block.alone.ramps_s(),
            range: [from, self.chords.length()],
        });
        self.vertices.settle(false);
        self.release(false, out);
    }

    /// Ends the chain at rest, and outputs all its blocks.
    pub(crate) fn finish(&mut self, out: impl FnMut(PlannedBlock)) {
        self.chords.finish(&mut self.vertices);
        self.vertices.settle(true);
        self.release(true, out);
        self.clear();
    }

    fn release(&mut self, is_last: bool, mut out: impl FnMut(PlannedBlock)) {
        let known = if is_last {
            f64::INFINITY
        } else {
            self.vertices.known_to()
        };
        while let Some(block) = self.waiting.pop_front_if(|block| block.range[1] <= known) {
            let begins_at_rest = !std::mem::replace(&mut self.has_begun, true);
            let ends_at_rest = is_last && self.waiting.is_empty();
            let curve = curve::smooth_block(&block, &self.vertices, [begins_at_rest, ends_at_rest]);
            self.vertices.forget_before(block.range[1]);
            out(PlannedBlock {
                segment: block.segment,
                epoch: block.epoch,
                origin: block.origin,
                motion: BlockMotion::Smoothed(Arc::new(curve)),
            });
        }
    }
}
