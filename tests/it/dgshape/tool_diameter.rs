//! G39 to G42: tool-diameter offset. Tool 1 has the radius 3, tool 2 the radius 2.

use super::{alarm, findings, run, run_with};

const NONE: [&str; 0] = [];

#[test]
fn dgshape_1_6_the_sample_program_goes_where_its_offset_leads() {
    // the corners of the contour, offset by 3 mm to the left: all turns are outside turns of 90 degrees
    let blocks = "G91\nG92X0Y0Z0\nG10P1R3.0\nG00Z5.0\nF300.0S6000M03\nG17G41D01G00X8.0Y8.0\nG01Z-7.0\nY35.0\nX45.0\n\
                  G03X15.0Y-15.0I15.0\nG01Y-20.0\nX-60.0\nZ7.0\nG40G00X-8.0Y-8.0\nM05";
    assert_eq!(
        run(blocks),
        [
            "rapid Z5",
            "M3",
            "rapid X5 Y8 Z5",
            "line X5 Y8 Z-2 F300",
            "line X5 Y46 Z-2 F300",
            "line X56 Y46 Z-2 F300",
            "line X56 Y43 Z-2 F300",
            "ccw X68 Y31 Z-2 about 68 43",
            "line X71 Y31 Z-2 F300",
            "line X71 Y5 Z-2 F300",
            "line X8 Y5 Z-2 F300",
            "line X8 Y5 Z5 F300",
            "rapid Z5",
            "M5"
        ]
    );
}

#[test]
fn dgshape_d_names_an_offset_of_g10_or_of_the_tool_table() {
    let way = |set: &str, number: &str| run(&format!("{set}\nG41D{number}G00X10.\nY10.\nG40X0Y0"))[0].clone();
    assert_eq!(way("", "1"), "rapid X7");
    assert_eq!(way("", "2"), "rapid X8");
    assert_eq!(way("", "0"), "rapid X10", "the offset of number 0 is 0");
    assert_eq!(way("G10P1R4.5", "1"), "rapid X5.5", "G10 takes precedence");
    assert_eq!(way("G10P77R1.0", "77"), "rapid X9");
    assert_eq!(
        way("G10P1R-3.0", "1"),
        "rapid X13",
        "a negative one is to the other side"
    );
    assert_eq!(findings("G41X10.")[0], "E0111", "D is needed");
    assert_eq!(findings("G41D1.0X10.")[0], "E0110");
}

#[test]
fn dgshape_restrictions_1_to_9_of_tool_diameter_offset() {
    let within = |block: &str| findings(&format!("M03F60.\nG41D1G00X10.\nG01Y10.\n{block}\nG40G00X0Y0"));
    // 1: Z and A move as they are programmed
    assert_eq!(within("G01Z-5."), NONE);
    assert_eq!(
        run("F60.\nG41D1G00X10.\nG01Y10.\nZ-5.\nX20.\nG40G00X30.")[2],
        "line X7 Y13 Z-5 F60"
    );
    // 2: no arc begins or ends it
    for block in ["G02", "G02X20.Y0.I5."] {
        assert_eq!(
            findings(&format!("F60.\nG41D1{block}\nG01Y10.\nG40G00X0Y0"))[0],
            "E0119",
            "{block}"
        );
        assert_eq!(within(&format!("G40{block}"))[0], "E0119", "{block}");
    }
    // 3: no other plane
    assert_eq!(within("G18"), ["E0119"]);
    assert_eq!(findings("G18\nG41D1G00X10.\nG40X0")[0], "E0119");
    // 4: no code sets coordinates, 8: drills or scales, 9: goes to the reference point
    for block in [
        "G10P1R1.0",
        "G54",
        "G55",
        "G56",
        "G57",
        "G58",
        "G59",
        "G92X0",
        "G50",
        "G51P2.0",
        "G80",
        "G81Z-1.",
        "G82Z-1.",
        "G83Z-1.",
        "G85Z-1.",
        "G86Z-1.",
        "G89Z-1.",
        "G28X0",
        "G53X0",
    ] {
        assert_eq!(within(block)[0], "E0119", "{block}");
    }
    // 5: M codes and dwells are permitted in it; two consecutive blocks without X and Y are reported
    assert_eq!(within("M12\nX20.\nG04P100"), NONE);
    assert_eq!(within("M12\nG04P100\nG01Z-5."), ["W0008"]);
    // 6: an arc that the tool does not fit into
    assert_eq!(
        alarm("F60.\nG41D1G00X10.\nG01Y10.\nG03X8.Y12.I-1.J1.\nG40G01X0"),
        116
    );
    // 7: the side and the number stay
    assert_eq!(within("G42D1"), ["E0119"]);
    assert_eq!(within("G41D2"), ["E0119"]);
    assert_eq!(within("G41D1"), NONE, "that changes nothing");
    // the program neither ends nor stops in it
    assert_eq!(within("M00"), ["E0119"]);
    assert_eq!(findings("G41D1G00X10.\nY5."), ["E0119"]);
}

