//! Threads of G74 and G84: revolutions, offsets, and rejected programs (M1h).

use tandem_model::alarm::{
    AXIS_MISSING, COMPENSATION_REFUSED, FEEDRATE_MISSING, SOFT_LIMIT, SPINDLE_SPEED_MISSING, TAP_OFF_AXIS,
    VALUE_OUT_OF_RANGE,
};
use tandem_model::flow::{
    Action, AxisWords, Block, Compensation, Distance, Mirror, ProgrammedFeed, Rotation, Scaling, Segment,
    SegmentEnd, SegmentMotion, Tap, TapLeg, ThreadAhead, Transform,
};
use tandem_model::plane::{Plane, Turn};
use tandem_model::{Axis, AxisSet, AxisVector, MachinePosition};
use tandem_path::PathStage;

use crate::rig::{block, g00, length_and_feed, refused, run, settings, stage, transform, words};

use Axis::{X, Y, Z};
use Distance::{Absolute, Incremental};

/// At F100: the manual's example has S300.
pub fn tap(line: u32, z: f64, leg: TapLeg, speed: Option<f64>) -> Block {
    let turn = match leg {
        TapLeg::In => Turn::Clockwise,
        TapLeg::Out => Turn::CounterClockwise,
    };
    let tap = Tap {
        target: words(Distance::Absolute, &[(Z, z)]),
        leg,
        turn,
        spindle_speed_r_min: speed,
    };
    let block = block(line, Action::Tap(Box::new(tap)));
    Block {
        feed: ProgrammedFeed {
            feedrate_mm_min: 100.0,
            ..block.feed
        },
        ..block
    }
}

fn hole(r: f64, z: f64, speed: Option<f64>) -> Vec<Block> {
    vec![
        g00(1, &[(Z, r)]),
        tap(2, z, TapLeg::In, speed),
        block(2, Action::Dwell { dwell_s: 1.0 }),
        tap(2, r, TapLeg::Out, speed),
    ]
}

fn thread(segment: &Segment) -> (f64, f64, f64, TapLeg) {
    match &segment.motion {
        SegmentMotion::Tap {
            from,
            to,
            revolutions,
            leg,
            ..
        } => (from[Z], to[Z], *revolutions, *leg),
        other => panic!("not a thread: {other:?}"),
    }
}

#[track_caller]
fn near(value: (f64, f64, f64, TapLeg), expected: (f64, f64, f64, TapLeg)) {
    let close = [
        (value.0, expected.0),
        (value.1, expected.1),
        (value.2, expected.2),
    ]
    .iter()
    .all(|(a, b)| (a - b).abs() < 1e-9);
    assert!(close && value.3 == expected.3, "{value:?} is not {expected:?}");
}

#[test]
fn m1h_f100_and_s300_are_15_revolutions_over_5_mm_and_back() {
    let segments = run(&hole(-5.0, -10.0, Some(300.0)));
    assert_eq!(segments.len(), 4);
    near(thread(&segments[1]), (-5.0, -10.0, 15.0, TapLeg::In));
    assert!(matches!(segments[2].motion, SegmentMotion::Dwell { .. }));
    near(thread(&segments[3]), (-10.0, -5.0, -15.0, TapLeg::Out));
    assert!(
        segments
            .iter()
            .all(|segment| segment.end == SegmentEnd::ExactStop)
    );
    // 10 mm: 30
    let segments = run(&hole(-5.0, -15.0, Some(300.0)));
    near(thread(&segments[1]), (-5.0, -15.0, 30.0, TapLeg::In));
}

#[test]
fn m1h_without_a_spindle_nothing_is_locked_to_the_thread_path() {
    let segments = run(&hole(-5.0, -10.0, None));
    near(thread(&segments[1]), (-5.0, -10.0, 0.0, TapLeg::In));
}

#[test]
fn m1h_pitch_is_in_machine_coordinates_and_mirror_keeps_the_rotation() {
    let mut scale = Transform {
        scaling: Some(Scaling {
            centre: AxisVector::ZERO,
            factors: [2.0; 3],
        }),
        ..Transform::default()
    };
    scale.work_offset[Z] = 100.0;
    let mut blocks = vec![transform(1, scale)];
    blocks.extend(hole(-5.0, -10.0, Some(300.0)));
    near(thread(&run(&blocks)[1]), (90.0, 80.0, 30.0, TapLeg::In));
    let mirror = Transform {
        mirror: Some(Mirror {
            centre: AxisVector::ZERO,
            axes: AxisSet::from_iter([Z]),
        }),
        ..Transform::default()
    };
    let mut blocks = vec![transform(1, mirror)];
    blocks.extend(hole(-5.0, -10.0, Some(300.0)));
    near(thread(&run(&blocks)[1]), (5.0, 10.0, 15.0, TapLeg::In));
}

