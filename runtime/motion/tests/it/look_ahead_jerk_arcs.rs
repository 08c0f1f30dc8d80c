//! G500 where motors have a maximum jerk (M1d): arcs between lines.

use std::f64::consts::{PI, TAU};

use tandem_model::flow::{MultiBlock, Path, Segment, SegmentEnd, SegmentFeed, SegmentMotion};
use tandem_model::plane::{Plane, Turn};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{ArcPath, Axis, AxisVector};

use crate::look_ahead_jerk::{LEFT, Motion, rest_ramp_s, rise};
use crate::look_ahead_random::{Random, chains, each_seed};
use crate::rig::{PERIOD_S, feed, line, motor, segment, settings, turning, vector};

/// Largest share of a limit that the curvature of an arc uses. Each of two terms uses half of the remaining
/// jerk.
const SHARE: f64 = 0.75;

/// Two motors, and a feed with its ramps.
struct Machine {
    settings: CoordinateSystemSettings,
    /// Maximum acceleration without the reserve for feed hold, and maximum jerk, of each motor.
    limits: [[f64; 2]; 2],
    v: f64,
    ramp: [f64; 2],
}

impl Machine {
    fn random(random: &mut Random) -> Self {
        let ta = random.within(0.005, 0.1);
        let limits: [[f64; 2]; 2] = std::array::from_fn(|_| {
            let acceleration = random.magnitude(100.0, 20_000.0);
            [acceleration, acceleration * random.magnitude(5.0, 200.0)]
        });
        Self {
            settings: settings(std::array::from_fn(|i| {
                let [acceleration, jerk] = *limits.get(i)?;
                Some(motor(1e5, acceleration, Some(jerk)))
            })),
            limits: limits.map(|[acceleration, jerk]| [acceleration * LEFT, jerk]),
            v: random.magnitude(5.0, 500.0),
            ramp: [ta, random.within(PERIOD_S, ta)],
        }
    }

    fn feed(&self) -> SegmentFeed {
        let [ta, ts] = self.ramp.map(|time| time * 1000.0);
        feed(self.v * 60.0, [ta, ta, ts])
    }

    fn ramp_s(&self) -> f64 {
        self.ramp.iter().sum()
    }

    /// Returns the smallest of the values that the limits of the motors allow.
    fn least(&self, allowed: impl Fn([f64; 2]) -> f64) -> f64 {
        self.limits
            .iter()
            .fold(f64::INFINITY, |least, limits| least.min(allowed(*limits)))
    }

    /// Returns the maximum change of the rate on a line, and the maximum change of this change.
    fn on_line(&self, direction: f64) -> [f64; 2] {
        let shares = [direction.cos().abs(), direction.sin().abs()].map(|share| share * self.v);
        let least = |k: usize| {
            let each = self.limits.iter().zip(shares);
            each.fold(f64::INFINITY, |least, (limits, share)| {
                least.min(limits[k] / share)
            })
        };
        [least(0), least(1)]
    }

    /// Returns a radius whose arc is long enough to change from these rates and back, and the smallest angle
    /// that the change needs.
    fn radius(&self, random: &mut Random, most: f64, ends: impl Fn(&Circle) -> [f64; 2]) -> (f64, f64) {
        let mut r = self.v * self.v / (self.limits[0][0] * random.magnitude(0.05, 50.0));
        loop {
            let circle = self.circle(r);
            let ways = ends(&circle).map(|w| rise(w, circle.top, circle.changes)[1] + self.ramp_s() / 2.0);
            let least = self.v * (ways[0] + ways[1]) / r * 1.001;
            if least < most {
                return (r, least);
            }
            r *= 1.3;
        }
    }

    /// Returns the rates of a circle with this radius, which passes through both directions.
    fn circle(&self, r: f64) -> Circle {
        let (v, [ta, ts]) = (self.v, self.ramp);
        let [bend, sway] = [v * v / r, v * v * v / (r * r)];
        let turned = bend * f64::midpoint(ta, ts);
        let within = |[a, j]: [f64; 2], more: f64| {
            let changed = turned + more;
            let acceleration = changed / ta + bend;
            let jerk = changed / (ta * ts) + 3.0 * bend / ta + sway;
            (a / acceleration).sqrt().min((j / jerk).cbrt()).min(1.0)
        };
        let top = self
            .least(|[a, j]| (SHARE * a / bend).sqrt().min((SHARE * j / sway).cbrt()))
            .min(1.0);
        let left = |j: f64| (1.0 - sway * top.powi(3) / j) / 2.0 * j;
        let by_both = |[a, j]: [f64; 2]| {
            let by_acceleration = (a - bend * top * top) / v;
            by_acceleration.min(left(j) / (3.0 * bend * top))
        };
        Circle {
            on_ramps: self.least(|limits| within(limits, 0.0)),
            from_rest: within(self.limits[0], v).min(within(self.limits[1], 0.0)),
            top,
            changes: [self.least(by_both), self.least(|[_, j]| left(j) / v)],
        }
    }
}

