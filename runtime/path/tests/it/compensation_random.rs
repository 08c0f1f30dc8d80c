//! Properties of every compensated contour (M1g), tested on random contours of lines and arcs with all kinds
//! of corners. The random numbers are the same in each run.

use std::f64::consts::{PI, TAU};

use tandem_model::alarm::{COMPENSATION_ARC_SMALL, COMPENSATION_CORNER, OVERCUT};
use tandem_model::flow::{Path, Segment, SegmentMotion};
use tandem_model::plane::Plane;
use tandem_model::settings::{CoordinateSystemSettings, Overcut};
use tandem_model::{Alarm, Axis};

use crate::contour::Step::{A, L};
use crate::contour::{Step, blocks, left, mirrored, outcome, right};
use crate::rig::settings;

use Axis::{X, Y};

struct Random(u64);

impl Random {
    /// Returns a random whole number from 0 to below the limit.
    fn below(&mut self, end: usize) -> usize {
        let share = self.within(0.0, 1.0);
        (0..end)
            .rev()
            .find(|n| *n as f64 <= share * end as f64)
            .unwrap_or(0)
    }

    /// Returns a random number between two values.
    fn within(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let share = (self.0 >> 33) as f64 / (1_u64 << 31) as f64;
        low + (high - low) * share
    }
}

struct Contour {
    start: (f64, f64),
    /// Blocks of the contour: the first block leads in, the last block leads out.
    steps: Vec<Step>,
}

/// Creates a contour of up to 20 blocks; the size of a block is one to a few times that of the tool.
fn contour(random: &mut Random) -> Contour {
    let calm = random.within(0.0, 1.0);
    let count = 2 + random.below(18);
    let mut heading = random.within(0.0, TAU);
    let start = (random.within(-5.0, 5.0), random.within(-5.0, 5.0));
    let mut at = start;
    let mut steps = Vec::new();
    for i in 0..count + 2 {
        // Tangent but for rounding, smooth, or anything.
        let sharp = match calm {
            calm if calm < 0.1 => 1e-6,
            calm if calm < 0.2 => 1e-4,
            calm if calm < 0.5 => 0.9,
            _ => 2.6,
        };
        heading += random.within(-sharp, sharp);
        let lead = i == 0 || i == count + 1;
        if lead || random.within(0.0, 1.0) < 0.5 {
            let length = random.within(if lead { 10.0 } else { 2.0 }, 30.0);
            at = (at.0 + length * heading.cos(), at.1 + length * heading.sin());
            steps.push(L(at.0, at.1));
        } else {
            let radius = random.within(3.0, 30.0);
            let sweep = random.within(-1.0, 1.0) * random.within(0.2, 4.0);
            let normal = heading + PI / 2.0 * sweep.signum();
            let centre = (at.0 + radius * normal.cos(), at.1 + radius * normal.sin());
            let angle = normal + PI + sweep;
            at = (centre.0 + radius * angle.cos(), centre.1 + radius * angle.sin());
            heading += sweep;
            steps.push(A(at, centre, sweep > 0.0));
        }
    }
    Contour { start, steps }
}

fn free(overcut: Overcut) -> CoordinateSystemSettings {
    let mut settings = settings();
    for motor in settings.motors.iter_mut().flatten() {
        motor.soft_limits = None;
    }
    settings.motion.overcut = overcut;
    settings
}

fn path(segment: &Segment) -> &Path {
    match &segment.motion {
        SegmentMotion::Feed { path, .. } => path,
        other => panic!("{other:?}"),
    }
}

