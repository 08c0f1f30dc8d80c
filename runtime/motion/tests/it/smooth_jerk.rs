//! The maximum jerk on smoothed paths (M1d.9).

use std::collections::VecDeque;
use std::f64::consts::TAU;

use tandem_model::AxisVector;
use tandem_model::flow::Segment;
use tandem_model::profile::{PathPlace, Profile};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_motion::Planner;

use crate::look_ahead_random::{Random, chains, each_seed, random_blocks};
use crate::rig::{PERIOD_S, motor, settings, vector};
use crate::smooth::{blended, check, contour, lines, machine, plan, setpoints, size, time_s};

/// Largest third difference of the setpoints, in shares of a maximum jerk.
pub const JERK_MAX: f64 = 1.001;

/// Returns settings with three linear motors that have a maximum jerk, for a tolerance.
pub fn soft_machine(tolerance: f64, [velocity, acceleration, jerk]: [f64; 3]) -> CoordinateSystemSettings {
    let mut settings = machine(tolerance, velocity, acceleration);
    for motor in settings.motors.iter_mut().flatten() {
        motor.max_jerk = Some(jerk);
    }
    settings
}

/// Returns the largest third difference of the setpoints of each axis, in shares of its maximum jerk. The machine rests
/// before and after.
pub fn jerk_of_setpoints(settings: &CoordinateSystemSettings, profiles: &[Profile]) -> f64 {
    let mut points = setpoints(profiles);
    let [first, last] = [points[0], points[points.len() - 1]];
    points.splice(0..0, [first; 3]);
    points.extend([last; 3]);
    let mut most = 0.0_f64;
    for window in points.windows(4) {
        for (axis, motor) in settings.motors.iter().enumerate() {
            let Some(jerk) = motor.as_ref().and_then(|motor| motor.max_jerk) else {
                continue;
            };
            let [a, b, c, d] = [0, 1, 2, 3].map(|k| window[k].0[axis]);
            let third = (d - 3.0 * c + 3.0 * b - a) / PERIOD_S.powi(3);
            // Each setpoint is rounded to the last bit.
            let rounding = 8.0 * f64::EPSILON * d.abs().max(1.0) / PERIOD_S.powi(3);
            most = most.max((third.abs() - rounding) / jerk);
        }
    }
    most
}

/// Checks the tolerance, the velocities, the accelerations and the jerks of a plan.
fn check_jerk(settings: &CoordinateSystemSettings, segments: &[Segment], context: &str) -> Vec<Profile> {
    let profiles = plan(settings, segments);
    check(settings, segments, &profiles, context);
    let used = jerk_of_setpoints(settings, &profiles);
    assert!(used <= JERK_MAX, "{context}: {used} of the jerk");
    profiles
}

#[test]
fn m1d9_random_paths_keep_the_maximum_jerk() {
    each_seed(chains() / 80, |seed| {
        let mut random = Random(seed);
        let (accelerations, blocks) = random_blocks(&mut random, 12);
        let velocity = random.magnitude(20.0, 1000.0);
        let time_s = random.magnitude(0.01, 0.5);
        let motors = std::array::from_fn(|i| {
            let acceleration = *accelerations.get(i)?;
            let jerk = (random.unit() < 0.9).then_some(acceleration / time_s);
            Some(motor(velocity, acceleration, jerk))
        });
        let mut settings = settings(motors);
        settings.motion.path_tolerance_mm = random.magnitude(1e-3, 1.0);
        let segments: Vec<Segment> = blocks.into_iter().map(|(segment, _)| blended(segment)).collect();
        check_jerk(&settings, &segments, &format!("seed {seed}"));
    });
}

/// Returns the time of a motion over a distance from rest to rest, with a peak below both maxima.
pub fn double_s(distance: f64, [velocity, acceleration, jerk]: [f64; 3]) -> f64 {
    let ramp = |v: f64| {
        if v * jerk < acceleration * acceleration {
            2.0 * (v / jerk).sqrt()
        } else {
            v / acceleration + acceleration / jerk
        }
    };
    let covered = |v: f64| v * ramp(v);
    if covered(velocity) <= distance {
        return distance / velocity + ramp(velocity);
    }
    let [mut low, mut high] = [0.0, velocity];
    for _ in 0..100 {
        let middle = f64::midpoint(low, high);
        if covered(middle) < distance {
            low = middle;
        } else {
            high = middle;
        }
    }
    2.0 * ramp(low)
}

