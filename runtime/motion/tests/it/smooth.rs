//! Smoothing within `path_tolerance` (M1d.8), against the programmed path and the limits of the motors.

use std::collections::VecDeque;
use std::f64::consts::TAU;

use tandem_model::flow::{MultiBlock, Path, Segment, SegmentEnd, SegmentMotion};
use tandem_model::plane::{Plane, Turn};
use tandem_model::profile::{CubicMotion, Law, PacedMotion, PathPlace, Profile};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{AXES_MAX, ArcPath, Axis, AxisVector};
use tandem_motion::Planner;

use crate::look_ahead_random::{Random, chains, each_seed, random_blocks};
use crate::look_ahead_rig::{Step, best_time_of, pieces, plan_time, rate_of_plan};
use crate::rig::{PERIOD_S, feed, line, motor, settings, vector};

/// Returns settings with three linear motors, for a tolerance.
pub fn machine(tolerance: f64, velocity: f64, acceleration: f64) -> CoordinateSystemSettings {
    let motors = std::array::from_fn(|i| (i < 3).then(|| motor(velocity, acceleration, None)));
    let mut settings = settings(motors);
    settings.motion.path_tolerance_mm = tolerance;
    settings
}

pub fn blended(segment: Segment) -> Segment {
    Segment {
        end: SegmentEnd::Continuous,
        multi_block: MultiBlock::On,
        ..segment
    }
}

/// Returns lines between these points, without ramp times.
pub fn lines(points: &[AxisVector], feedrate: f64) -> Vec<Segment> {
    points
        .windows(2)
        .map(|ends| blended(line(ends[0], ends[1], feed(feedrate, [0.0; 3]))))
        .collect()
}

pub fn plan(settings: &CoordinateSystemSettings, segments: &[Segment]) -> Vec<Profile> {
    let mut planner = Planner::new(settings);
    let mut out = VecDeque::new();
    for segment in segments {
        planner.push(segment, &mut out).unwrap();
    }
    planner.flush(&mut out);
    out.into()
}

pub fn path(segment: &Segment) -> &Path {
    match &segment.motion {
        SegmentMotion::Feed { path, .. } => path,
        other => panic!("no feed: {other:?}"),
    }
}

fn smoothed(profile: &Profile) -> &CubicMotion {
    match &profile.law {
        Law::Paced {
            block: PacedMotion::Smoothed(part),
            ..
        } => part,
        other => panic!("not smoothed: {other:?}"),
    }
}

pub fn time_s(profiles: &[Profile]) -> f64 {
    profiles.iter().map(|profile| profile.duration_s).sum()
}

/// Returns the setpoints of profiles, one per period.
pub fn setpoints(profiles: &[Profile]) -> Vec<AxisVector> {
    let (mut begin_s, mut points) = (0.0, Vec::new());
    for profile in profiles {
        while points.len() as f64 * PERIOD_S < begin_s + profile.duration_s {
            points.push(profile.position(points.len() as f64 * PERIOD_S - begin_s));
        }
        begin_s += profile.duration_s;
    }
    points.extend(profiles.last().map(Profile::end_position));
    points
}

/// Returns the size of a deviation: the distance over X, Y and Z, or the largest angle.
pub fn size(off: AxisVector) -> f64 {
    off.0[3..]
        .iter()
        .fold(off.orthogonal_length(), |most, angle| most.max(angle.abs()))
}

/// Returns the deviation of a point from the programmed path: from the point at the same distance along the path, or from
/// the nearest point around it.
fn deviation(segments: &[Segment], block: usize, distance: f64, point: AxisVector, tolerance: f64) -> f64 {
    let at = |distance: f64| {
        let (mut k, mut left) = (block, distance);
        while left < 0.0 && k > 0 {
            k -= 1;
            left += path(&segments[k]).length();
        }
        while left > path(&segments[k]).length() && k + 1 < segments.len() {
            left -= path(&segments[k]).length();
            k += 1;
        }
        size(path(&segments[k]).point_at(left).minus(point))
    };
    let here = at(distance);
    if here <= tolerance {
        return here;
    }
    let (mut best, mut step) = (distance, 4.0 * here);
    while step > 1e-3 * tolerance {
        best = (-16..=16)
            .map(|k| best + step * f64::from(k) / 16.0)
            .min_by(|one, other| at(*one).total_cmp(&at(*other)))
            .unwrap();
        step /= 8.0;
    }
    at(best)
}

