use super::{only, program, result, stopped, values};

#[test]
fn integers_are_converted() {
    values(&[
        ("INT", "DINT_TO_INT(32767)", "32767"),
        ("USINT", "INT_TO_USINT(INT#255)", "255"),
        ("UINT", "SINT_TO_UINT(SINT#5)", "5"),
        ("INT", "BOOL_TO_INT(TRUE)", "1"),
        ("BOOL", "INT_TO_BOOL(INT#2)", "TRUE"),
        ("BOOL", "INT_TO_BOOL(INT#0)", "FALSE"),
        ("REAL", "DINT_TO_REAL(DINT#5)", "5.0"),
        ("LREAL", "LINT_TO_LREAL(LINT#-3)", "-3.0"),
    ]);
    assert!(
        stopped("a : DINT := 40000; r : INT;", "r := DINT_TO_INT(a);").contains("40000 does not fit INT")
    );
    assert!(stopped("a : INT := -1; r : UINT;", "r := INT_TO_UINT(a);").contains("-1 does not fit UINT"));
}

#[test]
fn reals_are_rounded_to_even() {
    // the values of the standard
    values(&[
        ("INT", "REAL_TO_INT(1.6)", "2"),
        ("INT", "REAL_TO_INT(-1.6)", "-2"),
        ("INT", "REAL_TO_INT(1.5)", "2"),
        ("INT", "REAL_TO_INT(-1.5)", "-2"),
        ("INT", "REAL_TO_INT(1.4)", "1"),
        ("INT", "REAL_TO_INT(-1.4)", "-1"),
        ("INT", "REAL_TO_INT(2.5)", "2"),
        ("INT", "REAL_TO_INT(-2.5)", "-2"),
        ("LINT", "LREAL_TO_LINT(0.5)", "0"),
        ("REAL", "LREAL_TO_REAL(0.1)", "0.1"),
    ]);
    assert!(stopped("a : REAL := 1.0E30; r : DINT;", "r := REAL_TO_DINT(a);").contains("does not fit DINT"));
    assert!(
        stopped("a : LREAL := 1.0E300; r : REAL;", "r := LREAL_TO_REAL(a);").contains("does not fit REAL")
    );
}

#[test]
fn trunc_goes_towards_zero() {
    values(&[
        ("DINT", "TRUNC(1.6)", "1"),
        ("DINT", "TRUNC(-1.6)", "-1"),
        ("DINT", "TRUNC(1.4)", "1"),
        ("DINT", "TRUNC(-1.4)", "-1"),
        ("INT", "REAL_TRUNC_INT(1.6)", "1"),
        ("SINT", "TRUNC_SINT(-1.6)", "-1"),
    ]);
    assert_eq!(only(&program("r : DINT; a : INT;", "r := TRUNC(a);")), "ST020");
}

#[test]
fn to_takes_every_type() {
    values(&[
        ("INT", "TO_INT(DINT#5)", "5"),
        ("INT", "TO_INT(2.5)", "2"),
        ("STRING", "TO_STRING(TRUE)", "TRUE"),
        ("REAL", "TO_REAL(UDINT#7)", "7.0"),
    ]);
    assert_eq!(only(&program("r : WORD;", "r := TO_WORD(1.5);")), "ST020");
}

#[test]
fn bits_are_transferred() {
    values(&[
        ("INT", "WORD_TO_INT(WORD#16#FFFF)", "-1"),
        ("INT", "BYTE_TO_INT(BYTE#16#FF)", "255"),
        ("SINT", "WORD_TO_SINT(WORD#16#0180)", "-128"),
        ("WORD", "INT_TO_WORD(INT#-1)", "65535"),
        ("DWORD", "INT_TO_DWORD(INT#-1)", "65535"),
        ("BYTE", "WORD_TO_BYTE(WORD#16#1234)", "52"),
        ("LWORD", "LINT_TO_LWORD(LINT#-1)", "18446744073709551615"),
        ("BOOL", "BYTE_TO_BOOL(BYTE#1)", "TRUE"),
        ("BYTE", "BOOL_TO_BYTE(TRUE)", "1"),
    ]);
    assert_eq!(
        only(&program("r : REAL;", "r := DWORD_TO_REAL(DWORD#1);")),
        "ST020"
    );
}

#[test]
fn times_are_numbers_of_milliseconds() {
    values(&[
        ("DINT", "TIME_TO_DINT(T#1s500ms)", "1500"),
        ("LREAL", "TIME_TO_LREAL(T#1ms500us)", "1.5"),
        ("TIME", "DINT_TO_TIME(DINT#1500)", "T#1s500ms"),
        ("TIME", "LREAL_TO_TIME(1.5)", "T#1ms500us"),
        ("STRING", "TIME_TO_STRING(T#90s)", "T#1m30s"),
    ]);
}

