//! `tandem convert`: the result moves like the source, and everything without an equivalent is reported.

mod left;
mod settings;

use std::fs;

use tandem_interp::dialects::convert::{ConvertedProgram, Source, convert};
use tandem_interp::dialects::{dgshape, nj};
use tandem_interp::{CheckContext, check_source};
use tandem_model::settings::{Calculator, NcOptions};

use crate::cli_findings::run_with;
use crate::dgshape::{MACHINE, machine_settings, steps};
use crate::support::binary::root;
use crate::support::machine::Machine;
use crate::support::simulated::run;

/// A small generator of numbers (xorshift64*).
struct Random(u64);

impl Random {
    fn below(&mut self, bound: i64) -> i64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        let value = self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 33;
        i64::try_from(value).unwrap() % bound
    }

    /// A length between two, thousandths.
    fn thousandths(&mut self, from: i64, to: i64) -> i64 {
        from * 1000 + self.below((to - from) * 1000 + 1)
    }

    /// A length between two, mm: with a point, or in thousandths without one.
    fn length(&mut self, from: i64, to: i64) -> String {
        let thousandths = self.thousandths(from, to);
        if self.below(3) == 0 {
            return thousandths.to_string();
        }
        let sign = if thousandths < 0 { "-" } else { "" };
        let (whole, rest) = (thousandths.abs() / 1000, thousandths.abs() % 1000);
        format!("{sign}{whole}.{rest:03}")
    }
}

/// Returns a few blocks of dialect dgshape that have an equivalent.
fn blocks(random: &mut Random) -> String {
    let (x, y) = (random.length(-9, 9), random.length(-9, 9));
    let (z, r) = (random.length(-9, -2), random.length(-1, 3));
    let level = random.length(4, 9);
    match random.below(12) {
        10 => format!(
            "G51X1.Y2.P1.{:03}\nG00X{x}Y{y}Z2.\nG02X-3.Y2.R9.F100.\nG50\nG00X{y}Y{x}Z{level}\n",
            random.below(1000)
        ),
        0 => format!("G00X{x}Y{y}Z{level}\n"),
        1 => format!("G01X{x}Y{y}F{}.\nY{x}(on) \nZ{level}\n", 100 + random.below(900)),
        2 => format!(
            "G91G01X{}Z{}F200.\nG00Y{}\nG90\n",
            random.length(-2, 2),
            random.length(-1, 0),
            random.length(-2, 2)
        ),
        3 => "G91\nG02X5.Y0R4.F300.\nG03X-5.I-2.5\nG90G00\n".to_owned(),
        4 => "G91G18G02X3.R-2.F100.\nG17G90G00Z5.\n".to_owned(),
        5 => format!("G04P{}\nG04X.5\nG04X250\n", random.below(2000)),
        6 => {
            let tool = 1 + random.below(2);
            format!(
                "M06T{tool}\nS{}M03\nG43H{tool}Z20.\nG01X{x}F100.\nG49Z15.\n",
                500 + random.below(5000)
            )
        }
        7 => {
            let code = ["81", "82", "83", "85", "86", "89"][usize::try_from(random.below(6)).unwrap()];
            let back = 98 + random.below(2);
            let more = match code {
                "83" => format!("Q{}", random.length(1, 2)),
                "82" | "89" => "P300".to_owned(),
                _ => String::new(),
            };
            format!("M03\nG00Z12.\nG{back}G{code}X{x}Y{y}Z{z}R{r}{more}F150.\nX{y}\nG98Y{x}\nG80\nX1.\n")
        }
        8 => format!("M03\nG00Z8.\nG91G99G81X1.Y-1.Z-3.R-2.K3F99.\nX-2.\nG98X.5\nG80\nG90\nG00X0Z{level}\n"),
        9 => format!("G5{}\nG00X{x}Y{y}Z5.\nM12\nM13\n", 4 + random.below(2)),
        _ => "(over)\n\nG17\nG40G49\n".to_owned(),
    }
}