/// 2-2, restriction 6: an offset value that is larger than the radius of the arc is an error; the radius itself is none.
#[test]
fn dgshape_a_tool_as_large_as_an_inside_arc_turns_in_its_centre() {
    // up along X 10 and left about (7, 10): the tool of radius 3 reaches (7, 10), and continues along Y 10
    let blocks = |radius: &str| {
        format!("F60.\nG10P9R{radius}\nG41D9G00X10.\nG01Y10.\nG03X7.Y13.I-3.\nG01X-5.\nG40G00X-20.")
    };
    // the arc has no length
    assert_eq!(
        run(&blocks("3.0")),
        [
            "rapid X7",
            "line X7 Y10 F60",
            "line X-5 Y10 F60",
            "rapid X-20 Y13"
        ]
    );
    assert_eq!(alarm(&blocks("3.001")), 116);
    assert_eq!(run(&blocks("2.999"))[2], "ccw X7 Y10.001 about 7 10");
    // a whole circle
    let circle = "F60.\nG41D1G00X10.Y-3.\nG03J3.\nG01X20.\nG40G00X40.";
    assert_eq!(findings(circle), NONE);
}

#[test]
fn dgshape_overcuts_are_not_looked_for() {
    // a groove of 4 mm for a tool of radius 3, which moves back on the line between
    let done = run("F60.\nG41D1G00X10.\nG01Y10.\nX6.\nY0\nG40G00X0");
    assert_eq!(
        done[..4],
        ["rapid X7", "line X7 Y7 F60", "line X9 Y7 F60", "line X9 F60"]
    );
}

#[test]
fn dgshape_rapids_move_in_the_offset() {
    assert_eq!(
        run("G41D1G00X10.\nY10.\nX20.\nG40X30.Y0")[..3],
        ["rapid X7", "rapid X7 Y13", "rapid X20 Y13"]
    );
}

#[test]
fn dgshape_outside_starts_are_of_type_a_or_b() {
    let first = |keys: &str, direction: &str| {
        let blocks = format!("F60.\nG41D1G01X10.\n{direction}\nG40X50.Y0");
        let mut done = run_with(&blocks, keys).unwrap();
        done.truncate(4);
        done
    };
    let (a, b) = ("compensation_start = \"a\"", "compensation_start = \"b\"");
    // right turn of 90 degrees (obtuse, by the manual's angle): next to the corner, or by the crossing of both paths
    assert_eq!(first(a, "Y-20.")[..2], ["line X13 F60", "line X13 Y-20 F60"]);
    assert_eq!(first(b, "Y-20.")[..2], ["line X13 Y3 F60", "line X13 Y-20 F60"]);
    // back to (0, -10): a turn of 135 degrees (acute); each path is extended by 3 mm
    let r = 3.0 * std::f64::consts::FRAC_1_SQRT_2;
    let beside = format!("line X{} Y{} F60", six(10.0 + r), six(-r));
    assert_eq!(first(a, "X0Y-10.")[0], beside);
    let acute = first(b, "X0Y-10.");
    assert_eq!(acute[0], "line X13 Y3 F60");
    assert_eq!(acute[1], format!("line X{} F60", six(10.0 + 2.0 * r)));
    // on the inside, and within 1 degree of a reversal, both types are equal
    for direction in ["Y20.", "X0Y-0.1"] {
        assert_eq!(first(a, direction)[0], first(b, direction)[0], "{direction}");
    }
}

