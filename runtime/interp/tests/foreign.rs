//! Programs for other controls: the help says what to write here, and what it says is right.

#![allow(clippy::panic, reason = "tests")]

use tandem_interp::dialects::{dgshape, nj};
use tandem_interp::{CheckContext, Dialect, check_source};

/// Code and help of the first finding of a block.
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
        ("#3000=1", "E0003", "There are no system variables"),
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
        ("X1;", "Remove it: a block ends with its line."),
        ("G00 U5", "Write X"),
        ("G00 V5", "Write Y"),
        ("G00 W5", "Write Z"),
        ("G01 E5", "Write the feedrate as F"),
    ] {
        let (_, help) = help(block, dgshape());
        assert!(help.starts_with(begin), "{block}: {help}");
    }
}

/// Every row of the table is proved above.
#[test]
fn no_row_is_without_a_test() {
    let own = include_str!("foreign.rs");
    for dialect in [nj(), dgshape()] {
        for (name, _) in (dialect.grammar)().foreign {
            let with_zero = name.replace("G5", "G05");
            assert!(own.contains(with_zero.as_str()), "{name}");
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
