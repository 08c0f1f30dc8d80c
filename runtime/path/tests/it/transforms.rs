//! D20 to D23: transforms, their inverse, tool length, G53.

use tandem_model::alarm::{AXIS_MISSING, OFFSET_IN_FORCE, VALUE_NOT_FINITE, VALUE_OUT_OF_RANGE};
use tandem_model::flow::{
    Action, AxisWords, Block, Compensation, Distance, Frame, Mirror, Rotation, Scaling, SegmentEnd,
    SegmentMotion, Transform,
};
use tandem_model::plane::Plane;
use tandem_model::{Axis, AxisSet, MachinePosition};
use tandem_path::{PathStage, work_position};

use crate::rig::{
    block, g00, g01, incremental, near, refused, run, settings, stage, target, transform, words, xyz,
};

use Axis::{A, X, Y, Z};

fn set(axes: &[Axis]) -> AxisSet {
    axes.iter().copied().collect()
}

/// Creates a mirror of X about 5, scales 2, 3, 0.5 about (1, 2, 4), a rotation by 30 degrees about (10, 20),
/// and offsets.
fn everything() -> Transform {
    Transform {
        mirror: Some(Mirror {
            axes: set(&[X]),
            centre: xyz([5.0, 99.0, 99.0]),
        }),
        scaling: Some(Scaling {
            centre: xyz([1.0, 2.0, 4.0]),
            factors: [2.0, 3.0, 0.5],
        }),
        rotation: Some(Rotation {
            plane: Plane::Xy,
            centre: xyz([10.0, 20.0, 99.0]),
            angle_deg: 30.0,
        }),
        local: xyz([1.0, -2.0, 3.0]),
        work_offset: xyz([7.0, 8.0, -9.0]),
        tool_length: 6.0,
    }
}

/// Calculates the transform of [`everything`] step by step in the order of D20.
fn everything_by_hand([x, y, z]: [f64; 3]) -> [f64; 3] {
    let (x, y, z) = (10.0 - x, y, z);
    let (x, y, z) = (
        1.0 + 2.0 * (x - 1.0),
        2.0 + 3.0 * (y - 2.0),
        4.0 + 0.5 * (z - 4.0),
    );
    let (cos, sin) = (0.75_f64.sqrt(), 0.5);
    let (dx, dy) = (x - 10.0, y - 20.0);
    let (x, y) = (10.0 + cos * dx - sin * dy, 20.0 + sin * dx + cos * dy);
    [x + 1.0 + 7.0, y - 2.0 + 8.0, z + 3.0 - 9.0 + 6.0]
}

#[test]
fn d20_order_is_mirror_scale_rotation_local_work_offset_tool_length() {
    for point in [[0.0, 0.0, 0.0], [3.0, -4.0, 5.0], [12.5, 7.25, -2.0]] {
        let [x, y, z] = point;
        let segments = run(&[transform(1, everything()), g01(2, &[(X, x), (Y, y), (Z, z)])]);
        near(target(&segments[0]), everything_by_hand(point));
    }
}

#[test]
fn d20_the_work_position_undoes_all_of_it() {
    for point in [[0.0, 0.0, 0.0], [3.0, -4.0, 5.0], [12.5, 7.25, -2.0]] {
        let machine = MachinePosition(xyz(everything_by_hand(point)));
        let work = work_position(&everything(), machine).0;
        near([work[X], work[Y], work[Z]], point);
    }
}

#[test]
fn d20_incremental_words_take_the_linear_part_only() {
    let segments = run(&[
        transform(1, everything()),
        g01(2, &[(X, 3.0), (Y, -4.0), (Z, 5.0)]),
        incremental(3, &[(X, 1.0), (Y, 2.0), (Z, -4.0)]),
    ]);
    near(target(&segments[1]), everything_by_hand([4.0, -2.0, 1.0]));
    // Only X: -2 mm before the rotation by 30 degrees.
    let segments = run(&[
        transform(
            1,
            Transform {
                tool_length: 0.0,
                ..everything()
            },
        ),
        incremental(2, &[(X, 1.0)]),
    ]);
    near(target(&segments[0]), [-(3.0_f64.sqrt()), -1.0, 0.0]);
}

