//! Findings of the checker: one test for each rule, by a table of text and findings.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use tandem_interp::dialects::nj;
use tandem_interp::{CheckContext, check_source};
use tandem_model::settings::Unit;
use tandem_model::{Axis, Severity};
use tandem_syntax::{LineIndex, parse};

/// Returns all findings as `line:column code`.
fn findings(source: &str, context: &CheckContext<'_>) -> Vec<String> {
    let (_, check) = check_source(source, nj(), context);
    let index = LineIndex::new(source);
    check
        .diagnostics
        .iter()
        .map(|finding| {
            let (line, column) = index.locate(finding.span.start);
            format!("{line}:{column} {}", finding.code)
        })
        .collect()
}

/// Checks a text followed by M30.
fn check(source: &str, expect: &[&str]) {
    assert_eq!(
        findings(&format!("{source}\nM30"), &CheckContext::default()),
        expect,
        "{source:?}"
    );
}

/// Checks a text without additions.
fn check_whole(source: &str, expect: &[&str]) {
    assert_eq!(findings(source, &CheckContext::default()), expect, "{source:?}");
}

#[test]
fn a_whole_program_is_clean() {
    check(
        "G17 G21 G40 G49 G50 G50.1 G69 G80 G90 G98 G501 // safety line\n\
         N10 G54 G00 X0 Y0 Z50\nM03 S1200\nG01 Z-2 F300 ta80 td80 ts20\n/1 X10\nG91 G61 Y5 A10\nG64 G09 X1 B2 C3\n\
         G04 P500\nG04 X1.5\nG04\nM100 VA1 VB-2.5 VH3\nM98 P1000 L3\nM98 P9999\nM00\nM01\nG55 G56X1",
        &["16:5 E0106"],
    );
}

#[test]
fn d01_codes_are_read_by_number() {
    check("g1 x1 m3\nG001 X2\ng50.1\nG90.0 X1", &[]);
}

#[test]
fn words_of_arcs_and_cycles_belong_to_later_blocks_too() {
    check("G02 X10 Y0 I5 J0\nX20 I5\nX30 R5\nG01 X1\nX2 R1", &["5:4 E0108"]);
    check("G84 X1 Z-5 R2 P100 K3\nX2\nG80\nX3 K2", &["4:4 E0108"]);
    check("G05 P1 Q2\nP5", &["1:1 E0101", "2:1 E0108"]);
    check("G28 P1\nP5", &["1:5 E0108", "2:1 E0108"]);
    check("G02 X1 I2 F0", &["1:11 E0109"]);
    // the text does not show the codes in force after a subprogram or a branch
    check("M98 P1000\nX1 I1", &[]);
    check("if(P1==1) M98 P1000\nX3 I5", &["2:4 W0009"]);
}

#[test]
fn g_codes_that_exist_nowhere_are_told_apart() {
    check("G05 X1", &["1:1 E0101"]);
    check("G50.2", &["1:1 E0101"]);
    check("G80.001", &["1:1 E0101"]);
    check("G1000", &["1:1 E0101"]);
    check("G1.05", &["1:1 E0101"]);
    check("G-1", &["1:1 E0103"]);
    check("G[L1]", &["1:1 E0103"]);
}

#[test]
fn m_codes_are_whole_numbers_to_191() {
    check("M0191\nM191 VA1", &[]);
    check("M192", &["1:1 E0104"]);
    check("M3.5", &["1:1 E0103"]);
    check("M-3", &["1:1 E0103"]);
    check("M[L1]", &["1:1 E0103"]);
    check("N1.5 X1", &["1:1 E0103"]);
    check("N-1 X1", &["1:1 E0103"]);
}

#[test]
fn d02_two_words_of_one_address_are_an_error() {
    check("X1 Y2 X3", &["1:7 E0105"]);
    check("F1 ta2 TA3 X1", &["1:8 E0105"]);
    check("M10 VA1 VB2 VA3", &["1:13 E0105"]);
}

#[test]
fn d02_two_g_codes_of_one_group_are_an_error() {
    check("G90 G91 X1", &["1:5 E0106"]);
    check("G00 X1 G01", &["1:8 E0106"]);
    check("G54 G55", &["1:5 E0106"]);
    check("G01 G1 X1", &["1:5 E0106"]);
    check("G04 P1 G04", &["1:8 E0106"]);
    check("G90 G01 G17 G61 G54 G09 X1", &[]);
}

#[test]
fn d02_two_m_codes_are_an_error() {
    check("M03 M08", &["1:5 E0107"]);
    check("M03 S100 M03", &["1:10 E0107"]);
}