fn moves_equally(text: &str, converted: &ConvertedProgram) {
    let of_dgshape = steps(text, dgshape(), &machine_settings(&MACHINE));
    let config = MACHINE.replace("dialect = \"dgshape\"\n", "");
    let of_nj = steps(&converted.text, nj(), &machine_settings(&config));
    assert_eq!(
        of_nj.unwrap_or_else(|alarm| panic!("{alarm:?}\n{}", converted.text)),
        of_dgshape.unwrap_or_else(|alarm| panic!("{alarm:?}\n{text}")),
        "{text}\n{}",
        converted.text
    );
}

fn has_lines(text: &str, lines: &[&str]) {
    for line in lines {
        assert!(text.lines().any(|one| one == *line), "{line}: {text}");
    }
}

#[test]
fn programs_of_dgshape_made_at_random_move_equally_in_nj() {
    let mut random = Random(0x0c0d_e000_0000_0001);
    for _ in 0..300 {
        let count = 1 + random.below(6);
        let body: String = (0..count).map(|_| blocks(&mut random)).collect();
        let text = format!("%\nO0001(a)\nG21G90\nG00X0Y0Z10.\n{body}\nM05\nM30\n%\n");
        let converted = convert(&text, Source::Dgshape, &NcOptions::default());
        assert_eq!(converted.left, [], "{text}");
        moves_equally(&text, &converted);
    }
}

#[test]
fn dgshape_example_moves_equally_in_nj_except_returns_with_tool_length() {
    let text = fs::read_to_string(root().join("examples/nc/dgshape/plate.nc")).unwrap();
    let converted = convert(&text, Source::Dgshape, &NcOptions::default());
    let left: Vec<&str> = converted.left.iter().map(|left| left.text.as_str()).collect();
    assert_eq!(left, ["N170 G91 G28 Z0.0", "N290 G91 G28 Z0.0"]);
    // nj refuses a contour if its lead-in and lead-out cut into each other
    let uncompensated = text.replace("G41 D1 ", "");
    let lines = uncompensated.lines().filter(|line| !line.contains("G28"));
    let rest: String = lines.flat_map(|line| [line, "\n"]).collect();
    let converted = convert(&rest, Source::Dgshape, &NcOptions::default());
    assert_eq!(converted.left, []);
    moves_equally(&rest, &converted);
    for comment in ["plate: pocket outline by tool 1", "// lead in", "// lead out"] {
        assert!(converted.text.contains(comment), "{comment}: {}", converted.text);
    }
}

#[test]
fn block_numbers_comments_block_skip_and_the_program_number_stay() {
    let text =
        "%\nO12 (Title)\n(first)\nN10 G90 G00 X1. (there) \n\n/ N20 X2.\n/(skipped)M08 (oil)\nN30 M30\n%\n";
    let options = NcOptions {
        m_codes: [8].into_iter().collect(),
        ..NcOptions::default()
    };
    let converted = convert(text, Source::Dgshape, &options);
    assert_eq!(converted.left, []);
    let lines: Vec<&str> = converted.text.lines().skip(1).collect();
    let expected = [
        "",
        "// O12 Title",
        "// first",
        "N10 G90 G00 X1 // there",
        "",
        "/ N20 G00 X2",
        "/ M08 // skipped oil",
        "N30 M30",
        "",
    ];
    assert_eq!(lines, expected);
}

#[test]
fn numbers_are_read_as_the_machine_of_dgshape_reads_them() {
    let of = |calculator| {
        let options = NcOptions {
            calculator,
            ..NcOptions::default()
        };
        convert("%\nG00 X1500 Y1.5\nM30\n%\n", Source::Dgshape, &options).text
    };
    assert!(of(Calculator::None).contains("G00 X1.5 Y1.5"));
    assert!(of(Calculator::All).contains("G00 X1500 Y1.5"));
}