#[test]
fn d20_unnamed_axis_keeps_its_programmed_value_under_a_rotation() {
    let rotation = Rotation {
        plane: Plane::Xy,
        centre: xyz([0.0, 0.0, 0.0]),
        angle_deg: 90.0,
    };
    let turned = Transform {
        rotation: Some(rotation),
        ..Transform::default()
    };
    let segments = run(&[
        transform(1, turned),
        g01(2, &[(X, 10.0), (Y, 4.0), (Z, 1.0)]),
        g01(3, &[(X, 20.0)]),
        g00(4, &[(A, 5.0)]),
    ]);
    near(target(&segments[0]), [-4.0, 10.0, 1.0]);
    near(target(&segments[1]), [-4.0, 20.0, 1.0]);
    // A quarter turn moves the other axis by nothing at all, and a word outside the plane moves neither.
    let x_moved = segments.iter().skip(1).any(|segment| match &segment.motion {
        SegmentMotion::Feed { path, .. } => path.start()[X].to_bits() != path.end()[X].to_bits(),
        SegmentMotion::Rapid { from, to }
        | SegmentMotion::Skip { from, to }
        | SegmentMotion::Tap { from, to, .. } => {
            from[X].to_bits() != to[X].to_bits() || from[Y].to_bits() != to[Y].to_bits()
        }
        SegmentMotion::Dwell { .. } => false,
    });
    assert!(!x_moved);
}

#[test]
fn d20_rotation_is_counter_clockwise_from_first_to_second_plane_axis() {
    for (plane, axis, expected) in [
        (Plane::Xy, X, [0.0, 10.0, 0.0]),
        (Plane::Zx, Z, [10.0, 0.0, 0.0]),
        (Plane::Yz, Y, [0.0, 0.0, 10.0]),
    ] {
        let rotation = Rotation {
            plane,
            centre: xyz([0.0; 3]),
            angle_deg: 90.0,
        };
        let turned = Transform {
            rotation: Some(rotation),
            ..Transform::default()
        };
        near(
            target(&run(&[transform(1, turned), g01(2, &[(axis, 10.0)])])[0]),
            expected,
        );
    }
}

#[test]
fn d20_a_rotation_that_moves_an_axis_that_is_missing_is_an_alarm() {
    let mut settings = settings();
    settings.motors[Y.index()] = None;
    let mut stage = PathStage::new(&settings, MachinePosition::default());
    let mut out = Vec::new();
    let rotation = Rotation {
        plane: Plane::Xy,
        centre: xyz([0.0; 3]),
        angle_deg: 45.0,
    };
    let turned = Transform {
        rotation: Some(rotation),
        ..Transform::default()
    };
    stage.push(&transform(1, turned), &mut out).unwrap();
    let alarm = stage.push(&g01(2, &[(X, 10.0)]), &mut out).unwrap_err();
    assert_eq!(alarm.entry, &AXIS_MISSING);
    assert!(alarm.text.contains('Y'), "{}", alarm.text);
}

/// The manual's figures of G43: length 8, Z-10: machine Z -2; length 6: -4; G49, Z0: 0.
#[test]
fn d22_tool_length_shifts_z_without_motion_of_its_own() {
    let tool = |line, tool_length| {
        transform(
            line,
            Transform {
                tool_length,
                ..Transform::default()
            },
        )
    };
    let segments = run(&[
        tool(1, 8.0),
        g00(2, &[(Z, -10.0)]),
        tool(3, 6.0),
        g01(4, &[(Z, -10.0)]),
        tool(5, 0.0),
        g01(6, &[(Z, 0.0)]),
    ]);
    let z: Vec<_> = segments.iter().map(|segment| target(segment)[2]).collect();
    assert_eq!(z, [-2.0, -4.0, 0.0]);
    assert!(
        segments
            .iter()
            .all(|segment| segment.end == SegmentEnd::ExactStop),
        "each G43 ends the chain"
    );
}

