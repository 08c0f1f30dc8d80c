//! Compensated contours in a plane: runs a program and converts the resulting segments to plane coordinates.

use tandem_model::alarm::AlarmEntry;
use tandem_model::flow::{
    Action, Arc, ArcShape, Block, Compensation, Distance, Path, Segment, SegmentMotion,
};
use tandem_model::plane::{Plane, Turn};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{Alarm, Axis, AxisVector, MachinePosition};
use tandem_path::PathStage;

use crate::rig::{block, g01, settings, words};

/// A piece of a contour, which ends at a point of the plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Step {
    /// A straight line to the point.
    L(f64, f64),
    /// An arc to the point about a centre; true for counter-clockwise.
    A((f64, f64), (f64, f64), bool),
}

use Axis::X;
use Step::{A, L};

impl Step {
    pub fn to(self) -> (f64, f64) {
        match self {
            L(u, v) => (u, v),
            A(to, ..) => to,
        }
    }

    /// Returns the mirror image about the first axis.
    pub fn mirrored(self) -> Self {
        match self {
            L(u, v) => L(u, -v),
            A(to, centre, ccw) => A((to.0, -to.1), (centre.0, -centre.1), !ccw),
        }
    }
}

pub fn mirrored(steps: &[Step]) -> Vec<Step> {
    steps.iter().map(|step| step.mirrored()).collect()
}

pub const PLANES: [Plane; 3] = [Plane::Xy, Plane::Zx, Plane::Yz];

pub fn left(radius: f64, plane: Plane) -> Compensation {
    Compensation::Left { radius, plane }
}

pub fn right(radius: f64, plane: Plane) -> Compensation {
    Compensation::Right { radius, plane }
}

/// Returns the blocks of a contour: the first step leads in, the last step leads out. Lines are numbered from
/// 1; the first block goes to the start without compensation.
pub fn blocks(start: (f64, f64), steps: &[Step], compensation: Compensation) -> Vec<Block> {
    let plane = match compensation {
        Compensation::Left { plane, .. } | Compensation::Right { plane, .. } => plane,
        Compensation::Off => Plane::Xy,
    };
    let [first, second] = plane.axes();
    let mut all = vec![g01(1, &[(first, start.0), (second, start.1)])];
    let mut at = start;
    for (step, line) in steps.iter().zip(2..) {
        let (u, v) = step.to();
        let target = words(Distance::Absolute, &[(first, u), (second, v)]);
        let action = match *step {
            L(..) => Action::Linear(target),
            A(_, centre, ccw) => {
                let mut from_start = AxisVector::ZERO;
                (from_start[first], from_start[second]) = (centre.0 - at.0, centre.1 - at.1);
                Action::Arc(Box::new(Arc {
                    target,
                    plane,
                    turn: if ccw {
                        Turn::CounterClockwise
                    } else {
                        Turn::Clockwise
                    },
                    shape: ArcShape::Centre([from_start[Axis::X], from_start[Axis::Y], from_start[Axis::Z]]),
                }))
            }
        };
        all.push(Block {
            compensation,
            ..block(line, action)
        });
        at = (u, v);
    }
    if let Some(last) = all.last_mut() {
        last.compensation = Compensation::Off;
    }
    all
}

/// Returns the segments for blocks, and the alarm that ended them.
pub fn outcome(settings: &CoordinateSystemSettings, blocks: &[Block]) -> (Vec<Segment>, Option<Alarm>) {
    let mut stage = PathStage::new(settings, MachinePosition::default());
    let mut out = Vec::new();
    let alarm = blocks.iter().find_map(|block| stage.push(block, &mut out).err());
    stage.finish(&mut out).unwrap();
    (out, alarm)
}

#[track_caller]
pub fn completed(blocks: &[Block]) -> Vec<Segment> {
    let (segments, alarm) = outcome(&settings(), blocks);
    assert_eq!(alarm, None);
    segments
}

