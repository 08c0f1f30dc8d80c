//! Corners at which the motion could not stay within the tolerance of the path (D59).
//!
//! Where two blocks blend, one slows down while the other speeds up, both over the time `T = ta + ts`. In the middle of it the
//! tool is off the corner by `|v2 - v1| T / 8`, the velocities as vectors. A change of curvature adds up to
//! `|k2 - k1| (v T)^2 / 100`: at three quarters of it the tool has gone `9/32 v T` on the next block and is `8/32 v T` from the
//! corner, so it is off by `(81 - 64)/1024 (v T)^2 k / 2`.

use tandem_model::AxisVector;
use tandem_model::flow::{Feed, Path, Segment, SegmentMotion};

use crate::stage::PathStage;

/// Share of `k (v T)^2` that a change of curvature is off by at the most.
const OF_CURVATURE: f64 = 0.01;

impl PathStage {
    /// True when the tool would be further off the corner between two segments than the tolerance.
    pub(crate) fn is_sharp(&self, before: &Segment, after: &Segment) -> bool {
        let (Some(last), Some(next)) = (Course::of(before, true), Course::of(after, false)) else {
            return false;
        };
        let ramp_s = (last.feed.td_ms + last.feed.ts_ms).max(next.feed.ta_ms + next.feed.ts_ms) / 1000.0;
        let speed = last.speed().max(next.speed());
        let turn = next.velocity().minus(last.velocity()).orthogonal_length() * ramp_s / 8.0;
        let bend = next.curvature.minus(last.curvature).orthogonal_length();
        turn + bend * (speed * ramp_s).powi(2) * OF_CURVATURE > self.settings.nc.corner_tolerance_mm
    }
}

/// How a segment goes at one of its ends.
struct Course {
    /// Change of the position per unit of the path's length.
    along: AxisVector,
    curvature: AxisVector,
    feed: Feed,
}

impl Course {
    fn of(segment: &Segment, at_end: bool) -> Option<Self> {
        let SegmentMotion::Feed { path, feed } = &segment.motion else {
            return None;
        };
        let [along, curvature] = match path {
            Path::Line { from, to, length } => [to.minus(*from).scaled(1.0 / length), AxisVector::ZERO],
            Path::Arc(arc) => arc.derivatives_at(if at_end { arc.length() } else { 0.0 }),
        };
        Some(Self {
            along,
            curvature,
            feed: *feed,
        })
    }

    /// mm/s.
    fn speed(&self) -> f64 {
        self.feed.feedrate_mm_min / 60.0
    }

    fn velocity(&self) -> AxisVector {
        self.along.scaled(self.speed())
    }
}
