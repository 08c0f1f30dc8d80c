//! Texts of a dialect: for codes whose effect differs from other dialects, and for diagnostics whose rule or
//! example differs.

use tandem_syntax::DiagnosticEntry;

use crate::codes::{Code, WordSpec};
use crate::dialect::{Dialect, Numbers};
use crate::numbers;

/// Texts of a dialect that replace the default texts of codes and diagnostics.
#[derive(Debug, Clone, Copy)]
pub struct Texts {
    /// Code, name and effect; an empty text selects the default text of the code.
    pub codes: &'static [(&'static str, &'static str, &'static str)],
    /// Number of the diagnostic, its rule, and its example.
    pub diagnostics: &'static [(&'static str, &'static str, &'static str)],
}

/// Texts of a dialect that uses only the default texts.
pub static NO_TEXTS: Texts = Texts {
    codes: &[],
    diagnostics: &[],
};

/// Texts of dialect dgshape that differ from the default texts.
pub static DGSHAPE: Texts = Texts {
    codes: &[
        (
            "G00",
            "Positioning",
            "Moves along a straight line to the target, as fast as the motors can together; F has no effect. \
             It is never blended with another motion. In force at start-up.",
        ),
        (
            "G01",
            "",
            "Moves along a straight line at the feedrate F. If A moves, F is the speed of the surface about \
             A at the tool (D58).",
        ),
        (
            "G02",
            "Clockwise circular interpolation",
            "Moves clockwise on an arc of the selected plane, with the centre I, J, K from the start point \
             in G90 and G91 alike, or the radius R: positive for up to a half circle, negative for more, 0 \
             for a straight line. If the target is the start point, or no target in the plane is given, I, \
             J, K give a full circle. X, Y or Z outside the plane moves linearly in the angle; A does not \
             move. With R, I, J and K have no effect.",
        ),
        ("G03", "Counterclockwise circular interpolation", ""),
        (
            "G17",
            "Select X-Y plane",
            "Selects the XY plane for arcs, and for tool-diameter offset and fixed cycles, which are \
             possible in this plane only. In force at start-up.",
        ),
        ("G18", "Select Z-X plane", "Selects the ZX plane for arcs."),
        ("G19", "Select Y-Z plane", "Selects the YZ plane for arcs."),
        (
            "G20",
            "",
            "Lengths and feedrates from this block on are in inches and inches a minute, `max_feedrate` and \
             `default_feedrate` of the coordinate system too. Motor limits, soft limits, work offsets and tools stay in mm \
             (D25).",
        ),
        ("G21", "Millimeter input", ""),
        ("G28", "Reference-point return", ""),
        (
            "G40",
            "Cancel tool-diameter offset",
            "Switches tool-diameter offset off; the next G00 or G01 that moves in the XY plane leads out. \
             Until then, a block that waits or ends the program is an error. In force at start-up.",
        ),
        ("G41", "Tool-diameter offset, left", ""),
        ("G42", "Tool-diameter offset, right", ""),
        ("G43", "Tool-length offset", ""),
        ("G49", "Cancel tool-length offset", ""),
        ("G53", "Movement in the machine coordinate system", ""),
        ("G80", "Cancel fixed cycle", ""),
        (
            "M02",
            "",
            "Ends the program. Blocks after it are not executed; the next start begins at line 1.",
        ),
        (
            "M30",
            "",
            "Ends the program. Blocks after it are not executed; the next start begins at line 1.",
        ),
        (
            "M",
            "",
            "Makes an output at the start of its block, which needs a reset. The program continues without \
             waiting for the reset, unless the configuration has `timing = \"after_motion\"`.",
        ),
    ],
    diagnostics: &[
        (
            "E0001",
            "A program is at most 64 MiB of text. The program was not read.",
            "Split the program, and run its parts one after the other.",
        ),
        (
            "E0004",
            "A comment that begins with ( ends with the next ), on the same line.",
            "wrong: (roughing   right: (roughing)",
        ),
        (
            "E0005",
            "A word is an address and a number.",
            "wrong: G01 X Y10.   right: G01 X0 Y10.",
        ),
        (
            "E0007",
            "The dialect has the addresses of the manual's list of words (2-7).",
            "wrong: G01 W10.   right: G01 Z10.",
        ),
        (
            "E0008",
            "Block skip has no number.",
            "wrong: /2 X10.   right: /X10.",
        ),
        (
            "E0009",
            "Block skip comes first in its line, also before the block number.",
            "wrong: N10 / X10.   right: / N10 X10.",
        ),
        (
            "E0104",
            "The dialect has the M codes of the manual's list (2-7), and those with a table m_code in the configuration.",
            "wrong: M08   right: M08, with [m_code.8] in the configuration",
        ),
        (
            "E0106",
            "If a block has two codes of a modal group, the last one is used. Codes that are valid only in their block exclude each other.",
            "wrong: G28 G92 X0   right: G28 X0 and G92 X0 in blocks of their own",
        ),
        (
            "E0107",
            "A block makes at most one output. The manual does not define the order of two M codes.",
            "wrong: M12 M14   right: M12 and M14 in blocks of their own",
        ),
        (
            "E0109",
            "The manual gives the ranges of numbers with and without a decimal point (2-1), and those of words (2-2).",
            "wrong: X10000.   right: X9999.999",
        ),
        (
            "E0110",
            "D, H, K, L, N, S and T have no decimal point. P has one only as a factor.",
            "wrong: G41 D1.   right: G41 D1",
        ),
        (
            "E0111",
            "Some codes need a certain word: M06 needs T.",
            "wrong: M06   right: M06 T1",
        ),
        (
            "E0113",
            "G04 takes one of X and P.",
            "wrong: G04 P500 X1.   right: G04 P500",
        ),
        (
            "E0115",
            "A program ends with M02 or M30, in a block that is never skipped.",
            "Write M30 in the last block.",
        ),
        (
            "E0118",
            "The text does not show to which of the codes the value belongs.",
            "wrong: G51 G04 P500   right: G51 P2. and G04 P500 in blocks of their own",
        ),
        (
            "E0119",
            "Tool-diameter offset begins and ends with G00 or G01 in the XY plane. In between, the plane, \
             the side and the number stay. G10, G28, G50, G51, G53 to G59, G80 to G89 and G92 are not \
             allowed there, nor blocks that wait or end the program.",
            "wrong: G41 D1 and then G54   right: G40 and a lead-out before G54",
        ),
        (
            "E0120",
            "G53 needs G49 before it. Without axis words, G49 moves Z down by the offset.",
            "wrong: G43 H1 and then G53 Z0   right: G43 H1, then G90 G49 Z50., and then G53 Z0",
        ),
        (
            "E0121",
            "Fixed cycles drill along Z: the XY plane must be selected, and the spindle must turn.",
            "wrong: G81 X1. Z-5. R2. before M03   right: M03 before G81",
        ),
        (
            "E0122",
            "G02 and G03 need the centre by I, J, K of the plane in force, or the radius R. R is at least \
             half the distance from start to end (D26).",
            "wrong: G02 X10. Y0   right: G02 X10. Y0 R5.",
        ),
        (
            "W0002",
            "Nothing after M02 or M30 is executed.",
            "Remove the blocks, or move the end below them.",
        ),
        (
            "W0006",
            "Block skip skips the words of its own line. Without words on the line, it has no effect.",
            "wrong: / on a line of its own   right: /X10.",
        ),
        (
            "W0009",
            "The codes in force at this block depend on a block that may be skipped. On the path that the \
             message names, the block has the error in parentheses, and an alarm stops the machine there.",
            "wrong: /G02 X1. R5. and then X3. R5.   right: G02 X3. R5.",
        ),
        (
            "W0018",
            "A motion at the feedrate without F before it or in its block takes default_feedrate of the \
             coordinate system. If that is 0, which is its default, the motion is alarm 101; with --config, \
             the check reports E0126.",
            "wrong: G01 X10.   right: G01 X10. F300.",
        ),
    ],
};

