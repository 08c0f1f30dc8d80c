//! G02 to G04, G17 to G19, G43 and G49, and F on the A axis.

use super::{alarm, findings, run, run_with};

const NONE: [&str; 0] = [];

#[test]
fn dgshape_g02_and_g03_move_on_arcs_of_three_planes() {
    assert_eq!(run("G17G02X10.Y10.I10.F60."), ["cw X10 Y10 about 10 0"]);
    assert_eq!(run("G17G91G03X10.Y10.J10.F60."), ["ccw X10 Y10 about 0 10"]);
    // a full circle, because the target is the position of the tool
    assert_eq!(run("G02X0Y0I5.F60."), ["cw about 5 0"]);
    // by radius: up to half a circle, and beyond with a negative one
    assert_eq!(run("G02X10.Y10.R10.F60."), ["cw X10 Y10 about 10 0"]);
    assert_eq!(run("G02X10.Y10.R-10.F60."), ["cw X10 Y10 about 0 10"]);
    // the plane ZX has Z as its first axis: centre Z, X
    assert_eq!(
        run("G18G02X10.Z10.I10.F60.")[0].split(" about").next(),
        Some("cw X10 Z10")
    );
    assert_eq!(
        run("G19G03Y10.Z10.J10.F60.")[0].split(" about").next(),
        Some("ccw Y10 Z10")
    );
    // a helix
    assert_eq!(run("G17G03X10.Y10.J10.Z-5.F60."), ["ccw X10 Y10 Z-5 about 0 10"]);
    assert_eq!(
        findings("G02X10.Y10.R10.A5.F60."),
        ["E0108"],
        "A is no part of an arc"
    );
    assert_eq!(findings("G02X10.Y0F60."), ["E0122"]);
}

#[test]
fn dgshape_g04_rests() {
    assert_eq!(
        run("G04X10.0\nG04X10000\nG04P10000"),
        ["dwell 10", "dwell 10", "dwell 10"]
    );
    assert_eq!(findings("G04X1.0P1000"), ["E0113"]);
    // 0 to 3600 s
    assert_eq!(run("G04P3600000\nG04X3600."), ["dwell 3600", "dwell 3600"]);
    for beyond in ["G04P3600001", "G04X3600001", "G04X3600.001", "G04P-1", "G04X-1."] {
        assert_eq!(findings(beyond), ["E0109"], "{beyond}");
    }
    assert_eq!(findings("G04P1.0"), ["E0110"], "P has no decimal point");
    assert_eq!(findings("G04P1000F1.0").len(), 0, "F is the feedrate here");
}

/// 2-2: G49 or G43H0 cancels tool-length offset; G53 needs it cancelled.
#[test]
fn dgshape_g43_with_h0_cancels_as_g49_does() {
    assert_eq!(
        run("G43H1Z1.\nG43H0\nG53Z20."),
        ["rapid Z9", "rapid Z1", "rapid Z20"]
    );
    assert_eq!(findings("G43H0\nG53Z20.").len(), 0);
    assert_eq!(findings("G43H0G53Z20.").len(), 0);
    assert_eq!(findings("G43H1\nG53Z20."), ["E0120"]);
    assert_eq!(findings("G43H0\nG43H2\nG53Z20."), ["E0120"]);
    // if a block that may be skipped cancels it, one of both cases is wrong
    assert_eq!(findings("G43H1\n/G43H0\nG53Z20."), ["W0009"]);
    assert_eq!(findings("G43H0\n/G43H1\nG53Z20."), ["W0009"]);
}

#[test]
fn dgshape_g43_moves_by_the_offset() {
    // with axis words the motion ends at the corrected Z
    assert_eq!(
        run("G00G43H1Z1000\nZ2000\nG49Z0"),
        ["rapid Z9", "rapid Z10", "rapid"]
    );
    // without them Z moves by the change, in absolute and incremental programming
    for distance in ["G90", "G91"] {
        let done = run(&format!("{distance}G00G43H1\nG43H2\nG43H0"));
        assert_eq!(done, ["rapid Z8", "rapid Z5", "rapid"], "{distance}");
    }
    assert_eq!(run("G00G43H1\nG49"), ["rapid Z8", "rapid"]);
    assert_eq!(
        run("G01F60.G43H1"),
        ["line Z8 F60"],
        "as the motion in force goes"
    );
    assert_eq!(run("G49"), NONE, "nothing to change");
    assert_eq!(findings("G43"), ["E0111"], "H is needed");
    assert_eq!(findings("G43H1.0"), ["E0110"]);
    assert_eq!(findings("H1"), ["E0108"]);
}

#[test]
fn dgshape_2_5_f_is_the_speed_of_the_surface_about_a() {
    // 10 mm from the centre, 90 degrees are a path of pi/2 * 10 mm
    let seconds = |blocks: &str| way_s(blocks);
    assert!((seconds("G00Y6.Z8.\nG01A90.F60.") - 10.0 * std::f64::consts::FRAC_PI_2).abs() < 1e-9);
    // the radius at the beginning of the block applies: with Z lower A is slower, with Z higher faster
    assert!((seconds("G00Z5.\nG01A90.F60.") - 5.0 * std::f64::consts::FRAC_PI_2).abs() < 1e-9);
    // with a linear axis both distances are combined: 3 mm and 4 mm on the surface
    let blocks = format!("G00Z10.\nG01X3.0A{:.6}F60.", (0.4_f64).to_degrees());
    assert!((seconds(&blocks) - 5.0).abs() < 1e-6);
    // at the highest Z, and in the centre, A turns at 90 degrees/s with any F
    assert!((seconds("G00Z100.\nG01A90.F1.0") - 1.0).abs() < 1e-9);
    assert!((seconds("G01A90.F1.0") - 1.0).abs() < 1e-9);
}

/// The time of the last motion at its feedrate, without ramps, s.
fn way_s(blocks: &str) -> f64 {
    let (length, feedrate) = super::last_line(blocks);
    length / feedrate * 60.0
}

#[test]
fn dgshape_2_5_f_is_held_within_the_feedrates_of_the_machine() {
    assert_eq!(run("G01X1.F5000."), ["line X1 F3000"]);
    assert_eq!(
        run_with("G01X1.F5.", "min_feedrate = 20.0").unwrap(),
        ["line X1 F20"]
    );
    assert_eq!(
        run("G01X1.F0"),
        ["line X1 F0.001"],
        "the least one where none is set"
    );
    assert_eq!(alarm("G01X1."), 101, "without F");
}