/// Converts a segment to plane coordinates.
pub fn step(segment: &Segment, plane: Plane) -> Step {
    let [first, second] = plane.axes();
    match &segment.motion {
        SegmentMotion::Feed {
            path: Path::Arc(arc), ..
        } => {
            assert_eq!(arc.plane(), plane);
            let [u, v] = arc.centre();
            A((arc.end()[first], arc.end()[second]), (u, v), arc.sweep() > 0.0)
        }
        SegmentMotion::Feed { path, .. } => L(path.end()[first], path.end()[second]),
        SegmentMotion::Rapid { to, .. } | SegmentMotion::Skip { to, .. } | SegmentMotion::Tap { to, .. } => {
            L(to[first], to[second])
        }
        SegmentMotion::Dwell { at, .. } => L(at[first], at[second]),
    }
}

#[track_caller]
pub fn same(steps: &[Step], expected: &[Step]) {
    let close = |a: (f64, f64), b: (f64, f64)| (a.0 - b.0).hypot(a.1 - b.1) < 1e-9;
    let equal = |a: &Step, b: &Step| match (*a, *b) {
        (L(..), L(..)) => close(a.to(), b.to()),
        (A(to, centre, ccw), A(to_b, centre_b, ccw_b)) => {
            close(to, to_b) && close(centre, centre_b) && ccw == ccw_b
        }
        _ => false,
    };
    let all = steps.len() == expected.len() && steps.iter().zip(expected).all(|(a, b)| equal(a, b));
    assert!(all, "{steps:?}\nis not\n{expected:?}");
}

/// Checks that the path of the centre is as expected in every plane, and mirrored for the mirrored contour
/// and side.
#[track_caller]
pub fn goes(radius: f64, start: (f64, f64), steps: &[Step], expected: &[Step]) {
    for plane in PLANES {
        let sides = [
            (left(radius, plane), start, steps.to_vec(), expected.to_vec()),
            (
                right(radius, plane),
                (start.0, -start.1),
                mirrored(steps),
                mirrored(expected),
            ),
        ];
        for (side, start, steps, expected) in sides {
            let segments = completed(&blocks(start, &steps, side));
            let moved = usize::from(start != (0.0, 0.0));
            let way: Vec<Step> = segments
                .iter()
                .skip(moved)
                .map(|segment| step(segment, plane))
                .collect();
            same(&way, &expected);
        }
    }
}

/// Returns the alarm of a contour on the left in X, Y, and the line of the last block that moved.
#[track_caller]
pub fn refused(radius: f64, start: (f64, f64), steps: &[Step]) -> (Alarm, Option<u32>) {
    let blocks = blocks(start, steps, left(radius, Plane::Xy));
    let (segments, alarm) = outcome(&settings(), &blocks);
    (alarm.unwrap(), segments.last().map(|segment| segment.origin.line))
}

/// Radius of the tool, mm.
pub const R: f64 = 5.0;
/// Compensation on the left in X, Y.
pub const G41: Compensation = Compensation::Left {
    radius: R,
    plane: Plane::Xy,
};

pub fn with(compensation: Compensation, block: Block) -> Block {
    Block {
        compensation,
        ..block
    }
}

pub fn way(segments: &[Segment]) -> Vec<Step> {
    segments.iter().map(|segment| step(segment, Plane::Xy)).collect()
}

#[track_caller]
pub fn is(alarm: &Alarm, entry: &'static AlarmEntry, line: u32) {
    assert_eq!(alarm.entry, entry, "{}", alarm.text);
    assert_eq!(
        alarm.origin.map(|origin| origin.line),
        Some(line),
        "{}",
        alarm.text
    );
}

/// From (0, 0) over (10, 0) with G41: lines 1 and 2.
pub fn led_in() -> Vec<Block> {
    vec![with(G41, g01(1, &[(X, 10.0)])), with(G41, g01(2, &[(X, 20.0)]))]
}

pub fn led_in_then(more: impl IntoIterator<Item = Block>) -> Vec<Block> {
    led_in().into_iter().chain(more).collect()
}

#[track_caller]
pub fn alarm_of(blocks: &[Block]) -> (Alarm, Vec<Segment>) {
    let (segments, alarm) = outcome(&settings(), blocks);
    (alarm.unwrap(), segments)
}
