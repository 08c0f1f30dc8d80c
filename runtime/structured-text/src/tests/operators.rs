use super::{only, program, result, values};

#[test]
fn operators_bind_as_in_the_table() {
    values(&[
        ("INT", "2 + 3 * 4", "14"),
        ("INT", "(2 + 3) * 4", "20"),
        ("INT", "20 - 5 - 3", "12"),
        ("INT", "100 / 10 / 2", "5"),
        ("INT", "7 MOD 4 * 2", "6"),
        ("INT", "-2 * -3", "6"),
        ("LREAL", "2.0 * 3.0 ** 2.0", "18.0"),
        ("LREAL", "(-2.0) ** 2.0", "4.0"),
        ("LREAL", "2.0 ** 10", "1024.0"),
        ("BOOL", "NOT FALSE AND FALSE", "FALSE"),
        ("BOOL", "TRUE OR TRUE AND FALSE", "TRUE"),
        ("BOOL", "TRUE OR TRUE XOR TRUE", "TRUE"),
        ("BOOL", "TRUE XOR TRUE AND FALSE", "TRUE"),
        ("BOOL", "TRUE & FALSE", "FALSE"),
        ("BOOL", "1 + 1 = 2", "TRUE"),
        ("BOOL", "1 < 2 = TRUE", "TRUE"),
        ("BOOL", "3 > 2 AND 2 > 1", "TRUE"),
    ]);
    assert_eq!(only(&program("r, a : LREAL;", "r := -a ** 2.0;")), "ST010");
    assert_eq!(only(&program("r, a : LREAL;", "r := a ** 2.0 ** 3.0;")), "ST010");
}

#[test]
fn integer_division_goes_towards_zero() {
    for (a, b, quotient, rest) in [
        (7, 2, "3", "1"),
        (-7, 2, "-3", "-1"),
        (7, -2, "-3", "1"),
        (-7, -2, "3", "-1"),
    ] {
        let variables = format!("a : INT := {a}; b : INT := {b}; r : INT;");
        assert_eq!(result(&variables, "r := a / b;"), quotient);
        assert_eq!(result(&variables, "r := a MOD b;"), rest);
    }
    assert_eq!(result("a : INT := 7; b, r : INT;", "r := a MOD b;"), "0");
    assert_eq!(only(&program("r : LREAL;", "r := 1.5 MOD 1.0;")), "ST030");
}

#[test]
fn and_and_or_end_early() {
    let variables = "a : ARRAY[1..2] OF BOOL; n : INT := 3; r : BOOL;";
    assert_eq!(result(variables, "r := n <= 2 AND a[n];"), "FALSE");
    assert_eq!(result(variables, "r := n > 2 OR a[n];"), "TRUE");
}

#[test]
fn comparisons() {
    values(&[
        ("BOOL", "1 < 2", "TRUE"),
        ("BOOL", "2 <= 2", "TRUE"),
        ("BOOL", "2 > 2", "FALSE"),
        ("BOOL", "2 >= 3", "FALSE"),
        ("BOOL", "2 <> 3", "TRUE"),
        ("BOOL", "1.5 = 1.5", "TRUE"),
        ("BOOL", "'abc' < 'abd'", "TRUE"),
        ("BOOL", "'B' > 'A'", "TRUE"),
        ("BOOL", "T#1s = T#1000ms", "TRUE"),
        ("BOOL", "T#2s < T#1m", "TRUE"),
        ("BOOL", "TRUE = FALSE", "FALSE"),
    ]);
    assert_eq!(
        result("a : SINT := -1; b : USINT := 255; r : BOOL;", "r := a < b;"),
        "TRUE"
    );
    assert_eq!(result("a : SINT := -1; r : BOOL;", "r := a < 1000;"), "TRUE");
    assert_eq!(only(&program("r : BOOL;", "r := 'a' = 1;")), "ST030");
    assert_eq!(
        only(&program("a : LINT; b : ULINT; r : BOOL;", "r := a < b;")),
        "ST030"
    );
}

#[test]
fn types_become_wider_by_themselves_only() {
    for (from, to) in [
        ("SINT", "INT"),
        ("INT", "DINT"),
        ("DINT", "LINT"),
        ("USINT", "UINT"),
        ("UINT", "UDINT"),
        ("UDINT", "ULINT"),
        ("USINT", "INT"),
        ("UINT", "DINT"),
        ("UDINT", "LINT"),
        ("INT", "REAL"),
        ("UINT", "REAL"),
        ("DINT", "LREAL"),
        ("UDINT", "LREAL"),
        ("REAL", "LREAL"),
        ("BYTE", "WORD"),
        ("WORD", "DWORD"),
        ("DWORD", "LWORD"),
    ] {
        super::compiled(&program(&format!("a : {from}; b : {to};"), "b := a;"));
        let code = only(&program(&format!("a : {from}; b : {to};"), "a := b;"));
        assert_eq!(code, "ST031", "{to} to {from}");
    }
    for (from, to) in [
        ("INT", "UINT"),
        ("INT", "USINT"),
        ("DINT", "REAL"),
        ("LINT", "LREAL"),
        ("WORD", "INT"),
        ("BOOL", "INT"),
    ] {
        assert_eq!(
            only(&program(&format!("a : {from}; b : {to};"), "b := a;")),
            "ST031",
            "{from} to {to}"
        );
    }
    assert_eq!(only(&program("a : BOOL; b : TIME;", "b := a;")), "ST030");
    assert_eq!(result("a : SINT := 100; r : INT;", "r := a + 1000;"), "1100");
    assert_eq!(result("a : INT := 1; r : REAL;", "r := a * 0.5;"), "0.5");
}

#[test]
fn times_are_added_and_scaled() {
    values(&[
        ("TIME", "T#1s + T#500ms", "T#1s500ms"),
        ("TIME", "T#1s - T#2s", "T#-1s"),
        ("TIME", "T#100ms * 3", "T#300ms"),
        ("TIME", "T#1s * 1.5", "T#1s500ms"),
        ("TIME", "T#1s / 4", "T#250ms"),
        ("TIME", "ADD_TIME(T#1s, T#1s)", "T#2s"),
        ("TIME", "-T#5s", "T#-5s"),
    ]);
    assert_eq!(only(&program("r : TIME;", "r := T#1s * T#1s;")), "ST030");
    assert_eq!(only(&program("r : TIME;", "r := T#1s + 5;")), "ST030");
}
