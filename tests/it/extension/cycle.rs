//! A fixed cycle costs one file and two lines: its steps next to its code, its row in a dialect, and its module line.

use std::path::PathBuf;

use tandem_interp::codes::cycle_words::CYCLE_WORDS;
use tandem_interp::codes::feed_words::FEED_WORDS;
use tandem_interp::codes::g00_rapid::G00;
use tandem_interp::codes::g01_linear::G01;
use tandem_interp::codes::g74_g84_tapping::G80;
use tandem_interp::codes::g90_g91_distance::{G90, G91};
use tandem_interp::codes::g98_g99_return_level::{G98, G99};
use tandem_interp::codes::m_auxiliary::AUXILIARY;
use tandem_interp::codes::m02_m30_end::M30;
use tandem_interp::codes::{AXIS_WORDS, CodeTable};
use tandem_interp::dialect::{ModalWords, Policy};
use tandem_interp::dialects::texts::NO_TEXTS;
use tandem_interp::restrictions::USUAL;
use tandem_interp::{CheckContext, Dialect, check_source};
use tandem_model::Axis;
use tandem_model::profile::Profile;
use tandem_model::settings::PathRules;
use tandem_syntax::{Grammar, Header, compile};

use super::costs;
use super::g_code::naming;
use super::g81_drilling::G81;
use super::runs::{blocks, findings, profiles, shown};

static DRILLING_SHOP: Dialect = Dialect {
    name: "drilling",
    grammar: Grammar::nj,
    g_codes: CodeTable::new(&[&G00, &G01, &G80, &G81, &G90, &G91, &G98, &G99]),
    m_codes: CodeTable::new(&[&M30]),
    auxiliary: &AUXILIARY,
    modal_words: ModalWords::new(&AXIS_WORDS, &FEED_WORDS),
    start_up: &[&G01, &G80, &G90, &G98],
    cycle_cancel: Some(&G80),
    home: "",
    block_end: "M999.002",
    policy: Policy::NJ,
    path: PathRules::NJ,
    restrictions: &USUAL,
    texts: &NO_TEXTS,
};

fn moves(text: &str) -> Vec<String> {
    let blocks = blocks(text, &DRILLING_SHOP);
    blocks.iter().map(|block| shown(&block.action)).collect()
}

#[test]
fn custom_cycle_drills_its_holes_from_r_point_to_z_point() {
    let text = "G00 X0 Y0 Z10\nG99 G81 X10 Y20 Z-5 R2 F100\nX30\nG98 X40\nG80\nG00 X0\nM30\n";
    assert_eq!(findings(text, &DRILLING_SHOP), Vec::<&str>::new());
    assert_eq!(
        moves(text),
        [
            "rapid X0 Y0 Z10",
            // G99: each hole ends at the R point
            "rapid X10 Y20",
            "rapid Z2",
            "linear Z-5",
            "rapid Z2",
            "rapid X30",
            "rapid Z2",
            "linear Z-5",
            "rapid Z2",
            // G98: at Z where the cycle began
            "rapid X40",
            "rapid Z2",
            "linear Z-5",
            "rapid Z10",
            "None",
            "rapid X0",
        ]
    );
}

/// Returns the positions of X, Y and Z in a motion after a time.
fn at(profile: &Profile, t_s: f64) -> [f64; 3] {
    let position = profile.position(t_s);
    [Axis::X, Axis::Y, Axis::Z].map(|axis| (position[axis] * 1e9).round() / 1e9)
}

