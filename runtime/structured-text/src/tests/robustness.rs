use std::fmt::Write;

use plc_api::scan::{Image, ScanProgram};
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};

use crate::Program;
use crate::limits::{CALL_DEPTH_MAX, NESTING_MAX};

const WORDS: [&str; 84] = [
    "PROGRAM",
    "END_PROGRAM",
    "FUNCTION",
    "END_FUNCTION",
    "FUNCTION_BLOCK",
    "END_FUNCTION_BLOCK",
    "VAR",
    "VAR_INPUT",
    "VAR_IN_OUT",
    "VAR_OUTPUT",
    "VAR_TEMP",
    "END_VAR",
    "CONSTANT",
    "TYPE",
    "END_TYPE",
    "STRUCT",
    "END_STRUCT",
    "ARRAY",
    "OF",
    "IF",
    "THEN",
    "ELSIF",
    "ELSE",
    "END_IF",
    "CASE",
    "END_CASE",
    "FOR",
    "TO",
    "BY",
    "DO",
    "END_FOR",
    "WHILE",
    "END_WHILE",
    "REPEAT",
    "UNTIL",
    "END_REPEAT",
    "EXIT",
    "CONTINUE",
    "RETURN",
    "INT",
    "BOOL",
    "LREAL",
    "STRING",
    "TIME",
    "WORD",
    "TON",
    "MCODE",
    "CTU",
    "a",
    "b",
    "c",
    "f",
    "p",
    "x",
    "0",
    "1",
    "-1",
    "16#FF",
    "1.5",
    "T#1s",
    "'s'",
    "TRUE",
    ":=",
    "=>",
    ";",
    ":",
    ",",
    "(",
    ")",
    "[",
    "]",
    ".",
    "..",
    "+",
    "-",
    "*",
    "/",
    "**",
    "MOD",
    "AND",
    "NOT",
    "=",
    "<",
    "#",
];

/// Texts of each kind.
const CASES: u32 = 600;

/// A program that uses most of the language.
const WHOLE: &str = include_str!("whole.st");

fn runner(cases: u32) -> TestRunner {
    let config = Config {
        cases,
        failure_persistence: None,
        ..Config::default()
    };
    TestRunner::new_with_rng(config, TestRng::from_seed(RngAlgorithm::ChaCha, &[7; 32]))
}

/// Compiles a text, and runs it for some scans if it is right.
fn run(source: &str) {
    match Program::compile("fuzz.st", source) {
        Ok(mut program) => {
            for _ in 0..3 {
                program.scan(&mut Image::default());
            }
        }
        Err(findings) => {
            for found in findings {
                let (start, end) = (found.span.start as usize, found.span.end as usize);
                assert!(
                    start <= end && source.get(start..end).is_some(),
                    "{found:?} in {source:?}"
                );
            }
        }
    }
}

#[test]
fn no_text_of_characters_panics() {
    let texts = proptest::string::string_regex("[ -~\u{e4}\u{2019}\n]{0,200}").unwrap();
    runner(CASES)
        .run(&texts, |text| {
            run(&text);
            Ok(())
        })
        .unwrap();
}

#[test]
fn no_text_of_words_panics() {
    let texts = proptest::collection::vec(proptest::sample::select(WORDS.as_slice()), 0..120);
    runner(CASES).run(&texts, |words| {
        run(&words.join(" "));
        run(&format!("PROGRAM p VAR a, b : INT; c : ARRAY[0..3] OF LREAL; x : BOOL; f : TON; END_VAR {} END_PROGRAM", words.join(" ")));
        Ok(())
    }).unwrap();
}

#[test]
fn no_changed_program_panics() {
    run(WHOLE);
    assert!(
        Program::compile("whole.st", WHOLE).is_ok(),
        "{:#?}",
        Program::compile("whole.st", WHOLE).err()
    );
    // pieces of the text: words and the characters between them
    let mut pieces: Vec<&str> = Vec::new();
    let mut rest = WHOLE;
    while let Some(first) = rest.chars().next() {
        let is_word = |letter: char| letter.is_ascii_alphanumeric() || letter == '_';
        let end = rest
            .find(|letter| is_word(letter) != is_word(first))
            .unwrap_or(rest.len());
        pieces.push(&rest[..end]);
        rest = &rest[end..];
    }
    let changes = proptest::collection::vec(
        (
            0..pieces.len(),
            0..3_u8,
            proptest::sample::select(WORDS.as_slice()),
        ),
        1..4,
    );
    runner(CASES)
        .run(&changes, |changes| {
            let mut text = pieces.clone();
            for (place, how, word) in changes {
                match how {
                    0 => text[place] = "",
                    1 => text[place] = word,
                    _ => text.swap(place, (place * 7 + 3) % pieces.len()),
                }
            }
            run(&text.concat());
            Ok(())
        })
        .unwrap();
}

#[test]
fn the_deepest_program_fits_the_stack() {
    let mut text = String::new();
    let deep = NESTING_MAX - 2;
    for number in 0..CALL_DEPTH_MAX - 1 {
        let inner = if number == 0 {
            "1".to_owned()
        } else {
            format!("f{}()", number - 1)
        };
        let mut sum = inner;
        for _ in 0..deep / 2 {
            sum = format!("ABS({sum})");
        }
        let _ = writeln!(text, "FUNCTION f{number} : LINT VAR r : BOOL := TRUE; END_VAR");
        text.push_str(&"IF r THEN ".repeat(deep / 2));
        let _ = write!(text, "f{number} := {sum};");
        text.push_str(&"END_IF;".repeat(deep / 2));
        text.push_str("\nEND_FUNCTION\n");
    }
    let _ = write!(
        text,
        "PROGRAM p VAR r : LINT; END_VAR r := f{}(); END_PROGRAM",
        CALL_DEPTH_MAX - 2
    );
    let program = super::scanned(&text);
    assert_eq!(program.shown("R").unwrap(), "1");
}