#[test]
fn unconvertible_line_is_reported_with_reason_and_kept_as_a_comment() {
    for (line, reason) in [
        (
            "G10 P1 R3.",
            "G10 has no equivalent in nj. Remove it: the configuration",
        ),
        (
            "G92 X0",
            "G92 depends on the position of the tool, and its X is unknown at this block. Write G90 and a motion",
        ),
        ("G39 X5. Y5.", ""),
        ("G01 A90. F100.", "F of a motion of A"),
        (
            "G43 H2 Z5.",
            "H2 is not the offset of the tool in the spindle (unknown)",
        ),
        ("S50 M03", "S50 is the number of a speed"),
        ("G28", "the block names no axis"),
        ("/ G91 X5.", "a block with block skip changes"),
        ("G05", "there is no G5"),
        ("X1.;", "`;` is not part"),
        ("G01 X1. (not closed", "the comment"),
    ] {
        let text = format!("%\nG90\n{line}\nM30\n%\n");
        let converted = convert(&text, Source::Dgshape, &NcOptions::default());
        let left: Vec<_> = converted.left.iter().filter(|left| left.line == 3).collect();
        assert_eq!(left.len(), 1, "{line}: {:?}", converted.left);
        assert_eq!(left[0].text, line);
        assert!(left[0].reason.starts_with(reason), "{line}: {}", left[0].reason);
        assert!(converted.text.contains(line), "{line}: {}", converted.text);
    }
}

#[test]
fn programs_of_fanuc_become_programs_of_nj() {
    let text = "%\nO1234 (BRACKET)\nN1 G21 G94 G97\nT5 M06 (MILL)\nG54 G90 G00 X-10 Y0 S4000 M03\nG43 H5 Z50. M08\nG01 Z-2 F200\nG02 X0 Y10 R10\nG98 G83 X20. Y20. Z-8. R2. Q3. F100\nX40.\nG80 M09\nM98 P1000 L2\nG49\nG90 G53 G00 X-90\nG28 G91 Z0\nM05\nM30\n%\n";
    let converted = convert(text, Source::Fanuc, &NcOptions::default());
    assert_eq!(converted.left, []);
    for line in [
        "// O1234 BRACKET",
        "M06 VA5 // MILL",
        "S4000 M03",
        "G00 X-10 Y0",
        "M08",
        "G43 G00 Z50",
        "F200 G01 Z-2",
        "G02 X0 Y10 R10",
        "G00 X40",
        "M98 P1000 L2",
        "G53 X-90",
    ] {
        assert!(
            converted.text.lines().any(|one| one.contains(line)),
            "{line}: {}",
            converted.text
        );
    }
    let (_, check) = check_source(converted.text.as_str(), nj(), &CheckContext::default());
    assert!(!check.has_errors(), "{:?}", check.diagnostics);
}

#[test]
fn what_of_fanuc_has_no_equal_is_left_out_with_its_reason() {
    for (line, reason) in [
        ("#100 = 5", "`#` is not part of the language. Write Q100 for #100"),
        ("X[#1 + 2]", "`[` is not part of the language. Write one variable"),
        (
            "IF [#1 EQ 2] GOTO 10",
            "`IF` is not a word of this dialect. Write if",
        ),
        ("G51.1", "G51.1 names no axis"),
        ("G91 G51.1 X0", "G51.1 is in G91. Write G90"),
        ("G81 X1. Z-1. R1. K101 F1.", "more than 100 repetitions"),
        ("G65 P9000 A1.", "G65 has no equivalent"),
        ("M06", "M06 has no T"),
        ("G53 G01 Z0 F100", "G53 moves at rapid speed"),
        (
            "G84 Z-5. R2. Q1. F1.",
            "with Q, the thread is cut in steps. Write G84 without Q",
        ),
        ("G84 Z-5. F1.", "a tapping cycle needs Z and R"),
        (
            "G76 Z-5. R2. Q1. F1.",
            "G76 has no equivalent in nj. Write the motions",
        ),
        ("G91 G92 X0", "G92 is in G91. Write G90"),
        ("G92", "G92 names no axis"),
        (
            "G92 Z0",
            "G92 depends on the position of the tool, and its Z is unknown",
        ),
        ("G51 X0 Y0 P2000", "P2000 is in steps"),
        ("G51 X0 Y0", "G51 has no factor"),
        ("G68 X0 Y0", "the block has no angle R"),
        ("G68 X0 Y0 Z0 I0 J0 K1 R30", "I, J and K select an axis in space"),
        (
            "G68 X0 Y0 R400",
            "R400 (angle, counter-clockwise) is out of its range",
        ),
        (
            "G81 Z-1. R1. M98 P1000",
            "the positions in the subprogram are holes",
        ),
        ("M98 P100", "the number of a subprogram"),
    ] {
        let converted = convert(&format!("{line}\nM30\n"), Source::Fanuc, &NcOptions::default());
        let told: Vec<_> = converted
            .left
            .iter()
            .map(|left| (left.line, left.text.as_str()))
            .collect();
        assert_eq!(told, [(1, line)], "{:?}", converted.left);
        let why = &converted.left[0].reason;
        assert!(why.starts_with(reason), "{why}");
    }
}

