//! Chains of blended blocks (M1b) against the sum over all blocks, each with its ramps at both ends.

use std::collections::VecDeque;
use std::f64::consts::{FRAC_PI_2, TAU};

use proptest::prelude::*;
use tandem_model::alarm::LIMIT_ZERO;
use tandem_model::flow::{Path, Segment, SegmentEnd, SegmentFeed, SegmentMotion};
use tandem_model::plane::{Plane, Turn};
use tandem_model::profile::Profile;
use tandem_model::settings::{CoordinateSystemSettings, ShortBlock};
use tandem_model::{ArcPath, Axis, AxisVector};
use tandem_motion::Planner;

use crate::rig::{close, fast, feed, integral_of_ramp, line, segment, settings, vector};

/// The times ta and ts of a ramp, s.
type Ramp = [f64; 2];

fn total([ta, ts]: Ramp) -> f64 {
    ta + ts
}

/// Shortens a ramp by the rule `shrink`: first ts, then ta.
fn shrunk([ta, ts]: Ramp, most: f64) -> Ramp {
    let total = (ta + ts).min(most);
    let ta = ta.min(total);
    let ts = total - ta;
    // A ts that is only rounding is treated as 0.
    [ta, if ts > 1e-12 * total { ts } else { 0.0 }]
}

/// The chain by M1b: its ramps with their centres, and the time of its end.
pub struct Formula {
    pub paths: Vec<Path>,
    pub speeds: Vec<f64>,
    pub ramps: Vec<Ramp>,
    pub centres: Vec<f64>,
    longest_ramp_s: f64,
    pub end_s: f64,
}

impl Formula {
    pub fn new(segments: &[Segment], rule: ShortBlock) -> Self {
        let blocks: Vec<(Path, SegmentFeed)> = segments
            .iter()
            .map(|segment| match &segment.motion {
                SegmentMotion::Feed { path, feed, .. } => (path.clone(), *feed),
                other => panic!("not a cutting block: {other:?}"),
            })
            .collect();
        let n = blocks.len();
        let ms = |ta: f64, ts: f64| [ta.max(ts) / 1000.0, ts / 1000.0];
        let mut ramps: Vec<Ramp> = blocks
            .iter()
            .map(|(_, feed)| ms(feed.ta_ms, feed.ts_ms))
            .collect();
        ramps.push(ms(blocks[n - 1].1.td_ms, blocks[n - 1].1.ts_ms));
        let mut speeds: Vec<f64> = blocks
            .iter()
            .map(|(_, feed)| feed.feedrate_mm_min / 60.0)
            .collect();
        let times = |speeds: &[f64]| -> Vec<f64> {
            blocks
                .iter()
                .zip(speeds)
                .map(|((path, _), v)| path.length() / v)
                .collect()
        };
        match rule {
            ShortBlock::Shrink => {
                let times = times(&speeds);
                for (i, ramp) in ramps.iter_mut().enumerate() {
                    let before = i.checked_sub(1).map_or(f64::MAX, |i| times[i]);
                    let after = times.get(i).copied().unwrap_or(f64::MAX);
                    *ramp = shrunk(*ramp, before.min(after));
                }
            }
            ShortBlock::Extend => {
                for i in 0..n {
                    let least = f64::midpoint(total(ramps[i]), total(ramps[i + 1]));
                    speeds[i] = speeds[i].min(blocks[i].0.length() / least);
                }
            }
        }
        let paths = blocks.into_iter().map(|(path, _)| path).collect();
        Self::of(paths, speeds, ramps)
    }

    fn of(paths: Vec<Path>, speeds: Vec<f64>, ramps: Vec<Ramp>) -> Self {
        let mut centres = vec![total(ramps[0]) / 2.0];
        for (path, v) in paths.iter().zip(&speeds) {
            centres.push(centres[centres.len() - 1] + path.length() / v);
        }
        let end_s = centres[paths.len()] + total(ramps[paths.len()]) / 2.0;
        Self {
            paths,
            speeds,
            longest_ramp_s: ramps.iter().copied().map(total).fold(0.0, f64::max),
            ramps,
            centres,
            end_s,
        }
    }

    /// Replaces the ramps from rest and to rest.
    pub fn with_ends(self, [first, last]: [Ramp; 2]) -> Self {
        let mut ramps = self.ramps;
        let n = self.paths.len();
        (ramps[0], ramps[n]) = (first, last);
        Self::of(self.paths, self.speeds, ramps)
    }

