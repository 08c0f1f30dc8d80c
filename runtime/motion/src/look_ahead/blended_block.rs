//! A blended block as planned: velocity and acceleration of each axis as functions of plan time, with bounds
//! between the samples.

use tandem_model::flow::Path;
use tandem_model::profile::{Lead, RampedMotion};
use tandem_model::ramp::UnitRamp;
use tandem_model::{ArcPath, Axis, AxisVector};

/// Relative difference below which two speeds are treated as equal.
const SAME_SPEED: f64 = 1e-3;

/// Ratio from which two speeds are not measured by distance, because rounding of plan time would hide the
/// square of the ratio.
const RATIO_MAX: f64 = 1e4;

/// The motion of a block, and of the start of the next block, in plan time.
#[derive(Debug, Clone, Copy)]
pub(super) struct BlendedBlock<'a> {
    pub(super) block: &'a RampedMotion,
    /// Change of each axis per unit of length, for the block and for the next block.
    pub(super) slopes: [AxisVector; 2],
    /// Speeds of both blocks. `None` if they are equal.
    pub(super) uneven: Option<[f64; 2]>,
    pub(super) passage: Passage,
}

/// Start and direction of the motion along a block.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Passage {
    /// Start of the motion, s: plan time from the end of the block where a whole passage begins.
    pub(crate) from_s: f64,
    /// True for motion from the end of the block to its start. Plan time is then measured from the end.
    pub(crate) is_backward: bool,
}

/// A phase of a ramp, or the part between the ramps, with its begin and end in plan time, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Phase {
    pub(super) from_s: f64,
    pub(super) to_s: f64,
    pub(super) part: BlockPart,
}

/// The part of a block to which a phase belongs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum BlockPart {
    /// The ramp at the start of the block.
    Start,
    /// The part between the ramps.
    Between,
    /// The ramp at the end of the block, along which the next block begins.
    Stop,
}

/// One end of a piece: plan time, and velocity and acceleration with respect to plan time.
#[derive(Debug, Clone, Copy)]
pub(super) struct PieceEnd {
    pub(super) t_s: f64,
    /// Motion along the block and along the next block.
    along: [PathDerivatives; 2],
    pub(super) velocity: AxisVector,
    pub(super) acceleration: AxisVector,
}

/// Bounds of the derivatives of the distance along a block over a piece. They are with respect to plan time,
/// or to the distance along both blocks.
#[derive(Debug, Clone, Copy)]
pub(super) struct DerivativeBounds {
    pub(super) speed: f64,
    pub(super) acceleration: f64,
    pub(super) jerk: f64,
}

/// First and second derivative of the position with respect to plan time at both ends of a piece, and bounds
/// of the third and fourth derivative over the piece.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct PieceMotion {
    pub(super) velocity: [AxisVector; 2],
    pub(super) acceleration: [AxisVector; 2],
    pub(super) third: AxisVector,
    pub(super) fourth: AxisVector,
}

/// Distance along a path and its first three derivatives by plan time. The third is constant within a phase.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PathDerivatives {
    pub(super) distance: f64,
    pub(super) speed: f64,
    pub(super) acceleration: f64,
    pub(super) jerk: f64,
}

impl<'a> BlendedBlock<'a> {
    pub(super) fn new(block: &'a RampedMotion, passage: Passage) -> Self {
        let next = block.next.as_ref();
        Self {
            block,
            slopes: [
                slopes(&block.path),
                next.map_or(AxisVector::ZERO, |next| slopes(&next.path)),
            ],
            uneven: next.map(|next| [block.speed, next.speed]).filter(differ),
            passage,
        }
    }

    /// Returns true if the path of the block begins at rest.
    pub(super) fn begins_at_rest(&self) -> bool {
        self.block.begun_s == 0.0
    }

    /// Returns true if the block or the next block is an arc.
    pub(super) fn bends(&self) -> bool {
        let is_arc = |path: &Path| matches!(path, Path::Arc(_));
        let next = self.block.next.as_ref();
        is_arc(&self.block.path) || next.is_some_and(|next| is_arc(&next.path))
    }

    /// Returns true if a phase belongs to the ramp from rest or to rest.
    pub(super) fn is_slow(&self, phase: &Phase) -> bool {
        match phase.part {
            BlockPart::Start => self.begins_at_rest(),
            BlockPart::Stop => self.block.next.is_none(),
            BlockPart::Between => false,
        }
    }

    /// Returns the speed along the block at a plan time within a phase, relative to the speed of the block.
    pub(super) fn share_of_speed(&self, t_s: f64, phase: &Phase) -> f64 {
        let forward_s = |t_s: f64| {
            if self.passage.is_backward {
                self.block.plan_s - t_s
            } else {
                t_s
            }
        };
        let within_s = f64::midpoint(phase.from_s, phase.to_s);
        let [own, _] = self.along(forward_s(t_s), forward_s(within_s));
        own.speed / self.block.speed
    }