#[test]
fn calls_by_p_and_block_skip_numbers_are_converted_unchanged() {
    let text = "G21 G90\nM98 P31001\nM98 P1002 L2\nG01 X5. F100\n/2 X6.\n/ /3 X7.\nM30\n";
    let converted = convert(text, Source::Fanuc, &NcOptions::default());
    assert_eq!(converted.left, []);
    has_lines(
        &converted.text,
        &["M98 P1001 L3", "M98 P1002 L2", "/2 G01 X6", "/ /3 G01 X7"],
    );
}

/// Returns a few blocks for a FANUC control, and blocks of dialect dgshape with the same motion.
fn twins(random: &mut Random) -> (String, String) {
    #[expect(clippy::cast_precision_loss, reason = "at most 9000")]
    let mut length = |from, to| format!("{:.3}", random.thousandths(from, to) as f64 / 1000.0);
    let (x, y, z) = (length(-9, 9), length(-9, 9), length(4, 9));
    let tool = 1 + random.below(2);
    match random.below(8 + SHAPES) {
        0 => (
            format!("G00X{x}Y{y}Z{z}; over (the) part\n"),
            format!("G00X{x}Y{y}Z{z}\n"),
        ),
        1 => (
            format!("G94G91.1G64G01X{x}F300;\n;\nY{y}(;)\n"),
            format!("G01X{x}F300.\nY{y}\n"),
        ),
        2 => (
            format!("T{tool}\nG01X{x}F200\nM06\nG43H{tool}Z{z}\nG49Z{z}\n"),
            format!("G01X{x}F200.\nM06T{tool}\nG43H{tool}Z{z}\nG49Z{z}\n"),
        ),
        3 => (
            format!("T1\nT2 M06\nT{tool}\nM06\nG00X{x}\n"),
            format!("M06T2\nM06T{tool}\nG00X{x}\n"),
        ),
        4 => (
            format!("G91G28Z0\nG90G28X1.\nG00X{x}Y{y}Z{z}\n"),
            // the middle point of a G28 there is that of its axes, and of earlier ones
            format!("G53Z100.\nG00X1.\nG53X-90.\nG00X{x}Y{y}Z{z}\n"),
        ),
        5 => (
            format!("M03S1000\nG00Z9\nG99G81X{x}Y{y}Z-3R2.F100\nY{x}\nG80\nG00X1Z{z}\n"),
            format!("M03S1000\nG00Z9.\nG99G81X{x}Y{y}Z-3.R2.F100.\nY{x}\nG80\nG00X1.Z{z}\n"),
        ),
        6 => (
            format!("G52X2Y-1\nG00X{x}Y{y}\nG52X0Y0\nG00X{x}Y{y}\n"),
            format!("G10L2P0X2.Y-1.\nG00X{x}Y{y}\nG10L2P0X0Y0\nG00X{x}Y{y}\n"),
        ),
        7 => (
            "G50G69G91G02X5Y0R4F300G61\nG64G03X-5.I-2.5\nG90G00\n".to_owned(),
            "G91G02X5.Y0R4.F300.\nG03X-5.I-2.5\nG90G00\n".to_owned(),
        ),
        shape => shapes(shape - 8, [&x, &y, &z]),
    }
}

/// Forms of [`shapes`].
const SHAPES: i64 = 6;

