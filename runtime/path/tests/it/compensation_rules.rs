//! Requirements of G41 and G42 on a program, and other codes between their blocks (M1g, D20, D23; manual, restrictions
//! of G41).

use tandem_model::alarm::{
    COMPENSATION_ARC_SMALL, COMPENSATION_CORNER, COMPENSATION_LEAD_SHORT, COMPENSATION_LOOK_AHEAD,
    COMPENSATION_REFUSED, COMPENSATION_SPIRAL, OFFSET_IN_FORCE, OVERCUT, SOFT_LIMIT, VALUE_NOT_FINITE,
    VALUE_OUT_OF_RANGE,
};
use tandem_model::flow::{Action, Compensation, Distance, Frame, Mirror, Transform};
use tandem_model::plane::Plane;
use tandem_model::settings::Overcut;
use tandem_model::{Axis, MachinePosition};
use tandem_path::{LOOK_AHEAD_MAX, PathStage};

use crate::contour::Step::{A, L};
use crate::contour::{
    G41, R, Step, alarm_of, blocks, completed, is, led_in, led_in_then, left, outcome, refused, right, same,
    way, with,
};
use crate::rig::{block, g00, g01, settings, transform, words, xyz};

use Axis::{X, Y, Z};

#[test]
fn s1g_a_lead_in_or_lead_out_shorter_than_the_radius_is_an_alarm() {
    let (alarm, moved) = refused(R, (0.0, 0.0), &[L(4.99, 0.0), L(20.0, 0.0), L(30.0, 0.0)]);
    is(&alarm, &COMPENSATION_LEAD_SHORT, 2);
    assert!(alarm.text.contains("4.990000") && alarm.text.contains("5.000000"));
    assert_eq!(moved, None);
    let (alarm, moved) = refused(R, (0.0, 0.0), &[L(10.0, 0.0), L(20.0, 0.0), L(24.9, 0.0)]);
    is(&alarm, &COMPENSATION_LEAD_SHORT, 4);
    // The block before does not move: only the lead-out would have determined its end.
    assert_eq!(moved, Some(2));
    completed(&blocks(
        (0.0, 0.0),
        &[L(5.0, 0.0), L(20.0, 0.0), L(25.0, 0.0)],
        left(R, Plane::Xy),
    ));
}

#[test]
fn s1g_arcs_do_not_lead_in_or_out() {
    let (alarm, _) = refused(
        R,
        (0.0, 0.0),
        &[A((20.0, 0.0), (10.0, 0.0), false), L(30.0, 0.0), L(40.0, 0.0)],
    );
    is(&alarm, &COMPENSATION_REFUSED, 2);
    let (alarm, _) = refused(
        R,
        (0.0, 0.0),
        &[L(10.0, 0.0), L(20.0, 0.0), A((40.0, 0.0), (30.0, 0.0), false)],
    );
    is(&alarm, &COMPENSATION_REFUSED, 4);
}

#[test]
fn s1g_g00_does_not_move_while_g41_is_on() {
    for (values, line) in [([(X, 30.0)], 3), ([(Z, 5.0)], 3)] {
        let (alarm, _) = alarm_of(&led_in_then([with(G41, g00(3, &values))]));
        is(&alarm, &COMPENSATION_REFUSED, line);
    }
    let (alarm, _) = alarm_of(&[with(G41, g00(1, &[(X, 30.0)]))]);
    is(&alarm, &COMPENSATION_REFUSED, 1);
}

#[test]
fn s1g_side_plane_and_radius_stay() {
    for other in [right(R, Plane::Xy), left(R, Plane::Zx), left(6.0, Plane::Xy)] {
        let (alarm, segments) = alarm_of(&led_in_then([with(other, g01(3, &[(X, 30.0)]))]));
        is(&alarm, &COMPENSATION_REFUSED, 3);
        same(&way(&segments), &[L(10.0, 5.0)]);
    }
    // A mirror puts the tool on the other side.
    let mirror = Transform {
        mirror: Some(Mirror {
            axes: [X].into_iter().collect(),
            centre: xyz([0.0; 3]),
        }),
        ..Transform::default()
    };
    let (alarm, _) = alarm_of(&led_in_then([
        transform(3, mirror),
        with(G41, g01(4, &[(X, 30.0)])),
    ]));
    is(&alarm, &COMPENSATION_REFUSED, 4);
}