impl Dialect {
    fn own(&self, code: &Code) -> Option<&'static (&'static str, &'static str, &'static str)> {
        self.texts.codes.iter().find(|(own, ..)| *own == code.code)
    }

    /// Returns the name of a code in the dialect.
    pub fn name_of(&self, code: &Code) -> &'static str {
        let own = self.own(code).map(|(_, name, _)| *name);
        own.filter(|name| !name.is_empty()).unwrap_or(code.name)
    }

    /// Returns the effect of a code in the dialect.
    pub fn docs_of(&self, code: &Code) -> &'static str {
        let own = self.own(code).map(|(.., docs)| *docs);
        own.filter(|docs| !docs.is_empty()).unwrap_or(code.docs)
    }

    /// Returns the words that a code takes, without those whose address the dialect does not have.
    pub fn words_of(&self, code: &Code) -> impl Iterator<Item = &'static WordSpec> {
        let known = (self.grammar)().addresses;
        code.words.iter().filter(move |word| known.contains(word.address))
    }

    /// Returns the range of a word's numbers, with its unit, as programs write them.
    pub fn range_text(&self, word: &WordSpec) -> String {
        match self.policy.numbers {
            Numbers::AsWritten => word.range_text(),
            Numbers::Counted => numbers::written_range(word),
        }
    }

    /// Returns the rule and the example of a diagnostic in the dialect.
    pub fn explained(&self, entry: &DiagnosticEntry) -> (&'static str, &'static str) {
        let mut own = self.texts.diagnostics.iter();
        let own = own.find(|(code, ..)| *code == entry.code);
        own.map_or((entry.explanation, entry.example), |(_, rule, example)| {
            (rule, example)
        })
    }
}

