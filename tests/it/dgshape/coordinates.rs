//! G00, G10, G28, G50, G51, G53 to G59 and G92: positions of coordinate systems.

use super::{alarm, findings, run};

const NONE: [&str; 0] = [];

#[test]
fn dgshape_g00_positions_named_axes_only() {
    assert_eq!(run("G00X10.\nY10.Z5."), ["rapid X10", "rapid X10 Y10 Z5"]);
}

#[test]
fn dgshape_g54_to_g59_select_offsets_and_g54_holds_at_start() {
    // G55 is at machine X 10
    assert_eq!(
        run("G00X1.0\nG55X1.0\nG54X1.0"),
        ["rapid X1", "rapid X11", "rapid X1"]
    );
    let start = run("G10L2P1X20.0\nG00X1.0");
    assert_eq!(start, ["rapid X21"], "what G10 sets for G54 holds at once");
}

#[test]
fn dgshape_g10_sets_offsets_whether_g90_or_g91() {
    assert_eq!(run("G91G10L2P2X3.0Y4.0\nG90G55\nG00X1.0Y1.0"), ["rapid X4 Y5"]);
    // axes that are not programmed keep their value: X 10 of the table
    assert_eq!(run("G10L2P2Y4.0\nG55G00X1.0Y1.0"), ["rapid X11 Y5"]);
    // EXOFS shifts all
    assert_eq!(run("G10L2P0X2.0\nG00X1.0\nG55X1.0"), ["rapid X3", "rapid X13"]);
    for text in ["G10L2P7X1.0", "G10L1P1X1.0", "G10P0R1.0"] {
        assert_eq!(findings(text), ["E0109"], "{text}");
    }
    assert_eq!(findings("G10P1X1.0"), ["E0108"], "axes need L2");
    assert_eq!(findings("G10L2P1R1.0"), ["E0108"]);
    assert_eq!(findings("G10P1"), ["E0111"]);
    assert_eq!(findings("G10L2X1.0"), ["E0111"]);
}

#[test]
fn dgshape_g92_shifts_all_work_coordinate_systems() {
    // at machine 30 20: coordinates 0 0 from here on, also by G91 words
    let done = run("G00X30.Y20.\nG91G92X0Y0\nG90G00X1.0Y1.0\nG55X1.0");
    assert_eq!(done, ["rapid X30 Y20", "rapid X31 Y21", "rapid X41 Y21"]);
    assert_eq!(
        run("G00X30.\nG92Y5.\nG00X1.0Y5.0"),
        ["rapid X30", "rapid X1"],
        "other axes stay"
    );
    // a second one shifts from where the tool then is
    let twice = run("G00X10.\nG92X0\nG00X5.\nG92X1.\nX2.");
    assert_eq!(twice, ["rapid X10", "rapid X15", "rapid X16"]);
}

#[test]
fn dgshape_g28_goes_by_a_remembered_middle_point() {
    // reference points: X -90, Y -80, Z 100
    let done = run("G28X15000\nG28Y30000");
    assert_eq!(
        done,
        ["rapid X15", "rapid X-90", "rapid X15 Y30", "rapid X-90 Y-80"]
    );
    assert_eq!(run("G28G91Z0"), ["rapid Z100"], "only Z, from where it is");
    // an axis with an incremental middle point does not move: it is at the reference point
    assert_eq!(run("G91G28Z0\nG28X0")[1..], ["rapid X-90 Z100"]);
    assert_eq!(run("G28"), NONE, "no coordinate at all: no motion");
    assert_eq!(findings("G28A0"), ["E0108"]);
    assert_eq!(findings("G28B0"), ["E0007"]);
    // with a tool-length offset it also moves there
    assert_eq!(run("G43H1Z0\nG91G28Z0")[1..], ["rapid Z100"]);
}

#[test]
fn dgshape_g53_moves_in_machine_coordinates_in_g90_only() {
    assert_eq!(run("G55G01G53X5.0\nX1.0F60."), ["rapid X5", "line X11 F60"]);
    assert_eq!(findings("G91\nG53Z0"), ["E0125"]);
    assert_eq!(findings("G91\nG90G53Z0"), NONE, "the last code of the group");
    assert_eq!(findings("G43H1Z0\nG53Z0"), ["E0120"]);
    assert_eq!(findings("G41D1G00X1.0\nX5.0\nG53Z0\nG40X0"), ["E0119"]);
    // it applies to its block only, and scaling stays
    assert_eq!(run("G51X0Y0Z0P2.0\nG53X5.0\nG00X1.0"), ["rapid X5", "rapid X2"]);
}

#[test]
fn dgshape_g51_scales_about_a_point_by_one_factor() {
    assert_eq!(
        run("G51X10.Y10.Z0P0.5\nG00X20.Y10.\nG50\nG00X20."),
        ["rapid X15 Y10", "rapid X20 Y10"]
    );
    // without a point: the position of the tool
    assert_eq!(run("G00X10.\nG51P2.0\nX11."), ["rapid X10", "rapid X12"]);
    // less than 0.001 is treated as 0.001, more than 999.999 as 999.999
    assert_eq!(run("G51X0Y0Z0P0.0001\nG00X1000."), ["rapid X1"]);
    assert_eq!(run("G51X0Y0Z0P5000\nG00X0.01"), ["rapid X9.99999"]);
    // A is not scaled
    assert_eq!(run("G51X0Y0Z0P2.0\nG00X1.A10."), ["rapid X2 A10"]);
    assert_eq!(findings("G51X0"), ["E0111"], "P is needed");
}

#[test]
fn dgshape_a_motion_beyond_the_limits_is_an_alarm() {
    assert_eq!(alarm("G00X101."), 102);
}