#[test]
fn m1h_pitch_uses_programmed_f_and_other_blocks_are_limited_to_maximum() {
    let mut slow = settings();
    slow.max_feedrate_mm_min = 60.0;
    let mut stage = PathStage::new(&slow, MachinePosition::default());
    let mut out = Vec::new();
    let line = block(1, Action::Linear(words(Distance::Absolute, &[(X, 10.0)])));
    for block in [line, tap(2, -5.0, TapLeg::In, Some(300.0))] {
        stage.push(&block, &mut out).unwrap();
    }
    assert!((length_and_feed(&out[0]).1 - 60.0).abs() < 1e-12);
    // F100
    near(thread(&out[1]), (0.0, -5.0, 15.0, TapLeg::In));
}

#[test]
fn m1h_without_spindle_f_above_z_limits_is_refused_to_keep_the_pitch() {
    // F100 is 1.67 mm/s.
    for (max_feedrate, max_velocity, is_refused) in
        [(100.0, 10.0, false), (99.9, 10.0, true), (1000.0, 1.66, true)]
    {
        let mut slow = settings();
        slow.max_feedrate_mm_min = max_feedrate;
        slow.motors[Z.index()].as_mut().unwrap().max_velocity = max_velocity;
        let mut stage = PathStage::new(&slow, MachinePosition::default());
        let outcome = stage.push(&tap(1, -10.0, TapLeg::In, None), &mut Vec::new());
        assert_eq!(outcome.is_err(), is_refused, "{max_feedrate} {max_velocity}");
        if let Err(alarm) = outcome {
            assert_eq!((alarm.entry, alarm.words.as_str()), (&VALUE_OUT_OF_RANGE, "F"));
        }
    }
}

#[test]
fn a_thread_of_no_length_moves_nothing() {
    assert_eq!(run(&hole(-5.0, -5.0, Some(300.0))).len(), 2);
}

#[test]
fn a_thread_needs_f_and_s_an_axis_z_and_room() {
    refused(&tap(1, -10.0, TapLeg::In, Some(0.0)), &SPINDLE_SPEED_MISSING);
    refused(&tap(1, -100.1, TapLeg::In, Some(300.0)), &SOFT_LIMIT);
    let mut without_feed = tap(1, -10.0, TapLeg::In, Some(300.0));
    without_feed.feed.feedrate_mm_min = 0.0;
    refused(&without_feed, &FEEDRATE_MISSING);
    let mut without_z = settings();
    without_z.motors[Z.index()] = None;
    let mut stage = PathStage::new(&without_z, MachinePosition::default());
    let alarm = stage.push(&tap(1, -10.0, TapLeg::In, Some(300.0)), &mut Vec::new());
    assert_eq!(alarm.unwrap_err().entry, &AXIS_MISSING);
}

/// Announces a cycle of one hole at the present position with these levels, at S300 with a spindle.
fn ahead(line: u32, r: f64, z: f64) -> Block {
    holes(line, words(Distance::Absolute, &[]), 1, [r, z])
}

/// Returns a block with this number of holes, each at `position`, or each farther by `position`.
fn holes(line: u32, position: AxisWords, repetitions: u16, [r, z]: [f64; 2]) -> Block {
    let first = tap(line, z, TapLeg::In, Some(300.0));
    let Action::Tap(tap) = first.action else {
        unreachable!("a thread")
    };
    let ahead = ThreadAhead {
        position,
        repetitions,
        r_point: words(Distance::Absolute, &[(Z, r)]),
        tap: *tap,
        initial: None,
    };
    Block {
        action: Action::ThreadAhead(Box::new(ahead)),
        ..first
    }
}

#[test]
fn a_cycle_whose_thread_cannot_be_cut_is_refused_before_anything_moves() {
    refused(&ahead(1, -5.0, -100.1), &SOFT_LIMIT);
    refused(&ahead(1, 200.1, -5.0), &SOFT_LIMIT);
    let mut without_feed = ahead(1, -5.0, -10.0);
    without_feed.feed.feedrate_mm_min = 0.0;
    refused(&without_feed, &FEEDRATE_MISSING);
    let mut compensated = ahead(1, -5.0, -10.0);
    compensated.compensation = Compensation::Left {
        radius: 1.0,
        plane: Plane::Xy,
    };
    refused(&compensated, &COMPENSATION_REFUSED);
}