    pub fn position(&self, t: f64) -> AxisVector {
        let ramped = |i: usize| {
            let [ta, ts] = self.ramps[i];
            integral_of_ramp(t - self.centres[i] + f64::midpoint(ta, ts), ta, ts)
        };
        // Blocks that have ended, and blocks that have not begun, add nothing to the start of the next block.
        let half = self.longest_ramp_s / 2.0;
        let first = self.centres[1..].partition_point(|centre| centre + half <= t);
        let begun = self.centres.partition_point(|centre| centre - half < t);
        let within = first.min(self.paths.len() - 1)..begun.min(self.paths.len());
        let mut position = self.paths[within.start].start();
        for (i, path) in self.paths.iter().enumerate().take(within.end).skip(within.start) {
            let distance = self.speeds[i] * (ramped(i) - ramped(i + 1));
            position = position.plus(path.point_at(distance)).minus(path.start());
        }
        position
    }
}

/// Returns the profiles of a chain.
fn chain(settings: &CoordinateSystemSettings, segments: &[Segment]) -> Vec<Profile> {
    let mut planner = Planner::new(settings);
    let mut out = VecDeque::new();
    for segment in segments {
        let segment = Segment {
            end: SegmentEnd::Continuous,
            ..segment.clone()
        };
        planner.push(&segment, &mut out).unwrap();
    }
    planner.flush(&mut out);
    out.into()
}

fn end_s(profiles: &[Profile]) -> f64 {
    profiles.iter().map(|profile| profile.duration_s).sum()
}

/// Returns the position of a chain after `t` seconds.
fn position(profiles: &[Profile], t: f64) -> AxisVector {
    let mut t = t;
    for profile in profiles {
        if t < profile.duration_s {
            return profile.position(t);
        }
        t -= profile.duration_s;
    }
    profiles[profiles.len() - 1].end_position()
}

/// Returns lines through these points of X, Y, Z with one feed.
fn lines(points: &[[f64; 3]], feed: SegmentFeed) -> Vec<Segment> {
    points
        .windows(2)
        .map(|ends| line(vector(&ends[0]), vector(&ends[1]), feed))
        .collect()
}

#[test]
fn s1b_corner_miss_is_velocity_difference_times_ta_over_8_plus_ts_term() {
    // F6000 = 100 mm/s, ta 0.1, ts 0.05, right angle: |dv| (ta/8 + ts^2/(24 ta))
    let profiles = chain(
        &fast(),
        &lines(
            &[[0.0; 3], [100.0, 0.0, 0.0], [100.0, 100.0, 0.0]],
            feed(6000.0, [100.0, 300.0, 50.0]),
        ),
    );
    let missed = 100.0 * 2.0_f64.sqrt() * (0.1 / 8.0 + 0.05 * 0.05 / (24.0 * 0.1));
    // The middle of the blend is the time L/v after the middle of the first ramp.
    let middle = position(&profiles, 0.075 + 1.0).minus(vector(&[100.0, 0.0]));
    close(middle.orthogonal_length(), missed);
    // td acts only at the stop: 2 L/v + (0.15 + 0.35)/2
    close(end_s(&profiles), 2.0 + 0.25);
    assert_eq!(
        profiles
            .iter()
            .map(|profile| profile.exact_stop)
            .collect::<Vec<_>>(),
        [false, true]
    );
}

#[test]
fn s1b_the_blend_has_the_ramp_times_of_the_following_block() {
    let points = [[0.0; 3], [100.0, 0.0, 0.0], [100.0, 100.0, 0.0]];
    let mut segments = lines(&points, feed(6000.0, [100.0, 100.0, 0.0]));
    segments[1] = line(
        vector(&points[1]),
        vector(&points[2]),
        feed(6000.0, [40.0, 60.0, 0.0]),
    );
    let profiles = chain(&fast(), &segments);
    let middle = position(&profiles, 0.05 + 1.0).minus(vector(&[100.0, 0.0]));
    close(middle.orthogonal_length(), 100.0 * 2.0_f64.sqrt() * 0.04 / 8.0);
    close(end_s(&profiles), 2.0 + f64::midpoint(0.1, 0.06));
}

#[test]
fn s1b_in_one_direction_the_speed_goes_over_without_any_deviation() {
    let profiles = chain(
        &fast(),
        &lines(
            &[[0.0; 3], [30.0, 40.0, 0.0], [60.0, 80.0, 0.0]],
            feed(6000.0, [100.0; 3]),
        ),
    );
    // The same distance as one block of 100 mm.
    let whole = chain(
        &fast(),
        &lines(&[[0.0; 3], [60.0, 80.0, 0.0]], feed(6000.0, [100.0; 3])),
    );
    close(end_s(&profiles), end_s(&whole));
    for k in 0..=200 {
        let t = end_s(&whole) * f64::from(k) / 200.0;
        let off = position(&profiles, t).minus(position(&whole, t));
        assert!(off.orthogonal_length() < 1e-9);
    }
}

