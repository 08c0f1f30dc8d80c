//! 1-1, 1-3, 1-5, 2-6: text around blocks, reading of words, and comments.

use tandem_interp::dialects::dgshape;
use tandem_interp::{CheckContext, check_source};
use tandem_syntax::parse;

use super::{findings, findings_of, run, run_with, speed};

const NONE: [&str; 0] = [];

#[test]
fn dgshape_1_1_a_program_begins_with_a_mark_alone_on_its_line() {
    assert_eq!(findings_of("%\nG90\nM30\n%\n"), NONE);
    assert_eq!(
        findings_of("%\nG90\nM30\n"),
        NONE,
        "the mark at the end may be left out"
    );
    assert_eq!(findings_of("\n %\t\nG90\nM02\n"), NONE, "blanks are no words");
    assert_eq!(findings_of("G90\nM30\n%\n"), ["E0024"]);
    assert_eq!(findings_of("% G90\nM30\n%\n"), ["E0025"]);
    assert_eq!(findings_of("%\nM30\n% G90\n")[0], "E0025");
    assert_eq!(findings_of("%\nM30\n%\nnothing of this is read ???\n"), NONE);
    assert_eq!(
        findings_of("%\r\nG90\r\nM30\r\n%\r\n"),
        NONE,
        "CR and LF end a block, too"
    );
}

#[test]
fn dgshape_1_1_a_program_ends_with_m02_or_m30() {
    assert_eq!(findings_of("%\nG90\n%\n"), ["E0115"]);
}

#[test]
fn dgshape_2_6_program_number_has_eight_digits_once_and_alone() {
    let number = |text: &str| parse(text.to_owned(), (dgshape().grammar)()).0.number();
    assert_eq!(number("%\nO00000100\nM30\n"), Some(100));
    assert_eq!(number("%\no1\nM30\n"), Some(1));
    assert_eq!(number("%\nO99999999 (plate)\nM30\n"), Some(99_999_999));
    assert_eq!(number("%\nM30\n"), None, "it may be left out");
    assert_eq!(findings_of("%\nO00000100\nM30\n"), NONE);
    for (text, code) in [
        ("%\nO100000000\nM30\n", "E0026"),
        ("%\nO1.0\nM30\n", "E0026"),
        ("%\nO\nM30\n", "E0026"),
        ("%\nO1\nO2\nM30\n", "E0026"),
        ("%\nO1 G90\nM30\n", "E0025"),
        ("%\nG90 O1\nM30\n", "E0025"),
        ("%\nN10 O1\nM30\n", "E0025"),
        ("%\nG90\nO1\nM30\n", "W0007"),
    ] {
        assert_eq!(findings_of(text), [code], "{text:?}");
    }
}

#[test]
fn dgshape_2_6_a_block_number_has_eight_digits_and_stands_first() {
    assert_eq!(findings("N00000001G00X1.0\nN99999999X2.\nN5"), NONE);
    assert_eq!(findings("N100000000G00X1.0"), ["E0103"]);
    assert_eq!(findings("N000000001G00X1.0"), ["E0103"]);
    assert_eq!(findings("N10.0G00X1.0"), ["E0103"]);
    assert_eq!(findings("G00N10X1.0"), ["E0010"]);
}

#[test]
fn dgshape_2_6_comments_stand_in_parentheses_on_their_line() {
    assert_eq!(findings("(G99 ??? äö)G00X1.0(and Y2)\n( )"), NONE);
    assert_eq!(run("(X5.0)G00X1.0(X2.0)Y1."), ["rapid X1 Y1"]);
    assert_eq!(
        findings("(not closed\nG00X1.0"),
        ["E0004"],
        "the next line is read"
    );
}

#[test]
fn dgshape_2_6_a_block_skip_stands_first_and_has_no_number() {
    assert_eq!(run("/G00X1.0\nG00Y1.0"), ["rapid Y1"], "block skip is on");
    assert_eq!(findings("/G00X1.0\n/N10X2."), NONE);
    assert_eq!(findings("/1G00X1.0"), ["E0008"]);
    assert_eq!(findings("G00/X1.0"), ["E0009"]);
}

#[test]
fn dgshape_1_3_the_last_g_code_of_a_group_takes_effect() {
    assert_eq!(run("G01G00X5.F100"), ["rapid X5"]);
    assert_eq!(run("G90G91G00X5.\nX5."), ["rapid X5", "rapid X10"]);
}

#[test]
fn dgshape_1_3_modal_codes_go_on() {
    let done = run("G00X15000Y15000\nZ5000\nG01Z-3000F600\nX50000\nX15000Y30000");
    assert_eq!(
        done,
        [
            "rapid X15 Y15",
            "rapid X15 Y15 Z5",
            "line X15 Y15 Z-3 F0.6",
            "line X50 Y15 Z-3 F0.6",
            "line X15 Y30 Z-3 F0.6"
        ]
    );
}