/// Returns the distance of a point from a block.
fn distance(point: (f64, f64), from: (f64, f64), step: Step) -> f64 {
    let between = |a: (f64, f64), b: (f64, f64)| (a.0 - b.0).hypot(a.1 - b.1);
    match step {
        L(u, v) => {
            let way = (u - from.0, v - from.1);
            let square = way.0 * way.0 + way.1 * way.1;
            let share = ((point.0 - from.0) * way.0 + (point.1 - from.1) * way.1) / square;
            let share = share.clamp(0.0, 1.0);
            between(point, (from.0 + share * way.0, from.1 + share * way.1))
        }
        A(to, centre, ccw) => {
            let angle = |p: (f64, f64)| (p.1 - centre.1).atan2(p.0 - centre.0);
            let sense = if ccw { 1.0 } else { -1.0 };
            let turned = |p| (sense * (angle(p) - angle(from))).rem_euclid(TAU);
            let sweep = match turned(to) {
                closed if closed < 1e-12 => TAU,
                sweep => sweep,
            };
            if turned(point) <= sweep {
                (between(point, centre) - between(from, centre)).abs()
            } else {
                between(point, from).min(between(point, to))
            }
        }
    }
}

/// Returns the smallest distance of the centre from the contour, and its line. Measures the compensated
/// blocks and an arc added before the lead-out.
fn closest(contour: &Contour, segments: &[Segment]) -> (f64, u32) {
    let last = u32::try_from(contour.steps.len()).unwrap() + 1;
    let mut closest = (f64::INFINITY, 0);
    let is_measured = |segment: &&Segment| {
        let line = segment.origin.line;
        (3..last).contains(&line) || (line == last && matches!(path(segment), Path::Arc(_)))
    };
    for segment in segments.iter().filter(is_measured) {
        let path = path(segment);
        for i in 0..=40 {
            let point = path.point_at(path.length() * f64::from(i) / 40.0);
            for pair in contour.steps[..contour.steps.len() - 1].windows(2) {
                let near = distance((point[X], point[Y]), pair[0].to(), pair[1]);
                if near < closest.0 {
                    closest = (near, segment.origin.line);
                }
            }
        }
    }
    closest
}

/// Checks that each segment begins where the segment before ends.
fn continuous(segments: &[Segment]) {
    for pair in segments.windows(2) {
        let gap = path(&pair[1]).start().minus(path(&pair[0]).end());
        assert!(gap.orthogonal_length() <= 1e-9, "{pair:?}");
    }
}

/// Returns the direction of travel in the plane at the start (0) or the end (1) of a path.
fn direction(path: &Path, share: f64) -> (f64, f64) {
    let point = if share == 0.0 { path.start() } else { path.end() };
    match path {
        Path::Line { from, to, .. } => {
            let way = to.minus(*from);
            let length = way.orthogonal_length();
            (way[X] / length, way[Y] / length)
        }
        Path::Arc(arc) => {
            let [u, v] = arc.centre();
            let radius = (point[X] - u).hypot(point[Y] - v);
            let sense = arc.sweep().signum() / radius;
            (-(point[Y] - v) * sense, (point[X] - u) * sense)
        }
    }
}

fn is_expected(alarm: &Alarm) -> bool {
    [&COMPENSATION_ARC_SMALL, &COMPENSATION_CORNER, &OVERCUT].contains(&alarm.entry)
}

#[test]
fn s1g_without_an_alarm_the_centre_never_comes_closer_than_the_radius() {
    let (mut random, settings) = (Random(1), free(Overcut::Detect));
    let (mut went, mut refused) = (0, 0);
    for n in 0..4000 {
        let contour = contour(&mut random);
        let radius = random.within(0.5, 5.0);
        let side = if n % 2 == 0 {
            left(radius, Plane::Xy)
        } else {
            right(radius, Plane::Xy)
        };
        let (segments, alarm) = outcome(&settings, &blocks(contour.start, &contour.steps, side));
        continuous(&segments);
        if let Some(alarm) = alarm {
            assert!(is_expected(&alarm), "{n}: {alarm:?}");
            refused += 1;
            continue;
        }
        went += 1;
        let (near, line) = closest(&contour, &segments);
        assert!(near >= radius - 1e-9, "{n}: {near} of {radius} on line {line}");
    }
    assert!(went > 1000 && refused > 1000, "{went} {refused}");
}