/// The motion of a profile at one time.
#[derive(Debug, Clone, Copy)]
pub struct Point {
    position: AxisVector,
    velocity: AxisVector,
    acceleration: AxisVector,
    /// Distance from the start of the block.
    distance: f64,
}

/// Returns points of a profile, five on each piece of its pace.
pub fn points(profile: &Profile) -> Vec<Point> {
    let part = smoothed(profile);
    let at = |piece, t| {
        let plan_s = plan_time(piece, t);
        let [rate, rate_change] = rate_of_plan(piece, t);
        let past = plan_s - part.from_s;
        let [position, first, second, third] = part.derivatives;
        let q2 = second.plus(third.scaled(past));
        let q1 = first
            .plus(second.scaled(past))
            .plus(third.scaled(past * past / 2.0));
        Point {
            position: position
                .plus(first.scaled(past))
                .plus(second.scaled(past * past / 2.0))
                .plus(third.scaled(past * past * past / 6.0)),
            velocity: q1.scaled(rate),
            acceleration: q2.scaled(rate * rate).plus(q1.scaled(rate_change)),
            distance: plan_s * part.speed,
        }
    };
    pieces(profile)
        .iter()
        .flat_map(|(piece, duration_s)| (0..=4).map(move |k| at(piece, duration_s * f64::from(k) / 4.0)))
        .collect()
}

/// Checks that no motor exceeds its limits at a point.
fn check_limits(settings: &CoordinateSystemSettings, point: &Point, context: &str) {
    for (axis, motor) in settings.motors.iter().enumerate() {
        let Some(motor) = motor else { continue };
        let v = point.velocity.0[axis].abs() / motor.max_velocity;
        let a = point.acceleration.0[axis].abs() / motor.max_acceleration;
        assert!(
            v <= 1.0 + 1e-9 && a <= 1.0 + 1e-6,
            "{context}: v {v}, a {a} of axis {axis}"
        );
    }
}

/// Checks that the profiles stay within the tolerance and the limits, that position and velocity are continuous, and
/// that the motion begins and ends at rest.
pub fn check(settings: &CoordinateSystemSettings, segments: &[Segment], profiles: &[Profile], context: &str) {
    let tolerance = settings.motion.path_tolerance_mm;
    let far = segments
        .iter()
        .fold(1.0_f64, |most, segment| most.max(size(path(segment).end())));
    let mut before: Option<Point> = None;
    for profile in profiles {
        let block = usize::try_from(profile.segment).unwrap() - 1;
        let context = format!("{context}, block {block}");
        for (k, point) in points(profile).into_iter().enumerate() {
            check_limits(settings, &point, &context);
            let off = deviation(segments, block, point.distance, point.position, tolerance);
            assert!(
                off <= tolerance * (1.0 + 1e-6) + 1e-12 * far,
                "{context}: {off} off"
            );
            if k == 0
                && let Some(before) = before
            {
                let speed = size(before.velocity).max(size(point.velocity));
                let jump = size(before.position.minus(point.position));
                let step = size(before.velocity.minus(point.velocity));
                assert!(jump <= 1e-10 * far, "{context}: jumps by {jump}");
                assert!(
                    step <= 1e-4 * speed + 1e-9,
                    "{context}: the velocity steps by {step}"
                );
            }
            before = Some(point);
        }
    }
    let end = profiles.last().unwrap();
    let first = points(&profiles[0])[0];
    let last = points(end).pop().unwrap();
    let speed = path_speed(segments);
    for (what, at) in [("begins", first), ("ends", last)] {
        assert!(
            size(at.velocity) <= 1e-5 * speed,
            "{context}: {what} at {:?}",
            at.velocity
        );
    }
    assert_eq!(
        end.position(end.duration_s),
        path(segments.last().unwrap()).end(),
        "{context}"
    );
    assert!(end.exact_stop, "{context}");
}

/// Returns the largest change of an axis per second at the programmed feedrates.
fn path_speed(segments: &[Segment]) -> f64 {
    segments
        .iter()
        .fold(0.0, |most: f64, segment| match &segment.motion {
            SegmentMotion::Feed { path, feed } => {
                let steepest = Axis::ALL
                    .into_iter()
                    .map(|axis| path.steepest(axis))
                    .fold(1.0, f64::max);
                most.max(feed.feedrate_mm_min / 60.0 * steepest)
            }
            _ => most,
        })
}