#[test]
fn strings_are_numbers() {
    values(&[
        ("STRING", "INT_TO_STRING(INT#-12)", "-12"),
        ("STRING", "REAL_TO_STRING(1.5)", "1.5"),
        ("STRING", "LREAL_TO_STRING(1.0)", "1.0"),
        ("INT", "STRING_TO_INT('-12')", "-12"),
        ("LREAL", "STRING_TO_LREAL('1.5')", "1.5"),
        ("BOOL", "STRING_TO_BOOL('TRUE')", "TRUE"),
    ]);
    for text in ["", "x", "1.5", "99999999999999999999999999999999999999999999"] {
        let stops = stopped(
            &format!("a : STRING := '{text}'; r : INT;"),
            "r := STRING_TO_INT(a);",
        );
        assert!(
            stops.contains("is not a number") || stops.contains("does not fit"),
            "{stops}"
        );
    }
    assert!(
        stopped("a : STRING := 'inf'; r : LREAL;", "r := STRING_TO_LREAL(a);")
            .contains("'inf' is not a number")
    );
}

#[test]
fn numerical_functions() {
    values(&[
        ("INT", "ABS(INT#-5)", "5"),
        ("REAL", "ABS(REAL#-1.5)", "1.5"),
        ("LREAL", "SQRT(2.25)", "1.5"),
        ("LREAL", "LN(1.0)", "0.0"),
        ("LREAL", "LOG(1000.0)", "3.0"),
        ("LREAL", "EXP(0.0)", "1.0"),
        ("REAL", "SQRT(REAL#2.25)", "1.5"),
    ]);
    assert!(stopped("a : SINT := -128; r : SINT;", "r := ABS(a);").contains("128 does not fit SINT"));
    assert!(stopped("a, r : LREAL;", "r := LN(a);").contains("LN has no result"));
    assert_eq!(only(&program("r : LREAL; a : INT;", "r := SQRT(a);")), "ST030");
}

#[test]
fn trigonometric_functions() {
    values(&[
        ("LREAL", "SIN(0.0)", "0.0"),
        ("LREAL", "COS(0.0)", "1.0"),
        ("LREAL", "TAN(0.0)", "0.0"),
        ("LREAL", "ASIN(1.0) * 2.0 - ACOS(-1.0)", "0.0"),
        ("LREAL", "ATAN(1.0) * 4.0 - ACOS(-1.0)", "0.0"),
        ("LREAL", "ATAN2(Y := 1.0, X := -1.0) - 3.0 * ATAN(1.0)", "0.0"),
    ]);
    assert!(stopped("a : LREAL := 2.0; r : LREAL;", "r := ASIN(a);").contains("ASIN has no result"));
}

#[test]
fn arithmetic_functions() {
    values(&[
        ("INT", "ADD(1, 2, 3)", "6"),
        ("INT", "MUL(2, 3, 4)", "24"),
        ("INT", "SUB(5, 3)", "2"),
        ("INT", "DIV(7, 2)", "3"),
        ("INT", "MOD(7, 2)", "1"),
        ("LREAL", "EXPT(2.0, 3.0)", "8.0"),
        ("INT", "MOVE(INT#5)", "5"),
        ("INT", "ADD(IN1 := 1, IN2 := 2)", "3"),
    ]);
    assert_eq!(only(&program("r : INT;", "r := SUB(1, 2, 3);")), "ST040");
}

#[test]
fn shifts_and_rotations() {
    values(&[
        ("BYTE", "SHL(BYTE#16#81, 1)", "2"),
        ("BYTE", "SHR(BYTE#16#81, 1)", "64"),
        ("BYTE", "ROL(BYTE#16#81, 1)", "3"),
        ("BYTE", "ROR(BYTE#16#81, 1)", "192"),
        ("BYTE", "SHL(BYTE#16#81, 8)", "0"),
        ("LWORD", "SHL(LWORD#1, 64)", "0"),
        ("BYTE", "ROL(BYTE#16#81, 9)", "3"),
        ("LWORD", "ROR(LWORD#1, 1)", "9223372036854775808"),
        ("WORD", "SHL(IN := WORD#1, N := 4)", "16"),
    ]);
    assert!(stopped("n : INT := -1; r : BYTE;", "r := SHL(r, n);").contains("a shift by less than 0 bits"));
    assert_eq!(only(&program("r, a : INT;", "r := SHL(a, 1);")), "ST030");
}

#[test]
fn boolean_functions() {
    values(&[
        ("BOOL", "AND(TRUE, TRUE, FALSE)", "FALSE"),
        ("BOOL", "OR(FALSE, TRUE)", "TRUE"),
        ("BOOL", "XOR(TRUE, TRUE, TRUE)", "TRUE"),
        ("BOOL", "NOT(TRUE)", "FALSE"),
        ("BYTE", "BYTE#2#1100 AND BYTE#2#1010", "8"),
        ("BYTE", "BYTE#2#1100 OR 2#1010", "14"),
        ("BYTE", "BYTE#2#1100 XOR BYTE#2#1010", "6"),
    ]);
    assert_eq!(only(&program("r, a : INT;", "r := a AND 1;")), "ST030");
}

