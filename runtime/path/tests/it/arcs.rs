//! G02 and G03 (M1f, D21, D26).

use std::f64::consts::{PI, TAU};

use tandem_model::alarm::{
    ARC_DISTORTED, ARC_IMPOSSIBLE, AXIS_MISSING, AlarmEntry, FEEDRATE_MISSING, SOFT_LIMIT, VALUE_NOT_FINITE,
};
use tandem_model::flow::{
    Action, Arc, ArcShape, Block, Distance, Mirror, Path, PathControl, ProgrammedFeed, Rotation, Scaling,
    Segment, SegmentEnd, SegmentMotion, Transform,
};
use tandem_model::plane::{Plane, Turn};
use tandem_model::{Axis, MachinePosition};
use tandem_path::PathStage;

use crate::rig::{block, ends, g01, near, refused, run, settings, stage, target, transform, words, xyz};

use ArcShape::{Centre, Radius};
use Axis::{A, X, Y, Z};
use Turn::{Clockwise, CounterClockwise};

fn arc(line: u32, turn: Turn, plane: Plane, to: &[(Axis, f64)], shape: ArcShape) -> Block {
    let target = words(Distance::Absolute, to);
    block(
        line,
        Action::Arc(Box::new(Arc {
            target,
            plane,
            turn,
            shape,
        })),
    )
}

fn g02(line: u32, to: &[(Axis, f64)], shape: ArcShape) -> Block {
    arc(line, Clockwise, Plane::Xy, to, shape)
}

fn g03(line: u32, to: &[(Axis, f64)], shape: ArcShape) -> Block {
    arc(line, CounterClockwise, Plane::Xy, to, shape)
}

fn path(segment: &Segment) -> &Path {
    match &segment.motion {
        SegmentMotion::Feed { path, .. } => path,
        other => panic!("not a cutting block: {other:?}"),
    }
}

/// X, Y, Z at a share of the length.
fn at(segment: &Segment, share: f64) -> [f64; 3] {
    let path = path(segment);
    let point = path.point_at(path.length() * share);
    [point[X], point[Y], point[Z]]
}

#[track_caller]
fn close(value: f64, expected: f64) {
    assert!((value - expected).abs() < 1e-9, "{value} is not {expected}");
}

#[track_caller]
fn near9(values: [f64; 3], expected: [f64; 3]) {
    for (value, expected) in values.into_iter().zip(expected) {
        close(value, expected);
    }
}

#[test]
fn s1f_i_j_k_count_from_the_start_point_in_g90_too() {
    // From (100, 50) about (100, 90), a quarter turn clockwise to (60, 90).
    let segments = run(&[
        g01(1, &[(X, 100.0), (Y, 50.0)]),
        g02(2, &[(X, 60.0), (Y, 90.0)], Centre([0.0, 40.0, 0.0])),
    ]);
    close(path(&segments[1]).length(), 40.0 * PI / 2.0);
    let root = 40.0 * 0.5_f64.sqrt();
    near9(at(&segments[1], 0.5), [100.0 - root, 90.0 - root, 0.0]);
    near(target(&segments[1]), [60.0, 90.0, 0.0]);
    assert_eq!(
        ends(&segments),
        [(1, SegmentEnd::Continuous), (2, SegmentEnd::ExactStop)]
    );
}

#[test]
fn s1f_a_centre_without_a_target_in_the_plane_is_a_full_circle() {
    for (turn, quarter) in [
        (Clockwise, [-50.0, 50.0, 0.0]),
        (CounterClockwise, [50.0, 50.0, 0.0]),
    ] {
        let segments = run(&[arc(1, turn, Plane::Xy, &[], Centre([0.0, 50.0, 0.0]))]);
        close(path(&segments[0]).length(), TAU * 50.0);
        near9(at(&segments[0], 0.25), quarter);
        near(target(&segments[0]), [0.0; 3]);
    }
    // With Z a helix: one turn, Z linear in the angle, F over X, Y, Z.
    let helix = run(&[g02(1, &[(Z, 10.0)], Centre([0.0, 50.0, 0.0]))]);
    close(path(&helix[0]).length(), (TAU * 50.0).hypot(10.0));
    near9(at(&helix[0], 0.5), [0.0, 100.0, 5.0]);
}

