//! G28, G30 and G31.

use tandem_model::alarm::{SOFT_LIMIT, VALUE_OUT_OF_RANGE};
use tandem_model::flow::{Action, AxisWords, Block, Distance, SegmentEnd, SegmentMotion, Transform};
use tandem_model::{Axis, AxisVector, MachinePosition};
use tandem_path::PathStage;

use crate::rig::{block, g01, near, settings, target, transform, words, xyz};

use Axis::{A, X, Y, Z};

fn to_reference(line: u32, middle: AxisWords, point: u8) -> Block {
    block(
        line,
        Action::Reference {
            middle,
            point,
            with_tool_length: false,
        },
    )
}

/// Reference points X 1, 2, 3, 4; Y 10, 20, 30, 40; Z 100, ...; A 0, 90, 180, 270.
fn stage() -> PathStage {
    let mut settings = settings();
    for (axis, points) in [
        (X, [1.0, 2.0, 3.0, 4.0]),
        (Y, [10.0, 20.0, 30.0, 40.0]),
        (Z, [100.0, 110.0, 120.0, 300.0]),
        (A, [0.0, 90.0, 180.0, 270.0]),
    ] {
        settings.motors[axis.index()].as_mut().unwrap().reference_points = points;
    }
    PathStage::new(&settings, MachinePosition::default())
}

#[test]
fn g28_moves_named_axes_via_middle_point_to_first_reference_point() {
    let mut stage = stage();
    let mut out = Vec::new();
    let offset = Transform {
        work_offset: xyz([5.0, 5.0, 5.0]),
        ..Transform::default()
    };
    stage.push(&transform(1, offset), &mut out).unwrap();
    stage
        .push(&g01(2, &[(X, 20.0), (Y, 20.0), (Z, 20.0)]), &mut out)
        .unwrap();
    stage
        .push(
            &to_reference(3, words(Distance::Absolute, &[(X, 30.0), (Z, 50.0)]), 1),
            &mut out,
        )
        .unwrap();
    assert_eq!(out.len(), 3);
    assert_eq!(out[0].end, SegmentEnd::ExactStop, "G28 is not blended");
    near(target(&out[1]), [35.0, 25.0, 55.0]);
    near(target(&out[2]), [1.0, 25.0, 100.0]);
    assert!(
        out[1..]
            .iter()
            .all(|segment| matches!(segment.motion, SegmentMotion::Rapid { .. }))
    );
    assert!(out[1..].iter().all(|segment| segment.origin.line == 3));
}

#[test]
fn g30_selects_points_2_to_4_and_takes_incremental_middle_from_position() {
    for (point, x, y) in [(2, 2.0, 20.0), (3, 3.0, 30.0), (4, 4.0, 40.0)] {
        let mut stage = stage();
        let mut out = Vec::new();
        stage.push(&g01(1, &[(X, 7.0)]), &mut out).unwrap();
        let middle = words(Distance::Incremental, &[(X, 1.0), (Y, 2.0)]);
        stage.push(&to_reference(2, middle, point), &mut out).unwrap();
        near(target(&out[1]), [8.0, 2.0, 0.0]);
        near(target(&out[2]), [x, y, 0.0]);
    }
}

#[test]
fn d24_without_axis_words_all_axes_go_straight_to_the_reference_point() {
    let mut stage = stage();
    let mut out = Vec::new();
    stage
        .push(&to_reference(1, words(Distance::Absolute, &[]), 2), &mut out)
        .unwrap();
    assert_eq!(out.len(), 1);
    let mut expected = xyz([2.0, 20.0, 110.0]);
    expected[A] = 90.0;
    assert_eq!(stage.position(), MachinePosition(expected));
    // A middle point at the present position gives no motion.
    let middle = words(Distance::Incremental, &[(X, 0.0)]);
    stage.push(&to_reference(2, middle, 1), &mut out).unwrap();
    assert_eq!(out.len(), 2);
    near(target(&out[1]), [1.0, 20.0, 110.0]);
}

#[test]
fn soft_limits_of_both_ways_are_checked_before_either_begins() {
    for (middle, point, entry) in [
        (&[(X, 201.0)], 1, &SOFT_LIMIT),
        (&[(Z, 1.0)], 4, &SOFT_LIMIT),
        (&[(X, 1.0)], 0, &VALUE_OUT_OF_RANGE),
        (&[(X, 1.0)], 5, &VALUE_OUT_OF_RANGE),
    ] {
        let mut stage = stage();
        let mut out = Vec::new();
        let block = to_reference(1, words(Distance::Absolute, middle), point);
        let alarm = stage.push(&block, &mut out).unwrap_err();
        assert_eq!(alarm.entry, entry);
        assert!(out.is_empty());
        assert_eq!(stage.position(), MachinePosition(AxisVector::ZERO));
    }
}

#[test]
fn g31_moves_to_its_target_and_next_block_starts_at_servo_rest_position() {
    let mut stage = stage();
    let mut out = Vec::new();
    let offset = Transform {
        work_offset: xyz([0.0, 0.0, 5.0]),
        ..Transform::default()
    };
    stage.push(&transform(1, offset), &mut out).unwrap();
    stage.push(&g01(2, &[(X, 10.0)]), &mut out).unwrap();
    let down = Action::Skip(words(Distance::Absolute, &[(Z, -20.0)]));
    stage.push(&block(3, down), &mut out).unwrap();
    assert_eq!(out[0].end, SegmentEnd::ExactStop, "G31 is not blended");
    let (from, to) = (xyz([10.0, 0.0, 0.0]), xyz([10.0, 0.0, -15.0]));
    assert_eq!(out[1].motion, SegmentMotion::Skip { from, to });
    assert!(stage.is_skipping());
    stage.skipped_to(MachinePosition(xyz([10.0, 0.0, -7.3])));
    assert!(!stage.is_skipping());
    let up = words(Distance::Incremental, &[(Z, 1.0)]);
    stage.push(&block(4, Action::Rapid(up)), &mut out).unwrap();
    near(target(&out[2]), [10.0, 0.0, -6.3]);
    let beyond = Action::Skip(words(Distance::Absolute, &[(Z, -106.0)]));
    assert_eq!(
        stage.push(&block(5, beyond), &mut out).unwrap_err().entry,
        &SOFT_LIMIT
    );
}
