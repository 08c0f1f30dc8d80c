//! G41 and G42: corners, lead-in, lead-out (M1g). The expected points are derived by hand: feet of
//! perpendiculars, intersections of lines and circles.

use crate::contour::Step::{A, L};
use crate::contour::{blocks, completed, goes, right, same, step};
use tandem_model::plane::Plane;

const R: f64 = 5.0;

/// 5 at 45 degrees.
const D: f64 = 3.535_533_905_932_737_6;

#[test]
fn s1g_the_manuals_figure_of_g41_and_g42() {
    let programmed = [
        L(15.0, 10.0),
        L(15.0, 20.0),
        L(40.0, 20.0),
        L(40.0, 10.0),
        L(40.0, 0.0),
    ];
    let g41 = [
        L(10.0, 10.0),
        L(10.0, 25.0),
        L(45.0, 25.0),
        L(45.0, 10.0),
        L(40.0, 0.0),
    ];
    let g42 = [
        L(20.0, 10.0),
        L(20.0, 15.0),
        L(35.0, 15.0),
        L(35.0, 10.0),
        L(40.0, 0.0),
    ];
    goes(R, (0.0, 0.0), &programmed, &g41);
    let segments = completed(&blocks((0.0, 0.0), &programmed, right(R, Plane::Xy)));
    let way: Vec<_> = segments.iter().map(|segment| step(segment, Plane::Xy)).collect();
    same(&way, &g42);
}

#[test]
fn s1g_the_manuals_example_of_three_blocks_in_line() {
    goes(
        R,
        (0.0, 0.0),
        &[L(10.0, 0.0), L(20.0, 0.0), L(30.0, 0.0)],
        &[L(10.0, 5.0), L(20.0, 5.0), L(30.0, 0.0)],
    );
}

#[test]
fn s1g_inside_corner_of_two_lines() {
    // 45 degrees to the left: 5 tan(22.5) before the feet.
    let t = 5.0 * (2.0_f64.sqrt() - 1.0);
    goes(
        R,
        (-10.0, 0.0),
        &[L(0.0, 0.0), L(20.0, 0.0), L(40.0, 20.0), L(60.0, 20.0)],
        &[
            L(0.0, 5.0),
            L(20.0 - t, 5.0),
            L(40.0 - D, 20.0 + D),
            L(60.0, 20.0),
        ],
    );
}

#[test]
fn s1g_inside_corner_of_line_and_arc() {
    // y = 5 meets the circle of radius 15: x = sqrt(200).
    let x = 200.0_f64.sqrt();
    goes(
        R,
        (-10.0, 0.0),
        &[
            L(0.0, 0.0),
            L(20.0, 0.0),
            A((0.0, 20.0), (0.0, 0.0), true),
            L(-20.0, 20.0),
        ],
        &[
            L(0.0, 5.0),
            L(x, 5.0),
            A((0.0, 15.0), (0.0, 0.0), true),
            L(-20.0, 20.0),
        ],
    );
}

#[test]
fn s1g_inside_corner_of_arc_and_line() {
    let y = 200.0_f64.sqrt();
    goes(
        R,
        (20.0, -10.0),
        &[
            L(20.0, 0.0),
            A((0.0, 20.0), (0.0, 0.0), true),
            L(0.0, 0.0),
            L(0.0, -10.0),
        ],
        &[
            L(15.0, 0.0),
            A((5.0, y), (0.0, 0.0), true),
            L(5.0, 0.0),
            L(0.0, -10.0),
        ],
    );
}

#[test]
fn s1g_inside_corner_of_two_arcs() {
    // Circles of 15 about the origin and 5 about (12, 6): 2x + y = 95/3, and x from 5x^2 - 380/3 x + 7000/9 = 0.
    let b = 380.0 / 3.0;
    let x = (b - (b * b - 20.0 * 7000.0 / 9.0_f64).sqrt()) / 10.0;
    let y = 95.0 / 3.0 - 2.0 * x;
    goes(
        R,
        (20.0, -10.0),
        &[
            L(20.0, 0.0),
            A((12.0, 16.0), (0.0, 0.0), true),
            A((2.0, 6.0), (12.0, 6.0), true),
            L(2.0, -10.0),
        ],
        &[
            L(15.0, 0.0),
            A((x, y), (0.0, 0.0), true),
            A((7.0, 6.0), (12.0, 6.0), true),
            L(2.0, -10.0),
        ],
    );
}