#[test]
fn d23_g53_g28_and_g30_are_alarms_until_the_lead_out() {
    let machine = |line| {
        let mut target = words(Distance::Absolute, &[(X, 50.0)]);
        target.frame = Frame::Machine;
        block(line, Action::Linear(target))
    };
    let reference = |line| {
        let middle = words(Distance::Absolute, &[(X, 50.0)]);
        block(
            line,
            Action::Reference {
                middle,
                point: 1,
                with_tool_length: false,
            },
        )
    };
    for compensation in [G41, Compensation::Off] {
        for refused in [machine(3), reference(3)] {
            let (alarm, _) = alarm_of(&led_in_then([with(compensation, refused)]));
            is(&alarm, &OFFSET_IN_FORCE, 3);
        }
    }
}

#[test]
fn g31_does_not_move_before_the_lead_out() {
    for compensation in [G41, Compensation::Off] {
        let skip = block(3, Action::Skip(words(Distance::Absolute, &[(X, 50.0)])));
        let (alarm, _) = alarm_of(&led_in_then([with(compensation, skip)]));
        is(&alarm, &COMPENSATION_REFUSED, 3);
    }
}

#[test]
fn s1g_a_lead_out_needs_a_compensated_block_before_it() {
    let (alarm, _) = refused(R, (0.0, 0.0), &[L(10.0, 0.0), L(20.0, 0.0)]);
    is(&alarm, &COMPENSATION_REFUSED, 3);
}

#[test]
fn s1g_an_inside_arc_not_larger_than_the_tool_is_an_alarm_in_either_mode() {
    for overcut in [Overcut::Detect, Overcut::Prevent] {
        let mut settings = settings();
        settings.motion.overcut = overcut;
        for radius in [4.0, 5.0] {
            let contour = [
                L(10.0, 0.0),
                L(20.0, 0.0),
                A((20.0, 2.0 * radius), (20.0, radius), true),
                L(0.0, 2.0 * radius),
                L(-20.0, 2.0 * radius),
            ];
            let blocks = blocks((0.0, 0.0), &contour, G41);
            let (segments, alarm) = outcome(&settings, &blocks);
            let alarm = alarm.unwrap();
            is(&alarm, &COMPENSATION_ARC_SMALL, 4);
            assert!(alarm.text.contains(&format!("{radius:.6}")), "{}", alarm.text);
            same(&way(&segments), &[L(10.0, 5.0)]);
        }
    }
}

#[test]
fn s1g_blocks_that_do_not_meet_inside_are_an_alarm() {
    // An arc of radius 8 turns left; the line's offset y = 5 lies above the offset circle of radius 3 about (.., 1).
    let u = 20.0 - 63.0_f64.sqrt();
    let (alarm, moved) = refused(
        R,
        (-10.0, 0.0),
        &[
            L(0.0, 0.0),
            L(20.0, 0.0),
            A((u, 9.0), (u, 1.0), true),
            L(0.0, 9.0),
            L(-20.0, 9.0),
        ],
    );
    is(&alarm, &COMPENSATION_CORNER, 4);
    assert_eq!(moved, Some(2));
}

#[test]
fn s1g_a_spiral_is_an_alarm_and_a_rounded_arc_is_not() {
    let contour = |end: f64| {
        [
            L(10.0, 0.0),
            L(20.0, 0.0),
            A((20.0, end), (20.0, 10.0), true),
            L(0.0, end),
            L(-20.0, end),
        ]
    };
    let (alarm, moved) = refused(R, (0.0, 0.0), &contour(20.02));
    is(&alarm, &COMPENSATION_SPIRAL, 4);
    assert_eq!(moved, Some(2));
    let segments = completed(&blocks((0.0, 0.0), &contour(20.004), G41));
    same(
        &way(&segments),
        &[
            L(10.0, 5.0),
            L(20.0, 5.0),
            A((20.0, 15.004), (20.0, 10.0), true),
            L(0.0, 15.004),
            L(-20.0, 20.004),
        ],
    );
}

#[test]
fn a_radius_of_the_tool_that_is_no_length_is_an_alarm() {
    for (radius, entry) in [
        (f64::NAN, &VALUE_NOT_FINITE),
        (f64::INFINITY, &VALUE_NOT_FINITE),
        (-1.0, &VALUE_OUT_OF_RANGE),
    ] {
        let (alarm, moved) = refused(radius, (0.0, 0.0), &[L(10.0, 0.0), L(20.0, 0.0), L(30.0, 0.0)]);
        is(&alarm, entry, 2);
        assert_eq!(moved, None);
    }
}