#[test]
fn s1b_short_blocks_keep_f_and_ramp_in_the_first_and_last_block_only() {
    // Ten blocks of 1 mm at 100 mm/s, ta + ts = 150 ms: the ramps are shortened to the 10 ms of a block.
    let points: Vec<_> = (0..=10).map(|i| [f64::from(i), 0.0, 0.0]).collect();
    let profiles = chain(&fast(), &lines(&points, feed(6000.0, [100.0, 100.0, 50.0])));
    close(end_s(&profiles), 0.1 + 0.01);
    for k in 0..100 {
        let t = 0.01 + 0.09 * f64::from(k) / 100.0;
        close(position(&profiles, t)[Axis::X], 100.0 * (t - 0.005));
    }
    // A single block keeps its ramps and does not reach F (M1a): 0.3 s.
    let alone = chain(&fast(), &lines(&points[..2], feed(6000.0, [100.0, 100.0, 50.0])));
    close(end_s(&alone), 0.3);
}

#[test]
fn s1b_a_polyline_of_equal_chords_has_the_acceleration_of_its_circle() {
    let (radius, v, n) = (20.0, 50.0, 120);
    let points: Vec<_> = (0..n)
        .map(|i| {
            let angle = TAU * f64::from(i) / f64::from(n);
            [radius * angle.cos(), radius * angle.sin(), 0.0]
        })
        .collect();
    let profiles = chain(&fast(), &lines(&points, feed(v * 60.0, [100.0, 100.0, 50.0])));
    let step = 1e-3;
    let (begin, end) = (0.1, end_s(&profiles) - 0.1);
    for k in 0..500 {
        let t = begin + (end - begin) * f64::from(k) / 500.0;
        let at = |t: f64| position(&profiles, t);
        let second = at(t + step)
            .plus(at(t - step))
            .minus(at(t).scaled(2.0))
            .scaled(1.0 / (step * step));
        let acceleration = second.orthogonal_length();
        assert!(
            acceleration <= v * v / radius * (1.0 + 1e-6),
            "{acceleration} at {t}"
        );
        assert!(acceleration >= v * v / radius * 0.99, "{acceleration} at {t}");
    }
}

#[test]
fn s1b_with_the_rule_extend_short_blocks_slow_down_and_their_ramps_stay() {
    let mut settings = fast();
    settings.motion.short_block = ShortBlock::Extend;
    // Ramps of 150 ms: each block takes 150 ms, the chain takes one ramp more.
    let points: Vec<_> = (0..=10).map(|i| [f64::from(i), 0.0, 0.0]).collect();
    let segments = lines(&points, feed(6000.0, [100.0, 100.0, 50.0]));
    let profiles = chain(&settings, &segments);
    close(end_s(&profiles), 10.0 * 0.15 + 0.15);
    close(position(&profiles, 0.8)[Axis::X], (0.8 - 0.075) / 0.15);
}

#[test]
fn s1b_arcs_are_superposed_by_their_arc_length() {
    let feed = feed(6000.0, [100.0, 100.0, 50.0]);
    let around = |from: [f64; 3], to: [f64; 3], centre, turn| {
        let path = Path::Arc(ArcPath::new(vector(&from), vector(&to), Plane::Xy, centre, turn));
        segment(SegmentMotion::Feed { path, feed })
    };
    let segments = [
        line(AxisVector::ZERO, vector(&[50.0]), feed),
        around(
            [50.0, 0.0, 0.0],
            [70.0, 20.0, 5.0],
            [50.0, 20.0],
            Turn::CounterClockwise,
        ),
        around(
            [70.0, 20.0, 5.0],
            [90.0, 40.0, 5.0],
            [90.0, 20.0],
            Turn::Clockwise,
        ),
        line(vector(&[90.0, 40.0, 5.0]), vector(&[120.0, 40.0]), feed),
    ];
    let formula = Formula::new(&segments, ShortBlock::Shrink);
    let profiles = chain(&fast(), &segments);
    close(end_s(&profiles), formula.end_s);
    let arcs = (20.0 * FRAC_PI_2).hypot(5.0) + 20.0 * FRAC_PI_2;
    close(formula.end_s, (50.0 + arcs + 30.0_f64.hypot(5.0)) / 100.0 + 0.15);
    for k in 0..=1000 {
        let t = formula.end_s * f64::from(k) / 1000.0;
        let off = position(&profiles, t).minus(formula.position(t));
        assert!(
            off.orthogonal_length() < 1e-9,
            "{} at {t}",
            off.orthogonal_length()
        );
    }
}

