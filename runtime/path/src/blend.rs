//! Bounds of a blend in which one of the two blocks is an arc: the motion may leave the hull of both blocks
//! (M1b).

use tandem_model::alarm::SOFT_LIMIT;
use tandem_model::flow::{Path, SegmentFeed, SegmentMotion};
use tandem_model::{Alarm, Axis};

use crate::length::LENGTH_MIN;
use crate::stage::PathStage;

/// Bounds of the distance of one block's path from the joint, in one direction of an axis.
#[derive(Debug, Clone, Copy)]
struct BlendSide {
    /// Maximum distance.
    height: f64,
    /// Bound of the distance at the far end of the blend, from the steepest slope of the path.
    steep: f64,
}

impl BlendSide {
    /// Returns the bound of the distance at `share`, which is 0 at the joint and 1 at the far end of the
    /// blend.
    fn at(self, share: f64) -> f64 {
        (self.steep * share).min(self.height)
    }

    /// Returns the share u of the blend's time, from the joint, at which the slope bound `steep * u^2`
    /// reaches `height`; 1 if it never does.
    fn full(self) -> f64 {
        if self.steep > self.height {
            (self.height / self.steep).sqrt()
        } else {
            1.0
        }
    }
}

impl PathStage {
    /// Checks that the blend of two blocks stays within the soft limits.
    ///
    /// The blend begins `v T/2` before the joint, and ends at the same distance after it. Each of its points
    /// is the sum of a point of both blocks minus the joint. At the share u of the blend's time, at most
    /// `(1 - u)^2` of the first block's part is left, and at most `u^2` of the second block's part is covered.
    /// Lines stay within their hull.
    pub(crate) fn blend_within_soft_limits(
        &self,
        before: &SegmentMotion,
        next: &SegmentMotion,
    ) -> Result<(), Alarm> {
        let (
            SegmentMotion::Feed { path: first, feed: f },
            SegmentMotion::Feed {
                path: second,
                feed: g,
            },
        ) = (before, next)
        else {
            return Ok(());
        };
        if matches!((first, second), (Path::Line { .. }, Path::Line { .. })) {
            return Ok(());
        }
        let ramp_s = ramp_s(f).max(ramp_s(g));
        let zones = [zone(first, f, ramp_s), zone(second, g, ramp_s)];
        let joint = second.start();
        for axis in self.limited_axes() {
            let steep = |slope: fn(&Path, Axis) -> f64| {
                [zones[0] * slope(first, axis), zones[1] * slope(second, axis)]
            };
            let away: f64 = steep(steepest_at_most).iter().sum();
            let passes = |value| self.limit_passed(axis, value).is_some();
            if !passes(joint[axis] - away) && !passes(joint[axis] + away) {
                continue;
            }
            let steep = steep(Path::steepest);
            if steep[0] + steep[1] < LENGTH_MIN {
                continue;
            }
            let reaches = [reach(first, axis), reach(second, axis)];
            let side = |n: usize, sign: f64| BlendSide {
                height: sign * (reaches[n][usize::from(sign > 0.0)] - joint[axis]),
                steep: steep[n],
            };
            let [below, above] =
                [-1.0, 1.0].map(|sign| joint[axis] + sign * farthest([side(0, sign), side(1, sign)]));
            for value in [below, above] {
                if let Some((which, limit)) = self.limit_passed(axis, value) {
                    let text = format!(
                        "Blended with the block before, axis {} may move to {value:.6} (machine), beyond its \
                         {which} limit {limit:.6}; a lower F, shorter ramps or G61 keep it nearer to the \
                         path",
                        axis.letter()
                    );
                    return Err(Alarm::new(&SOFT_LIMIT, text).of_words(axis.letter()));
                }
            }
        }
        Ok(())
    }
}

/// Returns the largest sum of both distances during the blend. Between the shares at which one of the
/// distances reaches its maximum, the sum is convex.
fn farthest([first, second]: [BlendSide; 2]) -> f64 {
    [0.0, 1.0 - first.full(), second.full(), 1.0]
        .into_iter()
        .map(|u: f64| first.at((1.0 - u).powi(2)) + second.at(u.powi(2)))
        .fold(0.0, f64::max)
}

/// Returns an upper bound of the duration of a blend, s.
fn ramp_s(feed: &SegmentFeed) -> f64 {
    (feed.ta_ms.max(feed.td_ms).max(feed.ts_ms) + feed.ts_ms) / 1000.0
}

/// Returns an upper bound of the length of a block's part in a blend. Short blocks have shorter ramps.
fn zone(path: &Path, feed: &SegmentFeed, ramp_s: f64) -> f64 {
    (feed.feedrate_mm_min / 60.0 * ramp_s / 2.0).min(path.length() / 2.0)
}

/// Returns a bound of the slope of a path that needs no calculation for X, Y and Z: no axis moves farther
/// than the path.
fn steepest_at_most(path: &Path, axis: Axis) -> f64 {
    if axis.is_orthogonal() {
        1.0
    } else {
        path.steepest(axis)
    }
}

fn reach(path: &Path, axis: Axis) -> [f64; 2] {
    match path {
        Path::Line { from, to, .. } => [from[axis].min(to[axis]), from[axis].max(to[axis])],
        Path::Arc(arc) => arc.reach(axis),
    }
}
