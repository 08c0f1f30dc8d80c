//! Grammar of dialect nj, by the NJ/NY-series manual O031, chapters 1 and 4.

use tandem_model::limits::OPTIONAL_SKIP_MAX;

use super::ForeignWord;
use crate::address::{Address, AddressSet};
use crate::grammar::{Grammar, ProgramForm};

pub(super) static NJ: Grammar = Grammar {
    name: "nj",
    addresses: AddressSet::from_addresses(&[
        Address::A,
        Address::B,
        Address::C,
        Address::F,
        Address::G,
        Address::I,
        Address::J,
        Address::K,
        Address::L,
        Address::M,
        Address::N,
        Address::P,
        Address::Q,
        Address::R,
        Address::S,
        Address::X,
        Address::Y,
        Address::Z,
        Address::Ta,
        Address::Td,
        Address::Ts,
        Address::Va,
        Address::Vb,
        Address::Vc,
        Address::Vd,
        Address::Ve,
        Address::Vf,
        Address::Vg,
        Address::Vh,
    ]),
    line_comment: Some("//"),
    block_comment: Some(("/*", "*/")),
    comment_spans_lines: true,
    block_skip_max: OPTIONAL_SKIP_MAX,
    program_codes: true,
    program_form: ProgramForm {
        mark: None,
        number_letter: None,
        number_digits_max: usize::MAX,
    },
    sections: &[],
    foreign: FOREIGN,
};

/// Words, codes and characters of FANUC and ISO programs that dialect nj does not have, each with its help.
pub(super) static FOREIGN: &[ForeignWord] = &[
    ("%", "Remove the line: a program is its text, without marks."),
    (
        ";",
        "Remove it: a block ends with its line. A comment begins with //.",
    ),
    (
        "D",
        "Remove it: G41 and G42 take the radius of the tool that the sequence program has selected.",
    ),
    (
        "DEGREES",
        "Remove it: the functions sind, cosd and tand take degrees.",
    ),
    (
        "E",
        "Write the feedrate as F, in mm/min: the pitch of a thread is F / S.",
    ),
    ("END", "Write while (condition) { and close it with }."),
    ("EQ", "Write == in parentheses: if (L1 == 2)."),
    (
        "G5.1",
        "Write G500 to read the path ahead, G501 to end it; both without words.",
    ),
    (
        "G5",
        "Write G500 to read the path ahead, G501 to end it; both without words.",
    ),
    (
        "G10",
        "Remove it: the configuration holds work offsets and tools, and the sequence program writes them.",
    ),
    ("G15", "Remove it: positions are never polar."),
    ("G16", "Calculate X and Y: L1 = 10 * cosd(30), then X[L1]."),
    ("G22", "Remove it: the soft limits of the motors apply."),
    ("G32", "Write G84: a thread is tapped along Z."),
    ("G33", "Write G84: a thread is tapped along Z."),
    ("G39", "Remove it: G41 and G42 round the corners without it."),
    (
        "G65",
        "Set Q variables, then call with M98: Q1 = 5 on a line, M98 P1000 on the next one.",
    ),
    ("G66", "Write M98 P1000 after each block that moves."),
    ("G67", "Remove it: a call by M98 ends with its repetitions."),
    (
        "G73",
        "Write the motions: G00 X_ Y_, G00 to the R point, for each peck G01 Z_ F_ and a short G00 up, then G00 up.",
    ),
    (
        "G76",
        "Write the motions: G00 X_ Y_, G00 to the R point, G01 Z_ F_, M19, G00 X_ away from the wall, G00 up.",
    ),
    (
        "G81",
        "Write the motions: G00 X_ Y_, G00 to the R point, G01 Z_ F_, G00 up.",
    ),
    (
        "G82",
        "Write the motions: G00 X_ Y_, G00 to the R point, G01 Z_ F_, G04 P_, G00 up.",
    ),
    (
        "G83",
        "Write the motions: G00 X_ Y_, for each peck G00 down, G01 Z_ F_ and G00 to the R point, then G00 up.",
    ),
    (
        "G85",
        "Write the motions: G00 X_ Y_, G00 to the R point, G01 Z_ F_, G01 up.",
    ),
    (
        "G86",
        "Write the motions: G00 X_ Y_, G00 to the R point, G01 Z_ F_, M05, G00 up, M03.",
    ),
    (
        "G87",
        "Write the motions of back boring: M19, G00 X_ Y_ Z_, G01 Z_ F_, G00.",
    ),
    (
        "G88",
        "Write the motions: G00 X_ Y_, G00 to the R point, G01 Z_ F_, G04 P_, M05, M00, G00 up, M03.",
    ),
    (
        "G89",
        "Write the motions: G00 X_ Y_, G00 to the R point, G01 Z_ F_, G04 P_, G01 up.",
    ),
    (
        "G92",
        "Write G52 X_ Y_ Z_ for a local zero, or G54 to G59 for one that is configured.",
    ),
    (
        "G93",
        "Calculate F: the length of the block in mm, multiplied by the number after F, is the feedrate in mm/min.",
    ),
    ("G94", "Remove it: F is always in mm/min."),
    (
        "G95",
        "Calculate F: revolutions per minute, multiplied by the feed per revolution, is the feedrate in mm/min.",
    ),
    ("G96", "Write the speed of the spindle as S, in r/min."),
    ("G97", "Remove it: S is always in r/min."),
    ("GE", "Write >= in parentheses: if (L1 >= 2)."),
    ("GOTO", "Write if, switch, while or do with commands in braces."),
    ("GT", "Write > in parentheses: if (L1 > 2)."),
    (
        "H",
        "Remove it: G43 and G44 take the length of the tool that the sequence program has selected.",
    ),
    ("IF", "Write if (L1 == 2) { and close it with }."),
    ("LE", "Write <= in parentheses: if (L1 <= 2)."),
    ("LT", "Write < in parentheses: if (L1 < 2)."),
    ("MOD", "Write %: L1 = L2 % 4."),
    ("NE", "Write != in parentheses: if (L1 != 2)."),
    ("O", "Remove it: the name of the file is the number, {}.nc."),
    ("T", "Write M06 VA{} for a tool change T{} M06."),
    (
        "THEN",
        "Remove it: the command follows the parentheses: if (L1 == 2) X5.",
    ),
    (
        "U",
        "Write X: an axis is X, Y, Z, A, B or C, and G91 makes its value a distance.",
    ),
    (
        "V",
        "Write Y: an axis is X, Y, Z, A, B or C, and G91 makes its value a distance.",
    ),
    (
        "W",
        "Write Z: an axis is X, Y, Z, A, B or C, and G91 makes its value a distance.",
    ),
    ("WHILE", "Write while (L1 < 2) { and close it with }."),
    (
        "[",
        "Write one variable in brackets, X[L1]: it is calculated on a line before, L1 = L2 + 1.",
    ),
];
