//! Parsing: one test for each rule, by a table of text and finding.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use tandem_model::limits::PROGRAM_BYTES_MAX;
use tandem_syntax::{
    Address, DIAGNOSTICS_MAX, Expression, ExpressionId, Grammar, LineIndex, NcProgram, ProgramCode,
    Statement, Value, Variable, VariableKind, parse,
};

/// Returns all findings as `line:column code`.
fn findings(source: &str) -> Vec<String> {
    let (_, diagnostics) = parse(source, Grammar::nj());
    let index = LineIndex::new(source);
    diagnostics
        .iter()
        .map(|finding| {
            let (line, column) = index.locate(finding.span.start);
            format!("{line}:{column} {}", finding.code)
        })
        .collect()
}

fn check(source: &str, expect: &[&str]) {
    assert_eq!(findings(source), expect, "{source:?}");
}

/// Returns a text without errors as `line: /skips words`, one string for each block.
fn blocks(source: &str) -> Vec<String> {
    check(source, &[]);
    let (program, _) = parse(source, Grammar::nj());
    program
        .blocks()
        .iter()
        .map(|block| {
            let skips: Vec<String> = (1..=31)
                .filter(|number| block.skip_numbers() & (1 << (number - 1)) != 0)
                .map(|number| format!("/{number} "))
                .collect();
            let words: Vec<String> = program
                .words(block)
                .iter()
                .map(|word| match word.value() {
                    Value::Number(value) => format!("{}{value}", word.address.text()),
                    Value::Indirection(variable) => {
                        format!(
                            "{}[{}{}]",
                            word.address.text(),
                            variable.kind.prefix(),
                            variable.index
                        )
                    }
                })
                .collect();
            let code = program.program_code(block).map(|code| code_text(&program, code));
            format!(
                "{}: {}{}{}",
                block.line,
                skips.concat(),
                words.join(" "),
                code.unwrap_or_default()
            )
        })
        .collect()
}

fn code_text(program: &NcProgram, code: &ProgramCode) -> String {
    let value = code
        .expression
        .map_or_else(String::new, |id| expression_text(program, id));
    let to = code.to.map_or_else(String::new, |to| format!("->{to}"));
    match code.statement {
        Statement::Assignment(target) => format!("{}={value}", variable_text(target)),
        Statement::If => format!("if {value} {to}"),
        Statement::Else => format!("else {to}"),
        Statement::While => format!("while {value} {to}"),
        Statement::Repeat => format!("repeat {to}"),
        Statement::Do => "do".to_owned(),
        Statement::DoWhile => format!("until {value} {to}"),
        Statement::Switch { first, count } => {
            let cases: Vec<_> = (-9..=9)
                .filter_map(|label| Some(format!("{label}->{}", program.case(first, count, label)?)))
                .collect();
            format!("switch {value} {} {to}", cases.join(" "))
        }
        Statement::Case { label } => format!("case {label}"),
        Statement::Default => "default".to_owned(),
        Statement::Break => format!("break {to}"),
        Statement::Open => "{".to_owned(),
        Statement::Close => "}".to_owned(),
    }
}

fn variable_text(variable: Variable) -> String {
    format!("{}{}", variable.kind.prefix(), variable.index)
}

fn expression_text(program: &NcProgram, id: ExpressionId) -> String {
    let text = |id| expression_text(program, id);
    match *program.expression(id).unwrap() {
        Expression::Number(value) => value.to_string(),
        Expression::Variable(variable) => variable_text(variable),
        Expression::Negation(operand) => format!("(-{})", text(operand)),
        Expression::Binary {
            operator,
            left,
            right,
        } => {
            format!("({}{}{})", text(left), operator.text(), text(right))
        }
        Expression::Not(condition) => format!("!{}", text(condition)),
        Expression::Call {
            function,
            first,
            second,
        } => match second {
            Some(second) => format!("{}({},{})", function.text(), text(first), text(second)),
            None => format!("{}({})", function.text(), text(first)),
        },
    }
}

#[test]
fn d01_letters_are_read_without_regard_to_case() {
    assert_eq!(
        blocks("g01 x1 TA5 td6 tS7 va8 vH9\nif(l1==1){m30}"),
        [
            "1: G1 X1 ta5 td6 ts7 VA8 VH9",
            "2: if (L1==1) ->5",
            "2: {",
            "2: M30",
            "2: }"
        ]
    );
}

#[test]
fn d01_leading_zeros_mean_nothing_and_decimal_codes_are_their_own() {
    assert_eq!(blocks("G01 G001 G50.1"), ["1: G1 G1 G50.1"]);
}