#[test]
fn a_block_is_held_back_until_the_next_one_tells_how_it_ends() {
    let mut segments = lines(
        &[[0.0; 3], [10.0, 0.0, 0.0], [20.0, 0.0, 0.0], [30.0, 0.0, 0.0]],
        feed(600.0, [10.0; 3]),
    );
    for segment in &mut segments {
        segment.end = SegmentEnd::Continuous;
    }
    let mut planner = Planner::new(&fast());
    let mut out = VecDeque::new();
    let mut counts = Vec::new();
    for segment in &segments {
        planner.push(segment, &mut out).unwrap();
        counts.push((out.len(), planner.last_segment()));
    }
    assert_eq!(
        counts,
        [(0, 1), (1, 2), (2, 3)],
        "the numbers include the segments held back"
    );
    planner.flush(&mut out);
    planner.flush(&mut out);
    let numbers: Vec<_> = out
        .iter()
        .map(|profile| (profile.segment, profile.exact_stop))
        .collect();
    assert_eq!(numbers, [(1, false), (2, false), (3, true)]);
    // A restart discards the blocks held back. After an exact stop no block is held back.
    out.clear();
    planner.push(&segments[0], &mut out).unwrap();
    planner.restart(1);
    segments[1].end = SegmentEnd::ExactStop;
    planner.push(&segments[1], &mut out).unwrap();
    assert_eq!(out.iter().map(|profile| profile.segment).collect::<Vec<_>>(), [5]);
}

#[test]
fn what_comes_before_a_refused_block_ends_at_rest() {
    let mut motors = fast().motors;
    motors[1] = None;
    let mut planner = Planner::new(&settings(motors));
    let mut out = VecDeque::new();
    let mut segments = lines(
        &[[0.0; 3], [10.0, 0.0, 0.0], [10.0, 5.0, 0.0]],
        feed(600.0, [10.0; 3]),
    );
    segments[0].end = SegmentEnd::Continuous;
    planner.push(&segments[0], &mut out).unwrap();
    assert_eq!(
        planner.push(&segments[1], &mut out).unwrap_err().entry,
        &LIMIT_ZERO
    );
    assert_eq!(out.len(), 1);
    assert!(out[0].exact_stop);
    assert_eq!(out[0].end_position(), vector(&[10.0]));
}

proptest! {
    #[test]
    fn s1b_positions_are_those_of_the_formula(
        points in prop::collection::vec(prop::array::uniform3(-100.0..100.0), 3..9),
        short in prop::collection::vec(prop_oneof![Just(1.0), Just(0.01), Just(0.0001)], 9),
        feeds in prop::collection::vec((60.0..20_000.0, 1.0..300.0, 1.0..300.0, prop_oneof![Just(0.0), 1.0..200.0]), 9),
        extends in any::<bool>(),
    ) {
        let mut settings = fast();
        let rule = if extends { ShortBlock::Extend } else { ShortBlock::Shrink };
        settings.motion.short_block = rule;
        let mut at = AxisVector::ZERO;
        let mut segments = Vec::new();
        for (i, point) in points.iter().enumerate() {
            let to = at.plus(vector(point).scaled(short[i]));
            let (f, ta, td, ts) = feeds[i];
            prop_assume!(to.minus(at).orthogonal_length() > 1e-4);
            segments.push(line(at, to, feed(f, [ta, td, ts])));
            at = to;
        }
        let formula = Formula::new(&segments, rule);
        let profiles = chain(&settings, &segments);
        prop_assert!((end_s(&profiles) - formula.end_s).abs() < 1e-9 * formula.end_s.max(1.0));
        for k in 0..=200 {
            let t = formula.end_s * f64::from(k) / 200.0;
            let off = position(&profiles, t).minus(formula.position(t)).orthogonal_length();
            prop_assert!(off < 1e-7, "{off} at {t}");
        }
        prop_assert_eq!(position(&profiles, 0.0), AxisVector::ZERO);
        prop_assert_eq!(profiles[profiles.len() - 1].end_position(), at);
        // Each profile begins where the previous profile ends.
        for pair in profiles.windows(2) {
            let gap = pair[1].position(0.0).minus(pair[0].end_position()).orthogonal_length();
            prop_assert!(gap < 1e-9, "{gap}");
        }
    }
}