#[test]
fn d11_ranges_of_the_manual_hold_for_literals() {
    let cases = [
        ("X", 1_000_000.0, 1_000_000.1),
        ("X", -1_000_000.0, -1_000_000.1),
        ("Y", 1_000_000.0, 1_000_001.0),
        ("Z", 1_000_000.0, 1_000_001.0),
        ("A", 1_000_000.0, 1_000_001.0),
        ("B", 1_000_000.0, 1_000_001.0),
        ("C", 1_000_000.0, 1_000_001.0),
        ("F", 0.000_000_001, 0.0),
        ("S", 0.0, -1.0),
        ("ta", 250_000.0, 250_000.1),
        ("td", 250_000.0, 250_001.0),
        ("ts", 125_000.0, 125_001.0),
        ("ta", 0.0, -1.0),
        ("G04F", 100_000.0, 100_001.0),
        ("G04X", 100_000.0, 100_001.0),
        ("G04X", 0.0, -0.1),
        ("G04P", 100_000_000.0, 100_000_001.0),
        ("M98P", 1000.0, 999.0),
        ("M98P", 9999.0, 10_000.0),
        ("M98P1000 L", 10_000.0, 10_001.0),
        ("M98P1000 L", 0.0, -1.0),
    ];
    for (word, inside, outside) in cases {
        check(&format!("{word}{inside}"), &[]);
        let found = findings(&format!("{word}{outside}\nM30"), &CheckContext::default());
        assert_eq!(found.len(), 1, "{word}{outside}");
        assert!(found[0].ends_with("E0109"), "{word}{outside}: {found:?}");
    }
    check("F-5 X1", &["1:1 E0109"]);
}

#[test]
fn whole_numbers_are_needed_where_things_are_counted() {
    check("M98 P1000.5", &["1:5 E0110"]);
    check("M98 P1000 L1.5", &["1:11 E0110"]);
}

#[test]
fn words_belong_to_a_code_of_their_block() {
    check("G01 X1 R5", &["1:8 E0108"]);
    check("X1 I1 J2", &["1:4 E0108", "1:7 E0108"]);
    check("P100", &["1:1 E0108"]);
    check("L5", &["1:1 E0108"]);
    check("Q5", &["1:1 E0108"]);
    check("VA1", &["1:1 E0108"]);
    check("G04 P100 Y5", &["1:10 E0108"]);
    check("M10 P1000", &["1:5 E0108"]);
    check("M00 L1", &["1:5 E0108"]);
}

#[test]
fn d19_a_dwell_has_one_time() {
    check("G04 P500 X1", &["1:10 E0113"]);
    check("G04 F1 P1 X1", &["1:8 E0113"]);
    check("G04 M98 P1000", &["1:9 E0118"]);
}

#[test]
fn reserved_m_codes_take_no_parameters() {
    for code in ["M00", "M01", "M02", "M30", "M99"] {
        let found = findings(&format!("{code} VA1\nM30"), &CheckContext::default());
        assert!(found.contains(&"1:5 E0112".to_owned()), "{found:?}");
    }
    check("M98 P1000 VB1", &["1:11 E0112"]);
}

#[test]
fn m98_needs_a_program_number() {
    check("M98", &["1:1 E0111"]);
    check("M98 L2", &["1:1 E0111"]);
}

#[test]
fn d06_a_program_needs_an_end() {
    for end in ["M02", "M30", "M99", "X1 M30"] {
        check_whole(&format!("G01 X1 F1\n{end}"), &[]);
    }
    check_whole("X1\nY2", &["2:1 E0115"]);
    check_whole("", &["1:1 E0115"]);
    check_whole("// nothing", &["1:1 E0115"]);
    check_whole("X1\n/1 M30", &["2:1 E0115"]);
    check_whole("X1\n/1 M30\nM99", &[]);
}

#[test]
fn a_missing_end_is_not_told_where_the_end_cannot_be_read() {
    check_whole("X1\nM3O", &["2:3 E0007"]);
    check_whole("X1\n/* M30", &["2:1 E0004"]);
}

#[test]
fn d06_branches_may_end_or_go_past_the_end() {
    check_whole("if(L1==1){M30}", &["1:14 E0115"]);
    check_whole("if(L1==1) M30 else M99", &[]);
    check_whole("while(1==1) X1\nM30", &[]);
    check_whole("do M30 while(1==1)", &[]);
    check_whole("switch(L1){case 1: M30\ndefault: M30 }", &[]);
    check_whole("switch(L1){case 1: M30 }", &["1:24 E0115"]);
    check_whole("if(L1==1) M30 else M99\nX1\nX2", &["2:1 W0002"]);
}