    pub(super) fn stop_begins_s(&self) -> f64 {
        self.block.plan_s - self.block.stop.duration_s()
    }

    /// Returns the phases of the block in order. The motion is smooth within each phase.
    pub(super) fn phases(&self) -> [Phase; 7] {
        let ramp = |ramp: UnitRamp, begins_s: f64, part: BlockPart| {
            ramp.phases().map(|[from_s, to_s]| Phase {
                from_s: begins_s + from_s,
                to_s: begins_s + to_s,
                part,
            })
        };
        let [a, b, c] = ramp(self.block.start, -self.block.begun_s, BlockPart::Start);
        let [e, f, mut g] = ramp(self.block.stop, self.stop_begins_s(), BlockPart::Stop);
        g.to_s = self.block.plan_s;
        let between = Phase {
            from_s: c.to_s.max(0.0),
            to_s: e.from_s,
            part: BlockPart::Between,
        };
        let phases = [a, b, c, between, e, f, g];
        if self.passage.is_backward {
            let [a, b, c, d, e, f, g] = phases.map(|phase| Phase {
                from_s: self.block.plan_s - phase.to_s,
                to_s: (self.block.plan_s - phase.from_s).min(self.block.plan_s),
                ..phase
            });
            return [g, f, e, d, c, b, a];
        }
        phases
    }

    /// Returns the motion along the block and along the next block at `t_s`, by the formula of the phase that
    /// contains `within_s`.
    pub(super) fn along(&self, t_s: f64, within_s: f64) -> [PathDerivatives; 2] {
        let stopping_s = self.stop_begins_s();
        let [begun, within] = [t_s + self.block.begun_s, within_s + self.block.begun_s];
        let [s1, s2] = self.block.start.slopes(begun, within);
        let [p1, p2] = self.block.stop.slopes(t_s - stopping_s, within_s - stopping_s);
        let stopped = self.block.stop.speed(t_s - stopping_s);
        let stopped_s = self.block.stop.distance(t_s - stopping_s);
        let own = PathDerivatives {
            distance: self.block.speed * (self.block.start.distance(begun) - stopped_s),
            speed: self.block.speed * (self.block.start.speed(begun) - stopped).max(0.0),
            acceleration: self.block.speed * (s1 - p1),
            jerk: self.block.speed * (s2 - p2),
        };
        let speed = self.block.next.as_ref().map_or(0.0, |next| next.speed);
        let next = PathDerivatives {
            distance: speed * stopped_s,
            speed: speed * stopped,
            acceleration: speed * p1,
            jerk: speed * p2,
        };
        [own, next]
    }

    /// Returns one end of a piece at `t_s`, by the formula of the phase that contains `within_s`.
    pub(super) fn piece_end(&self, t_s: f64, within_s: f64) -> PieceEnd {
        if self.passage.is_backward {
            let end = self.forward_end(self.block.plan_s - t_s, self.block.plan_s - within_s);
            return PieceEnd {
                t_s,
                ..end.reversed()
            };
        }
        self.forward_end(t_s, within_s)
    }

    fn forward_end(&self, t_s: f64, within_s: f64) -> PieceEnd {
        let [own, next] = self.along(t_s, within_s);
        let mut end = PieceEnd::at(t_s, [own, next]);
        end.add(&self.block.path, self.slopes[0], own);
        if let Some(Lead { path, .. }) = &self.block.next
            && !next.rests()
        {
            end.add(path, self.slopes[1], next);
        }
        end
    }

    /// Returns the motion over a piece between two ends that lie in one phase.
    pub(super) fn between(&self, from: &PieceEnd, to: &PieceEnd) -> PieceMotion {
        let mut motion = PieceMotion::from_ends(from, to);
        motion.bound(&self.block.path, self.slopes[0], [from.along[0], to.along[0]]);
        let along = [from.along[1], to.along[1]];
        if let Some(Lead { path, .. }) = &self.block.next
            && !along.iter().all(PathDerivatives::rests)
        {
            motion.bound(path, self.slopes[1], along);
        }
        motion
    }
}

/// Returns the change of each axis per unit of a line's length; 0 for an arc.
fn slopes(path: &Path) -> AxisVector {
    match path {
        Path::Line { from, to, length } => to.minus(*from).scaled(1.0 / length),
        Path::Arc(_) => AxisVector::ZERO,
    }
}

impl PathDerivatives {
    /// Returns true if speed, acceleration and jerk are 0.
    fn rests(&self) -> bool {
        self.speed == 0.0 && self.acceleration == 0.0 && self.jerk == 0.0
    }
}

impl PieceEnd {
    /// Creates an end at rest; [`PieceEnd::add`] then adds the motion of each block.
    pub(super) fn at(t_s: f64, along: [PathDerivatives; 2]) -> Self {
        Self {
            t_s,
            along,
            velocity: AxisVector::ZERO,
            acceleration: AxisVector::ZERO,
        }
    }