#[test]
fn words_need_no_blanks_between_them() {
    assert_eq!(
        blocks("N10G01X1Y-2.5Z.5F5.ta100VA+1"),
        ["1: N10 G1 X1 Y-2.5 Z0.5 F5 ta100 VA1"]
    );
}

#[test]
fn blanks_may_stand_between_address_and_value() {
    assert_eq!(blocks("X 10 Y\t20"), ["1: X10 Y20"]);
}

#[test]
fn comments_of_both_forms_are_blanks() {
    assert_eq!(
        blocks("// head\nX1 // to the end /* of the line\n/* over\nseveral */ Y2 /* inside */ Z3\n"),
        ["2: X1", "4: Y2 Z3"]
    );
    assert_eq!(blocks("X1 /* a\n b */ Y2"), ["1: X1 Y2"]);
    check("X1\n /* open\nX2", &["2:2 E0004"]);
}

#[test]
fn empty_and_comment_lines_have_no_block() {
    assert_eq!(blocks("\n  \n// a\n\t/* b */\n").len(), 0);
}

#[test]
fn carriage_returns_tabs_and_byte_order_mark_are_no_words() {
    assert_eq!(blocks("\u{feff}G01 X1\r\n\tX2\r\n"), ["1: G1 X1", "2: X2"]);
}

#[test]
fn d13_block_skip_numbers_stand_at_the_beginning_of_the_line() {
    assert_eq!(
        blocks("/1 N03 X10\n/ Y1\n/1/2 X-20\n/31X3"),
        ["1: /1 N3 X10", "2: /1 Y1", "3: /1 /2 X-20", "4: /31 X3"]
    );
    check("/0 X1", &["1:1 E0008"]);
    check("/32 X1", &["1:1 E0008"]);
    check("/1/99999999999 X1", &["1:3 E0008"]);
    check("N10 /1 X1", &["1:5 E0009"]);
    check("X1 / Y2", &["1:4 E0009"]);
}

#[test]
fn d13_block_skip_before_a_program_code_is_an_error() {
    check("/1 L1=5", &["1:1 E0017"]);
    check("/2 if(L1==1){X1}", &["1:1 E0017"]);
}

#[test]
fn d02_the_block_number_stands_first() {
    check("X1 N10", &["1:4 E0010"]);
    check("N10 N20 X1", &["1:5 E0010"]);
}

#[test]
fn block_numbers_can_be_asked_for() {
    let (program, _) = parse("N0010 X1\nX2\n/1 N20 X3\nN1.5 X4", Grammar::nj());
    let numbers: Vec<_> = program
        .blocks()
        .iter()
        .map(|block| program.block_number(block))
        .collect();
    assert_eq!(numbers, [Some(10), None, Some(20), None]);
}

#[test]
fn d03_a_block_of_more_than_1020_bytes_is_an_error() {
    let fits = format!("X1{} Y1", " ".repeat(1020 - 5));
    assert_eq!(fits.len(), 1020);
    check(&fits, &[]);
    check(&format!("X1{} Y1", " ".repeat(1020 - 4)), &["1:1020 E0011"]);
    check(&format!("X1 /*{}*/ Y1", "c".repeat(2000)), &[]);
    check(&format!("{}\nX1", "X1 ".repeat(3000)), &["1:1021 E0011"]);
    check(&format!("L1=1{}", "+1".repeat(3000)), &["1:1022 E0011"]);
}

#[test]
fn d04_an_indirection_names_one_variable() {
    assert_eq!(
        blocks("X[L12] Y[ q34 ] VA[_cnc_CapturedPosition2] P[P0]"),
        ["1: X[L12] Y[Q34] VA[_CNC_CapturedPosition2] P[P0]"]
    );
    for text in [
        "X[L1+1] Y1",
        "X[] Y1",
        "X[12] Y1",
        "X[L] Y1",
        "X[sin(1)] Y1",
        "X[L-1] Y1",
    ] {
        check(text, &["1:1 E0012"]);
    }
    check("X[L1\nY1", &["1:1 E0012"]);
    check("X[L256]", &["1:1 E0013"]);
    check("X[Q4096] Y[P32768]", &["1:1 E0013", "1:10 E0013"]);
    check("X[_CNC_CapturedPosition8]", &["1:1 E0013"]);
}

#[test]
fn d04_the_four_forms_of_indirection_in_program_codes_are_errors() {
    check("P[P++]", &["1:1 E0012"]);
    check("P[P0]=P1", &["1:1 E0012"]);
    check("P0=P[P1]", &["1:4 E0012"]);
}

