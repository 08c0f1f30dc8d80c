use plc_api::scan::{Image, ScanProgram};

use super::{compiled, program, stopped};

#[test]
fn a_division_by_zero_stops_the_program() {
    let stops = stopped("a, count : INT;", "a := 1;\na := a / count;");
    assert_eq!(
        stops,
        "test.st has stopped: line 4, at count: a division by zero. Correct the program, and start it again"
    );
    assert!(stopped("a, b : LREAL;", "a := a / b;").contains("at b: a division by zero"));
    assert!(stopped("a : TIME; b : INT;", "a := a / b;").contains("at b: a division by zero"));
    assert!(stopped("a : LREAL;", "a := a ** -1.0;").contains("a division by zero"));
}

#[test]
fn an_index_out_of_range_stops_the_program() {
    let stops = stopped("a : ARRAY[1..3] OF INT; i : INT := 4;", "\n\na[i] := 1;");
    assert!(
        stops.contains("line 5, at a[i]: the index 4 is not in 1 to 3"),
        "{stops}"
    );
    stopped("a : ARRAY[-1..3] OF INT; i : INT := -2;", "a[i] := 1;");
    stopped(
        "a : ARRAY[1..3] OF INT; i : LINT := 9223372036854775807; r : INT;",
        "r := a[i];",
    );
    stopped(
        "a : ARRAY[0..3] OF INT; i : LINT := -9223372036854775808; r : INT;",
        "r := a[i];",
    );
}

#[test]
fn a_loop_without_end_stops_the_program() {
    for body in [
        "WHILE TRUE DO ; END_WHILE;",
        "REPEAT UNTIL FALSE END_REPEAT;",
        "FOR a := 0 TO 10 DO FOR b := 1 TO 9223372036854775807 DO ; END_FOR; END_FOR;",
    ] {
        let stops = stopped("a, b : LINT;", body);
        assert!(
            stops.contains("line 3, at ") && stops.contains("the scan does not end: more than 1000000 steps"),
            "{stops}"
        );
    }
}

#[test]
fn a_program_that_stands_is_not_run_again() {
    let mut program = compiled(&program("n, z : INT;", "n := n + 1; n := n / z;"));
    for _ in 0..3 {
        program.scan(&mut Image::default());
    }
    assert_eq!(program.shown("N").unwrap(), "1");
}

#[test]
fn a_long_piece_of_the_source_is_cut_in_the_alarm() {
    let long = "a".repeat(200);
    let stops = stopped(
        &format!("{long} : ARRAY[1..2] OF INT; i : INT;"),
        &format!("{long}[i] := 1;"),
    );
    assert!(
        stops.len() < 200 && stops.contains("aaa...: the index 0"),
        "{stops}"
    );
}