/// Blocks that dialect dgshape writes in a different form.
fn shapes(shape: i64, [x, y, z]: [&str; 3]) -> (String, String) {
    let number = |text: &str| text.parse::<f64>().unwrap();
    match shape {
        0 => (
            format!("G00X{x}Y{y}Z{z}\nG92X1Y2Z3\nG00X{y}Y{x}\nG52X2\nG00X{x}\nG52X0\nG00X1\n"),
            format!("G00X{x}Y{y}Z{z}\nG92X1.Y2.Z3.\nG00X{y}Y{x}\nG10L2P0X2.\nG00X{x}\nG10L2P0X0\nG00X1.\n"),
        ),
        1 => {
            // a quarter of a turn about X1 Y2 leads from X, Y to 3 - Y, 1 + X
            let (turned_y, turned_x) = (1.0 + number(x), 3.0 - number(y));
            (
                format!("G17G68X1Y2R90\nG00X{x}Y{y}\nG01X{y}F200\nG91X1Y2\nG90G69\nG00X{x}Y{y}Z{z}\n"),
                format!(
                    "G00X{turned_x:.3}Y{turned_y:.3}\nG01Y{:.3}F200.\nG91X-2.Y1.\nG90\nG00X{x}Y{y}Z{z}\n",
                    1.0 + number(y)
                ),
            )
        }
        2 => (
            format!("M03S1000\nG00Z9\nG98G73X{x}Y{y}Z-5R2Q3F100\nG80\nG00X1Z{z}\n"),
            // each cut begins half a millimetre above the last depth
            format!(
                "M03S1000\nG00Z9.\nG00X{x}Y{y}\nZ2.\nG01Z-1.F100.\nG00Z-.5\nG01Z-4.\nG00Z-3.5\nG01Z-5.\nG00Z9.\nX1.Z{z}\n"
            ),
        ),
        3 => {
            // X is mirrored about 1, then Y about 2 as well, then Y alone
            let (mirrored_x, mirrored_y) = (2.0 - number(x), 4.0 - number(y));
            (
                format!(
                    "G51.1X1\nG00X{x}Y{y}\nG02X{x}Y{y}I3F200\nG51.1Y2\nG00X{x}Y{y}\nG50.1X0\nX{x}Y{y}\nG50.1Y0\nG00X{x}Y{y}Z{z}\n"
                ),
                format!(
                    "G00X{mirrored_x:.3}Y{y}\nG03X{mirrored_x:.3}Y{y}I-3.F200.\nG00Y{mirrored_y:.3}\nX{x}\nG00Y{y}Z{z}\n"
                ),
            )
        }
        4 => (
            format!("M03S1000\nG00Z9\nG91G99G81X1Y-1Z-3R-2F99L3\nX2L0\nX-2L2\nG80\nG90G00X0Z{z}\n"),
            format!("M03S1000\nG00Z9.\nG91G99G81X1.Y-1.Z-3.R-2.F99.K3\nX-2.K2\nG80\nG90G00X0Z{z}\n"),
        ),
        _ => (
            format!("G09G01X{x}F300\nG91G30P2Z0\nG90G00X{x}Y{y}Z{z}\n"),
            format!("G01X{x}F300.\nG53Z0\nG00X{x}Y{y}Z{z}\n"),
        ),
    }
}

#[test]
fn programs_of_fanuc_made_at_random_move_as_their_twins_of_dgshape() {
    let mut random = Random(0x0c0d_e000_0000_0002);
    for _ in 0..300 {
        let (mut of_fanuc, mut twin) = (String::new(), String::new());
        for _ in 0..=random.below(6) {
            let (blocks, moving_equally) = twins(&mut random);
            of_fanuc += &blocks;
            twin += &moving_equally;
        }
        let head = "%\nO0001(a)\nG21G90\nG54G00X0Y0Z10.\n";
        // these programs end with their text, too
        let of_fanuc = format!("{head}{of_fanuc}M05\n%\n");
        let converted = convert(&of_fanuc, Source::Fanuc, &NcOptions::default());
        assert_eq!(converted.left, [], "{of_fanuc}");
        moves_equally(&format!("{head}{twin}M05\nM30\n%\n"), &converted);
    }
}

