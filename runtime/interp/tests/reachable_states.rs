//! The checker follows every state that a run may reach. A fault in all states is an error; a fault in some,
//! a warning.

use std::collections::BTreeMap;
use std::sync::Arc;

use tandem_interp::dialects::{dgshape, nj};
use tandem_interp::{Check, CheckContext, check_source};
use tandem_model::{Axis, AxisSet, Diagnostic};
use tandem_syntax::{LineIndex, parse};

fn told(source: &str, diagnostics: &[Diagnostic]) -> Vec<String> {
    let index = LineIndex::new(source);
    let place = |found: &Diagnostic| index.locate(found.span.start);
    diagnostics
        .iter()
        .map(|found| format!("{}:{} {}", place(found).0, place(found).1, found.code))
        .collect()
}

fn calculating() -> CheckContext<'static> {
    CheckContext {
        calculates: true,
        default_feedrate_mm_min: Some(1000.0),
        ..CheckContext::default()
    }
}

fn of(source: &str) -> (String, Check) {
    let source = format!("{source}\nM30");
    let (_, check) = check_source(source.as_str(), nj(), &calculating());
    (source, check)
}

#[track_caller]
fn finds(source: &str, expect: &[&str]) {
    let (text, check) = of(source);
    assert_eq!(
        told(&text, &check.diagnostics),
        expect,
        "{source}\n{:#?}",
        check.diagnostics
    );
}

/// Returns the message of the only finding.
#[track_caller]
fn message(source: &str) -> String {
    let (_, check) = of(source);
    let [found] = &check.diagnostics[..] else {
        unreachable!("{source}: {:#?}", check.diagnostics)
    };
    found.message.clone()
}

#[test]
fn what_is_wrong_on_all_ways_is_an_error() {
    finds("if(P1==1) G00 X1\nX3 R5", &["2:4 E0108"]);
    finds("if(P1==1) G18\nG02 X10", &["2:5 E0122"]);
    finds(
        "switch(P1){case 1: G90\nbreak\ncase 2: G91\nbreak}\nG01 X1 R5",
        &["5:8 E0108"],
    );
    finds("do X1 while(P1<3)\nX1 I5", &["2:4 E0108"]);
    finds("/1 G91\nX1 R5", &["2:4 E0108"]);
    finds("M98 P1000\nG02 X1", &["2:5 E0122"]);
    for before in ["M98 P1000", "while(P1<1) { X1 }", "if(P1==1) G02 X1 R5"] {
        finds(&format!("{before}\nif(P2==1) M99 P10"), &["2:15 E0108"]);
    }
}

#[test]
fn what_is_wrong_on_some_ways_is_a_warning_that_names_the_way() {
    let cases = [
        (
            "G02 X1 R5\nif(P1==1) G01 X2\nX3 R5",
            "if the condition in line 2 is true",
        ),
        (
            "if(P1==1)\n{\nG02 X1 R5\n}\nX3 R5",
            "if the condition in line 1 is false",
        ),
        (
            "if(P1==1) G02 X1 R5 else G01 X1\nX3 R5",
            "if the condition in line 1 is false",
        ),
        ("G91\nwhile(P1==1) G02 X1 R5\nX3 R5", "after the loop of line 2"),
        (
            "G02 X1 R5\n/2 G01 X3\nX4 R5",
            "if the block in line 2 is not skipped",
        ),
        ("/2 G02 X1 R5\nX4 R5", "if the block in line 1 is skipped"),
        (
            "switch(P1){case 4: G02 X1 R5\nbreak\ndefault: G00 X1}\nX3 R5",
            "if no case in line 1 matches",
        ),
        (
            "G02 X1 R5\nswitch(P1){case 4: G00 X1\nbreak}\nX3 R5",
            "if case 4 in line 2 matches",
        ),
    ];
    for (source, way) in cases {
        let message = message(source);
        assert!(message.contains(way), "{source}\n{message}");
        assert!(message.ends_with("(E0108)"), "{source}\n{message}");
    }
}

