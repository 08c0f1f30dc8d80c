use super::{only, program, value, values};

#[test]
fn names_have_no_case() {
    assert_eq!(
        super::result(
            "R : INT; Count : INT := 2;",
            "r := COUNT + count; If TRUE tHeN R := r; end_if;"
        ),
        "4"
    );
}

#[test]
fn comments_of_three_kinds_stand_within_each_other() {
    let body = "r := 1; // r := 2;\n(* r := 3; (* r := 4; *) r := 5; *) /* r := 6; /* */ */ r := r + 1;";
    assert_eq!(super::result("r : INT;", body), "2");
    assert_eq!(only(&program("r : INT;", "(* no end")), "ST004");
}

#[test]
fn integer_literals() {
    values(&[
        ("INT", "-12", "-12"),
        ("INT", "0", "0"),
        ("DINT", "123_456", "123456"),
        ("INT", "+986", "986"),
        ("ULINT", "18446744073709551615", "18446744073709551615"),
        ("LINT", "-9223372036854775808", "-9223372036854775808"),
    ]);
    for wrong in ["1__0", "1_", "18446744073709551616", "12a"] {
        assert_eq!(
            only(&program("r : ULINT;", &format!("r := {wrong};"))),
            "ST005",
            "{wrong}"
        );
    }
}

#[test]
fn real_literals() {
    values(&[
        ("LREAL", "-12.0", "-12.0"),
        ("LREAL", "0.4560", "0.456"),
        ("LREAL", "3.14159_26", "3.1415926"),
        ("LREAL", "-1.34E-12", "-1.34e-12"),
        ("LREAL", "1.0e+6", "1000000.0"),
        ("LREAL", "1.234E6", "1234000.0"),
        ("REAL", "0.5", "0.5"),
    ]);
    assert_eq!(only(&program("r : LREAL;", "r := 1.0E999;")), "ST005");
}

#[test]
fn based_literals() {
    values(&[
        ("UINT", "2#1111_1111", "255"),
        ("UINT", "2#1110_0000", "224"),
        ("UINT", "8#377", "255"),
        ("UINT", "8#340", "224"),
        ("UINT", "16#FF", "255"),
        ("UINT", "16#ff", "255"),
        ("UINT", "16#E0", "224"),
    ]);
    for wrong in ["2#12", "8#8", "16#", "3#1"] {
        assert_eq!(
            only(&program("r : UINT;", &format!("r := {wrong};"))),
            "ST005",
            "{wrong}"
        );
    }
}

#[test]
fn bool_literals() {
    values(&[
        ("BOOL", "FALSE", "FALSE"),
        ("BOOL", "true", "TRUE"),
        ("BOOL", "BOOL#0", "FALSE"),
        ("BOOL", "BOOL#1", "TRUE"),
        ("BOOL", "BOOL#TRUE", "TRUE"),
    ]);
    assert_eq!(only(&program("r : BOOL;", "r := BOOL#2;")), "ST005");
    assert_eq!(only(&program("r : BOOL;", "r := 1;")), "ST030");
}

#[test]
fn typed_literals() {
    values(&[
        ("DINT", "DINT#5", "5"),
        ("UINT", "UINT#16#9AF", "2479"),
        ("INT", "INT#-5", "-5"),
        ("LREAL", "REAL#1.5", "1.5"),
        ("REAL", "REAL#2", "2.0"),
        ("WORD", "WORD#16#AFF", "2815"),
        ("STRING", "STRING#'OK'", "OK"),
    ]);
    assert_eq!(only(&program("r : INT;", "r := SINT#200;")), "ST006");
    assert_eq!(only(&program("r : INT;", "r := INT#1.5;")), "ST031");
}

#[test]
fn string_literals() {
    values(&[
        ("STRING", "'A'", "A"),
        ("STRING", "''", ""),
        ("STRING", "' '", " "),
        ("STRING", "'$41$c4'", "A\u{c4}"),
        ("STRING", "'$'\"'", "'\""),
        ("STRING", "'This conveys a \u{2019}'", "This conveys a \u{2019}"),
    ]);
    assert_eq!(only(&program("r : STRING;", "r := 'no end;\n")), "ST004");
    assert_eq!(only(&program("r : STRING;", "r := '$4';")), "ST005");
}

#[test]
fn dollar_sequences() {
    values(&[
        ("STRING", "'$$'", "$"),
        ("STRING", "'$''", "'"),
        ("STRING", "'$L$l$N$n'", "\n\n\n\n"),
        ("STRING", "'$P$R$T'", "\u{c}\r\t"),
    ]);
}

#[test]
fn duration_literals() {
    values(&[
        ("TIME", "T#14ms", "T#14ms"),
        ("TIME", "T#-14ms", "T#-14ms"),
        ("TIME", "T#14.7s", "T#14s700ms"),
        ("TIME", "T#14.7m", "T#14m42s"),
        ("TIME", "T#14.7h", "T#14h42m"),
        ("TIME", "t#14.7d", "T#14d16h48m"),
        ("TIME", "t#25h15m", "T#1d1h15m"),
        ("TIME", "t#12h4m34ms230us400ns", "T#12h4m34ms230us400ns"),
        ("TIME", "t#5d14h12m18s3.5ms", "T#5d14h12m18s3ms500us"),
        ("TIME", "TIME#14ms", "T#14ms"),
        ("TIME", "T#25h_15m", "T#1d1h15m"),
        ("TIME", "time#5d_14h_12m_18s_3.5ms", "T#5d14h12m18s3ms500us"),
        ("TIME", "T#0s", "T#0s"),
    ]);
    for wrong in [
        "T#5",
        "T#1s1h",
        "T#1s1s",
        "T#1.5h3m",
        "T#",
        "T#1y",
        "T#999999999d",
    ] {
        assert_eq!(
            only(&program("r : TIME;", &format!("r := {wrong};"))),
            "ST005",
            "{wrong}"
        );
    }
    assert_eq!(value("TIME", "T#1s500ms"), value("TIME", "T#1.5s"));
}
