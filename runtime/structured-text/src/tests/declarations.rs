use super::{compiled, only, program, result, scanned, stopped, values};

#[test]
fn integers_have_their_ranges() {
    for (of, low, high) in [
        ("SINT", "-128", "127"),
        ("INT", "-32768", "32767"),
        ("DINT", "-2147483648", "2147483647"),
        ("LINT", "-9223372036854775808", "9223372036854775807"),
        ("USINT", "0", "255"),
        ("UINT", "0", "65535"),
        ("UDINT", "0", "4294967295"),
        ("ULINT", "0", "18446744073709551615"),
    ] {
        assert_eq!(super::value(of, low), low);
        assert_eq!(super::value(of, high), high);
        let stops = stopped(&format!("a : {of} := {high};"), "a := a + 1;");
        assert!(
            stops.contains(&format!("does not fit {of}")) && stops.contains("line 3"),
            "{stops}"
        );
        stopped(&format!("a : {of} := {low};"), "a := a - 1;");
    }
    assert_eq!(only(&program("a : SINT;", "a := 128;")), "ST006");
}

#[test]
fn reals_have_their_precision() {
    // 2 to the power of 24 is the first integer of which a REAL has no successor
    assert_eq!(result("r : REAL := 16777216.0;", "r := r + 1.0;"), "16777216.0");
    assert_eq!(result("r : LREAL := 16777216.0;", "r := r + 1.0;"), "16777217.0");
    assert!(stopped("a : REAL := 3.0E38;", "a := a * 10.0;").contains("does not fit REAL"));
    assert!(stopped("a : LREAL := -1.0;", "a := SQRT(a);").contains("SQRT has no result"));
}

#[test]
fn bit_strings_have_their_widths() {
    values(&[
        ("BYTE", "NOT BYTE#16#0F", "240"),
        ("WORD", "NOT WORD#0", "65535"),
        ("DWORD", "NOT DWORD#0", "4294967295"),
        ("LWORD", "NOT LWORD#0", "18446744073709551615"),
    ]);
    assert_eq!(only(&program("a : BYTE;", "a := 16#100;")), "ST006");
}

#[test]
fn time_counts_nanoseconds() {
    values(&[
        ("TIME", "T#1ns + T#1us", "T#1us1ns"),
        ("TIME", "T#1d - T#1ns", "T#23h59m59s999ms999us999ns"),
    ]);
    assert!(stopped("a : TIME := T#106751d;", "a := a + a;").contains("does not fit TIME"));
}

#[test]
fn strings_have_their_lengths() {
    assert_eq!(result("r : STRING[3];", "r := 'abc';"), "abc");
    assert_eq!(only(&program("r : STRING[3];", "r := 'abcd';")), "ST006");
    assert!(
        stopped("a : STRING := 'abcd'; r : STRING[3];", "r := a;")
            .contains("4 characters does not fit STRING[3]")
    );
    assert_eq!(result("r : INT; a : STRING;", "a := 'äöü'; r := LEN(a);"), "3");
    assert_eq!(only(&program("r : STRING[1001];", "")), "ST050");
}

#[test]
fn variables_without_a_value_begin_with_0() {
    for (of, expected) in [
        ("BOOL", "FALSE"),
        ("INT", "0"),
        ("WORD", "0"),
        ("LREAL", "0.0"),
        ("TIME", "T#0s"),
        ("STRING", ""),
    ] {
        assert_eq!(result(&format!("r : {of};"), ""), expected);
    }
}

#[test]
fn enumerations() {
    let source = "TYPE Colour : (Red, Green, Blue); Level : (Low, Red); END_TYPE
        PROGRAM p VAR c : Colour; r : INT; END_VAR
        IF c = Colour#Red THEN c := Blue; END_IF;
        CASE c OF Colour#Red, Green: r := 1; Blue: r := 2; END_CASE;
        IF c <> Green THEN r := r + 10; END_IF;
        END_PROGRAM";
    assert_eq!(scanned(source).shown("R").unwrap(), "12");
    assert_eq!(only(&source.replace("c = Colour#Red", "c = Red")), "ST020");
    assert_eq!(only(&source.replace("c := Blue", "c := Low")), "ST030");
    assert_eq!(only(&source.replace("c := Blue", "c := 1")), "ST030");
}

#[test]
fn arrays_have_bounds_and_dimensions() {
    let body = "FOR i := -1 TO 1 DO FOR j := 2 TO 3 DO a[i, j] := 10 * i + j; END_FOR; END_FOR; r := a[1, 2] * 100 + a[-1, 3];";
    assert_eq!(
        result("a : ARRAY[-1..1, 2..3] OF INT; i, j, r : INT;", body),
        "1193"
    );
    let body = "a[1][2] := 5; r := a[1][2] + a[2][1];";
    assert_eq!(
        result("a : ARRAY[1..2] OF ARRAY[1..2] OF INT; r : INT;", body),
        "5"
    );
    assert_eq!(
        result(
            "r, n : INT := 2; a : ARRAY[1..3] OF INT := [7, 8, 9];",
            "r := a[n + 1];"
        ),
        "9"
    );
    assert_eq!(only(&program("a : ARRAY[5..1] OF INT;", "")), "ST050");
    assert_eq!(only(&program("a : ARRAY[1..5] OF INT;", "a[6] := 1;")), "ST050");
    assert_eq!(
        only(&program("a : ARRAY[1..5] OF INT;", "a[1, 1] := 1;")),
        "ST050"
    );
    assert_eq!(
        only(&program("a : ARRAY[1..5] OF INT; b : BOOL;", "a[b] := 1;")),
        "ST030"
    );
}