#[test]
fn what_belongs_together_stays_together() {
    // both branches leave a state that is valid for the later blocks of that branch
    finds("if(P1==1) { G91\nG00 X1 } else { G90\nG02 X1 R5 }\nG01 X3", &[]);
    finds("L1=0\nif(P1==1) { L1=1\nG02 X1 R5 }\nif(L1==1) { X3 R5 }", &[]);
    finds(
        "L1=0\nif(P1==1) { L1=1\nG02 X1 R5 }\nif(L1==0) { X3 R5 }",
        &["4:16 E0108"],
    );
}

#[test]
fn a_loop_is_followed_turn_by_turn() {
    // the third turn is a full circle by radius; a run is certain to come to it
    finds(
        "G00 X0 Y0\nL2=4\nwhile(L1<3) { G91 G02 X[L2] R5\nL2=4-L1*4\nL1=L1+1 }",
        &["3:29 E0122"],
    );
    finds("L1=0\nwhile(L1<50) { G01 X[L1] F100\nL1=L1+1 }", &[]);
    finds(
        "L1=0 L2=0\nwhile(L1<50) { G01 X[L2] F100\nL2=L2+30000 L1=L1+1 }",
        &["2:20 E0109"],
    );
}

#[test]
fn values_out_of_their_range_are_told() {
    finds("L1=2000000\nX[L1]", &["2:1 E0109"]);
    finds("Q1=2000000\nX[Q1]", &["2:1 E0109"]);
    finds("P1=0-5\nF[P1]", &["2:1 E0109"]);
    finds("L1=5\nM98 P[L1]", &["2:5 E0109"]);
    finds("if(P1>2000000) X[L1] else X[L2]", &[]);
    finds("L1=P1\nif(L1>2000000) { X[L1] }", &["2:18 E0109"]);
    finds("if(P1==1) L1=2000000\nX[L1]", &["2:1 W0009"]);
}

#[test]
fn d11_a_calculated_value_is_an_alarm_of_a_run_and_a_warning_of_a_load() {
    let found = |source: &str| {
        let source = format!("{source}\nM30");
        told(
            &source,
            &check_source(source.as_str(), nj(), &CheckContext::default())
                .1
                .diagnostics,
        )
    };
    assert_eq!(found("L1=2000000\nX[L1]"), ["2:1 W0009"]);
    assert_eq!(found("L1=1/0\nX[L1]"), ["1:1 W0010", "2:1 W0009"]);
    assert_eq!(
        found("L1=2000000\nX[L1] X2 R5"),
        ["2:1 W0009", "2:7 E0105", "2:10 E0108"]
    );
    assert_eq!(found("L1=P1\nif(L1>2000000) { X[L1] }"), ["2:18 W0009"]);
}

#[test]
fn a_value_that_another_program_may_have_written_is_a_warning() {
    finds("P1=2000000\nM100\nX[P1]", &["3:1 W0009"]);
    let message = message("P1=2000000\nM100\nX[P1]");
    assert!(
        message.contains("unless another program has written the variable"),
        "{message}"
    );
    // and no reason to take a way
    finds("P1=0\nM100\nwhile(P1==0) { G04 P100 }\nX1", &[]);
}

#[test]
fn calculations_without_a_result_are_told() {
    finds("L2=1/L1", &["1:1 W0010"]);
    finds("L2=5%(L1*3)", &["1:1 W0010"]);
    finds("L1=sqrt(0-4)", &["1:1 W0010"]);
    finds("L1=sqrt(0-4)\nX[L1]", &["1:1 W0010", "2:1 E0019"]);
    finds("L1=atan2(0,L2)", &["1:1 W0010"]);
    finds("L1=1/P1 L2=sqrt(P2) L3=log(P3)", &[]);
    finds("L1=4\nif(L1!=0) L2=1/L1", &[]);
}

