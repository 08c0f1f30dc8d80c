use std::fmt::Write;

use super::{found, only, program};

#[test]
fn what_is_outside_the_subset_is_refused_with_what_to_do() {
    for source in [
        "PROGRAM p VAR RETAIN n : INT; END_VAR END_PROGRAM",
        "VAR_GLOBAL n : INT; END_VAR",
        "CONFIGURATION c END_CONFIGURATION",
        "PROGRAM p VAR n AT %IX0.0 : BOOL; END_VAR END_PROGRAM",
        "PROGRAM p VAR n : POINTER TO INT; END_VAR END_PROGRAM",
        "PROGRAM p VAR n : REF_TO INT; END_VAR END_PROGRAM",
        "PROGRAM p VAR n : WSTRING; END_VAR END_PROGRAM",
        "PROGRAM p VAR n : DATE; END_VAR END_PROGRAM",
        "PROGRAM p VAR n : INT(0..5); END_VAR END_PROGRAM",
        "CLASS c END_CLASS",
        "{pragma}",
        "FUNCTION_BLOCK f EXTENDS g END_FUNCTION_BLOCK",
    ] {
        let codes = found(source);
        assert_eq!(
            codes.first().map(|(code, _)| *code),
            Some("ST012"),
            "{source}: {codes:?}"
        );
    }
    for body in [
        "%QX0.0 := TRUE;",
        "a := b.%X3;",
        "a := b.3;",
        "a := T#1s + LT#1s;",
        "a := D#2026-01-01;",
        "a := \"wide\";",
        "JMP x;",
    ] {
        let codes = found(&program("a, b : WORD;", body));
        assert!(
            codes.iter().any(|(code, _)| *code == "ST012"),
            "{body}: {codes:?}"
        );
    }
    assert_eq!(only(&program("t : TON;", "t(EN := TRUE, IN := TRUE);")), "ST012");
    assert_eq!(
        only(&program("t : TON; a : BOOL;", "t(IN := TRUE, NOT Q => a);")),
        "ST012"
    );
}

#[test]
fn all_mistakes_of_a_text_are_told_with_their_lines() {
    let source = "PROGRAM p\nVAR a : INT; b : BOOL; END_VAR\na := b;\nc := 1;\nIF a THEN\n  b := 5;\nEND_IF;\na := ;\nb := TRUE\nEND_PROGRAM\n";
    let codes = found(source);
    assert_eq!(
        codes,
        [
            ("ST031", 3),
            ("ST020", 4),
            ("ST031", 5),
            ("ST030", 6),
            ("ST010", 8),
            ("ST010", 9)
        ]
    );
}

#[test]
fn every_finding_says_what_to_do() {
    let source =
        "PROGRAM p VAR a : INT; END_VAR a := b; a := TRUE; x(); FOR a := 1 TO TRUE DO END_FOR; END_PROGRAM ?";
    for found in crate::Program::compile("a.st", source).unwrap_err() {
        assert!(!found.message.is_empty() && !found.help.is_empty(), "{found:?}");
        assert!(crate::FindingEntry::find(found.code).is_some(), "{found:?}");
    }
}

#[test]
fn a_wrong_declaration_is_one_finding_and_not_one_for_each_use() {
    assert_eq!(
        only(&program(
            "a : FOO; b : INT;",
            "a := 1; a := a + 1; a(); b := a.c;"
        )),
        "ST020"
    );
}

#[test]
fn names_are_declared_once_and_are_no_words_of_the_language() {
    assert_eq!(only(&program("a : INT; A : BOOL;", "")), "ST021");
    assert_eq!(only(&program("if : INT;", "")), "ST022");
    assert_eq!(only(&program("ton : INT;", "")), "ST022");
    assert_eq!(
        only("FUNCTION f END_FUNCTION FUNCTION f END_FUNCTION PROGRAM p END_PROGRAM"),
        "ST021"
    );
}

#[test]
fn a_text_has_one_program() {
    assert_eq!(only(""), "ST060");
    assert_eq!(only("PROGRAM a END_PROGRAM PROGRAM b END_PROGRAM"), "ST060");
}

