use super::{only, program, result};

#[test]
fn assignments() {
    assert_eq!(
        result(
            "a, b : ARRAY[1..2] OF INT := [1, 2]; r : INT;",
            "a[1] := 5; b := a; a[1] := 7; r := b[1];"
        ),
        "5"
    );
    assert_eq!(
        only(&program(
            "a : ARRAY[1..2] OF INT; b : ARRAY[1..3] OF INT;",
            "a := b;"
        )),
        "ST030"
    );
    assert_eq!(only(&program("t, u : TON;", "t := u;")), "ST032");
    assert_eq!(only(&program("r : INT;", "r = 1;")), "ST010");
}

#[test]
fn if_takes_the_first_that_is_true() {
    for (a, expected) in [(1, "10"), (2, "20"), (3, "30")] {
        let body = "IF a = 1 THEN r := 10; ELSIF a = 2 THEN r := 20; ELSE r := 30; END_IF;";
        assert_eq!(result(&format!("a : INT := {a}; r : INT;"), body), expected);
    }
    assert_eq!(only(&program("a : INT;", "IF a THEN END_IF;")), "ST031");
    assert_eq!(only(&program("a : INT;", "IF a > 0 THEN ; END_IF")), "ST010");
}

#[test]
fn case_takes_lists_and_ranges() {
    for (a, expected) in [(1, "1"), (2, "2"), (5, "3"), (7, "3"), (-3, "4"), (9, "5")] {
        let body = "CASE a OF 1: r := 1; 2, 3: r := 2; n..7: r := 3; -4..-2: r := 4; ELSE r := 5; END_CASE;";
        let source = format!(
            "PROGRAM p VAR CONSTANT n : INT := 5; END_VAR VAR a : INT := {a}; r : INT; END_VAR {body} END_PROGRAM"
        );
        assert_eq!(super::scanned(&source).shown("R").unwrap(), expected, "{a}");
    }
    assert_eq!(
        only(&program("a : INT;", "CASE a OF 1..3: ; 2: ; END_CASE;")),
        "ST051"
    );
    assert_eq!(only(&program("a, b : INT;", "CASE a OF b: ; END_CASE;")), "ST033");
    assert_eq!(only(&program("a : REAL;", "CASE a OF 1: ; END_CASE;")), "ST030");
}

#[test]
fn for_counts_up_and_down() {
    assert_eq!(
        result("i, r : INT;", "FOR i := 1 TO 4 DO r := r * 10 + i; END_FOR;"),
        "1234"
    );
    assert_eq!(
        result(
            "i, r : INT;",
            "FOR i := 5 TO 1 BY -2 DO r := r * 10 + i; END_FOR;"
        ),
        "531"
    );
    assert_eq!(result("i, r : INT;", "FOR i := 5 TO 1 DO r := 1; END_FOR;"), "0");
    assert_eq!(
        result(
            "i : USINT; r : INT;",
            "FOR i := 250 TO 255 DO r := r + 1; END_FOR;"
        ),
        "6"
    );
    assert_eq!(
        result(
            "i : USINT; r : INT;",
            "FOR i := 3 TO 0 BY -1 DO r := r + 1; END_FOR;"
        ),
        "4"
    );
    assert_eq!(
        result("i, r : INT;", "FOR i := 1 TO 3 DO ; END_FOR; r := i;"),
        "4"
    );
    assert_eq!(
        only(&program("i : INT;", "FOR i := 1 TO 3 DO i := 5; END_FOR;")),
        "ST032"
    );
    assert_eq!(
        only(&program("i : REAL;", "FOR i := 1 TO 3 DO ; END_FOR;")),
        "ST030"
    );
    assert!(super::stopped("i, n : INT;", "FOR i := 1 TO 3 BY n DO ; END_FOR;").contains("a step of 0"));
}

#[test]
fn while_and_repeat() {
    assert_eq!(result("r : INT;", "WHILE r < 5 DO r := r + 2; END_WHILE;"), "6");
    assert_eq!(
        result("r : INT := 9;", "WHILE r < 5 DO r := r + 2; END_WHILE;"),
        "9"
    );
    assert_eq!(
        result("r : INT := 9;", "REPEAT r := r + 2; UNTIL r > 5 END_REPEAT;"),
        "11"
    );
}

#[test]
fn exit_and_continue_act_on_the_innermost_loop() {
    let body =
        "FOR i := 1 TO 3 DO FOR j := 1 TO 3 DO IF j = 2 THEN EXIT; END_IF; r := r + 1; END_FOR; END_FOR;";
    assert_eq!(result("i, j, r : INT;", body), "3");
    let body = "FOR i := 1 TO 4 DO IF i MOD 2 = 0 THEN CONTINUE; END_IF; r := r + i; END_FOR;";
    assert_eq!(result("i, r : INT;", body), "4");
    let body = "WHILE TRUE DO r := r + 1; IF r < 3 THEN CONTINUE; END_IF; EXIT; END_WHILE;";
    assert_eq!(result("r : INT;", body), "3");
    assert_eq!(only(&program("", "EXIT;")), "ST010");
}

#[test]
fn return_ends_its_unit() {
    let source = "FUNCTION f : INT VAR_INPUT a : INT; END_VAR
        f := 1; WHILE TRUE DO IF a > 0 THEN RETURN; END_IF; f := 2; EXIT; END_WHILE; END_FUNCTION
        PROGRAM p VAR r : INT; END_VAR r := f(1) + 10 * f(0); RETURN; r := 0; END_PROGRAM";
    assert_eq!(super::scanned(source).shown("R").unwrap(), "21");
}
