//! Programs for other controls: the help of a finding names the replacement, and the replacement is valid.

#![allow(clippy::panic, reason = "tests")]

use tandem_interp::dialects::{dgshape, nj};
use tandem_interp::{CheckContext, Dialect, check_source};

/// Returns the code and help of the first finding of a block.
fn help(block: &str, dialect: &'static Dialect) -> (&'static str, String) {
    let (_, check) = check_source(format!("{block}\nM30\n"), dialect, &CheckContext::default());
    // the mark of the data is missing in dialect dgshape
    let first = check.diagnostics.into_iter().find(|found| found.code != "E0024");
    first.map_or_else(
        || panic!("{block}: nothing is found"),
        |found| (found.code, found.help),
    )
}

#[test]
fn each_word_of_another_control_has_its_help() {
    for (block, code, begin) in [
        ("M06 T5", "E0007", "Write M06 VA5 for a tool change T5 M06."),
        ("T12 M06", "E0007", "Write M06 VA12 for a tool change T12 M06."),
        ("G43 H1 Z5", "E0007", "Remove it: G43 and G44 take the length"),
        ("G41 D1 X5", "E0007", "Remove it: G41 and G42 take the radius"),
        (
            "O1000",
            "E0007",
            "Remove it: the name of the file is the number, 1000.nc.",
        ),
        ("G00 W5", "E0007", "Write Z: "),
        ("G00 U5", "E0007", "Write X: "),
        ("G00 V5", "E0007", "Write Y: "),
        ("G01 E1", "E0007", "Write the feedrate as F"),
        ("GOTO 10", "E0007", "Write if, switch, while or do"),
        ("END1", "E0007", "Write while (condition) {"),
        ("THEN X5", "E0007", "Remove it: the command follows"),
        ("EQ", "E0007", "Write =="),
        ("NE", "E0007", "Write !="),
        ("GT", "E0007", "Write > "),
        ("GE", "E0007", "Write >="),
        ("LT", "E0007", "Write < "),
        ("LE", "E0007", "Write <="),
        ("MOD", "E0007", "Write %"),
        ("DEGREES", "E0007", "Remove it: the functions sind"),
        ("#5=10", "E0003", "Write L5 for #5, [L5] as the value of a word."),
        (
            "#100=5",
            "E0003",
            "Write Q100 for #100, [Q100] as the value of a word",
        ),
        ("X#101", "E0003", "Write Q101 for #101"),
        ("#3000=1", "E0003", "System variables do not exist"),
        ("#[1]=1", "E0003", "Write L1, Q1 or P1"),
        ("%", "E0003", "Remove the line"),
        ("X1;", "E0003", "Remove it: a block ends with its line."),
        ("G00 X1 (rapid)", "E0003", "Write comments as // or /* */."),
    ] {
        let (found, help) = help(block, nj());
        assert_eq!(found, code, "{block}");
        assert!(help.starts_with(begin), "{block}: {help}");
    }
}

#[test]
fn each_code_of_another_control_has_its_help() {
    for (code, begin) in [
        ("G05", "Write G500"),
        ("G05.1", "Write G500"),
        ("G10", "Remove it: the configuration holds"),
        ("G15", "Remove it: positions are never polar"),
        ("G16", "Calculate X and Y"),
        ("G22", "Remove it: the soft limits"),
        ("G32", "Write G84"),
        ("G33", "Write G84"),
        ("G39", "Remove it: G41 and G42 round"),
        ("G65", "Set Q variables, then call with M98"),
        ("G66", "Write M98 P1000"),
        ("G67", "Remove it"),
        ("G73", "Write the motions"),
        ("G76", "Write the motions"),
        (
            "G81",
            "Write the motions: G00 X_ Y_, G00 to the R point, G01 Z_ F_, G00 up.",
        ),
        ("G82", "Write the motions"),
        ("G83", "Write the motions"),
        ("G85", "Write the motions"),
        ("G86", "Write the motions"),
        ("G87", "Write the motions"),
        ("G88", "Write the motions"),
        ("G89", "Write the motions"),
        ("G92", "Write G52"),
        ("G93", "Calculate F"),
        ("G94", "Remove it"),
        ("G95", "Calculate F"),
        ("G96", "Write the speed"),
        ("G97", "Remove it"),
    ] {
        let (found, help) = help(code, nj());
        assert_eq!(found, "E0101", "{code}");
        assert!(help.starts_with(begin), "{code}: {help}");
    }
    assert!(help("G999", nj()).1.starts_with("Write a G code"));
}

