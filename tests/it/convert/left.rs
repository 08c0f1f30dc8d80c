//! Lines that cannot be converted: their modal effects apply to the following lines.

use tandem_interp::dialects::convert::{Source, convert};
use tandem_interp::dialects::nj;
use tandem_interp::{CheckContext, check_source};
use tandem_model::settings::NcOptions;

use super::has_lines;

fn of_fanuc(text: &str) -> (String, Vec<u32>) {
    let converted = convert(text, Source::Fanuc, &NcOptions::default());
    let left = converted.left.iter().map(|left| left.line).collect();
    (converted.text, left)
}

#[test]
fn blocks_behind_one_that_is_left_mean_what_it_puts_in_force() {
    // G91 within a cycle is not converted, nor is the next hole, which would be a different one under G90
    let text = "G90 G00 Z9.\nG99 G81 X1. Z-1. R1. F100\nG91 X5. K2\nX5.\nG80\nG90 G81 X1. Z-1. R1.\nM30\n";
    let converted = convert(text, Source::Fanuc, &NcOptions::default());
    let lines: Vec<u32> = converted.left.iter().map(|left| left.line).collect();
    assert_eq!(lines, [3, 4], "{:?}", converted.left);
    // the motion of X continues at the feedrate, as that of A did
    let converted = convert(
        "%\nG00X1.\nG01A90.F100.\nX5.\nM30\n",
        Source::Dgshape,
        &NcOptions::default(),
    );
    assert_eq!(converted.left.len(), 1);
    assert!(converted.text.contains("\nG01 X5\n"), "{}", converted.text);
}

/// FANUC: F, S, G01, G91 and similar words stay in force, independent of the other words of their block.
#[test]
fn what_stays_in_force_of_a_line_that_is_left_stands_before_its_comment() {
    for (line, kept) in [
        ("G01 X#1 F200. S300", "S300 F200 G01"),
        ("G91 G76 X4. Q1. F33. S44", "G91 S44 F33"),
        ("G18 G03 X#5 (a turn) F9.", "G18 F9 G03"),
        ("G20 X#5 F10.", "G20 F10"),
    ] {
        let (text, left) = of_fanuc(&format!("M06 T1\nG90 G00 X0 F100.\n{line}\nX3. R9.\nM30\n"));
        assert!(left.contains(&3), "{left:?}");
        assert!(
            text.contains(&format!("\n{kept}\n// not converted: {line}\n")),
            "{text}"
        );
    }
    let (text, left) = of_fanuc("G90 G00 X0 F100.\nG01 X#1 F200.\nX3.\nM30\n");
    assert_eq!(left, [2]);
    assert!(text.contains("\nG01 X3\n"), "no rapid: {text}");
}

#[test]
fn unconverted_line_leaves_out_its_uncertain_modal_words_too() {
    for line in [
        "IF [#1 EQ 2] THEN F200.",
        "#1 = 5 F200.",
        "G65 P9000 F200. S3",
        "G95 F0.2",
        "G96 S100",
        "G92 S2000",
        "G33 Z-5. F1.5",
        "/G91 X5. F200.",
        "G04 F2.",
    ] {
        let (text, left) = of_fanuc(&format!("G90 G00 X0 F100.\n{line}\nX3.\nM30\n"));
        assert_eq!(left, [2], "{line}");
        let before = text
            .lines()
            .take_while(|one| !one.starts_with("// not converted"))
            .last();
        assert_eq!(before, Some("G90 F100 G00 X0"), "{text}");
    }
}

#[test]
fn a_block_that_may_be_skipped_may_name_what_is_in_force() {
    let (text, left) =
        of_fanuc("G90 G00 X0 F100.\n/G00 X1.\n/2 G90 X2.\n/G04 P500\nG01 X3.\n/G01 Y2.\nM30\n");
    assert_eq!(left, [0_u32; 0], "{text}");
    has_lines(&text, &["/ G00 X1", "/2 G90 G00 X2", "/ G04 X0.5", "/ G01 Y2"]);
    for line in ["/G01 X1.", "/G91 X1.", "/G17", "/G54", "/G81 X1. Z-1. R1."] {
        let (_, left) = of_fanuc(&format!("G90 G00 X0 F100.\n{line}\nG01 X3.\nM30\n"));
        assert_eq!(left, [2], "{line}");
    }
}

/// FANUC, G86: the spindle stops during the retract, and turns again above the hole.
#[test]
fn g86_of_fanuc_stops_the_spindle_at_the_bottom() {
    for (start, again) in [("M03", "M03"), ("M04", "M04"), ("M08", "M03")] {
        let (text, left) = of_fanuc(&format!(
            "S500 {start}\nG90 G00 X0 Z9. F100.\nG99 G86 X1. Z-5. R1.\nG80\nM30\n"
        ));
        assert_eq!(left, [0_u32; 0]);
        let hole = format!("G00 X1\nG00 Z1\nG01 Z-5\nM05\nG00 Z1\n{again}\n");
        assert!(text.contains(&hole), "{text}");
        assert!(
            !check_source(text.as_str(), nj(), &CheckContext::default())
                .1
                .has_errors()
        );
    }
}