#[test]
fn the_soft_limits_are_those_of_the_tools_centre() {
    // Y may move to 200: the programmed line is within that limit, the offset centre is not.
    let contour = |y: f64| {
        [
            L(10.0, y - 20.0),
            L(10.0, y),
            L(60.0, y),
            L(60.0, y - 20.0),
            L(60.0, y - 40.0),
        ]
    };
    let (alarm, moved) = refused(R, (0.0, 0.0), &contour(196.0));
    is(&alarm, &SOFT_LIMIT, 3);
    assert_eq!(moved, Some(2));
    // With the tool on the other side the programmed line may lie beyond.
    let other = blocks((0.0, 0.0), &contour(204.0), right(R, Plane::Xy));
    completed(&other);
}

#[test]
fn more_blocks_without_plane_motion_than_the_look_ahead_are_an_alarm() {
    let lifting = |count: u32| {
        let lift = (0..count).map(|i| with(G41, g01(3 + i, &[(Z, f64::from(i + 1))])));
        led_in_then(lift.chain([with(G41, g01(200, &[(Y, 20.0)])), g01(201, &[(Y, 40.0)])]))
    };
    let limit = u32::try_from(LOOK_AHEAD_MAX).unwrap();
    completed(&lifting(limit));
    let (alarm, segments) = alarm_of(&lifting(limit + 1));
    is(&alarm, &COMPENSATION_LOOK_AHEAD, 3 + limit);
    assert_eq!(way(&segments), [L(10.0, 5.0)]);
}

#[test]
fn blocks_are_held_back_for_the_look_ahead_and_counted() {
    let mut stage = PathStage::new(&settings(), MachinePosition::default());
    let mut out = Vec::new();
    for i in 0..200_u32 {
        let x = 10.0 + f64::from(i) * 0.5;
        stage.push(&with(G41, g01(i + 1, &[(X, x)])), &mut out).unwrap();
        assert_eq!(out.len() + stage.held_back(), usize::try_from(i).unwrap() + 1);
        assert!(stage.held_back() <= LOOK_AHEAD_MAX + 1);
        // A wait outputs no segment that can still change, and drops no segment.
        if i % 7 == 0 {
            stage.flush(&mut out);
            assert_eq!(out.len() + stage.held_back(), usize::try_from(i).unwrap() + 1);
        }
    }
    assert!(stage.is_compensating());
    stage.push(&g01(201, &[(X, 150.0)]), &mut out).unwrap();
    assert!(!stage.is_compensating());
    stage.flush(&mut out);
    assert_eq!(out.len(), 201);
    assert_eq!(stage.held_back(), 0);
}

#[test]
fn what_is_certain_runs_to_its_end_before_an_alarm() {
    let (alarm, segments) = alarm_of(&led_in_then([
        with(G41, g01(3, &[(Y, 20.0)])),
        with(G41, g01(4, &[(X, f64::NAN)])),
    ]));
    is(&alarm, &VALUE_NOT_FINITE, 4);
    same(&way(&segments), &[L(10.0, 5.0), L(15.0, 5.0)]);
    // Afterwards the stage is without compensation.
    let mut stage = PathStage::new(&settings(), MachinePosition::default());
    let mut out = Vec::new();
    for block in led_in() {
        stage.push(&block, &mut out).unwrap();
    }
    assert!(
        stage
            .push(&with(right(R, Plane::Xy), g01(3, &[(X, 30.0)])), &mut out)
            .is_err()
    );
    assert!(!stage.is_compensating());
    for block in led_in() {
        stage.push(&block, &mut out).unwrap();
    }
    stage.restart(MachinePosition::default());
    assert!(!stage.is_compensating() && stage.held_back() == 0);
}

#[test]
fn s1g_a_block_that_has_nothing_left_between_its_neighbours_is_an_overcut() {
    // A groove 8 wide for a tool of 10.
    let (alarm, moved) = refused(
        R,
        (-10.0, 0.0),
        &[
            L(0.0, 0.0),
            L(20.0, 0.0),
            L(20.0, -10.0),
            L(28.0, -10.0),
            L(28.0, 0.0),
            L(48.0, 0.0),
            L(60.0, 0.0),
        ],
    );
    is(&alarm, &OVERCUT, 5);
    assert!(alarm.text.contains("8.000000") && alarm.text.contains("5.000000"));
    assert_eq!(moved, Some(3));
}

#[test]
fn s1g_an_overcut_of_blocks_apart_is_found_before_the_first_of_them_moves() {
    // A chamber with a mouth 8 wide. The centre offset from its first wall, x = 5, passes the chamber's ceiling, which
    // ends in (8, -10): line 9.
    let (alarm, moved) = refused(
        R,
        (-30.0, 0.0),
        &[
            L(-20.0, 0.0),
            L(0.0, 0.0),
            L(0.0, -10.0),
            L(-20.0, -10.0),
            L(-20.0, -40.0),
            L(28.0, -40.0),
            L(28.0, -10.0),
            L(8.0, -10.0),
            L(8.0, 0.0),
            L(28.0, 0.0),
            L(40.0, 0.0),
        ],
    );
    assert_eq!(alarm.entry, &OVERCUT);
    assert_eq!(alarm.origin.map(|origin| origin.line), Some(4));
    assert!(
        alarm
            .text
            .contains("line 9: the tool's centre comes as close as 3.000000"),
        "{}",
        alarm.text
    );
    assert_eq!(moved, Some(3));
}