#[test]
fn dialect_dgshape_names_what_it_has_instead_and_its_manual() {
    for (block, begin) in [
        ("#100=5", "Write numbers: the dialect has no variables. See"),
        ("X[1+2]", "Write numbers: the dialect has no calculations. See"),
        ("X=5", "Write numbers: the dialect has no variables. See"),
        ("IF [X]", "Write the blocks that are to be executed"),
        ("GOTO 10", "Write the blocks that are to be executed"),
        ("END 1", "Write the blocks that are to be executed"),
        ("( a hole at (1, 2) )", "Write no ( and ) inside a comment."),
        ("WHILE [X]", "Write the blocks that are to be executed"),
        ("X1;", "Remove it: a block ends with its line."),
        (":1000", "Remove it: a program number is written as O1000,"),
        (
            "X1 {",
            "Remove it, or make it a comment: the dialect has no branches",
        ),
        (
            "X1 /",
            "Write the block skip before the block number and all words. See",
        ),
        ("G00 U5", "Write X"),
        ("G00 V5", "Write Y"),
        ("G00 W5", "Write Z"),
        ("G01 E5", "Write the feedrate as F"),
        ("G00 B5", "Remove it: the axes are X, Y, Z and A."),
        ("G00 C5", "Remove it: the axes are X, Y, Z and A."),
        ("G00 XO", "If a zero is meant"),
    ] {
        let (_, help) = help(block, dgshape());
        assert!(help.starts_with(begin), "{block}: {help}");
    }
}

#[test]
fn dialect_dgshape_says_what_to_write_for_codes_that_it_does_not_have() {
    for (code, found, begin) in [
        ("G05", "E0101", "Remove it: motion"),
        ("G05.1", "E0101", "Remove it: motion"),
        ("G08", "E0101", "Remove it: motion"),
        ("G09", "E0101", "Remove it: motion"),
        ("G61", "E0101", "Remove it: motion"),
        ("G64", "E0101", "Remove it: motion"),
        ("G15", "E0101", "Remove it: positions"),
        ("G16", "E0101", "Calculate X and Y"),
        ("G30", "E0101", "Write G53 X_ Y_ Z_"),
        ("G31", "E0101", "Remove it: the dialect has no probing"),
        ("G38.2", "E0101", "Remove it: the dialect has no probing"),
        ("G44", "E0101", "Write G43"),
        ("G52", "E0101", "Write G10 L2"),
        ("G54.1", "E0101", "Write one of G54 to G59"),
        ("G65", "E0101", "Write the blocks of the macro"),
        ("G66", "E0101", "Write the blocks of the macro"),
        ("G67", "E0101", "Remove it"),
        ("G68", "E0101", "Calculate"),
        ("G69", "E0101", "Remove it"),
        ("G70", "E0101", "Write G20"),
        ("G71", "E0101", "Write G21"),
        ("G73", "E0101", "Write G83"),
        ("G74", "E0101", "Remove it: no cycle taps"),
        ("G84", "E0101", "Remove it: no cycle taps"),
        ("G76", "E0101", "Write G85, G86 or G89"),
        ("G87", "E0101", "Write G85, G86 or G89"),
        ("G88", "E0101", "Write G85, G86 or G89"),
        ("G90.1", "E0101", "Write I, J and K"),
        ("G91.1", "E0101", "Remove it: I, J and K"),
        ("G93", "E0101", "Calculate F"),
        ("G94", "E0101", "Remove it: F is always"),
        ("G95", "E0101", "Calculate F"),
        ("G96", "E0101", "Write the speed"),
        ("G97", "E0101", "Remove it: S"),
        ("M04", "E0104", "Write M03: only M03 starts the spindle"),
        ("M97 P5", "E0104", "Write the blocks of the subprogram"),
        ("M98 P1000", "E0104", "Write the blocks of the subprogram"),
        ("M99", "E0104", "Write M30"),
    ] {
        let (is, help) = help(code, dgshape());
        assert_eq!(is, found, "{code}");
        assert!(help.starts_with(begin), "{code}: {help}");
        assert!(help.ends_with("See 2-7 of the manual."), "{code}: {help}");
    }
}

