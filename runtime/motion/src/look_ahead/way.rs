//! A blended block as planned: velocity and acceleration of each axis by plan time, with bounds of what lies between.

use tandem_model::flow::Path;
use tandem_model::profile::{Law, Profile};
use tandem_model::ramp::UnitRamp;
use tandem_model::{Axis, AxisVector};

/// The motion of one profile in plan time: its block between its ramps, and the begin of the next block.
#[derive(Debug, Clone, Copy)]
pub(super) struct Way<'a> {
    pub(super) path: &'a Path,
    pub(super) speed: f64,
    lead: Option<(&'a Path, f64)>,
    start: UnitRamp,
    stop: UnitRamp,
    begun_s: f64,
    pub(super) plan_s: f64,
    pub(super) passage: Passage,
}

/// How a block is passed.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Passage {
    /// Where it begins, s from the end that comes first.
    pub(crate) from_s: f64,
    /// From its end to its begin: plan time counts from its end then.
    pub(crate) is_backward: bool,
}

/// A phase of a ramp, or the way between the ramps, by its begin and end in plan time, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Phase {
    pub(super) from_s: f64,
    pub(super) to_s: f64,
    pub(super) is_ramp: bool,
}

/// First and second derivative of the position by plan time at both ends of a piece, and bounds of the third and fourth
/// derivative over it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Motion {
    pub(super) velocity: [AxisVector; 2],
    pub(super) acceleration: [AxisVector; 2],
    pub(super) third: AxisVector,
    pub(super) fourth: AxisVector,
}

/// Distance along a path and its first three derivatives by plan time; the third is constant within a phase.
#[derive(Debug, Clone, Copy)]
struct Along {
    distance: f64,
    speed: f64,
    acceleration: f64,
    jerk: f64,
}

impl<'a> Way<'a> {
    /// Of a profile along a path; `None` for any other.
    pub(super) fn new(profile: &'a Profile, passage: Passage) -> Option<Self> {
        let Law::Ramped {
            path,
            speed,
            start,
            stop,
            begun_s,
            next,
        } = &profile.law
        else {
            return None;
        };
        Some(Self {
            path,
            speed: *speed,
            lead: next.as_ref().map(|next| (&next.path, next.speed)),
            start: *start,
            stop: *stop,
            begun_s: *begun_s,
            plan_s: profile.duration_s,
            passage,
        })
    }

    /// True when its path begins at rest.
    pub(super) fn begins_at_rest(&self) -> bool {
        self.begun_s == 0.0
    }

    fn stop_begins_s(&self) -> f64 {
        self.plan_s - self.stop.duration_s()
    }

    /// Its phases in order, each of smooth motion.
    pub(super) fn phases(&self) -> [Phase; 7] {
        let ramp = |ramp: UnitRamp, begins_s: f64| {
            ramp.phases().map(|[from_s, to_s]| Phase {
                from_s: begins_s + from_s,
                to_s: begins_s + to_s,
                is_ramp: true,
            })
        };
        let [a, b, c] = ramp(self.start, -self.begun_s);
        let [e, f, mut g] = ramp(self.stop, self.stop_begins_s());
        g.to_s = self.plan_s;
        let between = Phase {
            from_s: c.to_s.max(0.0),
            to_s: e.from_s,
            is_ramp: false,
        };
        let phases = [a, b, c, between, e, f, g];
        if self.passage.is_backward {
            let [a, b, c, d, e, f, g] = phases.map(|phase| Phase {
                from_s: self.plan_s - phase.to_s,
                to_s: (self.plan_s - phase.from_s).min(self.plan_s),
                ..phase
            });
            return [g, f, e, d, c, b, a];
        }
        phases
    }