fn with_called(main: &str, called: &[(u16, &str)]) -> (Vec<String>, Vec<(u16, Vec<String>)>) {
    let trees: BTreeMap<_, _> = called
        .iter()
        .map(|(number, text)| (*number, Arc::new(parse(*text, (nj().grammar)()).0)))
        .collect();
    let context = CheckContext {
        programs: Some(&trees),
        ..calculating()
    };
    let (_, check) = check_source(main, nj(), &context);
    let text = |number| {
        called
            .iter()
            .find(|(of, _)| *of == number)
            .map_or("", |(_, text)| text)
    };
    let found = check.called.iter().filter(|(_, of)| !of.diagnostics.is_empty());
    let of_called = found.map(|(number, of)| (*number, told(text(*number), &of.diagnostics)));
    (told(main, &check.diagnostics), of_called.collect())
}

#[test]
fn a_called_program_is_checked_in_the_states_that_it_is_called_in() {
    let none: Vec<(u16, Vec<String>)> = Vec::new();
    assert_eq!(
        with_called("G02 X1 R5\nM98 P1000\nM30", &[(1000, "X3 R5\nM99")]),
        (vec![], none.clone())
    );
    let (main, called) = with_called("G01 X1\nM98 P1000\nM30", &[(1000, "X3 R5\nM99")]);
    assert_eq!(
        (main, called),
        (vec![], vec![(1000, vec!["1:4 E0108".to_owned()])])
    );
    let (main, called) = with_called(
        "G01 X1\nM98 P1000\nG02 X2 R5\nM98 P1000\nM30",
        &[(1000, "X3 R5\nM99")],
    );
    assert_eq!(
        (main, called),
        (vec![], vec![(1000, vec!["1:4 E0108".to_owned()])])
    );
    let (main, called) = with_called(
        "if(P1==1) { G01 X1\nM98 P1000 } else { G02 X2 R5\nM98 P1000 }\nM30",
        &[(1000, "X3 R5\nM99")],
    );
    assert_eq!(
        (main, called),
        (vec![], vec![(1000, vec!["1:4 W0009".to_owned()])])
    );
    // the changes of a called program stay after the call, but its L variables do not
    let (main, called) = with_called(
        "M98 P1000\nX3 R5\nM98 P1001\nX3 R5\nX[L1]\nM30",
        &[(1000, "G02 X1 R5\nL1=2000000\nM99"), (1001, "G01 X1\nM99")],
    );
    assert_eq!((main, called), (vec!["4:4 E0108".to_owned()], none.clone()));
}

#[test]
fn calls_repeat_nest_and_come_to_an_end() {
    let sub = [(1000, "X3 R5\nG01 X1\nM99")];
    let (main, called) = with_called("G02 X1 R5\nM98 P1000 L2\nM30", &sub);
    assert_eq!(
        (main, called),
        (vec![], vec![(1000, vec!["1:4 E0108".to_owned()])])
    );
    let (main, called) = with_called("G02 X1 R5\nM98 P1000 L0\nM30", &sub);
    assert_eq!((main, called.len()), (vec![], 0));
    let endless = [(1000, "G91 X1\nM98 P1000\nM99")];
    let (main, called) = with_called("M98 P1000\nM30", &endless);
    assert_eq!(
        (main, called),
        (vec![], vec![(1000, vec!["2:5 W0019".to_owned()])])
    );
    let many = [
        (1000, "G91 X1\nM98 P1001 L9999\nM99"),
        (1001, "if(P1==1) G01 X1\nL1=L1+1\nM99"),
    ];
    let (main, called) = with_called("M98 P1000 L9999\nX3 R5\nM30", &many);
    assert_eq!((main, called.len()), (vec!["2:4 E0108".to_owned()], 0));
}

#[test]
fn d12_a_program_that_is_called_no_times_is_not_called() {
    let wrong = [(1000, "G02 X1\nM99")];
    for main in ["M98 P1000 L0\nM30", "L1=1000\nM98 P[L1] L0\nM30"] {
        assert_eq!(with_called(main, &wrong), (vec![], vec![]), "{main}");
        let (_, check) = check_source(main, nj(), &calculating());
        assert!(check.programs.is_empty() && !check.calls_any, "{main}");
    }
}