/// Programs of other controls contain many unknown words; the rest of such a line causes no further finding.
#[test]
fn a_line_of_dialect_dgshape_that_is_no_block_is_one_finding() {
    for line in [
        "G21 ; set units to millimetres, and go on",
        ": set units to mm",
        "#1 = #2 + 3.5",
        "X[#<_z> + 5] Y[#6]",
        "IF [#1 GT 5] GOTO 100",
        "WHILE [#1 LT 2] DO1",
        "o100 sub",
        "MSG, load the tool",
        "Absolute positioning on",
        "G00 X10, Y20, Z5",
        "( a hole at (61.045, 67.745) )",
        "G00 X10. (from (9.15, 18.5) to (9.15, 57.5) in cut(s))",
        "G10 L12 P10 R3.0",
        "END1",
    ] {
        let text = format!("%\nG21\n{line}\nM30\n");
        let (_, check) = check_source(text, dgshape(), &CheckContext::default());
        assert_eq!(check.diagnostics.len(), 1, "{line}: {:?}", check.diagnostics);
    }
}

#[test]
fn a_word_that_no_code_takes_names_the_codes_that_do() {
    for (block, begin) in [
        ("T5", "Remove T, or write M06 with it."),
        ("D1 X5", "Remove D, or write G41 or G42 with it."),
        ("H1 Z5", "Remove H, or write G43 with it."),
        ("Q1", "Remove Q, or write G83 with it."),
        ("L2", "Remove L, or write G10 with it."),
    ] {
        let (code, help) = help(block, dgshape());
        assert_eq!(code, "E0108", "{block}");
        assert!(help.starts_with(begin), "{block}: {help}");
    }
}

#[test]
fn the_end_that_is_missing_names_the_codes_that_the_dialect_has() {
    let (code, end) = {
        let (_, check) = check_source("%\nG21\n".to_owned(), dgshape(), &CheckContext::default());
        let first = check
            .diagnostics
            .first()
            .map(|found| (found.code, found.help.clone()));
        first.unwrap_or_default()
    };
    assert_eq!(code, "E0115");
    assert_eq!(
        end,
        "Write M30 in the last block, without block skip. See 2-3, M02 of the manual."
    );
    let (_, check) = check_source("G21\n".to_owned(), nj(), &CheckContext::default());
    let nj_help = check.diagnostics.first().map(|found| found.help.clone());
    assert_eq!(
        nj_help.as_deref(),
        Some(
            "Write M30 in the last block of a main program, M99 in that of a subprogram, without block skip."
        )
    );
}

/// Returns true if a test names the word, with or without the leading zero of its number.
fn proved(own: &str, name: &str) -> bool {
    let (letter, number) = name.split_at(1);
    own.contains(&format!("\"{name}")) || own.contains(&format!("\"{letter}0{number}")) || own.contains(name)
}

/// Checks that a test of this file covers every row of the table.
#[test]
fn no_row_is_without_a_test() {
    let own = include_str!("foreign.rs");
    for dialect in [nj(), dgshape()] {
        for (name, _) in (dialect.grammar)().foreign {
            assert!(proved(own, name), "{name}");
        }
    }
}

#[test]
fn what_the_help_says_is_right() {
    let text = "L1 = 10 * cosd(30)\nG00 X[L1]\nQ1 = 5\nM98 P1000\nM06 VA5\nQ100 = 5\nG01 X[Q100] F100\nif (L1 == 2) X5\nwhile (L1 < 2) {\nL1 = L1 + 1\n}\nG500\nG501\nG52 X1 Y2 Z3\nM19\nM30\n";
    let (_, check) = check_source(text, nj(), &CheckContext::default());
    let errors: Vec<_> = check
        .diagnostics
        .iter()
        .filter(|found| found.is_error())
        .collect();
    assert!(errors.is_empty(), "{errors:?}");
}
