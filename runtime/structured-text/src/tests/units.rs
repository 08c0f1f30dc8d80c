use plc_api::scan::{Image, ScanProgram};

use super::{compiled, found, only, program, result, scanned};

fn r(source: &str) -> String {
    let program = scanned(source);
    assert_eq!(program.stopped(), None);
    program.shown("R").unwrap()
}

#[test]
fn functions_give_what_their_name_is_assigned() {
    let source = "PROGRAM p VAR r : INT; END_VAR r := twice(twice(3)) + twice(1); END_PROGRAM
        FUNCTION twice : INT VAR_INPUT a : INT; END_VAR twice := a; twice := twice + a; END_FUNCTION";
    assert_eq!(r(source), "14");
    assert_eq!(
        only("FUNCTION f : TON END_FUNCTION PROGRAM p END_PROGRAM"),
        "ST012"
    );
    assert_eq!(
        only("FUNCTION f : INT VAR t : TON; END_VAR f := 1; END_FUNCTION PROGRAM p END_PROGRAM"),
        "ST012"
    );
}

#[test]
fn parameters_by_order_and_by_name() {
    let source = |call: &str| {
        format!(
            "FUNCTION f : INT VAR_INPUT a : INT; b : INT := 5; END_VAR VAR_OUTPUT c : INT; END_VAR f := a * 10 + b; c := a; END_FUNCTION
            PROGRAM p VAR r, s : INT; d : DINT; END_VAR {call} END_PROGRAM"
        )
    };
    assert_eq!(r(&source("r := f(1, 2);")), "12");
    assert_eq!(r(&source("r := f(b := 2, a := 1);")), "12");
    assert_eq!(r(&source("r := f(a := 1);")), "15");
    assert_eq!(r(&source("s := f(a := 7, c => r);")), "7");
    assert_eq!(
        scanned(&source("r := f(a := 7, c => d);")).shown("D").unwrap(),
        "7"
    );
    assert_eq!(only(&source("r := f(1);")), "ST040");
    assert_eq!(only(&source("r := f(1, b := 2);")), "ST040");
    assert_eq!(only(&source("r := f(a := 1, c := s);")), "ST040");
    assert_eq!(only(&source("r := f(a => s);")), "ST040");
    assert_eq!(only(&source("r := f(a := 1, c => 5);")), "ST032");
}

#[test]
fn in_outs_change_the_variable_that_is_passed() {
    let source = "FUNCTION swap : BOOL VAR_IN_OUT a, b : INT; END_VAR VAR t : INT; END_VAR t := a; a := b; b := t; END_FUNCTION
        FUNCTION_BLOCK Sum VAR_IN_OUT row : ARRAY[1..3] OF INT; END_VAR VAR_OUTPUT total : INT; END_VAR VAR i : INT; END_VAR
        FOR i := 1 TO 3 DO total := total + row[i]; row[i] := 0; END_FOR; swap(a := row[1], b := total); END_FUNCTION_BLOCK
        PROGRAM p VAR a : ARRAY[1..2] OF ARRAY[1..3] OF INT := [[1, 2, 3], [4, 5, 6]]; s : Sum; n, r : INT; END_VAR
        n := 2; s(row := a[n]); r := a[2][1] * 100 + s.total * 10 + a[2][3] + a[1][3]; END_PROGRAM";
    assert_eq!(r(source), "1503");
    assert_eq!(only(&source.replace("s(row := a[n])", "s()")), "ST040");
    assert_eq!(only(&source.replace("s(row := a[n])", "s(row := n)")), "ST030");
    let timer = "FUNCTION_BLOCK F VAR_IN_OUT t : R_TRIG; END_VAR t(CLK := TRUE); END_FUNCTION_BLOCK
        PROGRAM p VAR f : F; t : R_TRIG; r : BOOL; END_VAR f(t := t); r := t.Q; END_PROGRAM";
    assert_eq!(r(timer), "TRUE");
}

#[test]
fn functions_keep_nothing() {
    let source = "FUNCTION f : INT VAR n : INT := 1; END_VAR n := n + 1; f := n; END_FUNCTION
        PROGRAM p VAR r : INT; END_VAR r := f() * 10 + f(); END_PROGRAM";
    assert_eq!(r(source), "22");
}

#[test]
fn recursion_is_refused() {
    let itself = "FUNCTION f : INT VAR_INPUT a : INT; END_VAR f := f(a); END_FUNCTION PROGRAM p END_PROGRAM";
    assert_eq!(only(itself), "ST041");
    let both = "FUNCTION f : INT f := g(); END_FUNCTION FUNCTION g : INT g := f(); END_FUNCTION PROGRAM p END_PROGRAM";
    assert_eq!(only(both), "ST041");
    assert!(
        found("FUNCTION_BLOCK A VAR a : A; END_VAR END_FUNCTION_BLOCK PROGRAM p END_PROGRAM")
            .contains(&("ST041", 1))
    );
}

#[test]
fn function_blocks_keep_their_variables() {
    let source = "FUNCTION_BLOCK Counter VAR_INPUT step : INT := 1; END_VAR VAR_OUTPUT n : INT; END_VAR VAR hidden : INT; END_VAR
        n := n + step; END_FUNCTION_BLOCK
        PROGRAM p VAR a, b : Counter; r : INT; END_VAR a(); a(step := 5); b(2); a.step := 7; a(); r := a.n * 10 + b.n; END_PROGRAM";
    assert_eq!(r(source), "132");
    assert_eq!(only(&source.replace("r := a.n * 10", "r := a.hidden")), "ST020");
    assert_eq!(only(&source.replace("a.step := 7", "a.n := 7")), "ST032");
}

