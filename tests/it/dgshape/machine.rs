//! M codes, S and T: commands to the machine (2-3, 2-4, 2-7).

use super::{findings, run, speed};

const NONE: [&str; 0] = [];

#[test]
fn dgshape_m06_takes_the_number_of_t() {
    assert_eq!(run("M06T2\nM06T0"), ["M6 2", "M6 0"]);
    assert_eq!(run("T3M06G00X1."), ["M6 3", "rapid X1"]);
    assert_eq!(findings("M06"), ["E0111"]);
    assert_eq!(findings("T2"), ["E0108"]);
    assert_eq!(findings("M03T2"), ["E0108"]);
    assert_eq!(findings("M06T1M06T2"), ["E0107", "E0105"]);
    assert_eq!(findings("M06T1T2"), ["E0105"]);
    assert_eq!(findings("M06T1.0"), ["E0110"]);
}

#[test]
fn dgshape_2_7_m_codes_of_the_list_are_outputs_and_others_need_settings() {
    let done = run("M03\nM05\nM12\nM13\nM14\nM15\nM16\nM17");
    assert_eq!(done, ["M3", "M5", "M12", "M13", "M14", "M15", "M16", "M17"]);
    for code in ["M04", "M08", "M19", "M98P1000", "M99"] {
        let found = findings(code);
        assert!(found.contains(&"E0104"), "{code}: {found:?}");
    }
}

#[test]
fn dgshape_2_3_stops_and_ends_stand_alone() {
    for code in ["M00", "M01", "M02", "M30"] {
        assert_eq!(findings(&format!("G00X1.0{code}"))[0], "E0123", "{code}");
        assert_eq!(findings(&format!("{code}S100"))[0], "E0123", "{code}");
    }
    assert_eq!(
        findings("N10M00\nM01(stop)"),
        NONE,
        "a block number and a comment are no words"
    );
}

#[test]
fn dgshape_2_4_s_is_a_speed_or_the_number_of_one() {
    // the motor's highest speed is 12000 r/min
    for (text, r_min) in [
        ("S8000M03", 8000.0),
        ("S60", 1000.0),
        ("S00", 400.0),
        ("S99", 12_000.0),
        ("S20000", 12_000.0),
    ] {
        assert_eq!(speed(text, "min_spindle_speed = 400.0"), r_min, "{text}");
        assert_eq!(findings(text), NONE, "{text}");
    }
    assert_eq!(speed("S20000", "max_spindle_speed = 9000.0"), 9000.0);
    assert_eq!(findings("S20000M03"), NONE, "the fastest speed is used");
    assert_eq!(findings("S-1"), NONE, "the slowest speed is used");
}