/// Rates of a circle.
struct Circle {
    on_ramps: f64,
    /// Rate on a ramp from rest along X, or to rest.
    from_rest: f64,
    /// Largest rate between the ramps.
    top: f64,
    /// Changes of the rate, per second and per second squared.
    changes: [f64; 2],
}

/// Lines and arcs without corners between them, long enough to change their speed within the jerk.
struct Contour {
    machine: Machine,
    at: AxisVector,
    direction: f64,
    segments: Vec<Segment>,
    time_s: f64,
}

impl Contour {
    fn new(machine: Machine, direction: f64) -> Self {
        Self {
            machine,
            at: AxisVector::ZERO,
            direction,
            segments: Vec::new(),
            time_s: 0.0,
        }
    }

    /// Creates random lines with arcs of half a turn and more between them.
    fn random(random: &mut Random) -> Self {
        let mut contour = Self::new(Machine::random(random), random.within(0.0, TAU));
        let arcs: Vec<(f64, f64)> = (0..random.bits() % 3)
            .map(|_| {
                let (r, least) = contour.machine.radius(random, 6.2, |circle| [circle.on_ramps; 2]);
                (r, random.within(least.max(PI), 6.2) * random.one_of(&[1.0, -1.0]))
            })
            .collect();
        let mut before = None;
        for (r, sweep) in arcs {
            let on_ramps = contour.machine.circle(r).on_ramps;
            contour.line(random.within(0.001, 0.3), [before, Some(on_ramps)]);
            contour.arc(r, sweep, [on_ramps; 2]);
            before = Some(on_ramps);
        }
        contour.line(random.within(0.001, 0.3), [before, None]);
        contour
    }

    /// Adds a line that takes this time at its speed, and has these rates on its ramps. `None` means rest.
    fn line(&mut self, at_speed_s: f64, ends: [Option<f64>; 2]) {
        let own = self.machine.on_line(self.direction);
        let rest_s = rest_ramp_s(own, self.machine.ramp);
        let mut plan = at_speed_s;
        if ends.contains(&None) {
            // A ramp from rest takes at most the time that F takes for its line.
            plan += rest_s / 2.0;
        }
        self.time_s += plan;
        for end in ends {
            let [time, way] = match end {
                Some(w) => {
                    let [time, way] = rise(w, 1.0, own);
                    [
                        time + self.machine.ramp_s() / w / 2.0,
                        way + self.machine.ramp_s() / 2.0,
                    ]
                }
                None => [rest_s, rest_s / 2.0],
            };
            self.time_s += time;
            plan += way;
        }
        let along = vector(&[self.direction.cos(), self.direction.sin()]);
        let to = self.at.plus(along.scaled(self.machine.v * plan));
        self.push(line(self.at, to, self.machine.feed()).motion, to);
    }

    /// Adds an arc with these rates on the ramps before and after it.
    fn arc(&mut self, r: f64, sweep: f64, ends: [f64; 2]) {
        let circle = self.machine.circle(r);
        let mut plan = r * sweep.abs() / self.machine.v;
        for w in ends {
            let [time, way] = rise(w, circle.top, circle.changes);
            self.time_s += time + self.machine.ramp_s() / w / 2.0;
            plan -= way + self.machine.ramp_s() / 2.0;
        }
        self.time_s += plan / circle.top;
        let arc = turning(self.at, self.direction, r, sweep);
        let (to, path) = (arc.end(), Path::Arc(arc));
        let feed = self.machine.feed();
        self.push(SegmentMotion::Feed { path, feed }, to);
        self.direction += sweep;
    }

    fn push(&mut self, motion: SegmentMotion, to: AxisVector) {
        self.segments.push(Segment {
            multi_block: MultiBlock::On,
            end: SegmentEnd::Continuous,
            ..segment(motion)
        });
        self.at = to;
    }

    #[track_caller]
    fn keeps_its_limits_and_takes_its_time(&self, seed: u64) {
        self.check(seed, &Motion::new(&self.machine.settings, &self.segments));
    }