#[test]
fn selection_functions() {
    values(&[
        ("INT", "SEL(FALSE, 1, 2)", "1"),
        ("INT", "SEL(G := TRUE, IN0 := 1, IN1 := 2)", "2"),
        ("INT", "MAX(1, 3, 2)", "3"),
        ("INT", "MIN(3, 1, 2)", "1"),
        ("INT", "LIMIT(0, 5, 3)", "3"),
        ("INT", "LIMIT(MN := 0, IN := -5, MX := 3)", "0"),
        ("INT", "LIMIT(0, 2, 3)", "2"),
        ("INT", "MUX(0, 10, 20, 30)", "10"),
        ("INT", "MUX(2, 10, 20, 30)", "30"),
        ("STRING", "MAX('a', 'b')", "b"),
        ("TIME", "MIN(T#1s, T#1ms)", "T#1ms"),
        ("LREAL", "MAX(1, 2.5)", "2.5"),
    ]);
    assert!(stopped("k : INT := 3; r : INT;", "r := MUX(k, 10, 20, 30);").contains("MUX has no input 3"));
    assert_eq!(only(&program("r : INT;", "r := MAX(1);")), "ST040");
    assert_eq!(only(&program("r : INT;", "r := SEL(1, 1, 2);")), "ST030");
}

#[test]
fn comparison_functions() {
    values(&[
        ("BOOL", "GT(2, 1)", "TRUE"),
        ("BOOL", "GE(1, 1)", "TRUE"),
        ("BOOL", "EQ(1, 2)", "FALSE"),
        ("BOOL", "LE(2, 1)", "FALSE"),
        ("BOOL", "LT(1, 2)", "TRUE"),
        ("BOOL", "NE(1, 2)", "TRUE"),
    ]);
}

#[test]
fn parts_of_strings() {
    values(&[
        ("INT", "LEN('ASTRING')", "7"),
        ("STRING", "LEFT(IN := 'ASTR', L := 3)", "AST"),
        ("STRING", "RIGHT(IN := 'ASTR', L := 3)", "STR"),
        ("STRING", "MID(IN := 'ASTR', L := 2, P := 2)", "ST"),
        ("STRING", "CONCAT('AB', 'CD', 'E')", "ABCDE"),
        ("STRING", "LEFT('AB', 5)", "AB"),
        ("STRING", "RIGHT('AB', 5)", "AB"),
    ]);
    assert!(stopped("n : INT := -1; r : STRING;", "r := LEFT('AB', n);").contains("LEFT has no result"));
    assert!(stopped("n : INT; r : STRING;", "r := MID('AB', 1, n);").contains("MID has no result"));
}

#[test]
fn changes_of_strings() {
    values(&[
        ("STRING", "INSERT(IN1 := 'ABC', IN2 := 'XY', P := 2)", "ABXYC"),
        ("STRING", "DELETE(IN := 'ABXYC', L := 2, P := 3)", "ABC"),
        (
            "STRING",
            "REPLACE(IN1 := 'ABCDE', IN2 := 'X', L := 2, P := 3)",
            "ABXE",
        ),
        ("INT", "FIND(IN1 := 'ABCBC', IN2 := 'BC')", "2"),
        ("INT", "FIND('ABC', 'X')", "0"),
    ]);
    let grows = "FOR i := 1 TO 10 DO a := CONCAT(a, a); END_FOR;";
    let stops = stopped("i : INT; a : STRING[1000] := 'aa';", grows);
    assert!(
        stops.contains("1024 characters does not fit STRING[1000]"),
        "{stops}"
    );
}

#[test]
fn a_call_with_wrong_parameters_is_refused() {
    for (call, code) in [
        ("LIMIT(1, 2)", "ST040"),
        ("LIMIT(MN := 1, IN := 2)", "ST040"),
        ("LIMIT(MN := 1, 2, MX := 3)", "ST040"),
        ("LIMIT(MN := 1, IN := 2, MX := 3, MX := 4)", "ST040"),
        ("LIMIT(MN := 1, IN := 2, M := 3)", "ST040"),
        ("ABS(TRUE)", "ST030"),
        ("FOO(1)", "ST020"),
        ("TON(IN := TRUE)", "ST042"),
    ] {
        assert_eq!(
            only(&program("r : INT;", &format!("r := {call};"))),
            code,
            "{call}"
        );
    }
    assert_eq!(only(&program("r : INT;", "ABS(r);")), "ST040");
    assert_eq!(result("r : INT;", "r := ABS(IN := -5);"), "5");
}