#[test]
fn a_program_that_no_run_comes_to_is_looked_at_as_a_load_does() {
    // a load takes what the text names, whatever conditions and depths say
    let chain: Vec<(u16, String)> = (1000..1008)
        .map(|number| (number, format!("M98 P{}\nM99", number + 1)))
        .collect();
    let mut deep: Vec<(u16, &str)> = chain
        .iter()
        .map(|(number, text)| (*number, text.as_str()))
        .collect();
    deep.push((1008, "G02 X1\nM99"));
    let cases = [
        ("M98 P1000\nM30", deep),
        ("L1=0\nM98 P1008 L[L1]\nM30", vec![(1008, "G02 X1\nM99")]),
        ("if(1==0) M98 P1008\nM30", vec![(1008, "G02 X1\nM99")]),
        ("M30\nM98 P1008\nM30", vec![(1008, "G02 X1\nM99")]),
    ];
    for (main, programs) in cases {
        let (_, called) = with_called(main, &programs);
        let of_last = called.iter().find(|(number, _)| *number == 1008);
        let found = of_last.map(|(_, found)| found.join(" ")).unwrap_or_default();
        assert_eq!(found, "1:1 W0002 1:5 E0122", "{main}");
    }
}

#[test]
fn a_computed_call_is_followed_where_its_number_is_known() {
    let sub = [(1003, "X3 R5\nM99")];
    let (_, called) = with_called("L1=1000 L2=L1+3\nM98 P[L2]\nM30", &sub);
    assert_eq!(called, [(1003, vec!["1:4 E0108".to_owned()])]);
}

#[test]
fn a_missing_feedrate_is_told_where_the_machine_has_none() {
    let context = CheckContext {
        default_feedrate_mm_min: Some(0.0),
        ..calculating()
    };
    let found = |source: &str| told(source, &check_source(source, nj(), &context).1.diagnostics);
    assert_eq!(found("G00 X1\nG01 X2\nX3\nM30"), ["2:1 E0126"]);
    assert_eq!(found("G00 X1\nG01 X2 F100\nX3\nM30"), [""; 0]);
    assert_eq!(found("F100\nG01 X2\nX3\nM30"), [""; 0]);
    assert_eq!(found("if(P1==1) F100\nG01 X2\nM30"), ["2:1 W0009"]);
    assert_eq!(found("/1 F100\nG01 X2\nM30"), ["2:1 W0009"]);
}

#[test]
fn thread_without_spindle_speed_is_reported_if_the_machine_has_a_spindle() {
    let found = |source: &str, has_spindle| {
        let context = CheckContext {
            has_spindle: Some(has_spindle),
            ..calculating()
        };
        told(source, &check_source(source, nj(), &context).1.diagnostics)
    };
    let tap = "G84 X1 Z-5 R2 P100 F100\nG80\nM30";
    assert_eq!(found(tap, true), ["1:1 E0127"]);
    assert_eq!(found(tap, false), [""; 0]);
    assert_eq!(found(&format!("S100\n{tap}"), true), [""; 0]);
    assert_eq!(found(&format!("if(P1==1) S100\n{tap}"), true), ["2:1 W0009"]);
}

#[test]
fn many_ways_stay_within_bounds() {
    // 2^40 paths
    let way = |at: u8| format!("if(P{at}==1) {{ L{at}={at}\nG0{} X{at} }}\n", at % 2);
    let ways = (0..40).map(way).collect::<Vec<_>>().concat();
    let (_, check) = of(&ways);
    assert!(!check.has_errors());
    let nested = "while(P1==1) { L1=L1+1\n".repeat(20) + "X[L1]" + &" }".repeat(20);
    assert!(!of(&nested).1.has_errors());
}

#[test]
fn a_case_without_its_colon_is_one_finding() {
    let source = "switch(P1){\ncase 1\nX1\nbreak\ncase 2: X2\nbreak\n}\nM30";
    let (_, check) = check_source(source, nj(), &CheckContext::default());
    assert_eq!(told(source, &check.diagnostics), ["2:1 E0023"]);
}