#[test]
fn threads_of_fanuc_are_tapped_at_the_same_places_to_the_same_depths() {
    let mut random = Random(0x0c0d_e000_0000_0003);
    for _ in 0..50 {
        // eighths, whose sums are exact
        #[expect(clippy::cast_precision_loss, reason = "at most 72")]
        let mut length = |from: i64, to: i64| (from * 8 + random.below((to - from) * 8 + 1)) as f64 / 8.0;
        let (x, y, z, r) = (length(-9, 9), length(-9, 9), length(-9, -2), length(1, 3));
        let head = "G21 G90 G54\nS500 M03\nG00 X0 Y0 Z10\n";
        // from Z10 in G91: R counts from there, Z from R
        let of_fanuc = format!(
            "{head}M29 S400\nG99 G84 X{x} Y{y} Z{z} R{r} P300 F500\nX{y}\nG98 Y{x}\nG80\nG91 G98 G74 X1. Z{:.3} R{:.3}\nG90 G00 X0\n",
            z - r,
            r - 10.0
        );
        let by_hand = format!(
            "G500 ta0 td0 ts0\n{head}S400\nG99 G84 X{x} Y{y} Z{z} R{r} P300 F500\nX{y}\nG98 Y{x}\nG80\nG98 G74 X{:.3} Z{z} R{r} P0\nG00 X0\nM30\n",
            y + 1.0
        );
        let converted = convert(&of_fanuc, Source::Fanuc, &NcOptions::default());
        assert_eq!(converted.left, [], "{of_fanuc}");
        let config = MACHINE.replace("dialect = \"dgshape\"\n", "");
        let done = |text: &str| steps(text, nj(), &machine_settings(&config)).unwrap();
        assert_eq!(done(&converted.text), done(&by_hand), "{}", converted.text);
    }
}

#[test]
fn spindle_on_before_tapping_is_on_after_it_where_the_source_does_so() {
    let text = "G90 G00 X0 Y0 Z10\nS500 M03\nG98 G84 X1 Z-5 R2 F500\nG80\nG01 X5\n";
    let converted = convert(text, Source::Fanuc, &NcOptions::default());
    assert_eq!(converted.left, []);
    let lines: Vec<&str> = converted.text.lines().skip(3).collect();
    assert_eq!(
        lines,
        [
            "F500 G98 G84 X1 Z-5 R2 P0 K1",
            "G80 M03",
            "G01 X5",
            "M30 // the text ends"
        ]
    );
    let rigid = convert(
        &text.replace("G98 G84", "M29 G98 G84"),
        Source::Fanuc,
        &NcOptions::default(),
    );
    let starts = |text: &str| text.lines().filter(|line| line.contains("M03")).count();
    assert_eq!((starts(&converted.text), starts(&rigid.text)), (2, 1));
}

#[test]
fn coordinates_of_g92_and_g52_add_up_and_g92_ends_g52() {
    let text = "G90 G00 X10\nG52 X4\nX1\nG92 X0\nX2\nG52 X0\nG52 X1\n";
    let converted = convert(text, Source::Fanuc, &NcOptions::default());
    assert_eq!(converted.left, []);
    let lines: Vec<&str> = converted.text.lines().skip(2).collect();
    // X1 on top of 4 is 5, and 0 from there on
    let expected = [
        "G52 X4",
        "G00 X1",
        "G52 X5",
        "G00 X2",
        "G52 X5",
        "G52 X6",
        "M30 // the text ends",
    ];
    assert_eq!(lines, expected);
}

#[test]
fn fanuc_subprogram_and_block_after_a_call_keep_the_modal_state() {
    let subprogram = "O1000\nX5\nG91 G01 Y2 F100\nG90\nM99\n";
    let converted = convert(subprogram, Source::Fanuc, &NcOptions::default());
    assert_eq!(converted.left, []);
    assert_eq!(converted.text, "// O1000\nX5\nG91 F100 G01 Y2\nG90\nM99\n");
    let main = "G90 G00 X1\nM98 P1000\nX2\nG81 Z-1 R1 F100\nM30\n";
    let converted = convert(main, Source::Fanuc, &NcOptions::default());
    let told: Vec<u32> = converted.left.iter().map(|left| left.line).collect();
    assert_eq!(told, [4], "G90 or G91: {:?}", converted.left);
    assert!(converted.text.contains("M98 P1000\nX2\n"), "{}", converted.text);
}