#[test]
fn dgshape_1_1_a_plus_sign_is_not_required() {
    assert_eq!(run("G00X+1.0Y2.0\nX3.0Y+4.0"), ["rapid X1 Y2", "rapid X3 Y4"]);
}

#[test]
fn dgshape_1_3_f_and_s_act_in_their_block_and_stay() {
    let done = run("G01X1.0F600.0\nX2.0\nX3.0F300.0\nX4.0");
    assert_eq!(
        done,
        ["line X1 F600", "line X2 F600", "line X3 F300", "line X4 F300"]
    );
    assert_eq!(speed("S8000M03\nM05\nM03", ""), 8000.0);
}

#[test]
fn dgshape_1_3_m_codes_act_at_the_start_of_their_block() {
    assert_eq!(run("G00X15000Y10000M03S8000"), ["M3", "rapid X15 Y10"]);
}

#[test]
fn dgshape_1_5_numbers_are_read_in_increments_or_by_calculator() {
    let done = |keys| run_with("G01X2000Y1.5F60000\nG04X500\nG04P500\nA90", keys).unwrap();
    // 2000 of 0.001 mm, 60000 of 0.001 mm/min, 500 ms, 90 of 0.01 degrees
    let increments = [
        "line X2 Y1.5 F60",
        "dwell 0.5",
        "dwell 0.5",
        "line X2 Y1.5 A0.9 F60",
    ];
    assert_eq!(done("angle_increment = 0.01"), increments);
    let only_f = run_with("G01X2000F600", "calculator = \"f\"").unwrap();
    assert_eq!(only_f, ["line X2 F600"]);
    let all = run_with("G01X20F600\nG04X5\nA90", "calculator = \"all\"").unwrap();
    assert_eq!(all, ["line X20 F600", "dwell 5", "line X20 A90 F3000"]);
    let dimensions = run_with("G01X20F600000\nA90", "calculator = \"ijkrxyza\"").unwrap();
    assert_eq!(
        dimensions,
        ["line X20 F600", "line X20 A90 F3000"],
        "A in its centre turns freely"
    );
}

#[test]
fn dgshape_2_1_written_values_have_their_ranges() {
    assert_eq!(findings("G00X99999999"), NONE);
    for text in [
        "G00X100000000",
        "G00X10000.",
        "G01F100000000X1.",
        "G04X3601.0",
        "G04P3600001",
    ] {
        assert_eq!(findings(text), ["E0109"], "{text}");
    }
    for text in ["G04P1.5", "G10P1.0R3.0", "M03S8000.0", "G10L2P1.X5.0"] {
        assert_eq!(findings(text), ["E0110"], "{text}");
    }
    assert_eq!(findings_of("%\nG20\nG00X99999.999\nM30\n"), NONE);
}

#[test]
fn dgshape_2_2_units_are_selected_once_before_coordinates() {
    assert_eq!(findings_of("%\nG90\nG20\nG00X1.0\nM30\n"), NONE);
    assert_eq!(findings_of("%\nG21\nG00X1.0\nG21\nM30\n"), NONE, "the same one");
    assert_eq!(findings_of("%\nG21\nG00X1.0\nG20\nM30\n"), ["E0124"]);
    assert_eq!(findings_of("%\nG00X1.0\nG20\nM30\n"), ["E0124"]);
    assert_eq!(findings_of("%\nG54\nG20\nM30\n"), ["E0124"]);
    assert_eq!(findings_of("%\nG54G20\nM30\n"), NONE, "in one block");
    assert_eq!(findings_of("%\nG54\nG21\nM30\n"), NONE, "no change");
}

#[test]
fn dgshape_words_of_other_codes_are_told() {
    assert_eq!(findings("G00X1.0I5.0"), ["E0108"]);
    assert_eq!(findings("G00X1.0D1"), ["E0108"]);
    assert_eq!(findings("G95"), ["E0101"]);
    assert_eq!(findings("G00X1.0U5.0"), ["E0007"]);
    assert!(!findings("G00X[L1]").is_empty(), "there are no variables");
}

#[test]
fn dgshape_findings_name_the_section_of_the_manual() {
    let settings = super::settings("");
    let (_, check) = check_source(
        "G95X1.0\nM08\n(",
        dgshape(),
        &CheckContext::from_settings(&settings),
    );
    for finding in &check.diagnostics {
        assert!(finding.help.ends_with(" of the manual."), "{finding:?}");
    }
    assert!(check.diagnostics.len() >= 4, "{check:?}");
}