fn six(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

#[test]
fn dgshape_outside_corners_are_straight() {
    // a turn of 135 degrees: both paths are extended by 3 mm, and a line joins them
    let done = run("F60.\nG41D1G01X10.\nY10.\nX20.Y0\nG40X50.");
    let r = 3.0 * std::f64::consts::FRAC_1_SQRT_2;
    assert_eq!(done[1], "line X7 Y13 F60");
    assert_eq!(
        done[2],
        format!("line X{} Y{} F60", six(10.0 + r - r), six(10.0 + 2.0 * r))
    );
}

#[test]
fn dgshape_g39_rounds_the_next_corner() {
    let done = run("F60.\nG41D1G01X10.\nY10.\nG39X20.Y10.\nX20.\nY0\nG40X50.");
    assert_eq!(
        done[1..4],
        ["line X7 Y10 F60", "cw X10 Y13 about 10 10", "line X23 Y13 F60"]
    );
    let incremental = run("F60.\nG91G41D1G01X10.\nY10.\nG39X1.\nX10.\nY-10.\nG40X30.");
    assert_eq!(incremental[2], "cw X10 Y13 about 10 10");
    assert_eq!(
        run("F60.\nG41D1G01X10.\nY10.\nG39\nX20.\nY0\nG40X50.")[2],
        "cw X10 Y13 about 10 10"
    );
    assert_eq!(findings("G39X1.0"), ["E0119"]);
    assert_eq!(
        alarm("F60.\nG41D1G01X10.\nY10.\nG39X0Y20.\nX20.\nY0\nG40X50."),
        40
    );
}

#[test]
fn dgshape_a_way_out_by_an_inside_corner_ends_beside_it() {
    let done = run("F60.\nG42D1G01X10.\nY10.\nG40G00X20.Y20.");
    assert_eq!(done, ["line X13 F60", "line X13 Y10 F60", "rapid X20 Y20"]);
}

#[test]
fn dgshape_outside_ends_are_of_type_a_or_b() {
    let done = |start: &str, blocks: &str| {
        let done = run_with(
            &format!("F60.\n{blocks}"),
            &format!("compensation_start = \"{start}\""),
        );
        done.unwrap()
    };
    // the paths of the starts in reverse, on the other side: a turn of 90 degrees
    let obtuse = "G00X10.Y-40.\nG42D1G01Y-30.\nY0\nG40X0";
    let head = ["rapid X10 Y-40", "line X13 Y-30 F60"];
    assert_eq!(
        done("a", obtuse),
        [head.as_slice(), &["line X13 F60", "line F60"]].concat()
    );
    assert_eq!(
        done("b", obtuse),
        [head.as_slice(), &["line X13 Y3 F60", "line F60"]].concat()
    );
    // and a turn of 135 degrees
    let r = 3.0 * std::f64::consts::FRAC_1_SQRT_2;
    let acute = "G00X-10.Y-20.\nG42D1G01X0Y-10.\nX10.Y0\nG40X0";
    let beside = format!("line X{} Y{} F60", six(10.0 + r), six(-r));
    assert_eq!(done("a", acute)[2..], [beside.as_str(), "line F60"]);
    let beyond = format!("line X{} F60", six(10.0 + 2.0 * r));
    assert_eq!(
        done("b", acute)[2..],
        [beyond.as_str(), "line X13 Y3 F60", "line F60"]
    );
}

#[test]
fn dgshape_starts_before_arcs_and_ends_behind_them_are_of_type_a_or_b() {
    let done = |start: &str, blocks: &str| {
        let done = run_with(
            &format!("F60.\n{blocks}"),
            &format!("compensation_start = \"{start}\""),
        );
        done.unwrap()[1..].to_vec()
    };
    // up to the top of a circle about (10, -10), with a turn of 90 degrees, and off its side straight on
    let into_arc = "G00X10.Y-20.\nG41D1G01Y0\nG02X20.Y-10.J-10.\nG40G01Y-30.";
    let arc = ["line X10 Y3 F60", "cw X23 Y-10 about 10 -10", "line X20 Y-30 F60"];
    assert_eq!(done("a", into_arc), arc);
    assert_eq!(
        done("b", into_arc),
        [["line X7 Y3 F60"].as_slice(), &arc].concat()
    );
    // the same path in reverse
    let out_of_arc = "G00X20.Y-30.\nG42D1G01Y-10.\nG03X10.Y0I-10.\nG40G01Y-20.";
    let arc = ["line X23 Y-10 F60", "ccw X10 Y3 about 10 -10"];
    let out = "line X10 Y-20 F60";
    assert_eq!(done("a", out_of_arc), [arc.as_slice(), &[out]].concat());
    assert_eq!(
        done("b", out_of_arc),
        [arc.as_slice(), &["line X7 Y3 F60", out]].concat()
    );
}

#[test]
fn dgshape_outside_corners_of_lines_and_arcs_are_straight() {
    // turns of 90 degrees onto a circle about (10, -10) and off it
    let done = run("F60.\nG00X10.Y-30.\nG41D1G01Y-20.\nY0\nG02X20.Y-10.J-10.\nG01X10.\nG40X0");
    assert_eq!(
        done[1..],
        [
            "line X7 Y-20 F60",
            "line X7 Y3 F60",
            "line X10 Y3 F60",
            "cw X23 Y-10 about 10 -10",
            "line X23 Y-13 F60",
            "line X10 Y-13 F60",
            "line Y-10 F60"
        ]
    );
}

#[test]
fn dgshape_arcs_whose_offsets_have_no_common_point_are_an_error() {
    // two circles of radius 5 whose centres are 7 apart; within them by 3 mm, 2 and 2 do not reach, by 1 mm, 4 and 4 do
    let blocks = |number: u8| {
        format!(
            "F60.\nG10P3R1.0\nG00X-1.5Y10.\nG41D{number}G01Y3.571\nG03X0Y0I5.\nX1.5Y3.571I-3.5J3.571\nG40G01Y20."
        )
    };
    assert_eq!(alarm(&blocks(1)), 117);
    assert_eq!(run(&blocks(3)).last().unwrap(), "line X1.5 Y20 F60");
}