#[test]
fn motors_follow_the_steps_of_a_custom_cycle() {
    let text = "G00 X0 Y0 Z10\nta100 td100 ts0 G99 G81 X10 Y20 Z-5 R2 F600\nX30\nG98 X40\nG80\nM30\n";
    let profiles = profiles(text, &DRILLING_SHOP);
    let ends: Vec<_> = profiles.iter().map(|one| at(one, one.duration_s)).collect();
    let (initial, r, z) = (10.0, 2.0, -5.0);
    assert_eq!(
        ends,
        [
            [0.0, 0.0, initial],
            // G99: from the initial level to the first hole, then between R points
            [10.0, 20.0, initial],
            [10.0, 20.0, r],
            [10.0, 20.0, z],
            [10.0, 20.0, r],
            [30.0, 20.0, r],
            [30.0, 20.0, z],
            [30.0, 20.0, r],
            // G98: back to the Z position at the beginning of the cycle
            [40.0, 20.0, r],
            [40.0, 20.0, z],
            [40.0, 20.0, initial],
        ]
    );
    // the feed: 7 mm at F600, 10 mm/s, with ramps of 0.1 s at both ends: 7 / 10 + 0.1 s, half of the way in half of the time
    for place in [3, 6, 9] {
        let feed = &profiles[place];
        assert!((feed.duration_s - 0.8).abs() < 1e-9, "{}", feed.duration_s);
        assert_eq!(at(feed, 0.4), [ends[place][0], 20.0, f64::midpoint(r, z)]);
    }
}

#[test]
fn repetitions_go_on_by_the_distance_and_g99_goes_to_the_r_point_once() {
    // R counts from the initial level 10, Z from R: R point 10 - 8 = 2, Z point 2 - 7 = -5
    let holes = "G91 G99 G81 X5 Z-7 R-8 K2 F100\nG80\nM30\n";
    assert_eq!(
        moves(&format!("G00 Z10\n{holes}")),
        [
            "rapid Z10",
            "rapid X+5",
            "rapid Z2",
            "linear Z-5",
            "rapid Z2",
            "rapid X+5",
            "linear Z-5",
            "rapid Z2",
            // G80 moves nothing
            "None",
        ]
    );
}

#[test]
fn a_cycle_of_ones_own_is_restricted_and_compiled_as_tapping_is() {
    let found = |text| findings(text, &DRILLING_SHOP);
    assert_eq!(found("G81 X1 Z-5\nG80\nM30\n"), ["E0121"], "R is missing");
    assert_eq!(
        found("G81 X1 Z-5 R2\nM08\nG80\nM30\n"),
        ["E0121"],
        "M within the cycle"
    );
    assert_eq!(
        found("G81 X1 Z-5 R2 P9\nG80\nM30\n"),
        ["E0108"],
        "P is a word of tapping"
    );
    assert!(CYCLE_WORDS.iter().any(|word| word.address.text() == "P"));
    let text = "G81 X1 Z-5 R2\nX2\nG80\nM30\n";
    let (tree, check) = check_source(text, &DRILLING_SHOP, &CheckContext::default());
    assert!(check.m_codes.is_empty(), "drilling puts out no M code");
    assert_eq!(
        compile(&tree, Header::Program(1), &DRILLING_SHOP),
        "open prog 1\nN1 G80.001 G81 X1 Z-5 R2 M999.002\nN2 G81 X2 M999.002\nN3 G80 M999.002\nN4 M30 M999.002\nclose\n"
    );
}

#[test]
fn a_cycle_is_named_by_its_module_and_by_its_row_in_a_dialect_alone() {
    let rows = ["codes/mod.rs", "dialects/nj.rs"];
    for (file, dialects) in [
        ("g74_g84_tapping", &["dgshape", "nj"][..]),
        ("g81_g89_drilling", &["dgshape"]),
    ] {
        let of_dialects = dialects.iter().map(|name| format!("dialects/{name}.rs"));
        let files = std::iter::once(rows[0].to_owned()).chain(of_dialects);
        let files: Vec<_> = files
            .map(|row| PathBuf::from("runtime/interp/src").join(row))
            .collect();
        assert_eq!(naming(file), files, "{file}");
    }
    assert_eq!(
        costs("a fixed cycle of existing steps"),
        ["runtime/interp/src/codes", rows[0], rows[1]]
    );
}