    /// Creates an end with this motion.
    pub(super) fn of_motion(t_s: f64, velocity: AxisVector, acceleration: AxisVector) -> Self {
        Self {
            velocity,
            acceleration,
            ..Self::at(t_s, [PathDerivatives::default(); 2])
        }
    }

    /// Returns the end for backward motion: the velocity changes its sign, the acceleration does not.
    pub(super) fn reversed(self) -> Self {
        Self {
            velocity: self.velocity.scaled(-1.0),
            ..self
        }
    }

    /// Adds the motion of a block by the chain rule and returns `dp/ds`. Here `p(s)` is the path, `s` the
    /// distance along it.
    pub(super) fn add(&mut self, path: &Path, slopes: AxisVector, along: PathDerivatives) -> AxisVector {
        let (first, second) = match path {
            Path::Line { .. } => (slopes, AxisVector::ZERO),
            Path::Arc(arc) => {
                let [first, second] = arc.derivatives_at(along.distance);
                (first, second.scaled(along.speed * along.speed))
            }
        };
        self.velocity = self.velocity.plus(first.scaled(along.speed));
        self.acceleration = self
            .acceleration
            .plus(second)
            .plus(first.scaled(along.acceleration));
        first
    }
}

impl PieceMotion {
    /// Returns an upper bound of the speed of an axis on a piece of this length.
    pub(super) fn fastest(&self, axis: Axis, h_s: f64) -> f64 {
        let [begin, end] = self.velocity.map(|velocity| velocity[axis].abs());
        begin.max(end) + self.third[axis] * h_s * h_s / 8.0
    }

    /// Creates the motion between two ends, with bounds of 0.
    pub(super) fn from_ends(from: &PieceEnd, to: &PieceEnd) -> Self {
        Self {
            velocity: [from.velocity, to.velocity],
            acceleration: [from.acceleration, to.acceleration],
            ..Self::default()
        }
    }

    /// Adds the bounds of a block with respect to plan time.
    fn bound(&mut self, path: &Path, slopes: AxisVector, [from, to]: [PathDerivatives; 2]) {
        let jerk = from.jerk.abs();
        match path {
            Path::Line { .. } => {
                if jerk != 0.0 {
                    self.third = self.third.zip(slopes, |sum, slope| sum + slope.abs() * jerk);
                }
            }
            Path::Arc(arc) => {
                // Speed and acceleration along the path are monotone within a phase.
                let most = DerivativeBounds {
                    speed: from.speed.max(to.speed),
                    acceleration: from.acceleration.abs().max(to.acceleration.abs()),
                    jerk,
                };
                self.bend(arc, [from.distance, to.distance], most, jerk);
            }
        }
    }

    /// Adds the bounds of an arc. `along` is the jerk along the arc in the bound of the third derivative.
    pub(super) fn bend(&mut self, arc: &ArcPath, [from, to]: [f64; 2], most: DerivativeBounds, along: f64) {
        let DerivativeBounds {
            speed: v,
            acceleration: a,
            jerk: j,
        } = most;
        let [in_plane, beside] = arc.derivative_bounds(from, to);
        let bounds = |[b1, b2, b3, b4]: [f64; 4]| {
            [
                b3 * v * v * v + 3.0 * b2 * v * a + b1 * along,
                b4 * (v * v) * (v * v) + 6.0 * b3 * v * v * a + b2 * (4.0 * v * j + 3.0 * a * a),
            ]
        };
        let [third, fourth] = bounds(beside);
        let way = beside_plane(arc);
        self.third = self.third.zip(way, |sum, way| sum + third * way);
        self.fourth = self.fourth.zip(way, |sum, way| sum + fourth * way);
        let [third, fourth] = bounds(in_plane);
        for axis in arc.plane().axes() {
            self.third[axis] += third;
            self.fourth[axis] += fourth;
        }
    }
}

/// Returns the distances of the axes outside the plane of an arc; 0 for the axes in the plane.
fn beside_plane(arc: &ArcPath) -> AxisVector {
    let way = arc.end().minus(arc.start());
    let mut way = AxisVector(way.0.map(f64::abs));
    for axis in arc.plane().axes() {
        way[axis] = 0.0;
    }
    way
}

/// Returns the largest second and third derivative of each axis with respect to distance, between two
/// distances.
pub(super) fn bends(arc: &ArcPath, [from, to]: [f64; 2]) -> [AxisVector; 2] {
    let [in_plane, beside] = arc.derivative_bounds(from, to);
    [1, 2].map(|n| {
        let mut most = beside_plane(arc).scaled(beside[n]);
        for axis in arc.plane().axes() {
            most[axis] = in_plane[n];
        }
        most
    })
}

/// Returns true if the speeds differ by more than rounding, and their ratio is below the value at which their
/// powers overflow.
fn differ([one, other]: &[f64; 2]) -> bool {
    let ratio = one.max(*other) / one.min(*other);
    (1.0 + SAME_SPEED..RATIO_MAX).contains(&ratio)
}
