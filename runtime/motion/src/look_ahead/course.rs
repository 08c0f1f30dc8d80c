//! Measure of the rate on a piece: plan time or, on a ramp between blocks of different speeds, the distance
//! along both blocks.
//!
//! On such a ramp the velocity changes with plan time even when the machine moves slowly. A rate whose square
//! is linear in plan time therefore cannot keep a constant speed. Measured by distance, a ramp between two
//! blocks of one direction is a straight line. Let v1 and v2 be the speeds, `U = v1 (1 - S) + v2 S`, u the
//! distance divided by the initial speed `U_0` of the piece, and `r = U/U_0`:
//!
//! * `ds_2/du = v2 S/r` and `ds_1/du = v1 (1 - S)/r`;
//! * the second to fourth derivatives of `s_2` are `k S'/r^3`, `k (S''/r^4 - 3 p S'^2/r^5)` and `k (15 p^2 S'^3/r^7 -
//!   10 p S' S''/r^6)` with `k = v1 v2/U_0`, `p = (v2 - v1)/U_0`. The derivatives of `s_1` have the same size and the
//!   opposite sign. Each derivative of the motion is therefore this factor times the difference of the two directions.

use tandem_model::flow::Path;
use tandem_model::profile::SpeedGrowth;
use tandem_model::{Axis, AxisVector};

use super::blended_block::{self, BlendedBlock, DerivativeBounds, PathDerivatives, PieceEnd, PieceMotion};

/// A piece of the motion, by the measure of its rate: plan time or distance.
#[derive(Debug, Clone, Copy)]
pub(super) struct Course {
    pub(super) motion: PieceMotion,
    /// Length of the piece, s: plan time, or distance divided by the initial speed.
    pub(super) length_s: f64,
    /// Growth of the programmed speed; none if the measure is plan time.
    pub(super) growth: SpeedGrowth,
    /// Square of the speed at the end, divided by the square of the speed at the start. At the end this is
    /// also the ratio of the square of the rate by distance to the square of the rate by plan time.
    pub(super) scale: f64,
    /// Relative amount by which the square of the rate by plan time may exceed, between the ends, its values
    /// at the ends.
    pub(super) excess: f64,
}

impl Course {
    /// Creates a course by plan time, of this length in s.
    pub(super) fn by_plan_time(motion: &PieceMotion, length_s: f64) -> Self {
        Self {
            motion: *motion,
            length_s,
            growth: SpeedGrowth::default(),
            scale: 1.0,
            excess: 0.0,
        }
    }
}

/// State of the ramp at one end of a piece.
#[derive(Debug, Clone, Copy)]
struct RampPoint {
    t_s: f64,
    /// Share S of the ramp; the derivatives `slope` and `bend` are by the formula of the piece's phase.
    share: f64,
    slope: f64,
    bend: f64,
}