#[test]
fn s1g_what_prevention_lets_go_never_comes_closer_than_the_radius() {
    let (mut random, settings) = (Random(2), free(Overcut::Prevent));
    let detecting = free(Overcut::Detect);
    let mut saved = 0;
    for n in 0..4000 {
        let contour = contour(&mut random);
        let radius = random.within(0.5, 5.0);
        let all = blocks(contour.start, &contour.steps, left(radius, Plane::Xy));
        let (segments, alarm) = outcome(&settings, &all);
        continuous(&segments);
        if let Some(alarm) = alarm {
            assert!(is_expected(&alarm), "{n}: {alarm:?}");
            continue;
        }
        saved += usize::from(outcome(&detecting, &all).1.is_some());
        let (near, line) = closest(&contour, &segments);
        assert!(near >= radius - 1e-9, "{n}: {near} of {radius} on line {line}");
    }
    assert!(saved > 100, "{saved}");
}

#[test]
fn s1g_added_arcs_are_tangent_to_their_neighbours() {
    let (mut random, settings) = (Random(3), free(Overcut::Detect));
    let mut arcs = 0;
    for n in 0..4000 {
        let contour = contour(&mut random);
        let radius = random.within(0.5, 5.0);
        let (segments, _) = outcome(
            &settings,
            &blocks(contour.start, &contour.steps, left(radius, Plane::Xy)),
        );
        for three in segments.windows(3) {
            let corner = |point: (f64, f64)| {
                contour.steps.iter().any(|step| {
                    let to = step.to();
                    (to.0 - point.0).hypot(to.1 - point.1) < 1e-9
                })
            };
            let Path::Arc(arc) = path(&three[1]) else { continue };
            let [u, v] = arc.centre();
            // The straight pieces that lead in and out are tangent to nothing.
            let line = three[1].origin.line;
            let leads = line == 3 || usize::try_from(line).unwrap() > contour.steps.len();
            if !corner((u, v)) || leads {
                continue;
            }
            arcs += 1;
            assert!(arc.radii().iter().all(|r| (r - radius).abs() < 1e-9));
            for (end, start) in [(&three[0], &three[1]), (&three[1], &three[2])] {
                let (a, b) = (direction(path(end), 1.0), direction(path(start), 0.0));
                let (cross, dot) = (a.0 * b.1 - a.1 * b.0, a.0 * b.0 + a.1 * b.1);
                assert!(cross.abs() < 1e-7 && dot > 0.0, "{n}: {three:?}");
            }
        }
    }
    assert!(arcs > 500, "{arcs}");
}

#[test]
fn s1g_g42_on_the_mirror_image_is_the_mirror_image_of_g41() {
    let (mut random, settings) = (Random(4), free(Overcut::Prevent));
    for n in 0..2000 {
        let contour = contour(&mut random);
        let radius = random.within(0.5, 5.0);
        let plain = blocks(contour.start, &contour.steps, left(radius, Plane::Xy));
        let start = (contour.start.0, -contour.start.1);
        let image = blocks(start, &mirrored(&contour.steps), right(radius, Plane::Xy));
        let (plain, image) = (outcome(&settings, &plain), outcome(&settings, &image));
        let place = |alarm: &Option<Alarm>| alarm.as_ref().map(|alarm| (alarm.entry.number, alarm.origin));
        assert_eq!(place(&plain.1), place(&image.1), "{n}");
        assert_eq!(plain.0.len(), image.0.len(), "{n}");
        for (a, b) in plain.0.iter().zip(&image.0) {
            assert_eq!(a.origin, b.origin);
            let (a, b) = (path(a), path(b));
            for i in 0..=4 {
                let share = f64::from(i) / 4.0;
                let (p, q) = (a.point_at(a.length() * share), b.point_at(b.length() * share));
                assert!((p[X] - q[X]).hypot(p[Y] + q[Y]) < 1e-9, "{n}: {p:?} {q:?}");
            }
        }
    }
}