#[test]
fn d03_the_line_of_the_intermediate_code_counts() {
    // N1, and a blank and four bytes a word, and the end of the block
    let block = |words: usize| (0..words).map(|_| "G904").collect::<String>();
    let findings = |words| findings(&format!("{}\nM30", block(words)), &CheckContext::default());
    assert!(findings(201).iter().all(|finding| !finding.ends_with("E0011")));
    assert!(findings(202).iter().any(|finding| finding.ends_with("E0011")));
}

#[test]
fn d13_a_block_skip_number_that_skips_nothing_is_a_warning() {
    check("/2\nX1", &["1:1 W0006"]);
    check("X1\n /3/5 N10 // nothing", &["2:2 W0006"]);
    check("/1/2/ X1\n/7/31 X2", &["1:5 W0006"]);
    check("/1 L1=2", &["1:1 E0017"]);
}

#[test]
fn d03_the_repeated_code_of_a_fixed_cycle_counts() {
    // N2, a blank and the words, and a blank and the end of the block: 1020 bytes with the repeated code
    let digits = "1".repeat(1020 - "N2 G84 X. M999.002".len() - 1);
    let second = |more: &str| {
        let found = findings(
            &format!("G84 X1 Z-5 R1\nX0.{digits}{more}\nG80\nM30"),
            &CheckContext::default(),
        );
        found.iter().any(|finding| finding == "2:1 E0011")
    };
    assert!(!second(""));
    assert!(second("1"));
}

#[test]
fn blocks_after_the_end_are_warned_of_once() {
    check("M30\nX1\nY1", &["2:1 W0002"]);
    check("/1 M30\nX1", &[]);
    check("M99\n// comment", &["3:1 W0002"]);
}

#[test]
fn program_codes_and_indirections_are_part_of_the_language() {
    check(
        "L1=1005 Q2=6\nX[L12] Y1\nM98 P[L1]\nM100 VA[_CNC_CapturedPosition2]",
        &[],
    );
    check("while(L1<5) L1=L1+1", &[]);
    check("if(L1==1){\nX1 X1 W5\n}", &["2:4 E0105", "2:7 E0007"]);
}

#[test]
fn d26_an_arc_needs_a_centre_in_its_plane_or_a_radius_that_reaches() {
    check("G02 X10", &["1:5 E0122"]);
    check("G02 X10 K5", &["1:9 E0122"]);
    check("G18 G02 X10 K5\nG19 Y5 K1\nG17 X1 I1", &[]);
    check("G91 G03 X10 R4.98", &["1:13 E0122"]);
    check("G91 G03 X10 R4.99\nX3 Y4 R-2.5\nX9 R0", &[]);
    check("G90 G03 X10 R1", &[]);
}

#[test]
fn words_of_an_arc_that_it_does_not_use_are_told() {
    check("G17 G02 X10 I5 K3", &["1:16 W0012"]);
    check("G18 G02 X10 I5 J3", &["1:16 W0012"]);
    check("G19 G03 Y10 I1 J5 K0", &["1:13 W0012"]);
    check("G02 X10 I5 J1\nG03 X5 R9 I3", &["2:11 W0012"]);
}

#[test]
fn d26_absolute_arcs_are_judged_where_the_text_shows_the_start() {
    check("G00 X0 Y0\nG02 X20 R9.98", &["2:9 E0122"]);
    check("G00 X0 Y0\nG02 X20 R9.99\nX20 R5", &["3:5 E0122"]);
    check("G18 G00 X0 Z5\nG03 X3 Z1 R2.4", &["2:11 E0122"]);
    check("G91 X5\nG90 X1 Y1\nG91 X9\nG90 G02 X18 Y1 R3.9", &["4:16 E0122"]);
    // nothing shows the start: neither the head of a program, nor a variable, another frame, a skipped block, a call
    for before in [
        "X0",
        "X0 Y[P1]",
        "X0 Y0\nG55",
        "X0 Y0\nG52 X1",
        "X0 Y0\nG20",
        "X0 Y0\nG53 X1",
        "X0 Y0\n/X9",
        "X0 Y0\nM98 P1000\nG90 G17",
    ] {
        check(&format!("G90 G00 {before}\nG02 X20 Y0 R5"), &[]);
    }
}