#[test]
fn a_cycle_with_a_hole_out_of_reach_is_refused_before_the_first_hole() {
    let by = |distance, values: &[(Axis, f64)], repetitions| {
        holes(1, words(distance, values), repetitions, [-5.0, -10.0])
    };
    // limits -100 to 200
    for refuse in [
        by(Absolute, &[(X, 200.1)], 1),
        by(Incremental, &[(X, 20.0)], 11),
        by(Incremental, &[(X, 1.0), (Y, -34.0)], 3),
    ] {
        refused(&refuse, &SOFT_LIMIT);
    }
    refused(&by(Incremental, &[(Axis::B, 1.0)], 2), &AXIS_MISSING);
    let mut returns = by(Absolute, &[(X, 1.0)], 1);
    if let Action::ThreadAhead(ahead) = &mut returns.action {
        ahead.initial = Some(words(Absolute, &[(Z, 200.1)]));
    }
    refused(&returns, &SOFT_LIMIT);
    for accept in [by(Absolute, &[(X, 200.0)], 9), by(Incremental, &[(X, 20.0)], 10)] {
        assert!(run(&[accept]).is_empty());
    }
    // the distance is turned as the holes are: 11 times 20 mm along Y
    let rotation = Rotation {
        plane: Plane::Xy,
        centre: AxisVector::ZERO,
        angle_deg: 90.0,
    };
    let turned = Transform {
        rotation: Some(rotation),
        ..Transform::default()
    };
    let mut stage = stage();
    stage.push(&transform(1, turned), &mut Vec::new()).unwrap();
    let alarm = stage.push(&by(Incremental, &[(X, 20.0)], 11), &mut Vec::new());
    let alarm = alarm.unwrap_err();
    assert!(
        alarm.entry == &SOFT_LIMIT && alarm.text.contains("Axis Y"),
        "{}",
        alarm.text
    );
}

#[test]
fn cycle_start_moves_nothing_and_its_levels_include_the_tool_length() {
    let mut stage = stage();
    let mut out = Vec::new();
    // machine Z is 60 less than programmed Z: Z-41 is beyond -100, Z-39 within
    let shorter = Transform {
        tool_length: -60.0,
        ..Transform::default()
    };
    stage.push(&transform(1, shorter), &mut out).unwrap();
    stage.push(&ahead(2, -5.0, -39.0), &mut out).unwrap();
    assert!(out.is_empty());
    assert!((stage.counts_from().0[Z] + 60.0).abs() < 1e-12 && stage.position().0[Z] == 0.0);
    let alarm = stage.push(&ahead(2, -5.0, -41.0), &mut out).unwrap_err();
    assert_eq!(alarm.entry, &SOFT_LIMIT);
    assert!((stage.counts_from().0[Z] + 60.0).abs() < 1e-12 && out.is_empty());
}

#[test]
fn a_thread_along_another_direction_than_z_is_refused() {
    let rotation = Rotation {
        plane: tandem_model::plane::Plane::Zx,
        centre: AxisVector::ZERO,
        angle_deg: 30.0,
    };
    let turned = Transform {
        rotation: Some(rotation),
        ..Transform::default()
    };
    let mut stage = stage();
    let mut out = Vec::new();
    stage.push(&transform(1, turned), &mut out).unwrap();
    for block in [tap(2, -10.0, TapLeg::In, Some(300.0)), ahead(2, -5.0, -10.0)] {
        let alarm = stage.push(&block, &mut out).unwrap_err();
        assert_eq!(alarm.entry, &TAP_OFF_AXIS);
        assert!(out.is_empty());
    }
}

#[test]
fn d22_next_block_starts_from_z_with_the_tool_length_not_yet_moved() {
    let mut stage = stage();
    let mut out = Vec::new();
    let longer = Transform {
        tool_length: 8.0,
        ..Transform::default()
    };
    stage.push(&transform(1, longer), &mut out).unwrap();
    assert!((stage.counts_from().0[Z] - 8.0).abs() < 1e-12);
    assert!(stage.position().0[Z].abs() < 1e-12);
    stage.push(&g00(2, &[(X, 1.0)]), &mut out).unwrap();
    assert!((stage.counts_from().0[Z] - 8.0).abs() < 1e-12);
    assert!((stage.position().0[Z] - 8.0).abs() < 1e-12);
}
