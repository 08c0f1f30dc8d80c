//! Every word of a source is in the converted text, or its line is reported; times and axes never change silently.

use tandem_model::settings::{Calculator, CompensationStart, NcOptions, Unit};
use tandem_model::{Axis, AxisVector};

use super::{ConvertedProgram, Settings, Source, convert};

fn of_fanuc(text: &str) -> ConvertedProgram {
    convert(text, Source::Fanuc, &NcOptions::default())
}

fn lines_left(converted: &ConvertedProgram) -> Vec<u32> {
    converted.left.iter().map(|left| left.line).collect()
}

fn has_line(converted: &ConvertedProgram, wanted: &str) -> bool {
    converted.text.lines().any(|line| line == wanted)
}

#[test]
fn words_on_the_line_of_a_program_number_are_reported() {
    for line in [
        "O5 G1 X7 F100",
        "O<turn> sub",
        "O<turn> endsub",
        "O2 call",
        "O G1 X7",
    ] {
        let converted = of_fanuc(&format!("%\nO1\nG0 X1\n{line}\nG1 X9 F100\nM30\n%\n"));
        assert!(lines_left(&converted).contains(&4), "{line}: {converted:?}");
        assert!(
            has_line(&converted, &format!("// not converted: {line}")),
            "{}",
            converted.text
        );
    }
    let first = of_fanuc("O1 G1 X7\nM30\n");
    assert_eq!(lines_left(&first), [1]);
}

#[test]
fn a_second_program_is_reported_once_and_stays_as_comments() {
    let converted =
        of_fanuc("%\nO1000\nG00 X1 Z5\nM98 P2000\nX9\nM30\n\nO2000 (SUB)\nG91 G00 X5\nG90\nM99\n%\n");
    assert_eq!(lines_left(&converted), [8], "{converted:?}");
    assert_eq!(converted.left[0].text, "O2000 (SUB)");
    assert!(has_line(&converted, "M30"));
    for kept in ["O2000 (SUB)", "G91 G00 X5", "G90", "M99"] {
        assert!(
            has_line(&converted, &format!("// not converted: {kept}")),
            "{}",
            converted.text
        );
    }
}

#[test]
fn a_fixed_cycle_outside_g17_is_reported() {
    for text in [
        "G18\nG00 X0 Y20 Z10\nG81 X1 Z1 Y-10 R2 F100\nG80\nM30\n",
        "G19\nG00 X0 Y20 Z10\nG84 X1 Z1 Y-10 R2 F100\nG80\nM30\n",
    ] {
        let converted = of_fanuc(text);
        assert!(lines_left(&converted).contains(&3), "{converted:?}");
        assert!(!converted.text.contains("G01"), "{}", converted.text);
    }
    let changes = of_fanuc("G17 G00 X0 Y0 Z10\nG81 X1 Y1 Z-1 R1 F100\nG18 X5\nG80\nM30\n");
    assert_eq!(lines_left(&changes), [3]);
    let unknown = of_fanuc("G90 G98 G00 Z9\nG81 X1 Z-1 R1 F100\nG80\nM99\n");
    assert!(
        unknown.left[0]
            .reason
            .starts_with("the plane in force is unknown"),
        "{unknown:?}"
    );
}

/// Haas and LinuxCNC read a P with a decimal point as seconds; FANUC accepts no decimal point in P.
#[test]
fn p_of_a_dwell_with_a_point_counts_seconds() {
    let dwell = |text: &str| of_fanuc(text).text;
    assert!(dwell("G04 P1.8\nM30\n").contains("G04 X1.8\n"));
    assert!(dwell("G04 P1800\nM30\n").contains("G04 X1.8\n"));
    let hole = "G00 Z9\nG82 X1 Z-1 R1 P.5 F100\nG80\nM30\n";
    assert!(dwell(hole).contains("G04 X0.5\n"));
    let thread = "G00 Z9\nS100 M03\nG84 X1 Z-1 R1 P.5 F100\nG80\nM30\n";
    assert!(dwell(thread).contains("P500 "));
}