#[test]
fn s1f_different_radii_at_both_ends_are_a_spiral_about_the_same_centre() {
    let spiral = |line, j| {
        let target = words(Distance::Incremental, &[(Y, 10.0)]);
        block(
            line,
            Action::Arc(Box::new(Arc {
                target,
                plane: Plane::Xy,
                turn: Clockwise,
                shape: Centre([0.0, j, 0.0]),
            })),
        )
    };
    let segments = run(&[spiral(1, 50.0), spiral(2, 40.0), spiral(3, 30.0)]);
    for (segment, start) in segments.iter().zip([50.0, 40.0, 30.0]) {
        let path = path(segment);
        // Length of r = r0 - 10 u over one turn, by Simpson's rule on sqrt((2 pi r)^2 + 10^2).
        let rate = |u: f64| (TAU * (start - 10.0 * u)).hypot(10.0);
        let n = 200;
        let sum: f64 = (0..=n)
            .map(|i| {
                let weight = if i == 0 || i == n {
                    1.0
                } else {
                    2.0 + 2.0 * f64::from(i % 2)
                };
                weight * rate(f64::from(i) / f64::from(n))
            })
            .sum();
        close(path.length(), sum / f64::from(3 * n));
        // Every point lies on its radius: r falls linearly with the angle from the start direction (0, -1).
        for k in 1..50 {
            let point = path.point_at(path.length() * f64::from(k) / 50.0);
            let (dx, dy) = (point[X], point[Y] - 50.0);
            let turned = (-dx).atan2(-dy).rem_euclid(TAU);
            close(dx.hypot(dy), start - 10.0 * turned / TAU);
        }
    }
    near(target(&segments[2]), [0.0, 30.0, 0.0]);
}

#[test]
fn s1f_a_cone_has_radius_and_height_linear_in_the_angle() {
    let segments = run(&[g03(1, &[(X, -30.0), (Z, 12.0)], Centre([-10.0, 0.0, 0.0]))]);
    // Radius 10 to 20 over half a turn about (-10, 0).
    for k in 1..20 {
        let [x, y, z] = at(&segments[0], f64::from(k) / 20.0);
        let u = y.atan2(x + 10.0) / PI;
        close((x + 10.0).hypot(y), 10.0 + 10.0 * u);
        close(z, 12.0 * u);
    }
}

#[test]
fn s1f_a_positive_r_is_the_smaller_arc_and_a_negative_one_the_larger() {
    // From (0, 0) to (10, 0) with R 10: centres (5, +-sqrt(75)); the smaller arc is a sixth of a turn.
    let h = 75.0_f64.sqrt();
    for (turn, radius, centre_y, turns) in [
        (CounterClockwise, 10.0, h, 1.0 / 6.0),
        (CounterClockwise, -10.0, -h, 5.0 / 6.0),
        (Clockwise, 10.0, -h, 1.0 / 6.0),
        (Clockwise, -10.0, h, 5.0 / 6.0),
    ] {
        let segments = run(&[arc(1, turn, Plane::Xy, &[(X, 10.0)], Radius(radius))]);
        close(path(&segments[0]).length(), turns * TAU * 10.0);
        // The middle of a counter-clockwise arc along +X lies below the chord.
        let below = if turn == CounterClockwise { -10.0 } else { 10.0 };
        near9(at(&segments[0], 0.5), [5.0, centre_y + below, 0.0]);
    }
}