#[test]
fn inputs_that_are_not_given_stay() {
    assert_eq!(
        result(
            "c : CTU; r : LINT;",
            "c(CU := TRUE, PV := 3); c(CU := FALSE); c(CU := TRUE); r := c.CV * 10 + c.PV;"
        ),
        "23"
    );
}

#[test]
fn outputs_go_where_the_arrow_points() {
    assert_eq!(
        result("c : CTU; r : LINT;", "c(CU := TRUE, PV := 3, CV => r);"),
        "1"
    );
    assert_eq!(
        only(&program("c : CTU; r : INT;", "c(CU := TRUE, CV => r);")),
        "ST031"
    );
}

#[test]
fn instances_within_instances_and_arrays() {
    let source = "FUNCTION_BLOCK Two VAR_INPUT x : BOOL; END_VAR VAR_OUTPUT n : LINT; END_VAR VAR c : ARRAY[1..2] OF CTU; END_VAR
        c[1](CU := x); c[2](CU := NOT x); n := c[1].CV * 10 + c[2].CV; END_FUNCTION_BLOCK
        PROGRAM p VAR t : ARRAY[1..3] OF Two; i : INT; r : LINT; END_VAR
        FOR i := 1 TO 3 DO t[i](x := i = 2); t[i](x := i = 3); t[i](x := FALSE); END_FOR;
        r := t[1].n * 10000 + t[2].n * 100 + t[3].n; END_PROGRAM";
    // the inputs of 1: off off off; of 2: on off off; of 3: off on off
    assert_eq!(r(source), "11112");
}

#[test]
fn bistable_function_blocks() {
    assert_eq!(
        result("f : SR; r : BOOL;", "f(S1 := TRUE, R := TRUE); r := f.Q1;"),
        "TRUE"
    );
    assert_eq!(
        result("f : RS; r : BOOL;", "f(S := TRUE, R1 := TRUE); r := f.Q1;"),
        "FALSE"
    );
    assert_eq!(
        result("f : RS; r : BOOL;", "f(S := TRUE); f(S := FALSE); r := f.Q1;"),
        "TRUE"
    );
}

#[test]
fn edge_detection_function_blocks() {
    let body = "FOR i := 0 TO 3 DO e(CLK := i = 1 OR i = 2); IF e.Q THEN r := r * 10 + i; END_IF; END_FOR;";
    assert_eq!(result("e : R_TRIG; i : INT; r : INT;", body), "1");
    assert_eq!(
        result("e : F_TRIG; i : INT; r : INT;", body),
        "3",
        "off at the first call is an edge, too: 0, then 3"
    );
}

#[test]
fn counter_function_blocks() {
    let up =
        "FOR i := 1 TO 3 DO c(CU := TRUE, PV := 2); c(CU := FALSE); IF c.Q THEN r := r + 1; END_IF; END_FOR;";
    assert_eq!(result("c : CTU; i, r : INT;", up), "2");
    let down = "c(LD := TRUE, PV := 2); c(LD := FALSE, CD := TRUE); r := c.CV; c(CD := FALSE); c(CD := TRUE); IF c.Q THEN r := r + 10; END_IF;";
    assert_eq!(result("c : CTD; r : LINT;", down), "11");
    let both = "c(CU := TRUE, PV := 1); IF c.QU THEN r := 1; END_IF; c(CU := FALSE, CD := TRUE); IF c.QD THEN r := r + 10; END_IF;";
    assert_eq!(result("c : CTUD; r : INT;", both), "11");
}

#[test]
fn timer_function_blocks() {
    use std::time::Duration;

    use plc_api::fake::FakePort;
    // the diagrams of the standard: IN is on from 20 to 80 ms, PT is 40 ms, one scan each 10 ms
    let source = "PROGRAM p VAR on : TON; off : TOF; pulse : TP; x : BOOL; s : SCAN_STATE; END_VAR
        s(); x := s.Count >= 2 AND s.Count < 8;
        on(IN := x, PT := T#40ms); off(IN := x, PT := T#40ms); pulse(IN := x, PT := T#40ms);
        IF on.Q THEN SET_P(2000 + LREAL_TO_UDINT(ULINT_TO_LREAL(s.Count)), 1); END_IF;
        IF off.Q THEN SET_P(2100 + LREAL_TO_UDINT(ULINT_TO_LREAL(s.Count)), 1); END_IF;
        IF pulse.Q THEN SET_P(2200 + LREAL_TO_UDINT(ULINT_TO_LREAL(s.Count)), 1); END_IF; END_PROGRAM";
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(async {
        let fake = FakePort::new([1]);
        let plc = fake.plc();
        let program = compiled(source).sequence_program(Duration::from_millis(10));
        tokio::spawn(async move { program.run(&plc).await });
        fake.settle().await;
        fake.advance(Duration::from_millis(155)).await;
        let mut lines = Vec::new();
        for from in [2000, 2100, 2200] {
            let values = fake.plc().variables().read(from, 15).await.unwrap();
            lines.push(
                values
                    .iter()
                    .map(|value| if *value > 0.5 { '#' } else { '_' })
                    .collect::<String>(),
            );
        }
        //                      0123456789
        assert_eq!(lines[0], "______##_______");
        assert_eq!(lines[1], "__##########___");
        assert_eq!(lines[2], "__####_________");
    });
}

#[test]
fn a_program_keeps_its_variables_from_scan_to_scan() {
    let mut program = compiled(&program("n : INT;", "n := n + 1;"));
    for _ in 0..3 {
        program.scan(&mut Image::default());
    }
    assert_eq!(program.shown("N").unwrap(), "3");
}