#[test]
fn numbers_of_dgshape_mean_what_the_configuration_says() {
    let of = |text: &str, options: NcOptions, unit| {
        convert(
            &format!("%\n{text}\nM30\n%\n"),
            Source::Dgshape,
            Settings { options, unit },
        )
        .text
    };
    let plain = NcOptions::default();
    let all = NcOptions {
        calculator: Calculator::All,
        ..plain
    };
    assert!(of("G04X2", plain, Unit::Millimetre).contains("G04 X0.002\n"));
    assert!(of("G04X2", all, Unit::Millimetre).contains("G04 X2\n"));
    let inch = of("G90G00X1.0", plain, Unit::Inch);
    assert!(
        inch.starts_with("G00 G17 G20 ") && inch.contains("G00 X1\n"),
        "{inch}"
    );
    let limits = NcOptions {
        min_feedrate_mm_min: 60.0,
        min_spindle_speed_r_min: 500.0,
        max_spindle_speed_r_min: 3000.0,
        ..plain
    };
    assert!(of("G01X1.F6.", limits, Unit::Millimetre).contains("F60 "));
    assert!(of("S200M03", limits, Unit::Millimetre).contains("S500 M03"));
    assert!(of("S5000M03", limits, Unit::Millimetre).contains("S3000 M03"));
}

#[test]
fn settings_that_nj_does_not_have_are_reported() {
    let mut external_offset = AxisVector::ZERO;
    external_offset[Axis::X] = 1000.0;
    let options = NcOptions {
        external_offset,
        ..NcOptions::default()
    };
    let shifted = convert("%\nG90G00X1.\nM30\n%\n", Source::Dgshape, &options);
    assert!(shifted.left[0].reason.contains("external offset"), "{shifted:?}");
    let options = NcOptions {
        compensation_start: CompensationStart::B,
        ..NcOptions::default()
    };
    let text = "%\nM06T1\nG00X1.\nG41D1G01X5.F100.\nX9.Y5.\nG40X0\nM30\n%\n";
    assert!(lines_left(&convert(text, Source::Dgshape, &options)).contains(&4));
}

#[test]
fn each_m_code_of_a_block_becomes_a_block_in_its_order() {
    let converted = of_fanuc("N20 G54 G00 X0. Y0. S1200 M03 M08\nN30 G01 Z-2. F300\nN40 M09 M05\nM30\n");
    let lines: Vec<&str> = converted.text.lines().skip(1).collect();
    let wanted = [
        "N20 G54 S1200 M03",
        "M08",
        "G00 X0 Y0",
        "N30 F300 G01 Z-2",
        "N40 M09",
        "M05",
        "M30",
    ];
    assert_eq!(lines, wanted);
    assert_eq!(converted.left, []);
}

#[test]
fn a_block_that_nj_refuses_is_reported_as_written() {
    let converted = of_fanuc("G21 G17 G90\nG00 X0. Y0.\nG02 X10. Y0. R1. F100\nM30\n");
    let left: Vec<_> = converted
        .left
        .iter()
        .map(|left| (left.line, left.is_written))
        .collect();
    assert_eq!(left, [(3, true)]);
    assert!(has_line(&converted, "F100 G02 X10 Y0 R1"), "{}", converted.text);
}

#[test]
fn program_after_a_main_program_without_number_is_reported() {
    let converted = of_fanuc("G00 X1\nM98 P2000\nM30\nO2000\nG91 G00 X5\nM99\n");
    assert_eq!(lines_left(&converted), [4], "{converted:?}");
    assert!(has_line(&converted, "M30"));
    assert!(
        has_line(&converted, "// not converted: G91 G00 X5"),
        "{}",
        converted.text
    );
    let comment = of_fanuc("%\n(a part)\nO1\nG00 X1\nM30\n%\n");
    assert_eq!(comment.left, []);
}

#[test]
fn text_after_the_end_mark_is_kept_and_reported_at_its_line() {
    for (text, first) in [
        ("%\nO1\nG00 X1\nM30\n%\n\nO2\nG91 G00 X5\nM99\n%\n", 7),
        ("O1\nG00 X1\nM30\n%\nO2\nG91 G00 X5\n", 5),
        ("%\nO1\nG00 X1\nM30\n% G91 G00 X5\n", 5),
    ] {
        let converted = of_fanuc(text);
        assert_eq!(lines_left(&converted), [first], "{converted:?}");
        assert!(converted.text.contains("G91 G00 X5"), "{}", converted.text);
        assert!(!converted.text.lines().any(|line| line.starts_with("G91")));
    }
    let dgshape = convert(
        "%\nG90G00X1.\nM30\n%\nG00X9.\n",
        Source::Dgshape,
        &NcOptions::default(),
    );
    assert_eq!(lines_left(&dgshape), [5], "{dgshape:?}");
    assert!(has_line(&dgshape, "// not converted: G00X9."), "{}", dgshape.text);
}