#[test]
fn words_that_are_wrong_are_one_error_each_and_the_rest_is_read() {
    check("G01 X Y10", &["1:5 E0005"]);
    check("G01 XY10", &["1:5 E0005"]);
    check("G01 X1.2.3 Y--4 Z1", &["1:5 E0006", "1:12 E0006"]);
    check("X- Y1", &["1:1 E0006"]);
    check("F\u{e4}5 X1", &["1:2 E0003"]);
    check("X = 5 Y1", &["1:3 E0003"]);
    check("X1 = 5 Y1", &["1:4 E0003"]);
    check("GOTO 10", &["1:1 E0007"]);
    check("W10 T5 X1", &["1:1 E0007", "1:5 E0007"]);
    check("GOTO10", &["1:1 E0007"]);
    check("tx5", &["1:1 E0007"]);
    check("O1000\nX1", &["1:1 E0007"]);
    check("X1 5 Y2", &["1:4 E0003"]);
    check("X1,5 Y2", &["1:3 E0003"]);
    check(&format!("X{}", "9".repeat(400)), &["1:1 E0019"]);
    let (program, _) = parse("G01 X Y10", Grammar::nj());
    let words = program.words(&program.blocks()[0]);
    assert_eq!(
        words.iter().map(|word| word.address).collect::<Vec<_>>(),
        [Address::G, Address::Y]
    );
    assert!(program.blocks()[0].has_errors());
}

#[test]
fn characters_outside_the_language_are_shown() {
    for (text, shown) in [
        ("X1 ä", "`ä`"),
        ("X1 \0", "`\\u{0}`"),
        ("X1 \u{7f}", "`\\u{7f}`"),
        ("X1 #", "`#`"),
    ] {
        let (_, diagnostics) = parse(text, Grammar::nj());
        assert_eq!(diagnostics.len(), 1, "{text:?}");
        assert_eq!(diagnostics[0].code, "E0003");
        assert!(
            diagnostics[0].message.contains(shown),
            "{}",
            diagnostics[0].message
        );
    }
    check(
        "%\nX1 // ä\n(comment of another dialect)\n",
        &["1:1 E0003", "3:1 E0003"],
    );
}

#[test]
fn assignments_parse_into_the_tree() {
    assert_eq!(
        blocks("N03 L12=10 Q34 = 20 P5=-L1\nL1 = P3 + 2*sin(30)"),
        ["1: L12=10", "1: Q34=20", "1: P5=(-L1)", "2: L1=(P3+(2*sin(30)))"]
    );
}

#[test]
fn operators_combine_by_priority_and_from_the_left() {
    assert_eq!(
        blocks("L1=1-2-3\nL1=1+2*3%4/5\nL1=-7%3\nL1=(1+2)*-3\nL1=+1\nL1=atan2d(L1, Q2)/log10(P3)"),
        [
            "1: L1=((1-2)-3)",
            "2: L1=(1+(((2*3)%4)/5))",
            "3: L1=((-7)%3)",
            "4: L1=((1+2)*(-3))",
            "5: L1=1",
            "6: L1=(atan2d(L1,Q2)/log10(P3))"
        ]
    );
}

#[test]
fn expressions_that_are_wrong_are_one_error_each() {
    for (text, place) in [
        ("L1=", "1:4"),
        ("L1=2*(3+", "1:9"),
        ("L1=2*(3+4", "1:6"),
        ("L2=+L1", "1:4"),
        ("L1=foo(3)", "1:4"),
        ("L1=sin 3", "1:4"),
        ("L1=pow(3)", "1:4"),
        ("L1==2", "1:4"),
        ("L1=.", "1:4"),
    ] {
        check(text, &[&format!("{place} E0014")]);
    }
    check("L256=1", &["1:1 E0013"]);
    check("L1=Q4096", &["1:4 E0013"]);
    check("L1.5=1", &["1:1 E0013"]);
    check("G01 L1=5 X10", &["1:5 E0018"]);
    check("L1=5 X10", &["1:6 E0018"]);
}

#[test]
fn nesting_has_a_limit() {
    check(&format!("L1={}1{}", "(".repeat(63), ")".repeat(63)), &[]);
    check(
        &format!("L1={}1{}", "(".repeat(64), ")".repeat(64)),
        &["1:68 E0015"],
    );
    check(&format!("L1={}1", "-".repeat(900)), &["1:68 E0015"]);
}