#[test]
fn m_codes_and_coordinate_systems_are_constants_in_their_ranges() {
    for (call, code) in [
        ("MCODE(M := 10)", "ST042"),
        ("m(M := n)", "ST033"),
        ("m(M := 30)", "ST061"),
        ("m(M := 192)", "ST061"),
        ("m(M := 10, CS := 9)", "ST061"),
        ("m()", "ST040"),
    ] {
        let source = program("m : MCODE; n : UINT;", &format!("{call};"));
        assert_eq!(only(&source), code, "{call}");
    }
    assert_eq!(only(&program("r : LREAL; n : UDINT;", "r := P(n);")), "ST033");
    assert_eq!(only(&program("r : LREAL;", "r := P(32768);")), "ST061");
    assert_eq!(only(&program("r : LREAL;", "r := Q(9, 1);")), "ST061");
    assert_eq!(only(&program("m : MCODE;", "m.M := 5;")), "ST032");
    let asks = |m: u16| {
        program(
            "m : MCODE; q : QUESTION;",
            &format!("m(M := 80); q(M := {m}, Ask := m.Active);"),
        )
    };
    super::compiled(&asks(80));
    assert_eq!(only(&asks(81)), "ST061");
}

#[test]
fn limits_are_refused_with_their_numbers() {
    let deep = |count: usize| {
        program(
            "a : BOOL;",
            &format!("a := {}a{};", "(".repeat(count), ")".repeat(count)),
        )
    };
    super::compiled(&deep(30));
    assert_eq!(only(&deep(100)), "ST011");
    let ifs = |count: usize| {
        program(
            "a : BOOL;",
            &format!("{}{}", "IF a THEN ".repeat(count), "END_IF;".repeat(count)),
        )
    };
    super::compiled(&ifs(38));
    assert!(found(&ifs(100)).iter().any(|(code, _)| *code == "ST011"));
    let row = |count: usize| program("a : LINT;", &format!("a := a{};", " + a".repeat(count)));
    super::compiled(&row(39));
    assert_eq!(only(&row(40)), "ST011");
    assert_eq!(only(&program("a : ARRAY[1..100001] OF INT;", "")), "ST001");
    assert_eq!(
        only(&program(
            "a : ARRAY[1..60000] OF INT; b : ARRAY[1..60000] OF INT;",
            ""
        )),
        "ST001"
    );
    assert_eq!(only(&program("a : ARRAY[1..2000] OF STRING[1000];", "")), "ST001");
    assert_eq!(
        only(&program(
            "a : ARRAY[-9223372036854775808..9223372036854775807, 1..9] OF INT;",
            ""
        )),
        "ST001"
    );
    assert_eq!(only(&" ".repeat(1024 * 1024 + 1)), "ST001");
    let many = "x := 1;\n".repeat(200);
    let codes = found(&program("", &many));
    assert_eq!(
        (codes.len(), codes.last().map(|(code, _)| *code)),
        (101, Some("ST002"))
    );
}

#[test]
fn calls_go_10_deep() {
    let chain = |count: usize| {
        let mut text = "FUNCTION f0 : INT f0 := 1; END_FUNCTION\n".to_owned();
        for number in 1..count {
            let _ = writeln!(
                text,
                "FUNCTION f{number} : INT f{number} := f{}(); END_FUNCTION",
                number - 1
            );
        }
        format!(
            "{text}PROGRAM p VAR r : INT; END_VAR r := f{}(); END_PROGRAM",
            count - 1
        )
    };
    assert_eq!(super::scanned(&chain(9)).shown("R").unwrap(), "1");
    assert_eq!(only(&chain(10)), "ST011");
}

#[test]
fn variables_behind_too_many_are_one_finding_and_take_no_time() {
    let mut variables = String::new();
    for number in 0..20_000 {
        let _ = write!(variables, "v{number} : ARRAY[1..90000] OF INT;");
    }
    assert_eq!(only(&program(&variables, "v7[1] := 1;")), "ST001");
}