#[test]
fn unit_of_the_configuration_applies_to_programs_of_fanuc() {
    let settings = Settings {
        unit: Unit::Inch,
        ..Settings::from(&NcOptions::default())
    };
    let text = convert("G00 X1\nM30\n", Source::Fanuc, settings).text;
    assert!(
        text.starts_with("G00 G17 G20 ") && text.contains("G00 X1\n"),
        "{text}"
    );
    assert!(of_fanuc("G00 X1\nM30\n").text.starts_with("G00 G17 G21 "));
}

#[test]
fn subprogram_with_main_end_in_a_branch_keeps_state_of_callers() {
    let sub = of_fanuc("O2000\nG00 Z9\n/M30\nG91 G00 X5\nM99\n");
    assert!(!sub.text.contains("G21"), "{}", sub.text);
    let main = of_fanuc("O1\n/M99\nG00 X5\nM30\n");
    assert!(main.text.contains("G21"), "{}", main.text);
}

/// FANUC, parameter DPI: without a decimal point, X1000 is 1000 s with calculator input, otherwise 1 s.
#[test]
fn p25_x_of_a_dwell_without_a_point_is_reported() {
    let converted = of_fanuc("G04 X1000\nG04 X1.5\nG04 X2.\nG04 X0\nM30\n");
    assert_eq!(lines_left(&converted), [1]);
    let reason = &converted.left[0].reason;
    assert!(reason.contains("1000 s, otherwise 1 s"), "{reason}");
    for line in ["// not converted: G04 X1000", "G04 X1.5", "G04 X2"] {
        assert!(has_line(&converted, line), "{}", converted.text);
    }
}

/// The words that the assumption is about, and words of the same kind with only one meaning.
#[test]
fn p25_meaning_that_depends_on_the_control_is_reported_once() {
    for (text, about, line, lines) in [
        (
            "G00 X1.\nG01 X-10 F100\nG02 Y5. R9\nG01 X0\n",
            "decimal point are read in mm",
            2,
            2,
        ),
        ("G04 P500\nG04 P1.5\nG04 P0\n", "milliseconds", 1, 1),
        ("M03 S500\nG00 X1. M08\nG01 X2. M09 F100\nM05\n", "M codes", 2, 2),
        (
            "G00 X1.\nG00 X1. Y2.\nG01 X3. Y3. F100\nG28 X0 Y0\n",
            "rapid motion",
            2,
            2,
        ),
        (
            "G00 Z9.\nG99 G81 X1. Y1. Z-1. R1. F100\nG80\n",
            "rapid motion",
            2,
            1,
        ),
    ] {
        let converted = of_fanuc(&format!("{text}M30\n"));
        assert_eq!(converted.left, [], "{text}");
        let [assumption] = &converted.assumptions[..] else {
            panic!("{text}: {:?}", converted.assumptions)
        };
        assert!(assumption.text.contains(about), "{assumption:?}");
        assert_eq!((assumption.line, assumption.lines), (line, lines), "{text}");
    }
}

#[test]
fn p25_words_with_one_meaning_need_no_assumption() {
    let text = "G21 G90 G54\nT1 M06\nS500 M03\nG00 X1. Y0\nZ2.\nG01 X5. Y5. F200\nG52 X1. Y2.\nG51 X1. Y1. P2.\nG50\nX0 M00\nM30\n";
    let converted = of_fanuc(&text.replace("X1. Y0\n", "X1.\n"));
    assert_eq!((converted.left, converted.assumptions), (vec![], vec![]));
    let dgshape = convert(
        "%\nG90\nG00X1000Y1.\nM30\n%\n",
        Source::Dgshape,
        &NcOptions::default(),
    );
    assert_eq!(dgshape.assumptions, []);
}