#[test]
fn d26_r_too_small_within_tolerance_is_a_half_circle_beyond_it_an_alarm() {
    for radius in [5.0, 4.995, -4.991] {
        let segments = run(&[g03(1, &[(X, 10.0)], Radius(radius))]);
        close(path(&segments[0]).length(), PI * 5.0);
        near9(at(&segments[0], 0.5), [5.0, -5.0, 0.0]);
    }
    let text = refused(&g03(1, &[(X, 10.0)], Radius(4.98)), &ARC_IMPOSSIBLE);
    assert!(text.contains("4.98") && text.contains("5.0"), "{text}");
    let mut settings = settings();
    settings.motion.arc_radius_tolerance_mm = 0.05;
    let mut stage = PathStage::new(&settings, MachinePosition::default());
    stage
        .push(&g03(1, &[(X, 10.0)], Radius(4.98)), &mut Vec::new())
        .unwrap();
}

#[test]
fn d26_r_zero_is_a_straight_line() {
    let segments = run(&[g02(1, &[(X, 3.0), (Y, 4.0)], Radius(0.0))]);
    assert!(matches!(path(&segments[0]), Path::Line { .. }));
    close(path(&segments[0]).length(), 5.0);
}

#[test]
fn what_is_no_arc_is_an_alarm_that_names_the_values() {
    let cases: [(Block, &'static AlarmEntry); 9] = [
        (g02(1, &[], Radius(5.0)), &ARC_IMPOSSIBLE),
        (g02(1, &[(X, 10.0)], Centre([0.0, 0.0, 5.0])), &ARC_IMPOSSIBLE),
        (g02(1, &[(X, 10.0)], Centre([10.0, 0.0, 0.0])), &ARC_IMPOSSIBLE),
        (
            g02(1, &[(X, 10.0)], Centre([f64::NAN, 0.0, 0.0])),
            &VALUE_NOT_FINITE,
        ),
        (
            g02(1, &[(X, 10.0)], Centre([f64::MAX, f64::MAX, 0.0])),
            &VALUE_NOT_FINITE,
        ),
        (g02(1, &[(X, 10.0)], Radius(f64::INFINITY)), &VALUE_NOT_FINITE),
        (g02(1, &[(X, f64::NAN)], Radius(10.0)), &VALUE_NOT_FINITE),
        (g02(1, &[(Axis::B, 1.0)], Centre([5.0, 0.0, 0.0])), &AXIS_MISSING),
        (
            Block {
                feed: ProgrammedFeed {
                    feedrate_mm_min: 0.0,
                    ..g02(1, &[], Radius(1.0)).feed
                },
                ..g02(1, &[(X, 10.0)], Radius(10.0))
            },
            &FEEDRATE_MISSING,
        ),
    ];
    for (block, entry) in cases {
        refused(&block, entry);
    }
    let mut settings = settings();
    settings.motors[Y.index()] = None;
    let mut stage = PathStage::new(&settings, MachinePosition::default());
    let alarm = stage
        .push(&g02(1, &[(X, 10.0)], Radius(10.0)), &mut Vec::new())
        .unwrap_err();
    assert_eq!(alarm.entry, &AXIS_MISSING);
    assert!(alarm.text.contains('Y'));
}

#[test]
fn m1f_r_without_an_axis_of_the_plane_is_an_alarm_at_any_tool_length() {
    let mut stage = stage();
    let mut out = Vec::new();
    let longer = Transform {
        tool_length: 8.0,
        ..Transform::default()
    };
    stage.push(&transform(1, longer), &mut out).unwrap();
    for words in [&[][..], &[(Y, 3.0)]] {
        let alarm = stage.push(&arc(2, Clockwise, Plane::Zx, words, Radius(10.0)), &mut out);
        let alarm = alarm.unwrap_err();
        assert_eq!(alarm.entry, &ARC_IMPOSSIBLE);
        assert!(alarm.text.contains("neither Z nor X"), "{}", alarm.text);
    }
    assert!(out.is_empty());
}

#[test]
fn s1f_g18_turns_z_towards_x_and_g19_y_towards_z() {
    for (plane, to, ijk, middle) in [
        (
            Plane::Zx,
            [(Z, -10.0), (X, 10.0)],
            [0.0, 0.0, -10.0],
            [1.0, 0.0, -1.0],
        ),
        (
            Plane::Yz,
            [(Y, -10.0), (Z, 10.0)],
            [0.0, -10.0, 0.0],
            [0.0, -1.0, 1.0],
        ),
    ] {
        let segments = run(&[arc(1, CounterClockwise, plane, &to, Centre(ijk))]);
        close(path(&segments[0]).length(), 10.0 * PI / 2.0);
        // From the first axis's side of the centre towards the second's: 45 degrees on the way.
        let root = 10.0 * 0.5_f64.sqrt();
        let expected = middle.map(|side: f64| {
            if side > 0.0 {
                root
            } else if side < 0.0 {
                root - 10.0
            } else {
                0.0
            }
        });
        near9(at(&segments[0], 0.5), expected);
    }
}

fn scaled(factors: [f64; 3]) -> Transform {
    Transform {
        scaling: Some(Scaling {
            centre: xyz([0.0; 3]),
            factors,
        }),
        ..Transform::default()
    }
}

#[test]
fn d21_an_arc_under_a_mirror_or_one_negative_scale_changes_its_sense() {
    let mirrored = Transform {
        mirror: Some(Mirror {
            axes: [X].into_iter().collect(),
            centre: xyz([0.0; 3]),
        }),
        ..Transform::default()
    };
    for (transform_block, sense, factor) in [
        (transform(1, mirrored), [-1.0, 1.0], 1.0),
        (transform(1, scaled([-2.0, 2.0, 1.0])), [-1.0, 1.0], 2.0),
        (transform(1, scaled([3.0, -3.0, 1.0])), [1.0, -1.0], 3.0),
        (transform(1, scaled([-1.5, -1.5, 1.0])), [-1.0, -1.0], 1.5),
    ] {
        for shape in [Centre([0.0, 10.0, 0.0]), Radius(10.0)] {
            let segments = run(&[transform_block.clone(), g03(2, &[(X, 10.0), (Y, 10.0)], shape)]);
            let root = 10.0 * 0.5_f64.sqrt();
            close(path(&segments[0]).length(), factor * 10.0 * PI / 2.0);
            near9(
                at(&segments[0], 0.5),
                [sense[0] * factor * root, sense[1] * factor * (10.0 - root), 0.0],
            );
        }
    }
}

#[test]
fn d21_unequal_scale_of_the_plane_or_a_rotation_out_of_it_is_an_alarm() {
    let turned = |plane| Transform {
        rotation: Some(Rotation {
            plane,
            centre: xyz([0.0; 3]),
            angle_deg: 30.0,
        }),
        ..Transform::default()
    };
    for (distorting, text) in [
        (scaled([2.0, 1.0, 1.0]), "X, Y and Z are scaled by 2, 1 and 1"),
        (turned(Plane::Zx), "the rotation is by 30 degrees in the ZX plane"),
    ] {
        let mut stage = stage();
        let mut out = Vec::new();
        stage.push(&transform(1, distorting), &mut out).unwrap();
        let alarm = stage
            .push(&g02(2, &[(X, 10.0)], Radius(10.0)), &mut out)
            .unwrap_err();
        assert_eq!(alarm.entry, &ARC_DISTORTED);
        assert_eq!(alarm.text, format!("The arc is in the XY plane; {text}"));
    }
    // The third axis may be scaled: a helix stays one.
    let segments = run(&[
        transform(1, scaled([1.0, 1.0, 4.0])),
        g02(2, &[(Z, 1.0)], Centre([5.0, 0.0, 0.0])),
    ]);
    near(target(&segments[0]), [0.0, 0.0, 4.0]);
    // In its own plane a rotation turns the arc with its centre.
    let segments = run(&[
        transform(1, turned(Plane::Xy)),
        g02(2, &[], Centre([10.0, 0.0, 0.0])),
    ]);
    near9(at(&segments[0], 0.5), [20.0 * 0.75_f64.sqrt(), 10.0, 0.0]);
}

#[test]
fn soft_limits_hold_for_the_turning_points_of_an_arc_before_it_begins() {
    // From (190, 0) to (190, 20) about (190, 10): X reaches 200, the limit; about a larger circle it goes beyond.
    let start = g01(1, &[(X, 190.0)]);
    let within = g03(2, &[(X, 190.0), (Y, 20.0)], Centre([0.0, 10.0, 0.0]));
    assert_eq!(run(&[start.clone(), within]).len(), 2);
    let beyond = g03(2, &[(X, 190.0), (Y, 20.0)], Radius(-10.5));
    let mut stage = stage();
    let mut out = Vec::new();
    stage.push(&start, &mut out).unwrap();
    let alarm = stage.push(&beyond, &mut out).unwrap_err();
    assert_eq!(alarm.entry, &SOFT_LIMIT);
    // Its X comes to 190 + sqrt(10.5^2 - 10^2) + 10.5.
    let expected = format!("{:.6}", 190.0 + 10.25_f64.sqrt() + 10.5);
    assert!(
        alarm.text.contains(&expected) && alarm.text.contains('X'),
        "{}",
        alarm.text
    );
    // The other way round it stays below.
    let back = arc(3, Clockwise, Plane::Xy, &[(X, 190.0), (Y, 20.0)], Radius(10.5));
    stage.push(&back, &mut out).unwrap();
}

#[test]
fn soft_limits_hold_where_arcs_are_blended_beyond_the_hull_of_both() {
    // Two half circles of radius 5 that meet at (191, 0); each comes to X = 196. The blend takes half of each, 7.85 mm, at
    // 30 m/min; a quarter of the blend's part of each, 1.96 mm, is left at half of its time, less at others.
    let arcs = |feedrate_mm_min: f64| {
        let mut blocks = [
            g01(1, &[(X, 191.0), (Y, -10.0)]),
            g03(2, &[(X, 191.0), (Y, 0.0)], Centre([0.0, 5.0, 0.0])),
            g03(3, &[(X, 191.0), (Y, 10.0)], Centre([0.0, 5.0, 0.0])),
        ];
        for block in &mut blocks {
            block.feed.feedrate_mm_min = feedrate_mm_min;
        }
        blocks
    };
    let alarm_within = |blocks: &[Block], highest: f64| {
        let mut settings = settings();
        settings.motors[0].as_mut().unwrap().soft_limits = Some([-100.0, highest]);
        let mut stage = PathStage::new(&settings, MachinePosition::default());
        let mut out = Vec::new();
        blocks.iter().find_map(|block| stage.push(block, &mut out).err())
    };
    // At the ends of the blend only one of them is away from the joint: 191 + 5 at most there; between them the one is
    // at its maximum when the other has passed `(1 - sqrt(5/7.85))^2` of 7.85 mm.
    let half = 2.5 * PI;
    let farthest = 191.0 + 5.0 + half * (1.0 - (5.0 / half).sqrt()).powi(2);
    assert_eq!(alarm_within(&arcs(30_000.0), farthest + 1e-6), None);
    let alarm = alarm_within(&arcs(30_000.0), farthest - 1e-3).unwrap();
    assert_eq!((alarm.entry, alarm.origin.unwrap().line), (&SOFT_LIMIT, 3));
    assert_eq!(alarm.words, "X");
    assert!(alarm.text.contains(&format!("{farthest:.6}")), "{}", alarm.text);
    // Slow, the blend is short; with G61 there is none.
    assert_eq!(alarm_within(&arcs(600.0), 196.0), None);
    let mut exact = arcs(30_000.0);
    for block in &mut exact {
        block.path_control = PathControl::ExactStop;
    }
    assert_eq!(alarm_within(&exact, 196.0), None);
}

#[test]
fn an_axis_outside_its_limits_hinders_no_blended_arcs_that_do_not_move_it() {
    let mut at = xyz([0.0; 3]);
    at[Z] = -150.0;
    let mut stage = PathStage::new(&settings(), MachinePosition(at));
    let mut out = Vec::new();
    for block in [
        g01(1, &[(X, 10.0)]),
        g03(2, &[(Y, 10.0)], Radius(5.0)),
        g01(3, &[(X, 0.0)]),
    ] {
        stage.push(&block, &mut out).unwrap();
    }
    let alarm = stage.push(&g03(4, &[(X, -5.0), (Z, -151.0)], Radius(5.0)), &mut out);
    assert_eq!(alarm.unwrap_err().entry, &SOFT_LIMIT);
}

#[test]
fn d22_a_full_circle_without_words_ends_at_the_corrected_z() {
    let long = Transform {
        tool_length: 8.0,
        ..Transform::default()
    };
    let segments = run(&[transform(1, long), g02(2, &[], Centre([5.0, 0.0, 0.0]))]);
    near(target(&segments[0]), [0.0, 0.0, 8.0]);
}

#[test]
fn a_rotary_axis_goes_along_with_the_angle_and_does_not_count_for_f() {
    let segments = run(&[g02(1, &[(A, 360.0)], Centre([5.0, 0.0, 0.0]))]);
    close(path(&segments[0]).length(), TAU * 5.0);
    close(path(&segments[0]).point_at(PI * 5.0)[A], 180.0);
}

#[test]
fn any_numbers_give_a_finite_arc_or_an_alarm() {
    let mut settings = settings();
    for motor in settings.motors.iter_mut().flatten() {
        motor.soft_limits = None;
    }
    let numbers = [
        0.0,
        -0.0,
        1e-12,
        2e-9,
        -1e-5,
        0.3,
        10.0,
        -1e6,
        1e150,
        1e300,
        -1e308,
        f64::MIN_POSITIVE,
        f64::NAN,
    ];
    let mut drawn = 0;
    for x in numbers {
        for i in numbers {
            for j in numbers {
                for shape in [Centre([i, j, 0.0]), Radius(i)] {
                    let mut stage = PathStage::new(&settings, MachinePosition::default());
                    let mut out = Vec::new();
                    let block = g02(1, &[(X, x), (Y, j), (Z, 3.0)], shape);
                    if stage.push(&block, &mut out).is_err() {
                        continue;
                    }
                    stage.flush(&mut out);
                    for segment in &out {
                        let path = path(segment);
                        for share in [0.0, 1e-9, 0.25, 0.5, 0.999, 1.0] {
                            let point = path.point_at(path.length() * share);
                            assert!(point.is_finite(), "{x} {i} {j} {shape:?} at {share}: {path:?}");
                        }
                        assert!(
                            path.steepest(X).is_finite() && path.steepest(Z).is_finite(),
                            "{path:?}"
                        );
                        drawn += 1;
                    }
                }
            }
        }
    }
    assert!(drawn > 500, "{drawn}");
}

#[test]
fn s1f_spiral_tolerance_makes_a_larger_difference_of_the_radii_an_alarm() {
    // Radius 20 at the start, 20.3 at the end.
    let blocks = [
        g01(1, &[(X, 20.0)]),
        g03(2, &[(X, 0.0), (Y, 20.3)], Centre([-20.0, 0.0, 0.0])),
    ];
    let with_tolerance = |tolerance: f64| {
        let mut settings = settings();
        settings.motion.spiral_tolerance_mm = tolerance;
        let mut stage = PathStage::new(&settings, MachinePosition::default());
        let mut out = Vec::new();
        blocks.iter().find_map(|block| stage.push(block, &mut out).err())
    };
    assert_eq!(with_tolerance(0.0), None);
    assert_eq!(with_tolerance(0.301), None);
    let alarm = with_tolerance(0.299).unwrap();
    assert_eq!(alarm.entry, &ARC_IMPOSSIBLE);
    assert!(alarm.text.contains("20.300000"), "{}", alarm.text);
}