    /// Its own block and the next one, `within_s` telling the phase.
    fn along(&self, t_s: f64, within_s: f64) -> [Along; 2] {
        let stopping_s = self.stop_begins_s();
        let [begun, within] = [t_s + self.begun_s, within_s + self.begun_s];
        let [s1, s2] = self.start.slopes(begun, within);
        let [p1, p2] = self.stop.slopes(t_s - stopping_s, within_s - stopping_s);
        let stopped = self.stop.speed(t_s - stopping_s);
        let stopped_s = self.stop.distance(t_s - stopping_s);
        let own = Along {
            distance: self.speed * (self.start.distance(begun) - stopped_s),
            speed: self.speed * (self.start.speed(begun) - stopped).max(0.0),
            acceleration: self.speed * (s1 - p1),
            jerk: self.speed * (s2 - p2),
        };
        let speed = self.lead.map_or(0.0, |(_, speed)| speed);
        let next = Along {
            distance: speed * stopped_s,
            speed: speed * stopped,
            acceleration: speed * p1,
            jerk: speed * p2,
        };
        [own, next]
    }

    /// The motion over a piece within one phase.
    pub(super) fn motion(&self, from_s: f64, to_s: f64) -> Motion {
        if self.passage.is_backward {
            self.forward(self.plan_s - to_s, self.plan_s - from_s).reversed()
        } else {
            self.forward(from_s, to_s)
        }
    }

    fn forward(&self, from_s: f64, to_s: f64) -> Motion {
        let within_s = f64::midpoint(from_s, to_s);
        let from = self.along(from_s, within_s);
        let to = self.along(to_s, within_s);
        let mut motion = Motion::default();
        motion.add(self.path, from[0], to[0]);
        if let Some((path, _)) = self.lead {
            motion.add(path, from[1], to[1]);
        }
        motion
    }
}

impl Motion {
    /// The same way back: velocities change their sign, accelerations do not.
    fn reversed(self) -> Self {
        let [v0, v1] = self.velocity;
        let [a0, a1] = self.acceleration;
        Self {
            velocity: [v1.scaled(-1.0), v0.scaled(-1.0)],
            acceleration: [a1, a0],
            ..self
        }
    }

    /// Adds a block's share; with `p(s)` the path and `s` the distance along it, by the chain rule.
    fn add(&mut self, path: &Path, from: Along, to: Along) {
        match path {
            Path::Line {
                from: start,
                to: end,
                length,
            } => {
                let direction = end.minus(*start).scaled(1.0 / length);
                for (k, along) in [from, to].into_iter().enumerate() {
                    self.velocity[k] = self.velocity[k].plus(direction.scaled(along.speed));
                    self.acceleration[k] = self.acceleration[k].plus(direction.scaled(along.acceleration));
                }
                if from.jerk != 0.0 {
                    let jerk = from.jerk.abs();
                    self.third = self.third.zip(direction, |sum, share| sum + share.abs() * jerk);
                }
            }
            Path::Arc(arc) => {
                for (k, along) in [from, to].into_iter().enumerate() {
                    let [first, second] = arc.derivatives_at(along.distance);
                    self.velocity[k] = self.velocity[k].plus(first.scaled(along.speed));
                    self.acceleration[k] = self.acceleration[k]
                        .plus(second.scaled(along.speed * along.speed))
                        .plus(first.scaled(along.acceleration));
                }
                let [b1, b2, b3, b4] = arc.derivative_bounds(from.distance, to.distance);
                // Speed and acceleration along the path are monotone within a phase.
                let v = from.speed.max(to.speed);
                let a = from.acceleration.abs().max(to.acceleration.abs());
                let j = from.jerk.abs();
                for axis in Axis::ALL {
                    self.third[axis] += b3[axis] * v * v * v + 3.0 * b2[axis] * v * a + b1[axis] * j;
                    self.fourth[axis] += b4[axis] * v.powi(4)
                        + 6.0 * b3[axis] * v * v * a
                        + b2[axis] * (4.0 * v * j + 3.0 * a * a);
                }
            }
        }
    }
}