#[test]
fn m1d8_random_paths_stay_within_tolerance_and_limits() {
    each_seed(chains() / 20, |seed| {
        let mut random = Random(seed);
        let (accelerations, blocks) = random_blocks(&mut random, 30);
        let velocity = random.magnitude(1.0, 1000.0);
        let motors = std::array::from_fn(|i| Some(motor(velocity, *accelerations.get(i)?, None)));
        let mut settings = settings(motors);
        settings.motion.path_tolerance_mm = random.magnitude(1e-4, 1.0);
        let segments: Vec<Segment> = blocks.into_iter().map(|(segment, _)| blended(segment)).collect();
        check(
            &settings,
            &segments,
            &plan(&settings, &segments),
            &format!("seed {seed}"),
        );
    });
}

#[test]
fn m1d8_a_corner_between_long_lines_uses_the_whole_tolerance() {
    let corner = vector(&[50.0, 0.0]);
    for (turn, tolerance) in [(90.0_f64, 0.05), (30.0, 0.002), (150.0, 0.5)] {
        let (sin, cos) = turn.to_radians().sin_cos();
        let to = corner.plus(vector(&[50.0 * cos, 50.0 * sin]));
        let settings = machine(tolerance, 500.0, 5000.0);
        let profiles = plan(&settings, &lines(&[AxisVector::ZERO, corner, to], 6000.0));
        let joint = profiles.iter().find(|profile| profile.segment == 2).unwrap();
        let off = size(joint.position(0.0).minus(corner));
        assert!((off - tolerance).abs() < 0.01 * tolerance, "{turn}: {off}");
    }
}

#[test]
fn m1d8_a_spiral_that_begins_narrow_stays_within_tolerance_and_limits() {
    let settings = machine(0.01, 300.0, 1000.0);
    let [from, to] = [&[0.001, 0.0, 0.0], &[20.0, 0.0, 3.0]].map(|at| vector(at));
    let arc = ArcPath::new(from, to, Plane::Xy, [0.0, 0.0], Turn::CounterClockwise);
    let spiral = Segment {
        motion: SegmentMotion::Feed {
            path: Path::Arc(arc),
            feed: feed(6000.0, [0.0; 3]),
        },
        ..line(from, to, feed(6000.0, [0.0; 3]))
    };
    let mut segments = lines(&[vector(&[-10.0, 0.0, 0.0]), from], 6000.0);
    segments.push(blended(spiral));
    segments.extend(lines(&[to, vector(&[20.0, 30.0, 3.0])], 6000.0));
    check(&settings, &segments, &plan(&settings, &segments), "spiral");
}

/// Returns a closed contour of 270 mm in chords, with rounded coordinates.
pub fn contour(chords: u32, decimals: i32) -> Vec<AxisVector> {
    let scale = 10.0_f64.powi(decimals);
    let rounded = |value: f64| (value * scale).round() / scale;
    (0..=chords)
        .map(|k| {
            let angle = TAU * f64::from(k % chords) / f64::from(chords);
            let radius = 30.0 * (1.0 + 0.3 * (5.0 * angle).cos());
            vector(&[rounded(radius * angle.cos()), rounded(radius * angle.sin())])
        })
        .collect()
}

/// Returns the best possible time on the curve of [`contour`] at F6000 and 1000 mm/s^2, on a dense grid of its angle:
/// from the derivatives of the curve, without the planner.
fn best_time_on_contour_s() -> f64 {
    let count = 20_000;
    let h = TAU / f64::from(count);
    let step = |k: i32| {
        let angle = (f64::from(k) + 0.5) * h;
        let (sin5, cos5) = (5.0 * angle).sin_cos();
        let [r, r1, r2] = [30.0 * (1.0 + 0.3 * cos5), -45.0 * sin5, -225.0 * cos5];
        let (sin, cos) = angle.sin_cos();
        let first = [r1 * cos - r * sin, r1 * sin + r * cos];
        let second = [(r2 - r) * cos - 2.0 * r1 * sin, (r2 - r) * sin + 2.0 * r1 * cos];
        let mut rows = [[0.0; 2]; AXES_MAX];
        for axis in 0..2 {
            let (a, b) = (second[axis] / 2.0, first[axis] / (2.0 * h));
            rows[axis] = [(a - b) / 1000.0, (a + b) / 1000.0];
        }
        Step {
            h,
            most: (100.0 / first[0].hypot(first[1])).powi(2),
            rows,
        }
    };
    best_time_of(&(0..count).map(step).collect::<Vec<_>>(), [0.0; 2])
}