#[test]
fn a_tool_that_is_called_before_its_change_stands_as_a_comment() {
    let converted = convert(
        "G21 T3 ; next\nG00 X1\nM06 T4\nM30\n",
        Source::Fanuc,
        &NcOptions::default(),
    );
    assert_eq!(converted.left, []);
    has_lines(
        &converted.text,
        &["G21 // next T3 is called", "G00 X1", "M06 VA4"],
    );
}

#[test]
fn unconvertible_program_of_50000_lines_converts_within_20_s() {
    let text = "G05 P10000\n".repeat(50_000);
    let begun = std::time::Instant::now();
    let converted = convert(&text, Source::Fanuc, &NcOptions::default());
    assert!(converted.left.len() >= 1000);
    assert!(begun.elapsed().as_secs() < 20, "{:?}", begun.elapsed());
}

#[test]
fn no_text_makes_convert_panic_or_leaves_something_unsaid() {
    let corpus = [
        "%\nO1\nG81Z-1.R1.\nX1\nG80\n%\nrest",
        "G91G83Z-5R-1Q.001K99\n",
        "((\n)X\nM6\nM6T1T2\nG43\nN\n/",
        "\u{feff}G0X1\u{e4}\r\n",
    ];
    let mut random = Random(77);
    for round in 0..3000_usize {
        let mut text: Vec<char> = corpus[round % corpus.len()].chars().collect();
        for _ in 0..random.below(6) {
            let at = usize::try_from(random.below(i64::try_from(text.len()).unwrap() + 1)).unwrap();
            let piece = ["G", "M06", "(", ")", "\n", "X1.", "/", "%", "K0", "T9", "9", "-"];
            let piece = piece[usize::try_from(random.below(12)).unwrap()];
            text.splice(at..at, piece.chars());
        }
        let text: String = text.into_iter().collect();
        for from in [Source::Dgshape, Source::Fanuc] {
            let converted = convert(&text, from, &NcOptions::default());
            assert!(converted.left.is_sorted_by_key(|left| left.line), "{text:?}");
            let (_, check) = check_source(converted.text.as_str(), nj(), &CheckContext::default());
            assert!(!check.has_errors() || !converted.left.is_empty(), "{text:?}");
        }
    }
}

#[test]
fn convert_writes_the_program_tells_what_is_left_and_ends_with_1() {
    let machine = Machine::new("");
    machine.write("old.nc", "%\nO1 (one)\nG90 G00 X1.\nG92 Y0\nM30\n%\n");
    let arguments = [
        "convert", "old.nc", "--from", "dgshape", "--to", "nj", "-o", "new.nc",
    ];
    let ran = run(machine.folder(), &arguments);
    assert_eq!((ran.code, ran.stdout.as_str()), (1, ""));
    assert!(
        ran.stderr.contains("old.nc:4: not converted: G92 Y0\n  "),
        "{}",
        ran.stderr
    );
    let new = fs::read_to_string(machine.path("new.nc")).unwrap();
    assert!(new.contains("G90 G00 X1\n// not converted: G92 Y0\n"), "{new}");
    let ran = run_with(
        machine.folder(),
        &["convert", "-", "--from", "fanuc"],
        "G00 X1.\nM30\n",
    );
    assert_eq!((ran.code, ran.stderr.as_str()), (0, ""));
    assert!(ran.stdout.contains("\nG00 X1\nM30\n"), "{}", ran.stdout);
    let ran = run(
        machine.folder(),
        &["convert", "old.nc", "--from", "dgshape", "-o", "old.nc"],
    );
    assert_eq!(ran.code, 2);
    assert!(ran.stderr.contains("would replace the program"), "{}", ran.stderr);
}

#[test]
fn convert_reads_the_first_system_of_the_dialect_of_the_source() {
    let machine = Machine::new("dialect = \"dgshape\"\n[coordinate_system.dgshape]\ncalculator = \"all\"\n");
    machine.write("old.nc", "%\nG90\nG04X2\nM30\n%\n");
    let ran = run(
        machine.folder(),
        &[
            "convert",
            "old.nc",
            "--from",
            "dgshape",
            "--config",
            "tandem.toml",
        ],
    );
    assert_eq!((ran.code, ran.stderr.as_str()), (0, ""));
    assert!(ran.stdout.contains("G04 X2\n"), "{}", ran.stdout);
}