#[test]
fn s1g_prevention_leaves_out_what_the_tool_does_not_fit_into() {
    let run = |steps: &[Step]| {
        let mut settings = settings();
        settings.motion.overcut = Overcut::Prevent;
        let (segments, alarm) = outcome(&settings, &blocks((-30.0, 0.0), steps, G41));
        (way(&segments).split_off(1), alarm)
    };
    // A groove 8 wide: the tool passes over it.
    let (centre, alarm) = run(&[
        L(-20.0, 0.0),
        L(20.0, 0.0),
        L(20.0, -10.0),
        L(28.0, -10.0),
        L(28.0, 0.0),
        L(48.0, 0.0),
        L(60.0, 0.0),
    ]);
    assert_eq!(alarm, None);
    same(
        &centre,
        &[L(-20.0, 5.0), L(23.0, 5.0), L(48.0, 5.0), L(60.0, 0.0)],
    );
    // A step too short for the tool in a valley: both walls are cut where their offsets meet, (15, 5).
    let (centre, alarm) = run(&[
        L(-20.0, 0.0),
        L(19.0, 0.0),
        L(20.0, 1.0),
        L(20.0, 30.0),
        L(20.0, 60.0),
    ]);
    assert_eq!(alarm, None);
    same(
        &centre,
        &[L(-20.0, 5.0), L(15.0, 5.0), L(15.0, 30.0), L(20.0, 60.0)],
    );
    // The lead-out comes before any compensated motion: an alarm; the last moved block is the lead-in.
    let (centre, alarm) = run(&[
        L(-20.0, 0.0),
        L(20.0, 0.0),
        L(20.0, -10.0),
        L(28.0, -10.0),
        L(28.0, 0.0),
        L(28.0, 30.0),
    ]);
    is(&alarm.unwrap(), &OVERCUT, 5);
    same(&centre, &[L(-20.0, 5.0), L(25.0, 5.0)]);
}

#[test]
fn s1g_arc_before_the_lead_out_that_reaches_into_a_block_is_an_overcut() {
    // Clockwise about a block of material with a gap of 6 in its upper side. The lead-out turns by 135 degrees: the arc
    // about (20, 0) goes to (20 + 5 cos 45, -5 sin 45), and the first wall begins in (26, -2), behind the material.
    let contour = |first_wall: f64| {
        [
            L(first_wall, -2.0),
            L(first_wall, -40.0),
            L(-30.0, -40.0),
            L(-30.0, 0.0),
            L(20.0, 0.0),
            L(0.0, -20.0),
        ]
    };
    let distance = 6.0_f64.hypot(2.0) - 5.0;
    for overcut in [Overcut::Detect, Overcut::Prevent] {
        let mut settings = settings();
        settings.motion.overcut = overcut;
        let (segments, alarm) = outcome(&settings, &blocks((26.0, 20.0), &contour(26.0), G41));
        let alarm = alarm.unwrap();
        is(&alarm, &OVERCUT, 3);
        let text = format!("line 7: the tool's centre comes as close as {distance:.6}");
        assert!(alarm.text.contains(&text), "{}", alarm.text);
        assert_eq!(segments.last().map(|segment| segment.origin.line), Some(2));
    }
    // Where the wall begins more than twice the radius from the corner, nothing is cut.
    completed(&blocks((30.0, 20.0), &contour(30.0), G41));
}

#[test]
fn s1g_reversal_to_the_tool_side_with_separated_blocks_is_an_overcut() {
    // 0.5 degrees over 20 mm: the block back lies 20 sin 0.5 degrees above the one forth, where the tool is.
    let (sin, cos) = 0.5_f64.to_radians().sin_cos();
    let back = |way: f64| L(20.0 - way * cos, way * sin);
    let (alarm, moved) = refused(
        R,
        (-10.0, 0.0),
        &[L(0.0, 0.0), L(20.0, 0.0), back(20.0), back(40.0)],
    );
    is(&alarm, &OVERCUT, 3);
    let text = format!(
        "line 4: the tool's centre comes as close as {:.6}",
        5.0 - 20.0 * sin
    );
    assert!(alarm.text.contains(&text), "{}", alarm.text);
    assert_eq!(moved, Some(2));
}