#[test]
fn m1d9_a_line_takes_the_time_of_seven_segments() {
    for (distance, feedrate) in [(0.01, 6000.0), (1.0, 6000.0), (100.0, 6000.0), (100.0, 30_000.0)] {
        let limits = [500.0, 5000.0, 50_000.0];
        let settings = soft_machine(0.01, limits);
        let segments = lines(&[AxisVector::ZERO, vector(&[distance])], feedrate);
        let profiles = check_jerk(&settings, &segments, "line");
        let [_, acceleration, jerk] = limits;
        // A reserve of 5 percent of the jerk remains for feed hold.
        let best_s = double_s(distance, [feedrate / 60.0, acceleration, 0.95 * jerk]);
        let ratio = time_s(&profiles) / best_s;
        assert!(
            (0.999..1.03).contains(&ratio),
            "{distance} mm at F{feedrate}: {ratio}"
        );
    }
}

/// Returns points of a curve, rounded to three decimals.
pub fn curve(count: u32, at: impl Fn(f64) -> [f64; 3]) -> Vec<AxisVector> {
    let rounded = |value: f64| (value * 1000.0).round() / 1000.0;
    let mut points: Vec<AxisVector> = (0..=count)
        .map(|k| vector(&at(f64::from(k) / f64::from(count)).map(rounded)))
        .collect();
    points.dedup();
    points
}

/// Returns the points of shapes of CAM programs, by their names; each shape has about this number of points.
pub fn shapes(count: u32) -> [(&'static str, Vec<AxisVector>); 5] {
    let relief = curve(count, |u| {
        let x = 20.0 * (1.0 - (1.0 - 2.0 * (5.0 * u).fract()).abs());
        let z = 0.6 * (0.9 * x).sin() * (7.0 * u).cos();
        [x, (5.0 * u).floor() * 0.3, z]
    });
    let trochoid = curve(count, |u| {
        let angle = 12.0 * TAU * u;
        [2.0 * angle.cos() + 24.0 * u, 2.0 * angle.sin(), 0.0]
    });
    let spiral = curve(count, |u| {
        let angle = 6.0 * TAU * u;
        [12.0 * u * angle.cos(), 12.0 * u * angle.sin(), -u]
    });
    let gear = curve(count / 3, |u| {
        let angle = TAU * u;
        let radius = 15.0 + 1.5 * (24.0 * angle).sin().clamp(-0.7, 0.7);
        [radius * angle.cos(), radius * angle.sin(), 0.0]
    });
    [
        ("contour", contour(count, 3)),
        ("relief", relief),
        ("trochoid", trochoid),
        ("spiral", spiral),
        ("gear", gear),
    ]
}

#[test]
fn m1d9_shapes_of_cam_programs_keep_the_maximum_jerk() {
    for (name, points) in shapes(1500) {
        for tolerance in [0.002, 0.05] {
            let settings = soft_machine(tolerance, [500.0, 5000.0, 50_000.0]);
            let context = format!("{name} at {tolerance} mm");
            check_jerk(&settings, &lines(&points, 6000.0), &context);
        }
    }
}

#[test]
fn m1d9_back_trace_and_replanning_keep_the_maximum_jerk() {
    let settings = soft_machine(0.01, [300.0, 2000.0, 20_000.0]);
    let segments = lines(&contour(400, 3), 6000.0);
    let mut planner = Planner::new(&settings);
    let mut out = VecDeque::new();
    for segment in &segments {
        planner.push(segment, &mut out).unwrap();
    }
    planner.flush(&mut out);
    let at = PathPlace {
        segment: 200,
        plan_s: 1e-3,
    };
    let ahead = planner.replan(at, true);
    assert!(ahead.can_begin());
    let back = planner.retrace(at);
    for profiles in [Vec::from(ahead.profiles), Vec::from(back)] {
        let used = jerk_of_setpoints(&settings, &profiles);
        assert!(used <= JERK_MAX, "{used}");
    }
}

#[test]
fn m1d9_a_plan_for_another_override_begins_in_motion() {
    for jerk in [None, Some(20_000.0)] {
        let mut settings = machine(0.01, 300.0, 2000.0);
        for motor in settings.motors.iter_mut().flatten() {
            motor.max_jerk = jerk;
        }
        let mut planner = Planner::new(&settings);
        let mut out = VecDeque::new();
        for segment in lines(&contour(400, 3), 3000.0) {
            planner.push(&segment, &mut out).unwrap();
        }
        planner.flush(&mut out);
        planner.set_feed_override(0.5);
        let at = PathPlace {
            segment: 200,
            plan_s: 1e-3,
        };
        let ahead = planner.replan(at, false);
        let points = setpoints(&Vec::from(ahead.profiles));
        // 25 mm/s, if neither the curvature nor a stop is near.
        let speed = size(points[1].minus(points[0])) / PERIOD_S;
        assert!((24.0..25.1).contains(&speed), "{jerk:?}: {speed} mm/s");
    }
}