#[test]
fn what_is_in_force_behind_a_branch_depends_on_the_way() {
    check("G02 X1 R5\nif(P1==1) G00 X1\nX3 R5", &["3:4 W0009"]);
    check("G02 X1 R5\nwhile(P1==1) { X3 R5\nG00 X1 }", &["2:19 W0009"]);
    check("G01 X1\nif(L1==1) { X3 R5 }", &["2:16 E0108"]);
    check("G90 G00 X0 Y0\nif(L1==1) { G02 X20 R5 }", &["2:21 E0122"]);
    check("G90 G00 X0 Y0\nif(P1==1) X20\nG90 G02 X0 R5", &["3:12 W0009"]);
    check("G90 G00 X0 Y0\nif(P1==1) X20\nG90 G02 X9 R5", &["3:12 W0009"]);
}

#[test]
fn what_is_in_force_at_the_head_of_a_subprogram_depends_on_its_caller() {
    let context = CheckContext::default();
    assert_eq!(findings("X3 R5\nM99", &context), ["1:4 W0009"]);
    assert_eq!(findings("G40 X3\nG28\nM99", &context), [""; 0]);
    assert_eq!(findings("G01 X3 R5\nM99", &context), ["1:8 E0108"]);
}

#[test]
fn d23_reference_and_machine_positions_need_the_tool_without_offsets() {
    for code in ["G28", "G30 P2 X1", "G53 X1"] {
        check(&format!("G43\n{code}"), &["2:1 E0120"]);
        check(&format!("G41\nX9\n{code}\nG40\nX0"), &["3:1 E0119"]);
        check(&format!("G41\nX9\nG40\n{code}\nG01 X0"), &["4:1 E0119"]);
        check(&format!("G43\nG49\n{code}"), &[]);
    }
}

/// Checks a source with a lead-out before the end.
fn led_out(source: &str, expect: &[&str]) {
    check(&format!("{source}\nG40\nG01 X0 Y0"), expect);
}

#[test]
fn cutter_compensation_keeps_its_rules() {
    led_out("G41\nG02 X5 I5", &["2:1 E0119"]);
    check("G41\nX9\nG02 X5 I5\nG40\nG03 X1 R9", &["5:1 E0119"]);
    check("G41 X9\nG02 X5 I5\nG40 G01 X1\nG02 X3 R9", &[]);
    led_out("G41\nG00 X1", &["2:1 E0119"]);
    led_out("G41\nX9\nG42", &["3:1 E0119"]);
    led_out("G41\nX9\nG18", &["3:1 E0119"]);
    led_out("G41\nX9\nG17\nG41", &[]);
    led_out("G42\nM00", &["2:1 E0119"]);
    led_out("G42\nM100 VA1", &["2:1 E0119"]);
    led_out("G42\nM100", &[]);
}

#[test]
fn cutter_compensation_lasts_to_the_lead_out() {
    check("G41\nX9\nX20", &["4:1 E0119"]);
    check("G41\nX9\nX20\nG40", &["5:1 E0119"]);
    check("G41\nX9\nX20\nG40\nG00 Z50", &["6:1 E0119"]);
    check("G41\nX9\nX20\nG40\nG00 Z50\nX0", &[]);
    check("G41\nX9\nX20\nG40 X30 M100 VA1", &[]);
    for code in ["M01", "M100 VA1", "G19", "G31 X5"] {
        let text = format!("G41\nX9\nX20\nG40\n{code}\nG01 X30 Y9");
        check(&text, &["5:1 E0119"]);
    }
    // nothing has led in
    check("G41\nG40\nM00\nG02 X5 I5", &[]);
    // a move along another axis does not lead in
    led_out("G41\nZ-5\nG02 X5 I5", &["3:1 E0119"]);
    led_out("G41\nZ-5\nX5\nG02 X9 I5", &[]);
}

#[test]
fn d42_a_fixed_cycle_keeps_its_rules() {
    check("G84 X1 Z-5\nG80", &["1:1 E0121"]);
    check("G84 X1 Z-5 R1\nG98 X2\nG99 X3\nG74 X4\nG80", &[]);
    check("G84 X1 Z-5 R1\nM98 P1000\nG80", &["2:1 E0121"]);
    check("G84 X1 Z-5 R1", &["2:1 E0121"]);
    check("G84 X1 Z-5 R1\nG04 P100\nG80", &["2:1 E0121"]);
    check("G84 X1 Z-5 R1\nG00 X1\nG04 P100", &[]);
    check("G84 X1 Z-5 R1\nA5\nG80", &["2:1 E0108"]);
}

#[test]
fn ranges_of_the_codes_hold() {
    check("G51 P0", &["1:5 E0109"]);
    check("G51 I0.000001", &["1:5 E0109"]);
    check("G51 I-0.00001 J10000", &[]);
    check("G68 R360.1", &["1:5 E0109"]);
    check(
        "G68 R-360\nG69\nG68 R300.1\nG69\nG68 R300",
        &["1:5 W0011", "3:5 W0011"],
    );
    check("G68 X1", &["1:1 E0111"]);
    check("G30 P5", &["1:5 E0109"]);
    check("G84 Z-1 R1 K10001\nG80", &["1:12 E0109"]);
}