    #[track_caller]
    fn check(&self, seed: u64, motion: &Motion) {
        let time = motion.time_s();
        assert!(
            (time / self.time_s - 1.0).abs() < 1e-6,
            "seed {seed}: {time} s, not {} s",
            self.time_s
        );
        let begins = motion.begins();
        let middles = begins.windows(2).map(|ends| f64::midpoint(ends[0], ends[1]));
        let all: Vec<f64> = [0.0].into_iter().chain(middles).chain([time]).collect();
        for ends in all.windows(2) {
            for (axis, [acceleration, jerk]) in Axis::ALL.into_iter().zip(self.machine.limits) {
                let most = motion.most(axis, [ends[0], ends[1]]);
                let found = format!("seed {seed}: {axis:?} {most:?} at {ends:?}");
                assert!(most[0] <= acceleration * (1.0 + 1e-6), "{found}");
                assert!(most[1] <= jerk * (1.0 + 1e-4), "{found}");
            }
        }
    }
}

#[test]
fn m1d_long_lines_and_arcs_keep_acceleration_jerk_and_formula_time() {
    each_seed(chains() / 10, |seed| {
        Contour::random(&mut Random(seed)).keeps_its_limits_and_takes_its_time(seed);
    });
}

#[test]
fn m1d_long_lines_and_arcs_backward_match_forward_limits_and_time() {
    each_seed(chains() / 20, |seed| {
        let contour = Contour::random(&mut Random(seed));
        contour.check(seed, &Motion::back(&contour.machine.settings, &contour.segments));
    });
}

#[test]
fn m1d_a_circle_from_rest_to_rest_keeps_acceleration_and_jerk() {
    each_seed(chains() / 20, |seed| {
        let mut random = Random(seed);
        let machine = Machine::random(&mut random);
        let (r, _) = machine.radius(&mut random, TAU, |circle| [circle.from_rest; 2]);
        let rate = machine.circle(r).from_rest;
        // The direction is along X at both ends; the ramps end where the path turns.
        let mut contour = Contour::new(machine, 0.0);
        contour.arc(r, TAU, [rate; 2]);
        contour.time_s += contour.machine.ramp_s() / rate;
        contour.keeps_its_limits_and_takes_its_time(seed);
    });
}

#[test]
fn m1d_opening_spiral_is_not_slowed_to_the_limit_of_its_narrowest_turn() {
    // A spiral from a radius of 1 mm to 50 mm in one turn.
    let centre = [0.0, 0.0];
    let path = ArcPath::new(
        vector(&[1.0]),
        vector(&[50.0]),
        Plane::Xy,
        centre,
        Turn::CounterClockwise,
    );
    let motion = SegmentMotion::Feed {
        path: Path::Arc(path),
        feed: feed(12_000.0, [20.0, 20.0, 10.0]),
    };
    let spiral = [Segment {
        multi_block: MultiBlock::On,
        ..segment(motion)
    }];
    let [soft, stiff] = [Some(1e5), None].map(|jerk| {
        let machine = settings(std::array::from_fn(|i| {
            (i < 2).then(|| motor(1000.0, 2000.0, jerk))
        }));
        Motion::new(&machine, &spiral).time_s()
    });
    assert!(soft < 1.25 * stiff, "{soft} s, without a maximum jerk {stiff} s");
}

#[test]
fn m1d_arcs_of_any_radius_are_planned_with_any_maximum_jerk() {
    for r in [1e-9, 1e-6, 1e-3, 1e6] {
        for jerk in [1e-3, 1.0, 1e12] {
            let to = vector(&[2.0 * r]);
            let arc = ArcPath::new(AxisVector::ZERO, to, Plane::Xy, [r, 0.0], Turn::Clockwise);
            let motion = SegmentMotion::Feed {
                path: Path::Arc(arc),
                feed: feed(60_000.0, [20.0, 20.0, 10.0]),
            };
            let half = Segment {
                multi_block: MultiBlock::On,
                ..segment(motion)
            };
            let machine = settings(std::array::from_fn(|i| {
                (i < 2).then(|| motor(1000.0, 1000.0, Some(jerk)))
            }));
            let motion = Motion::new(&machine, &[half]);
            let time = motion.time_s();
            assert!(time > 0.0 && time.is_finite(), "{r} {jerk}: {time}");
            assert_eq!(motion.position(time), to);
            for k in 0..1000 {
                let at = motion.position(time * f64::from(k) / 1000.0).0;
                let off = (at[0] - r).hypot(at[1]) - r;
                assert!(off.abs() <= 1e-9 * r.max(1e-3), "{r} {jerk}: {off}");
            }
        }
    }
}