#[test]
fn branches_lie_flat_and_tell_where_the_program_goes_on() {
    assert_eq!(
        blocks("N05 if (Q0==1) {X10}\nX1"),
        ["1: if (Q0==1) ->4", "1: {", "1: X10", "1: }", "2: X1"]
    );
    assert_eq!(
        blocks("if(L1==1)\n X1\nelse {\n X2\n}\nX3"),
        [
            "1: if (L1==1) ->3",
            "2: X1",
            "3: else ->6",
            "3: {",
            "4: X2",
            "5: }",
            "6: X3"
        ]
    );
    assert_eq!(
        blocks("if(L1<1) X1 else if(L1<2) X2 else X3\nX4"),
        [
            "1: if (L1<1) ->3",
            "1: X1",
            "1: else ->7",
            "1: if (L1<2) ->6",
            "1: X2",
            "1: else ->7",
            "1: X3",
            "2: X4"
        ]
    );
}

#[test]
fn repetitions_go_back_to_their_condition_or_head() {
    assert_eq!(
        blocks("while(L1<3)\n{\n L1=L1+1\n break\n}\nX2"),
        [
            "1: while (L1<3) ->6",
            "2: {",
            "3: L1=(L1+1)",
            "4: break ->6",
            "5: }",
            "5: repeat ->0",
            "6: X2"
        ]
    );
    assert_eq!(
        blocks("do { X4 } while(L1<2)\nX5\ndo X1 while(L1<2)"),
        [
            "1: do",
            "1: {",
            "1: X4",
            "1: }",
            "1: until (L1<2) ->1",
            "2: X5",
            "3: do",
            "3: X1",
            "3: until (L1<2) ->7"
        ]
    );
}

#[test]
fn a_branch_without_braces_takes_one_command() {
    assert_eq!(
        blocks("if(L1==1) L2=3 L3=4\nwhile(L1==1) X1 Y2"),
        [
            "1: if (L1==1) ->2",
            "1: L2=3",
            "1: L3=4",
            "2: while (L1==1) ->6",
            "2: X1 Y2",
            "2: repeat ->3"
        ]
    );
}

#[test]
fn d10_a_switch_knows_its_cases() {
    assert_eq!(
        blocks("switch(L1){case 2: X1 break case -1: X2\ndefault: X3\n}\nM30"),
        [
            "1: switch L1 -1->5 2->2 ->7",
            "1: {",
            "1: case 2",
            "1: X1",
            "1: break ->10",
            "1: case -1",
            "1: X2",
            "2: default",
            "2: X3",
            "3: }",
            "4: M30"
        ]
    );
    check("switch(L1){case 1: X1 case 1: X2}", &["1:23 E0023"]);
    check("switch(L1){default: X1 default: X2}", &["1:24 E0023"]);
    check("switch(L1){case 1.5: X1}", &["1:12 E0023", "1:18 E0003"]);
    check("case 1: X1", &["1:1 E0020", "1:6 E0003"]);
}

#[test]
fn d09_conditions_and_numbers_are_told_apart() {
    assert_eq!(
        blocks("if(L1<1&&L2>=2||!(L3!=4)&&isnan(L5)) X1")[0],
        "1: if (((L1<1)&&(L2>=2))||(!(L3!=4)&&isnan(L5))) ->2"
    );
    assert_eq!(
        blocks("if((L1+1)*2==(3)) X1\nL1=isnan(L2)")[..1],
        ["1: if (((L1+1)*2)==3) ->2"]
    );
    for text in [
        "if(L1) X1",
        "L1=(L2==3)",
        "if(L1<2<3) X1",
        "if((L1<2)==(L2<3)) X1",
        "if(!(L1)) X1",
        "if(L1==1&&L2) X1",
        "L1=-(L2<3)",
        "switch(L1==2){}",
    ] {
        assert_eq!(findings(text).len(), 1, "{text}");
        assert!(
            findings(text)[0].ends_with("E0021"),
            "{text}: {:?}",
            findings(text)
        );
    }
    check("if(!L1==1) X1", &["1:5 E0014"]);
}

#[test]
fn d13_block_skip_stands_at_the_beginning_of_a_line_within_braces_too() {
    check("if(L1==1){\n/1 X1\n}", &[]);
    check("if(L1==1){ /1 X1\n}", &["1:12 E0009"]);
}