#[test]
fn s1g_outside_corner_up_to_90_degrees_is_extended() {
    // 45 degrees to the right, 5 tan(22.5) beyond the feet; then exactly 90 degrees, 5 beyond.
    let t = 5.0 * (2.0_f64.sqrt() - 1.0);
    goes(
        R,
        (-10.0, 0.0),
        &[
            L(0.0, 0.0),
            L(20.0, 0.0),
            L(40.0, -20.0),
            L(20.0, -40.0),
            L(0.0, -60.0),
        ],
        &[
            L(0.0, 5.0),
            L(20.0 + t, 5.0),
            L(40.0 + 2.0 * D, -20.0),
            L(20.0 + D, -40.0 - D),
            L(0.0, -60.0),
        ],
    );
}

#[test]
fn s1g_outside_corner_of_line_and_arc_goes_along_the_tangent() {
    goes(
        R,
        (-10.0, 0.0),
        &[
            L(0.0, 0.0),
            L(20.0, 0.0),
            A((10.0, -10.0), (10.0, 0.0), false),
            L(-10.0, -10.0),
        ],
        &[
            L(0.0, 5.0),
            L(25.0, 5.0),
            L(25.0, 0.0),
            A((10.0, -15.0), (10.0, 0.0), false),
            L(-10.0, -10.0),
        ],
    );
}

#[test]
fn s1g_outside_corner_of_arc_and_line_goes_along_the_tangent() {
    goes(
        R,
        (-10.0, -10.0),
        &[
            L(-10.0, 0.0),
            A((0.0, 10.0), (0.0, 0.0), false),
            L(0.0, -10.0),
            L(0.0, -20.0),
        ],
        &[
            L(-15.0, 0.0),
            A((0.0, 15.0), (0.0, 0.0), false),
            L(5.0, 15.0),
            L(5.0, -10.0),
            L(0.0, -20.0),
        ],
    );
}

#[test]
fn s1g_outside_corner_of_two_arcs_goes_along_both_tangents() {
    // At (20, 20) the direction turns from +Y to +X; the tool is inside of both arcs.
    goes(
        R,
        (-10.0, 0.0),
        &[
            L(0.0, 0.0),
            A((20.0, 20.0), (0.0, 20.0), true),
            A((40.0, 40.0), (20.0, 40.0), true),
            L(40.0, 60.0),
        ],
        &[
            L(0.0, 5.0),
            A((15.0, 20.0), (0.0, 20.0), true),
            L(15.0, 25.0),
            L(20.0, 25.0),
            A((35.0, 40.0), (20.0, 40.0), true),
            L(40.0, 60.0),
        ],
    );
}

#[test]
fn s1g_tangent_blocks_meet_at_the_foot_of_both() {
    goes(
        R,
        (-10.0, 0.0),
        &[
            L(0.0, 0.0),
            L(20.0, 0.0),
            A((40.0, 20.0), (20.0, 20.0), true),
            A((60.0, 40.0), (60.0, 20.0), false),
            L(80.0, 40.0),
            L(90.0, 40.0),
        ],
        &[
            L(0.0, 5.0),
            L(20.0, 5.0),
            A((35.0, 20.0), (20.0, 20.0), true),
            A((60.0, 45.0), (60.0, 20.0), false),
            L(80.0, 45.0),
            L(90.0, 40.0),
        ],
    );
}

#[test]
fn s1g_outside_corner_beyond_90_degrees_gets_an_arc() {
    goes(
        R,
        (-10.0, 0.0),
        &[L(0.0, 0.0), L(20.0, 0.0), L(0.0, -20.0), L(-20.0, -40.0)],
        &[
            L(0.0, 5.0),
            L(20.0, 5.0),
            A((20.0 + D, -D), (20.0, 0.0), false),
            L(D, -20.0 - D),
            L(-20.0, -40.0),
        ],
    );
}

#[test]
fn s1g_the_added_arc_begins_right_beyond_90_degrees() {
    let (sin, cos) = (-90.01_f64).to_radians().sin_cos();
    let beyond = |length: f64| (20.0 + length * cos, length * sin);
    let beside = |(u, v): (f64, f64)| (u - R * sin, v + R * cos);
    goes(
        R,
        (-10.0, 0.0),
        &[
            L(0.0, 0.0),
            L(20.0, 0.0),
            L(beyond(30.0).0, beyond(30.0).1),
            L(beyond(50.0).0, beyond(50.0).1),
        ],
        &[
            L(0.0, 5.0),
            L(20.0, 5.0),
            A(beside((20.0, 0.0)), (20.0, 0.0), false),
            L(beside(beyond(30.0)).0, beside(beyond(30.0)).1),
            L(beyond(50.0).0, beyond(50.0).1),
        ],
    );
}

#[test]
fn s1g_outside_corner_beyond_90_degrees_of_line_and_arc_gets_an_arc() {
    // The arc sets off in direction (-3, -4)/5; its centre (12, 6) is on the right.
    goes(
        R,
        (-10.0, 0.0),
        &[
            L(0.0, 0.0),
            L(20.0, 0.0),
            A((12.0, -4.0), (12.0, 6.0), false),
            L(-10.0, -4.0),
        ],
        &[
            L(0.0, 5.0),
            L(20.0, 5.0),
            A((24.0, -3.0), (20.0, 0.0), false),
            A((12.0, -9.0), (12.0, 6.0), false),
            L(-10.0, -4.0),
        ],
    );
}