#[test]
fn d11_a_calculated_word_leaves_what_is_written_beside_it_an_error() {
    let axes = AxisSet::from_iter([Axis::X]);
    let context = CheckContext {
        axes: Some(axes),
        max_spindle_speed_r_min: Some(1000.0),
        ..CheckContext::default()
    };
    let found = |source: &str| told(source, &check_source(source, nj(), &context).1.diagnostics);
    assert_eq!(found("L1=5\nG01 Y1 F[L1]\nM30"), ["2:5 E0114"]);
    assert_eq!(found("L1=5\nX1 F[L1] S2000\nM30"), ["2:10 E0109"]);
    assert_eq!(found("L1=2000\nX1 S[L1]\nM30"), ["2:4 W0009"]);
}

#[test]
fn a_warning_of_some_ways_cites_what_the_error_cites() {
    let source = "%\nG41 D1 G01 X5 F100\n/M01\nG40 X0\nM30\n%";
    let (_, check) = check_source(source, dgshape(), &CheckContext::default());
    let of_error = check.diagnostics.iter().find(|found| found.code == "E0119");
    let help = &of_error.expect("it waits in the offset").help;
    let section = help.rsplit(" See ").next().unwrap_or_default().to_owned();
    let source = "%\n/G41 D1\nG01 X5 F100\nM01\nG40 X0\nM30\n%";
    let (_, check) = check_source(source, dgshape(), &CheckContext::default());
    let of_way = check.diagnostics.iter().find(|found| found.code == "W0009");
    let help = &of_way.expect("it waits in the offset on one way").help;
    assert!(
        section.contains("manual") && help.ends_with(&section),
        "{section} {help}"
    );
}

/// A block that a run does not reach has no alarm: its values are checked as when a program is loaded.
#[test]
fn values_of_blocks_that_no_run_comes_to_are_not_told() {
    finds("L1=0/0\nif(!(isnan(L1))) X[L1]", &["1:1 W0010"]);
    finds("L1=0\nif(L1!=0) { L2=10/L1\nX[L2] }", &[]);
    finds("L1=1\nif(L1>3) { L2=0-5\nG04 P[L2] }", &[]);
    finds("L1=1\nif(L1>3) { G43 }\nif(L1>3) { G28 X0 }", &[]);
    finds("switch(2){case 1: F[L1]\nbreak\ncase 2: X1}", &[]);
    // faults that the text alone shows are reported in such a block too
    finds("L1=1\nif(L1>3) { G02 X1 }", &["2:16 E0122"]);
}

#[test]
fn a_loop_without_an_end_needs_no_m30_behind_it() {
    let found = |source: &str| told(source, &check_source(source, nj(), &calculating()).1.diagnostics);
    assert_eq!(found("G91\nwhile(1==1) { X1\nX-1 }"), [""; 0]);
    assert_eq!(found("G91\ndo { X1\nX-1 } while(1==1)"), [""; 0]);
    assert_eq!(found("while(1==1) { X1\nif(P1>0) break }"), ["2:17 E0115"]);
    assert_eq!(found("while(P1>0) { X1 }"), ["1:19 E0115"]);
    let (main, called) = with_called(
        "M98 P1000\nX1\nM30",
        &[(1000, "while(1==1) { X1\nif(P1>0) { M99 } }")],
    );
    assert_eq!((main, called), (vec![], vec![]));
}

#[test]
fn one_fault_of_a_call_is_one_finding() {
    let sub = [(1000, "X1\nM99")];
    assert_eq!(
        with_called("M98 P1000.5\nM30", &[]),
        (vec!["1:5 E0110".to_owned()], vec![])
    );
    // despite the missing M99, the blocks after the call are assumed to run
    let (main, called) = with_called("M98 P1000\nX2\nM30", &[(1000, "X1")]);
    assert_eq!(
        (main, called),
        (vec![], vec![(1000, vec!["1:1 E0115".to_owned()])])
    );
    let (main, called) = with_called("S9\nG84 Z-5 R2\nM98 P1000\nG80\nM30", &sub);
    assert_eq!((main, called), (vec!["3:1 E0121".to_owned()], vec![]));
}
