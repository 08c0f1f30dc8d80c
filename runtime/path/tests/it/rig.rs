//! A machine for tests, handmade blocks, and the segments that the path stage outputs.

use tandem_model::alarm::AlarmEntry;
use tandem_model::flow::{
    Action, AxisWords, Block, Compensation, Distance, Frame, MultiBlock, PathControl, ProgrammedFeed,
    Segment, SegmentEnd, SegmentMotion, Transform,
};
use tandem_model::settings::{CoordinateSystemSettings, MotorKind, MotorSettings, Unit};
use tandem_model::{Axis, AxisSet, AxisVector, MachinePosition, Origin};
use tandem_path::PathStage;

pub fn motor(number: u16, kind: MotorKind) -> MotorSettings {
    MotorSettings {
        soft_limits: (kind == MotorKind::Linear).then_some([-100.0, 200.0]),
        ..MotorSettings::new(number, kind, 500.0, 5000.0)
    }
}

/// Creates X, Y, Z with soft limits -100 to 200, and A and C without soft limits; B does not exist.
pub fn settings() -> CoordinateSystemSettings {
    let linear = |number| Some(motor(number, MotorKind::Linear));
    let rotary = |number| Some(motor(number, MotorKind::Rotary));
    CoordinateSystemSettings {
        motors: [
            linear(1),
            linear(2),
            linear(3),
            rotary(4),
            None,
            rotary(5),
            None,
            None,
        ],
        ..CoordinateSystemSettings::default()
    }
}

pub fn words(distance: Distance, values: &[(Axis, f64)]) -> AxisWords {
    let mut vector = AxisVector::ZERO;
    let mut named = AxisSet::EMPTY;
    for &(axis, value) in values {
        vector[axis] = value;
        named.insert(axis);
    }
    AxisWords {
        values: vector,
        named,
        distance,
        frame: Frame::Work,
    }
}

/// Creates a block in G64 at F600 on this line.
pub fn block(line: u32, action: Action) -> Block {
    Block {
        origin: Origin {
            program: 1,
            line,
            column: 1,
        },
        action,
        feed: ProgrammedFeed {
            feedrate_mm_min: 600.0,
            ta_ms: 100.0,
            td_ms: 100.0,
            ts_ms: 50.0,
        },
        unit: Unit::default(),
        feedrate_deg_min: 600.0,
        path_control: PathControl::ContinuousPath,
        exact_stop_before: false,
        exact_stop_after: false,
        multi_block: MultiBlock::Off,
        compensation: Compensation::Off,
    }
}

pub fn g01(line: u32, values: &[(Axis, f64)]) -> Block {
    block(line, Action::Linear(words(Distance::Absolute, values)))
}

pub fn g00(line: u32, values: &[(Axis, f64)]) -> Block {
    block(line, Action::Rapid(words(Distance::Absolute, values)))
}

pub fn stage() -> PathStage {
    PathStage::new(&settings(), MachinePosition::default())
}

/// Returns all segments of these blocks, with a flush at the end.
pub fn run(blocks: &[Block]) -> Vec<Segment> {
    let mut stage = stage();
    let mut out = Vec::new();
    for block in blocks {
        stage.push(block, &mut out).unwrap();
    }
    stage.flush(&mut out);
    out
}

pub fn ends(segments: &[Segment]) -> Vec<(u32, SegmentEnd)> {
    segments
        .iter()
        .map(|segment| (segment.origin.line, segment.end))
        .collect()
}

pub fn target(segment: &Segment) -> [f64; 3] {
    let end = match &segment.motion {
        SegmentMotion::Feed { path, .. } => path.end(),
        SegmentMotion::Rapid { to, .. } | SegmentMotion::Skip { to, .. } | SegmentMotion::Tap { to, .. } => {
            *to
        }
        SegmentMotion::Dwell { at, .. } => *at,
    };
    [end.0[0], end.0[1], end.0[2]]
}

pub fn near(values: [f64; 3], expected: [f64; 3]) {
    let close = values.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12);
    assert!(close, "{values:?} is not {expected:?}");
}

pub fn length_and_feed(segment: &Segment) -> (f64, f64) {
    match &segment.motion {
        SegmentMotion::Feed { path, feed, .. } => (path.length(), feed.feedrate_mm_min),
        other => panic!("not a cutting block: {other:?}"),
    }
}

#[track_caller]
pub fn refused(block: &Block, entry: &'static AlarmEntry) -> String {
    let mut stage = stage();
    let mut out = Vec::new();
    let alarm = stage.push(block, &mut out).unwrap_err();
    assert_eq!(alarm.entry, entry);
    assert_eq!(alarm.origin, Some(block.origin));
    stage.flush(&mut out);
    assert!(out.is_empty());
    assert_eq!(stage.position(), MachinePosition::default());
    alarm.text
}

/// Creates a vector with these values of X, Y, Z.
pub fn xyz(values: [f64; 3]) -> AxisVector {
    let mut vector = AxisVector::ZERO;
    vector.0[..3].copy_from_slice(&values);
    vector
}

pub fn transform(line: u32, transform: impl Into<Box<Transform>>) -> Block {
    block(line, Action::Transform(transform.into()))
}

pub fn incremental(line: u32, values: &[(Axis, f64)]) -> Block {
    block(line, Action::Linear(words(Distance::Incremental, values)))
}
