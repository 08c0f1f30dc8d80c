//! Grammar of dialect dgshape, by the NC code manual FA01232, 1-1 and 2-6.

use super::ForeignWord;
use crate::address::{Address, AddressSet};
use crate::grammar::{Grammar, ProgramForm};

pub(super) static DGSHAPE: Grammar = GRAMMAR;

pub(super) const GRAMMAR: Grammar = Grammar {
    name: "dgshape",
    addresses: AddressSet::from_addresses(&[
        Address::A,
        Address::D,
        Address::F,
        Address::G,
        Address::H,
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
        Address::T,
        Address::X,
        Address::Y,
        Address::Z,
    ]),
    line_comment: None,
    block_comment: Some(("(", ")")),
    comment_spans_lines: false,
    block_skip_max: 1,
    program_codes: false,
    program_form: ProgramForm {
        mark: Some(b'%'),
        number_letter: Some(b'O'),
        number_digits_max: 8,
    },
    sections: &[
        ("E0003", "1-1"),
        ("E0004", "2-6, Comment"),
        ("E0005", "1-1"),
        ("E0006", "1-5"),
        ("E0007", "2-7"),
        ("E0008", "2-6, Optional Block Skip"),
        ("E0009", "2-6, Optional Block Skip"),
        ("E0010", "2-6, Sequence Number"),
        ("E0024", "2-6, Data Start"),
        ("E0025", "2-6"),
        ("E0026", "2-6, Program Number"),
        ("E0101", "2-7"),
        ("E0103", "2-7"),
        ("E0104", "2-7"),
        ("E0105", "1-1"),
        ("E0107", "1-3, Miscellaneous Functions, and 2-3, M06"),
        ("E0108", "2-2 and 2-3"),
        ("E0109", "2-1"),
        ("E0110", "2-1"),
        ("E0111", "2-2 and 2-3"),
        ("E0113", "2-2, G04"),
        ("E0115", "2-3, M02"),
        ("E0118", "2-2"),
        ("E0119", "2-2, G39 to G42"),
        ("E0120", "2-2, G53"),
        ("E0121", "2-2, G80 to G89"),
        ("E0122", "2-2, G02 and G03"),
        ("E0123", "2-3"),
        ("E0124", "2-2, G20 and G21"),
        ("E0125", "2-2, G53"),
        ("E0126", "2-2, G01"),
        ("W0002", "2-3, M02"),
        ("W0004", "2-5"),
        ("W0006", "2-6, Optional Block Skip"),
        ("W0007", "2-6, Program Number"),
        ("W0008", "2-2, G40 to G42"),
        ("W0017", "2-2, G02 and G03"),
        ("W0018", "2-2, G01"),
    ],
    foreign: FOREIGN,
};

/// Words, codes and characters of other controls, each with the help for dialect dgshape.
static FOREIGN: &[ForeignWord] = &[
    ("#", "Write numbers: the dialect has no variables."),
    ("=", "Write numbers: the dialect has no variables."),
    ("[", "Write numbers: the dialect has no calculations."),
    (
        ";",
        "Remove it: a block ends with its line. A comment is written in parentheses.",
    ),
    (
        ":",
        "Remove it: a program number is written as O1000, a comment in parentheses.",
    ),
    ("B", NO_SUCH_AXIS),
    ("C", NO_SUCH_AXIS),
    ("E", "Write the feedrate as F."),
    ("G5", PATH_IS_KEPT),
    ("G5.1", PATH_IS_KEPT),
    ("G8", PATH_IS_KEPT),
    ("G9", PATH_IS_KEPT),
    ("G15", "Remove it: positions are never polar."),
    ("G16", "Calculate X and Y: positions are never polar."),
    (
        "G30",
        "Write G53 X_ Y_ Z_ for a position of the machine, or G28 for the reference point.",
    ),
    ("G31", NO_PROBING),
    ("G38.2", NO_PROBING),
    ("G44", "Write G43 with H of a negative length."),
    (
        "G52",
        "Write G10 L2 P_ X_ Y_ Z_ for a work offset, or G92 for all of them.",
    ),
    ("G54.1", "Write one of G54 to G59: the dialect has no others."),
    ("G61", PATH_IS_KEPT),
    ("G64", PATH_IS_KEPT),
    ("G65", NO_MACROS),
    ("G66", NO_MACROS),
    ("G67", "Remove it: there are no macros."),
    ("G68", "Calculate X, Y and Z: the dialect has no rotation."),
    ("G69", "Remove it: the dialect has no rotation."),
    (
        "G70",
        "Write G20 for inches: the dialect has no cycle of this number.",
    ),
    (
        "G71",
        "Write G21 for millimetres: the dialect has no cycle of this number.",
    ),
    ("G73", "Write G83, which returns to R after each cut."),
    ("G74", NO_TAPPING),
    ("G76", OTHER_BORING),
    ("G84", NO_TAPPING),
    ("G87", OTHER_BORING),
    ("G88", OTHER_BORING),
    (
        "G90.1",
        "Write I, J and K as distances from the start of the arc.",
    ),
    (
        "G91.1",
        "Remove it: I, J and K are always distances from the start of the arc.",
    ),
    (
        "G93",
        "Calculate F: the length of the block, multiplied by the number after F, is the distance per minute.",
    ),
    (
        "G94",
        "Remove it: F is always in mm/min, or in inches per minute.",
    ),
    (
        "G95",
        "Calculate F: revolutions per minute, multiplied by the feed per revolution, is the distance per minute.",
    ),
    ("G96", "Write the speed of the spindle as S, in r/min."),
    ("G97", "Remove it: S is always in r/min."),
    ("END", NO_BRANCHES),
    ("GOTO", NO_BRANCHES),
    ("IF", NO_BRANCHES),
    ("M4", "Write M03: only M03 starts the spindle."),
    ("M97", NO_SUBPROGRAMS),
    ("M98", NO_SUBPROGRAMS),
    (
        "M99",
        "Write M30 or M02 at the end: the dialect has no subprograms.",
    ),
    (
        "V",
        "Write Y: an axis is X, Y, Z or A, and G91 makes its value a distance.",
    ),
    (
        "U",
        "Write X: an axis is X, Y, Z or A, and G91 makes its value a distance.",
    ),
    (
        "W",
        "Write Z: an axis is X, Y, Z or A, and G91 makes its value a distance.",
    ),
    ("WHILE", NO_BRANCHES),
];

const PATH_IS_KEPT: &str = "Remove it: motion always keeps to the path.";
const NO_SUCH_AXIS: &str = "Remove it: the axes are X, Y, Z and A.";
const NO_BRANCHES: &str =
    "Write the blocks that are to be executed: the dialect has no branches and repetitions.";
const NO_PROBING: &str = "Remove it: the dialect has no probing.";
const NO_MACROS: &str = "Write the blocks of the macro here: the dialect has no subprograms.";
const NO_SUBPROGRAMS: &str = "Write the blocks of the subprogram here: the dialect has no subprograms.";
const NO_TAPPING: &str = "Remove it: no cycle taps.";
const OTHER_BORING: &str = "Write G85, G86 or G89, which stay in the centre of the hole, or the motions.";