#[test]
fn structures() {
    let source = "TYPE Inner : STRUCT n : INT := 3; END_STRUCT;
        Outer : STRUCT a : Inner; b : ARRAY[1..2] OF Inner; END_STRUCT; END_TYPE
        PROGRAM p VAR o, q : Outer; r : INT; END_VAR
        o.b[2].n := 5; q := o; o.a.n := 100; r := q.a.n + q.b[2].n; END_PROGRAM";
    assert_eq!(scanned(source).shown("R").unwrap(), "8");
    assert_eq!(only(&source.replace("o.a.n := 100", "o.a.m := 100")), "ST020");
    assert_eq!(
        only("TYPE A : STRUCT a : A; END_STRUCT; END_TYPE PROGRAM p END_PROGRAM"),
        "ST041"
    );
}

#[test]
fn other_names_for_types() {
    let source = "TYPE Length : LREAL; Row : ARRAY[1..3] OF Length; END_TYPE
        PROGRAM p VAR a : Row; r : Length; END_VAR a[3] := 1.5; r := a[3]; END_PROGRAM";
    assert_eq!(scanned(source).shown("R").unwrap(), "1.5");
}

#[test]
fn variables_begin_with_their_values() {
    assert_eq!(result("a, b : INT := 5; r : INT;", "r := a + b;"), "10");
    let source = "PROGRAM p VAR CONSTANT n : INT := 4; m : INT := 2 * n; END_VAR VAR a : ARRAY[1..m] OF INT; r : INT := m - 1; END_VAR
        a[8] := 1; r := r + a[m]; END_PROGRAM";
    assert_eq!(scanned(source).shown("R").unwrap(), "8");
    assert_eq!(only(&program("a : INT; b : INT := a;", "")), "ST033");
}

#[test]
fn arrays_and_structures_begin_with_their_values() {
    let row = "a : ARRAY[1..6] OF INT := [1, 2, 3(7)]; r : INT;";
    assert_eq!(result(row, "r := a[1] + 10 * a[2] + 100 * a[5] + a[6];"), "721");
    let source = "TYPE Point : STRUCT x, y : INT; END_STRUCT; END_TYPE
        PROGRAM p VAR a : Point := (y := 2, x := 1); b : ARRAY[1..2] OF Point := [(x := 3), (y := 4)]; r : INT; END_VAR
        r := a.x + 10 * a.y + 100 * b[1].x + 1000 * b[2].y + b[2].x; END_PROGRAM";
    assert_eq!(scanned(source).shown("R").unwrap(), "4321");
    assert_eq!(
        only(&program("a : ARRAY[1..2] OF INT := [1, 2, 3];", "")),
        "ST050"
    );
    assert_eq!(
        only(&program("a : ARRAY[1..2] OF INT := [1000000000(1)];", "")),
        "ST050"
    );
}

#[test]
fn instances_begin_with_their_inputs() {
    assert_eq!(
        result("c : CTU := (PV := 2); r : BOOL;", "c(CU := TRUE); r := c.Q;"),
        "FALSE"
    );
    assert_eq!(
        result("c : CTU := (PV := 1); r : BOOL;", "c(CU := TRUE); r := c.Q;"),
        "TRUE"
    );
    assert_eq!(only(&program("c : CTU := (Q := TRUE);", "")), "ST020");
}

#[test]
fn temporary_variables_begin_anew_in_each_call() {
    use plc_api::scan::{Image, ScanProgram};
    let source = "PROGRAM p VAR kept : INT; END_VAR VAR_TEMP t : INT := 5; END_VAR
        t := t + 1; kept := kept + t; END_PROGRAM";
    let mut program = compiled(source);
    program.scan(&mut Image::default());
    program.scan(&mut Image::default());
    assert_eq!(program.shown("KEPT").unwrap(), "12");
}

#[test]
fn inputs_and_constants_are_not_assigned() {
    let source =
        "FUNCTION f : INT VAR_INPUT a : INT; END_VAR a := 1; f := a; END_FUNCTION PROGRAM p END_PROGRAM";
    assert_eq!(only(source), "ST032");
    assert_eq!(
        only("PROGRAM p VAR CONSTANT n : INT := 4; END_VAR n := 5; END_PROGRAM"),
        "ST032"
    );
    assert_eq!(
        only("PROGRAM p VAR CONSTANT n : INT; END_VAR END_PROGRAM"),
        "ST033"
    );
    assert_eq!(only(&program("t : TON;", "t.Q := TRUE;")), "ST032");
}