impl BlendedBlock<'_> {
    /// Returns the course of a piece within one phase, by distance. Returns `None` outside of ramps between
    /// different speeds.
    pub(super) fn by_distance(&self, from_s: f64, to_s: f64) -> Option<Course> {
        let speeds = self.uneven?;
        let stop_begins_s = self.stop_begins_s();
        let ends = [from_s, to_s].map(|t_s| {
            if self.passage.is_backward {
                self.block.plan_s - t_s
            } else {
                t_s
            }
        });
        let within_s = f64::midpoint(ends[0], ends[1]);
        if within_s <= stop_begins_s || within_s >= self.block.plan_s {
            return None;
        }
        let [begin, end] = ends.map(|t_s| {
            let [slope, bend] = self
                .block
                .stop
                .slopes(t_s - stop_begins_s, within_s - stop_begins_s);
            let share = self.block.stop.speed(t_s - stop_begins_s);
            RampPoint {
                t_s,
                share,
                slope,
                bend,
            }
        });
        let ramp = Ramp::new(speeds, &begin);
        let forward = ramp.growth(&begin);
        let growth = if self.passage.is_backward {
            forward.reversed()
        } else {
            forward
        };
        let length_s = growth.distance_s(to_s - from_s);
        // The growth is evaluated as in the pace, so that rounding of plan time causes no step of the rate.
        let grown = growth.speed(to_s - from_s);
        let least = grown.min(1.0);
        let convex = (ramp.change * begin.bend).max(0.0);
        Some(Course {
            motion: self.motion_by_distance(&ramp, [begin, end], length_s)?,
            length_s,
            growth,
            scale: grown * grown,
            excess: length_s * length_s * convex / (4.0 * least * least * least),
        })
    }

    fn motion_by_distance(&self, ramp: &Ramp, places: [RampPoint; 2], length_s: f64) -> Option<PieceMotion> {
        let [own, next] = [&self.block.path, &self.block.next.as_ref()?.path];
        let within_s = f64::midpoint(places[0].t_s, places[1].t_s);
        let alongs = places.map(|place| ramp.along(&place, self.along(place.t_s, within_s)));
        let mut turn = AxisVector::ZERO;
        let ends = places.map(|place| place.t_s);
        let [from, to] = [0, 1].map(|k| {
            let along = alongs[k];
            let mut end = PieceEnd::at(ends[k], along);
            let first = end.add(own, self.slopes[0], along[0]);
            let second = end.add(next, self.slopes[1], along[1]);
            turn = turn.zip(second.minus(first), |most, off| most.max(off.abs()));
            if self.passage.is_backward {
                end.reversed()
            } else {
                end
            }
        });
        let mut motion = PieceMotion::from_ends(&from, &to);
        let (most, snap) = ramp.most(&places);
        for (n, path) in [own, next].into_iter().enumerate() {
            if let Path::Arc(arc) = path {
                let [from, to] = alongs.map(|along| along[n]);
                let most = DerivativeBounds {
                    speed: from.speed.max(to.speed),
                    ..most
                };
                let distances = [from.distance, to.distance];
                motion.bend(arc, distances, most, 0.0);
                // The direction of each arc also changes along the piece.
                turn = turn.zip(blended_block::bends(arc, distances)[0], |turn, bent| {
                    turn + bent * most.speed * length_s / 2.0
                });
            }
        }
        for axis in Axis::ALL {
            motion.third[axis] += turn[axis] * most.jerk;
            motion.fourth[axis] += turn[axis] * snap;
        }
        Some(motion)
    }
}

/// A ramp between two speeds, relative to the initial speed of a piece.
#[derive(Debug, Clone, Copy)]
struct Ramp {
    speeds: [f64; 2],
    /// `v1 v2/U_0`
    product: f64,
    /// `v1/U_0`
    own: f64,
    /// `(v2 - v1)/U_0`
    change: f64,
}

impl Ramp {
    fn new([own, next]: [f64; 2], begin: &RampPoint) -> Self {
        let speed = own + (next - own) * begin.share;
        Self {
            speeds: [own, next],
            product: own / speed * next,
            own: own / speed,
            change: (next - own) / speed,
        }
    }

    /// Returns the speed U divided by U at the start of the piece.
    fn speed(&self, place: &RampPoint) -> f64 {
        self.own + self.change * place.share
    }

    fn growth(&self, begin: &RampPoint) -> SpeedGrowth {
        SpeedGrowth {
            first: self.change * begin.slope,
            second: self.change * begin.bend,
        }
    }

    /// Returns the motion by distance along the block and along the next block, computed from the motion by
    /// plan time.
    fn along(&self, place: &RampPoint, by_plan_time: [PathDerivatives; 2]) -> [PathDerivatives; 2] {
        let r = self.speed(place);
        let [own, next] = self.speeds;
        let acceleration = self.product * place.slope / (r * r * r);
        let [first, second] = by_plan_time;
        [
            PathDerivatives {
                speed: own * (1.0 - place.share) / r,
                acceleration: -acceleration,
                ..first
            },
            PathDerivatives {
                speed: next * place.share / r,
                acceleration,
                ..second
            },
        ]
    }

    /// Returns the bounds of the derivatives between two points of a phase, and separately of the fourth
    /// derivative. S and U are monotonic between the points.
    fn most(&self, places: &[RampPoint; 2]) -> (DerivativeBounds, f64) {
        let [begin, end] = places;
        let r = self.speed(begin).min(self.speed(end));
        let (r3, p) = (r * r * r, self.change.abs());
        let (slope, bend) = (begin.slope.abs().max(end.slope.abs()), begin.bend.abs());
        let most = DerivativeBounds {
            speed: 0.0,
            acceleration: self.product * slope / r3,
            jerk: self.product * (bend + 3.0 * p * slope * slope / r) / (r3 * r),
        };
        let snap = self.product * p * slope * (10.0 * bend + 15.0 * p * slope * slope / r) / (r3 * r3);
        (most, snap)
    }
}