#[test]
fn s1g_a_reversal_within_1_degree_is_rounded_on_either_side() {
    // To the tool's side, straight back, and to the other side.
    for tilt in [0.002_f64.to_radians(), 0.0, -0.5_f64.to_radians()] {
        let (sin, cos) = tilt.sin_cos();
        let back = (20.0 - 20.0 * cos, 20.0 * sin);
        let foot = (-5.0 * sin, -5.0 * cos);
        goes(
            R,
            (-10.0, 0.0),
            &[
                L(0.0, 0.0),
                L(20.0, 0.0),
                L(back.0, back.1),
                L(back.0 - 20.0, back.1),
            ],
            &[
                L(0.0, 5.0),
                L(20.0, 5.0),
                A((20.0 + foot.0, foot.1), (20.0, 0.0), false),
                L(back.0 + foot.0, back.1 + foot.1),
                L(back.0 - 20.0, back.1),
            ],
        );
    }
}

#[test]
fn s1g_start_up_ends_beside_the_first_compensated_block() {
    let cases = [
        // Inside, outside up to 90 degrees, and a first block that is an arc.
        (
            vec![L(0.0, 0.0), L(0.0, 20.0), L(0.0, 40.0)],
            vec![L(-5.0, 0.0), L(-5.0, 20.0), L(0.0, 40.0)],
        ),
        (
            vec![L(0.0, 0.0), L(0.0, -20.0), L(0.0, -40.0)],
            vec![L(5.0, 0.0), L(5.0, -20.0), L(0.0, -40.0)],
        ),
        (
            vec![L(0.0, 0.0), A((20.0, 20.0), (20.0, 0.0), false), L(40.0, 20.0)],
            vec![L(-5.0, 0.0), A((20.0, 25.0), (20.0, 0.0), false), L(40.0, 20.0)],
        ),
    ];
    for (programmed, expected) in cases {
        goes(R, (-10.0, 0.0), &programmed, &expected);
    }
}

#[test]
fn s1g_outside_start_up_beyond_90_degrees_ends_offset_and_adds_an_arc() {
    goes(
        R,
        (-10.0, 0.0),
        &[L(0.0, 0.0), L(-20.0, -20.0), L(-40.0, -40.0)],
        &[
            L(0.0, 5.0),
            A((D, -D), (0.0, 0.0), false),
            L(-20.0 + D, -20.0 - D),
            L(-40.0, -40.0),
        ],
    );
}

#[test]
fn s1g_cancel_leaves_from_beside_the_last_compensated_block() {
    let lead = [L(0.0, 0.0), L(20.0, 0.0)];
    let beside = [L(0.0, 5.0), L(20.0, 5.0)];
    for out in [L(20.0, 20.0), L(20.0, -20.0), L(40.0, 0.0)] {
        goes(
            R,
            (-10.0, 0.0),
            &[lead[0], lead[1], out],
            &[beside[0], beside[1], out],
        );
    }
}

#[test]
fn s1g_cancel_outside_beyond_90_degrees_goes_round_and_then_beside_itself() {
    goes(
        R,
        (-10.0, 0.0),
        &[L(0.0, 0.0), L(20.0, 0.0), L(0.0, -20.0)],
        &[
            L(0.0, 5.0),
            L(20.0, 5.0),
            A((20.0 + D, -D), (20.0, 0.0), false),
            L(0.0, -20.0),
        ],
    );
}

#[test]
fn s1g_a_full_circle_inside_and_outside() {
    for (ccw, radius) in [(true, 15.0), (false, 25.0)] {
        // From the far side on the tangent.
        let sign = if ccw { -1.0 } else { 1.0 };
        goes(
            R,
            (20.0, sign * 10.0),
            &[
                L(20.0, 0.0),
                A((20.0, 0.0), (0.0, 0.0), ccw),
                L(20.0, -sign * 10.0),
            ],
            &[
                L(radius, 0.0),
                A((radius, 0.0), (0.0, 0.0), ccw),
                L(20.0, -sign * 10.0),
            ],
        );
    }
}

#[test]
fn a_tool_of_radius_0_follows_the_program() {
    let programmed = [
        L(0.0, 0.0),
        L(20.0, 0.0),
        L(20.0, 20.0),
        A((0.0, 40.0), (0.0, 20.0), true),
        L(0.0, 0.0),
        L(0.0, 30.0),
        L(-20.0, 30.0),
    ];
    goes(0.0, (-10.0, 0.0), &programmed, &programmed);
}