#[cfg(test)]
mod tests {
    use tandem_syntax::DIAGNOSTICS;

    use crate::dialects::{dgshape, nj};

    #[test]
    fn own_texts_are_of_codes_and_diagnostics_that_there_are_each_once() {
        for dialect in [nj(), dgshape()] {
            let codes = dialect.g_codes.codes.iter().chain(dialect.m_codes.codes);
            let codes: Vec<_> = codes.chain([&dialect.auxiliary]).map(|code| code.code).collect();
            for (index, (code, name, docs)) in dialect.texts.codes.iter().enumerate() {
                assert!(codes.contains(code), "{code}");
                assert!(!(name.is_empty() && docs.is_empty()), "{code}");
                let mut later = dialect.texts.codes[index + 1..].iter();
                assert!(later.all(|(other, ..)| other != code), "{code}");
            }
            let known: Vec<_> = DIAGNOSTICS.iter().map(|entry| entry.code).collect();
            let own = dialect.texts.diagnostics.iter().map(|(code, ..)| *code);
            let own: Vec<_> = own.collect();
            assert!(own.iter().all(|code| known.contains(code)), "{own:?}");
            assert!(own.windows(2).all(|pair| pair[0] < pair[1]), "{own:?}");
        }
    }

    #[test]
    fn a_dialect_tells_nothing_that_only_the_other_one_has() {
        let of_nj = [
            "G30",
            "G31",
            "G44",
            "G52",
            "G61",
            "G64",
            "G68",
            "G74",
            "G84",
            "G500",
            "M98",
            "M99",
            "subprogram",
            "_CNC_",
            "ta,",
            "/*",
            "[L",
            "VA5",
            "rotation",
        ];
        let dialect = dgshape();
        let codes = dialect.g_codes.codes.iter().chain(dialect.m_codes.codes);
        for code in codes.chain([&dialect.auxiliary]) {
            let docs = dialect.docs_of(code);
            for foreign in of_nj {
                assert!(!docs.contains(foreign), "{}: {foreign}: {docs}", code.code);
            }
            let addresses = (dialect.grammar)().addresses;
            assert!(
                dialect
                    .words_of(code)
                    .all(|word| addresses.contains(word.address))
            );
        }
    }
}