#[test]
fn program_codes_out_of_place_are_one_error_each() {
    check("else X1\nX2", &["1:1 E0020"]);
    check("break", &["1:1 E0020"]);
    check("if(L1==1){X1\nX2\nM30", &["1:10 E0016"]);
    check("if(L1==1 X1\nX2", &["1:3 E0014"]);
    check("X1 }\nX2", &["1:4 E0016"]);
    check("G01 if(L1==1){X1}", &["1:5 E0018"]);
    check("if(L1==1)", &["1:1 E0022"]);
    check("while(L1==1){}\nif(L1==1) }", &["2:1 E0022", "2:11 E0016"]);
    check("do X1\nX2", &["1:1 E0022"]);
    check("switch(L1) X1", &["1:1 E0022"]);
    check("if(L1==1){ L1= }\nX1 X2", &["1:16 E0014"]);
}

#[test]
fn branches_nest_64_deep() {
    check(&format!("{}X1", "if(L1==1) ".repeat(64)), &[]);
    check(&format!("{}X1", "if(L1==1) ".repeat(65)), &["1:651 E0015"]);
    check(&format!("if(L1==1) X1{}", " else if(L1==1) X1".repeat(500)), &[]);
}

#[test]
fn all_errors_come_at_once_and_their_number_has_a_limit() {
    check("X\nG01 Y1\nW1\nX1 N1", &["1:1 E0005", "3:1 E0007", "4:4 E0010"]);
    let (_, diagnostics) = parse("X\n".repeat(5000), Grammar::nj());
    assert_eq!(diagnostics.len(), DIAGNOSTICS_MAX + 1);
    assert_eq!(diagnostics[DIAGNOSTICS_MAX].code, "E0002");
}

#[test]
fn a_program_of_more_than_64_mib_is_not_read() {
    let (program, diagnostics) = parse(" ".repeat(PROGRAM_BYTES_MAX + 1), Grammar::nj());
    assert_eq!(diagnostics.len(), 1);
    assert_eq!(diagnostics[0].code, "E0001");
    assert!(program.blocks().is_empty());
}

#[test]
fn origins_count_lines_and_columns_in_characters() {
    let (program, _) = parse("\u{feff}/1 X1\n/* ä */ N5 X2\r\n  X3", Grammar::nj());
    let places: Vec<(u32, u32)> = program
        .blocks()
        .iter()
        .map(|block| {
            let origin = program.origin(block, 7);
            assert_eq!(origin.program, 7);
            (origin.line, origin.column)
        })
        .collect();
    assert_eq!(places, [(1, 1), (2, 9), (3, 3)]);
}

#[test]
fn spans_reach_from_the_first_to_the_last_byte() {
    let source = "  /1 G01 X[L1]  // c";
    let (program, _) = parse(source, Grammar::nj());
    let block = &program.blocks()[0];
    let span = program.span(block);
    assert_eq!(&source[span.start as usize..span.end as usize], "/1 G01 X[L1]");
    let word = program.words(block)[1].span();
    assert_eq!(&source[word.start as usize..word.end as usize], "X[L1]");
    assert_eq!(
        program.words(block)[1].value(),
        Value::Indirection(Variable {
            kind: VariableKind::Local,
            index: 1
        })
    );
}

#[test]
fn a_program_code_stands_on_the_line_where_it_begins() {
    let lines = |source: &str| {
        let (program, _) = parse(source, Grammar::nj());
        program
            .blocks()
            .iter()
            .map(|block| block.line)
            .collect::<Vec<_>>()
    };
    assert_eq!(lines("X1\nL1=/*\n*/2\nX2"), [1, 2, 4]);
    assert_eq!(lines("if(L1==/*\n*/1)\nX1"), [1, 3]);
    // what could not be read, too
    assert_eq!(lines("G01 X1\nif(\nif(1==1\n\n")[..2], [1, 2]);
    assert_eq!(lines("L1=(\nX1"), [1, 2]);
}

#[test]
fn a_captured_position_may_have_its_index_in_parentheses() {
    check(
        "L1=_CNC_CapturedPosition(2)+1\nX[_CNC_CapturedPosition(7)] Y[_cnc_capturedposition0]",
        &[],
    );
    check("X[_CNC_CapturedPosition(8)]", &["1:1 E0013"]);
    check("X[_CNC_CapturedPosition(2]", &["1:1 E0012"]);
}

#[test]
fn one_mistake_is_one_finding() {
    check("P0=1e3", &["1:4 E0006"]);
    check("X1e3 Y2\nX1e3.5 Y2", &["1:1 E0006", "2:1 E0006"]);
    check("for(L1=0;L1<3;L1++) {\nX1\n}\nY2", &["1:1 E0007"]);
    check(
        "for (L1=0; L1<3; L1=L1+1)\n{\nX1\nif(L1==1) { X2 }\n}\nY2 Y3",
        &["1:1 E0007"],
    );
}
