//! Formatting of programs without errors: generated ones, and the examples. `robustness.rs` covers programs
//! with errors.
#![allow(clippy::unwrap_used, reason = "tests")]

mod properties;
mod random;

use std::fmt::Write as _;
use std::path::Path;

use properties::the_layout_changes_only_blanks_and_case as examine;
use random::Random;
use tandem_interp::Dialect;
use tandem_interp::dialects::{dgshape, nj};
use tandem_syntax::{format, parse};

const BLANKS: &[&str] = &["", " ", "  ", "\t", " \t "];
const VALUES: &[&str] = &["1", "-2.50", "+3", ".5", "4.", "0", "-.125"];

fn expression(random: &mut Random, depth: usize) -> String {
    let blank = random.of(BLANKS);
    match random.below(if depth > 3 { 2 } else { 8 }) {
        0 => format!("{blank}{}", random.of(&["1", "2.5", ".5", "+3"])),
        1 => format!(
            "{blank}{}",
            random.of(&["l1", "Q20", "p300", "_cnc_CapturedPosition1"])
        ),
        2 => format!("{blank}({}{blank})", expression(random, depth + 1)),
        3 => format!("-{}", expression(random, depth + 1)),
        4 => {
            let name = random.of(&["sin", "SQRT", "Abs", "log10"]);
            format!("{blank}{name}{blank}({})", expression(random, depth + 1))
        }
        5 => {
            let (y, x) = (expression(random, depth + 1), expression(random, depth + 1));
            format!("{blank}atan2{blank}({y}{blank},{x})")
        }
        _ => {
            let operator = random.of(&["+", "-", "*", " / ", "%", "/ /* by */"]);
            let left = expression(random, depth + 1);
            format!("{left}{blank}{operator}{}", expression(random, depth + 1))
        }
    }
}

fn condition(random: &mut Random, depth: usize) -> String {
    let blank = random.of(BLANKS);
    match random.below(if depth > 1 { 2 } else { 5 }) {
        0 | 1 => {
            let operator = random.of(&["==", "!=", "<", ">=", ">"]);
            let left = expression(random, 2);
            format!("{left}{blank}{operator}{}", expression(random, 2))
        }
        2 => format!("{blank}!{blank}({})", condition(random, depth + 1)),
        3 => format!("isnan({})", expression(random, 2)),
        _ => {
            let operator = random.of(&["&&", "||"]);
            let (left, right) = (condition(random, depth + 1), condition(random, depth + 1));
            format!("({left}){blank}{operator}({right})")
        }
    }
}

/// A block of words with a line feed or without.
fn words(random: &mut Random, addresses: &[&str]) -> String {
    let mut text = String::new();
    for _ in 0..=random.below(4) {
        let (before, within) = (random.of(BLANKS), random.of(BLANKS));
        let _ = write!(
            text,
            "{before}{}{within}{}",
            random.of(addresses),
            random.of(VALUES)
        );
    }
    text
}

fn command_of_nj(random: &mut Random, depth: usize) -> String {
    let addresses = &["x", "Y", "z", "G", "m", "f", "Va", "vb", "TA", "i"];
    let line = random.of(&["\n", "\r\n", "\n\n", " // Note  x\n", "/* a\n  B */\n"]);
    match random.below(if depth > 3 { 3 } else { 9 }) {
        0 => format!("{}{line}", words(random, addresses)),
        1 => format!(
            "{}{}{line}",
            random.of(&["/", "/2", "n10", "/1/31 "]),
            words(random, addresses)
        ),
        2 => format!("{}={}\n", random.of(&["L1", "q2", "P 3"]), expression(random, 0)),
        3 => {
            let (condition, command) = (condition(random, 0), command_of_nj(random, depth + 1));
            format!("IF ({condition}){line}{command}")
        }
        4 => {
            let condition = condition(random, 0);
            let (yes, no) = (
                commands_of_nj(random, depth + 1),
                command_of_nj(random, depth + 1),
            );
            format!("if({condition}){line}{{{line}{yes}}}{line}ELSE {no}")
        }
        5 => format!(
            "while({}){{\n{}}}{line}",
            condition(random, 0),
            commands_of_nj(random, depth + 1)
        ),
        6 => format!(
            "do {}while({}){line}",
            command_of_nj(random, depth + 1),
            condition(random, 0)
        ),
        7 => {
            let (one, other) = (
                commands_of_nj(random, depth + 1),
                commands_of_nj(random, depth + 1),
            );
            format!(
                "switch({}){line}{{\ncase -1 :{line}{one}break\ndefault:{other}}}\n",
                expression(random, 2)
            )
        }
        _ => format!("x[{}]\n", random.of(&["L1", " q2 ", "_CNC_CapturedPosition0"])),
    }
}

fn commands_of_nj(random: &mut Random, depth: usize) -> String {
    (0..=random.below(3))
        .map(|_| command_of_nj(random, depth))
        .collect()
}

fn program_of_nj(random: &mut Random) -> String {
    (0..4).map(|_| command_of_nj(random, 0)).collect()
}

fn program_of_dgshape(random: &mut Random) -> String {
    let addresses = &["x", "Y", "z", "G", "m", "f", "T", "h", "D", "r"];
    let mut text = format!("{}%{}\no12 (plate  A)\n", random.of(BLANKS), random.of(BLANKS));
    for _ in 0..=random.below(6) {
        let begin = random.of(&["", "/", "N10", "n20 ", "(c) "]);
        let end = random.of(&["\n", "\r\n", "   ( Note )\n", "(x)\n\n"]);
        let _ = write!(text, "{begin}{}{end}", words(random, addresses));
    }
    text + random.of(&["", "%", "%\n rest  (of\n"])
}

#[test]
fn programs_made_at_random_keep_their_code() {
    let mut random = Random(0x51ed_2700_0000_0011);
    for (dialect, program) in [
        (nj(), program_of_nj as fn(&mut Random) -> String),
        (dgshape(), program_of_dgshape),
    ] {
        let grammar = (dialect.grammar)();
        let right = |text: &String| format(text, grammar).is_ok();
        let mut laid_out = 0;
        for _ in 0..1500 {
            let text = program(&mut random);
            laid_out += usize::from(right(&text));
            examine(&text);
        }
        assert!(
            laid_out > 500,
            "only {laid_out} programs of {} have no errors",
            grammar.name
        );
    }
}

#[test]
fn examples_keep_their_code() {
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/nc");
    let read = |folder: &Path, dialect: &'static Dialect| {
        let mut files = 0;
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_file() {
                let text = std::fs::read_to_string(&path).unwrap();
                let (_, found) = parse(text.as_str(), (dialect.grammar)());
                assert!(found.is_empty(), "{}: {found:?}", path.display());
                examine(&text);
                // without the blanks that may be missing
                examine(&text.replace(" G", "g").replace(" X", "x").replace(" F", "\tf"));
                files += 1;
            }
        }
        assert!(files > 0, "{}", folder.display());
    };
    read(&examples, nj());
    read(&examples.join("dgshape"), dgshape());
}