#[test]
fn m1d8_rounded_dense_chords_are_as_fast_as_the_smooth_curve() {
    let segments = |chords, decimals| lines(&contour(chords, decimals), 6000.0);
    let smooth_s = best_time_on_contour_s();
    for (chords, most) in [(3000, 1.05), (6000, 1.10), (12_000, 1.10)] {
        let settings = machine(0.002, 300.0, 1000.0);
        let segments = segments(chords, 3);
        let profiles = plan(&settings, &segments);
        let ratio = time_s(&profiles) / smooth_s;
        assert!(ratio <= most, "{chords} chords: {ratio}");
        check(&settings, &segments, &profiles, &format!("{chords} chords"));
        let points = setpoints(&profiles);
        let second = |three: &[AxisVector]| three[2].0[0] - 2.0 * three[1].0[0] + three[0].0[0];
        let reversals = points
            .windows(4)
            .filter(|four| second(&four[..3]) * second(&four[1..]) < 0.0)
            .count();
        let share = reversals as f64 / points.len() as f64;
        assert!(
            share < 0.05,
            "{chords} chords: the acceleration reverses in {share} of the samples"
        );
    }
}

#[test]
fn m1d8_back_trace_and_replanning_follow_the_same_curve() {
    let settings = machine(0.01, 300.0, 1000.0);
    let segments = lines(&contour(400, 3), 6000.0);
    let mut planner = Planner::new(&settings);
    let mut out = VecDeque::new();
    for segment in &segments {
        planner.push(segment, &mut out).unwrap();
    }
    planner.flush(&mut out);
    let forward: Vec<Profile> = out.into();
    let on_curve = |profile: &Profile| {
        let block = usize::try_from(profile.segment).unwrap() - 1;
        for k in 0..=3 {
            let t = profile.duration_s * f64::from(k) / 3.0;
            let plan_s = profile.plan_time(t);
            let same = forward.iter().filter(|other| other.segment == profile.segment);
            let nearest = same
                .map(|other| size(smoothed(other).position(plan_s).minus(profile.position(t))))
                .fold(f64::INFINITY, f64::min);
            assert!(nearest < 1e-9, "block {block}: {nearest}");
        }
    };
    let at = PathPlace {
        segment: 200,
        plan_s: 0.3 * smoothed(&forward[0]).plan_s,
    };
    let ahead = planner.replan(at, true);
    assert!(ahead.can_begin());
    ahead.profiles.iter().for_each(on_curve);
    assert!(ahead.profiles.back().unwrap().exact_stop);
    let back = planner.retrace(at);
    back.iter().for_each(on_curve);
    let last = back.back().unwrap();
    assert!(last.exact_stop);
    assert_eq!(last.position(last.duration_s), path(&segments[0]).start());
}

#[test]
fn m1d8_compensated_blocks_keep_their_path() {
    let settings = machine(0.05, 300.0, 1000.0);
    let mut segments = lines(&contour(40, 3), 3000.0);
    for segment in &mut segments[10..20] {
        if let SegmentMotion::Feed { feed, .. } = &mut segment.motion {
            feed.keeps_path = true;
        }
    }
    let profiles = plan(&settings, &segments);
    for profile in &profiles {
        let keeps = matches!(
            &profile.law,
            Law::Paced {
                block: PacedMotion::Ramped(_),
                ..
            }
        );
        assert_eq!(keeps, (11..=20).contains(&profile.segment), "{}", profile.segment);
    }
    // The motion stops where smoothing ends and begins.
    for block in [10, 20, 40] {
        let last = profiles.iter().rfind(|profile| profile.segment == block).unwrap();
        assert!(last.exact_stop, "{block}");
        assert_eq!(
            last.position(last.duration_s),
            path(&segments[usize::try_from(block).unwrap() - 1]).end()
        );
    }
}

#[test]
fn m1d8_an_axis_slower_than_the_next_block_keeps_its_velocity() {
    // Z is slow; the corner turns from Z into X.
    let mut settings = machine(0.2, 500.0, 5000.0);
    if let Some(z) = &mut settings.motors[Axis::Z.index()] {
        z.max_velocity = 5.0;
    }
    let points = [&[0.0, 0.0, 0.0], &[0.0, 0.0, 10.0], &[50.0, 0.0, 10.0]].map(|at| vector(at));
    let segments = lines(&points, 12_000.0);
    check(&settings, &segments, &plan(&settings, &segments), "Z then X");
}
