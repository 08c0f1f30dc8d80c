//! G80 to G89 with G98 and G99: drilling along Z.

use super::{findings, run, run_with};

const NONE: [&str; 0] = [];

/// Returns Z of each move after the first block, with `r` for a rapid and `f` for a feed, and dwells.
fn levels(blocks: &str) -> Vec<String> {
    levels_of(&run(&format!("G00Z10.M03\nF60.\n{blocks}")))
}

fn levels_of(done: &[String]) -> Vec<String> {
    let z = |text: &str| {
        let word = text.split(' ').find(|word| word.starts_with('Z'));
        word.map_or("0".to_owned(), |word| word[1..].to_owned())
    };
    let moves = done.iter().skip(2).map(|text| match text.split(' ').next() {
        Some("rapid") => format!("r{}", z(text)),
        Some("line") => format!("f{}", z(text)),
        _ => text.clone(),
    });
    moves.collect()
}

#[test]
fn dgshape_g81_drills_and_returns_to_the_level_that_g98_or_g99_says() {
    assert_eq!(levels("G98G81X5.Z-3.R2."), ["r10", "r2", "f-3", "r10"]);
    assert_eq!(levels("G99G81X5.Z-3.R2."), ["r10", "r2", "f-3", "r2"]);
    // each later block drills with the same Z and R
    assert_eq!(
        levels("G99G81X5.Z-3.R2.\nX6."),
        ["r10", "r2", "f-3", "r2", "r2", "f-3", "r2"]
    );
    // G80 and a motion code end it
    assert_eq!(levels("G81X5.Z-3.R2.\nG80\nX1.")[4..], ["r10"]);
    assert_eq!(levels("G81X5.Z-3.R2.\nG00X1.")[4..], ["r10"]);
}

#[test]
fn dgshape_g81_without_z_skips_drilling_without_r_uses_initial_level() {
    assert_eq!(levels("G81X5.R2."), ["r10"]);
    assert_eq!(levels("G81X5.Z-3."), ["r10", "f-3", "r10"]);
}

#[test]
fn dgshape_g81_in_g91_counts_r_from_the_initial_level_and_z_from_r() {
    assert_eq!(levels("G91G98G81X5.Z-3.R-8."), ["r10", "r2", "f-1", "r10"]);
}

/// 2-2: Z specifies the location of the bottom of the hole. A row of holes is G90 for the first, G91 and K for the rest.
#[test]
fn dgshape_levels_of_a_cycle_stay_where_they_are_when_g90_and_g91_change() {
    assert_eq!(
        levels("G99G81X5.Z-3.R2.\nG91X6.K2"),
        ["r10", "r2", "f-3", "r2", "r2", "f-3", "r2", "r2", "f-3", "r2"]
    );
    // below the initial level of 10, Z-3. below R
    assert_eq!(
        levels("G91G99G81X5.Z-3.R-8.\nG90X6."),
        ["r10", "r2", "f-1", "r2", "r2", "f-1", "r2"]
    );
    // a repeated word has the meaning that its block defines
    assert_eq!(
        levels("G99G81X5.Z-3.R2.\nG91X6.Z-4."),
        ["r10", "r2", "f-3", "r2", "r2", "f-2", "r2"]
    );
}

#[test]
fn dgshape_k_repeats_at_the_same_place_or_at_equal_distances() {
    assert_eq!(
        levels("G99G81X5.Z-3.R2.K2"),
        ["r10", "r2", "f-3", "r2", "f-3", "r2"]
    );
    let done = run("G00Z10.M03\nG91G99G81X5.Y1.Z-3.R-8.K3F60.");
    let places: Vec<_> = done.iter().filter(|text| text.starts_with("line")).collect();
    assert_eq!(
        places,
        ["line X5 Y1 Z-1 F60", "line X10 Y2 Z-1 F60", "line X15 Y3 Z-1 F60"]
    );
    assert_eq!(levels("G81X5.Z-3.R2.K0"), NONE, "no drilling");
    assert_eq!(
        levels("G99G81X5.Z-3.R2.K0\nX6."),
        ["r10", "r2", "f-3", "r2"],
        "K is of its block"
    );
    assert_eq!(findings("M03\nG81X1.Z-1.K10000"), ["E0109"]);
    assert_eq!(findings("M03\nG81X1.Z-1.K1.0"), ["E0110"]);
}

#[test]
fn dgshape_g82_and_g89_rest_at_the_bottom() {
    assert_eq!(
        levels("G99G82X5.Z-3.R2.P500"),
        ["r10", "r2", "f-3", "dwell 0.5", "r2"]
    );
    assert_eq!(
        levels("G99G82X5.Z-3.R2."),
        ["r10", "r2", "f-3", "r2"],
        "no dwell without P"
    );
    assert_eq!(
        levels("G98G89X5.Z-3.R2.P500"),
        ["r10", "r2", "f-3", "dwell 0.5", "f2", "r10"]
    );
    assert_eq!(findings("M03\nG82X1.Z-1.P0.5"), ["E0110"]);
    assert_eq!(findings("M03\nG81X1.Z-1.P500"), ["E0108"]);
}

#[test]
fn dgshape_g83_cuts_by_q_and_goes_out_between() {
    let done = run_with("G00Z10.M03\nF60.\nG99G83X5.Z-3.R2.Q2.", "peck_clearance = 0.5").unwrap();
    assert_eq!(
        levels_of(&done),
        ["r10", "r2", "f0", "r2", "r0.5", "f-2", "r2", "r-1.5", "f-3", "r2"]
    );
    assert_eq!(
        levels("G99G83X5.Z-3.R2."),
        ["r10", "r2", "f-3", "r2"],
        "without Q at once"
    );
    assert_eq!(levels("G99G83X5.Z-3.R2.Q50."), ["r10", "r2", "f-3", "r2"]);
}

#[test]
fn dgshape_g85_and_g86_come_out_at_the_feedrate_or_as_a_rapid() {
    assert_eq!(levels("G98G85X5.Z-3.R2."), ["r10", "r2", "f-3", "f2", "r10"]);
    assert_eq!(levels("G99G86X5.Z-3.R2."), ["r10", "r2", "f-3", "r2"]);
}

#[test]
fn dgshape_cycles_need_a_turning_spindle_the_xy_plane_and_no_a() {
    assert_eq!(findings("G81X5.Z-3.R2."), ["E0121"]);
    assert_eq!(findings("M03\nM05\nG81X5.Z-3.R2."), ["E0121"]);
    assert_eq!(
        findings("M03S100G81X5.Z-3.R2."),
        NONE,
        "M acts at the start of its block"
    );
    assert_eq!(findings("M03\nG18G81X5.Z-3.R2."), ["E0121"]);
    assert_eq!(findings("M03\nG81X5.A3.Z-3.R2."), ["E0108"]);
}