#[test]
fn all_findings_come_at_once_in_the_order_of_the_text() {
    check(
        "X1 R5\nX\nG90 G91\nM3 M4\nW1",
        &["1:4 E0108", "2:1 E0005", "3:5 E0106", "4:4 E0107", "5:1 E0007"],
    );
}

#[test]
fn a_broken_word_is_one_error() {
    check("M98 P", &["1:5 E0005"]);
    check("G04 P1.2.3", &["1:5 E0006"]);
}

#[test]
fn the_axes_of_the_coordinate_system_are_known() {
    let context = CheckContext {
        axes: Some([Axis::X, Axis::Y].into_iter().collect()),
        ..CheckContext::default()
    };
    assert_eq!(findings("X1 Y2 Z3\nG04 X1\nM30", &context), ["1:7 E0114"]);
}

#[test]
fn d11_feedrate_above_the_maximum_is_a_warning_and_spindle_speed_an_error() {
    let context = CheckContext {
        max_feedrate_mm_min: Some(3000.0),
        max_spindle_speed_r_min: Some(8000.0),
        ..CheckContext::default()
    };
    assert_eq!(
        findings("X1 F3000 S8000\nX2 F3001\nS8001\nG04 F5000\nM30", &context),
        ["2:4 W0004", "3:1 E0109"]
    );
}

#[test]
fn what_the_configuration_lacks_is_a_warning_once() {
    let there = parse("M99", (nj().grammar)()).0;
    let programs = BTreeMap::from([(1000, Arc::new(there))]);
    let m_codes = BTreeSet::from([3, 5]);
    let context = CheckContext {
        programs: Some(&programs),
        m_codes_with_settings: Some(&m_codes),
        ..CheckContext::default()
    };
    let source = "M98 P1000\nM98 P2000\nM98 P2000\nM98 P3000 L0\nM03\nM10\nM10\nM00\nM30";
    assert_eq!(findings(source, &context), ["2:5 W0001", "6:1 W0003"]);
    let (_, check) = check_source(source, nj(), &context);
    assert!(!check.has_errors());
    assert!(
        check
            .diagnostics
            .iter()
            .all(|finding| finding.severity == Severity::Warning)
    );
}

#[test]
fn m_codes_and_programs_are_listed_once_ascending() {
    let (_, check) = check_source(
        "M98 P3000\nM19\nM3\nM03\nM98 P1000\nM98 P2000 L0\nM0\nM1\nM98 P3000\nM2\nM30",
        nj(),
        &CheckContext::default(),
    );
    assert_eq!(check.m_codes, [3, 19]);
    assert_eq!(check.programs, [1000, 3000]);
}

#[test]
fn d42_m_codes_that_a_tapping_cycle_puts_out_are_listed() {
    let listed = |source: &str, has_spindle| {
        let context = CheckContext {
            has_spindle,
            ..CheckContext::default()
        };
        check_source(source, nj(), &context).1.m_codes
    };
    let source = "G84 X1 Z-5 R1\nX2\nG80\nM100\nM30";
    assert_eq!(listed(source, Some(true)), [5, 19, 100]);
    assert_eq!(listed(source, Some(false)), [3, 4, 19, 100]);
    assert_eq!(listed(source, None), [3, 4, 5, 19, 100]);
    assert_eq!(listed("G80\nG98\nX1\nM30", Some(true)), [0; 0]);
}

#[test]
fn d25_the_number_of_the_maximum_feedrate_counts_in_the_unit_in_force() {
    let context = CheckContext {
        max_feedrate_mm_min: Some(2540.0),
        ..CheckContext::default()
    };
    assert_eq!(
        findings("G20 X1 F2540\nF2541\nG21 F2540\nF2541\nM30", &context),
        ["2:1 W0004", "4:1 W0004"]
    );
    let inch = CheckContext {
        unit: Unit::Inch,
        ..context
    };
    assert_eq!(findings("X1 F2540\nF2541\nM30", &inch), ["2:1 W0004"]);
}

#[test]
fn the_list_of_findings_has_a_limit() {
    let (_, check) = check_source("X1 R1\n".repeat(5000), nj(), &CheckContext::default());
    assert_eq!(
        check
            .diagnostics
            .iter()
            .filter(|finding| finding.code == "E0108")
            .count(),
        1000
    );
    assert_eq!(
        check
            .diagnostics
            .iter()
            .filter(|finding| finding.code == "E0002")
            .count(),
        1
    );
}