#[test]
fn d22_next_motion_block_ends_at_corrected_z_whether_or_not_it_names_z() {
    let long = Transform {
        tool_length: 8.0,
        ..Transform::default()
    };
    let short = Transform {
        tool_length: -3.0,
        ..Transform::default()
    };
    let segments = run(&[
        g01(1, &[(Z, -10.0)]),
        transform(2, long),
        g01(3, &[(X, 5.0)]),
        g01(4, &[(X, 6.0)]),
        transform(5, short),
        transform(6, long),
        transform(7, short),
        incremental(8, &[(Y, 1.0)]),
        incremental(9, &[(Z, 1.0)]),
        transform(10, Transform::default()),
        g01(11, &[(Z, -10.0)]),
    ]);
    let ends: Vec<_> = segments.iter().map(target).collect();
    for (end, expected) in ends.iter().zip([
        [0.0, 0.0, -10.0],
        [5.0, 0.0, -2.0],
        [6.0, 0.0, -2.0],
        [6.0, 1.0, -13.0],
        [6.0, 1.0, -12.0],
        [6.0, 1.0, -10.0],
    ]) {
        near(*end, expected);
    }
    assert_eq!(ends.len(), 6);
}

fn machine(values: &[(Axis, f64)]) -> AxisWords {
    AxisWords {
        frame: Frame::Machine,
        ..words(Distance::Absolute, values)
    }
}

#[test]
fn g53_moves_to_machine_coordinates_whatever_transform_is_in_force() {
    let without_tool = Transform {
        tool_length: 0.0,
        ..everything()
    };
    let segments = run(&[
        transform(1, without_tool),
        block(2, Action::Rapid(machine(&[(X, 12.0), (Y, -3.0)]))),
        block(3, Action::Linear(machine(&[(Z, 4.5)]))),
    ]);
    near(target(&segments[0]), [12.0, -3.0, 0.0]);
    near(target(&segments[1]), [12.0, -3.0, 4.5]);
}

#[test]
fn d23_g53_g28_g30_with_tool_offset_or_cutter_compensation_are_alarms() {
    let reference = Action::Reference {
        middle: words(Distance::Absolute, &[(X, 1.0)]),
        point: 1,
        with_tool_length: false,
    };
    for action in [Action::Rapid(machine(&[(X, 1.0)])), reference] {
        let mut stage = stage();
        let mut out = Vec::new();
        stage.push(&transform(1, everything()), &mut out).unwrap();
        let alarm = stage.push(&block(2, action.clone()), &mut out).unwrap_err();
        assert_eq!(alarm.entry, &OFFSET_IN_FORCE);
        assert!(alarm.text.contains('6'), "{}", alarm.text);
    }
    let compensated = Block {
        compensation: Compensation::Left {
            radius: 5.0,
            plane: Plane::Xy,
        },
        ..block(
            1,
            Action::Reference {
                middle: words(Distance::Absolute, &[]),
                point: 1,
                with_tool_length: false,
            },
        )
    };
    refused(&compensated, &OFFSET_IN_FORCE);
}

#[test]
fn transform_with_zero_scale_or_not_a_number_is_an_alarm() {
    let scaled = |factor| Transform {
        scaling: Some(Scaling {
            centre: xyz([0.0; 3]),
            factors: [1.0, factor, 1.0],
        }),
        ..Transform::default()
    };
    refused(&transform(1, scaled(0.0)), &VALUE_OUT_OF_RANGE);
    refused(&transform(1, scaled(f64::NAN)), &VALUE_NOT_FINITE);
    let mut turned = everything();
    turned.rotation.as_mut().unwrap().angle_deg = f64::INFINITY;
    refused(&transform(1, turned), &VALUE_NOT_FINITE);
    let long = Transform {
        tool_length: f64::NAN,
        ..Transform::default()
    };
    refused(&transform(1, long), &VALUE_NOT_FINITE);
}
