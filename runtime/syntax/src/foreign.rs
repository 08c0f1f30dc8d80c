//! What programs for other controls write, and what is written in dialect nj in its place.

/// What another control writes, and what to write here. `{}` in the help is the value behind it.
type Foreign = (&'static str, &'static str);

/// Words, codes and characters of FANUC and ISO programs that dialect nj does not have.
pub(crate) static OF_NJ: &[Foreign] = &[
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
    ("G22", "Remove it: the soft limits of the motors hold."),
    ("G32", "Write G84: a thread is tapped along Z."),
    ("G33", "Write G84: a thread is tapped along Z."),
    ("G39", "Remove it: G41 and G42 round the corners by themselves."),
    (
        "G65",
        "Set Q variables, then call with M98: Q1 = 5 on a line, M98 P1000 on the next one.",
    ),
    ("G66", "Write M98 P1000 behind each block that moves."),
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
        "Calculate F: the length of the block in mm, times the number behind F, is mm/min.",
    ),
    ("G94", "Remove it: F is always mm/min."),
    (
        "G95",
        "Calculate F: revolutions a minute times the feed of one revolution is mm/min.",
    ),
    ("G96", "Write the speed of the spindle as S, in r/min."),
    ("G97", "Remove it: S is always r/min."),
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

/// Of dialect dgshape.
pub(crate) static OF_DGSHAPE: &[Foreign] = &[
    ("#", "Write numbers: the dialect has no variables."),
    ("=", "Write numbers: the dialect has no variables."),
    ("[", "Write numbers: the dialect has no calculations."),
    (
        ";",
        "Remove it: a block ends with its line. A comment stands in parentheses.",
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
    ("G54.1", "Write one of G54 to G59: there are no others."),
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
    ("G73", "Write G83: it goes up to R after each cut."),
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
        "Calculate F: the length of the block, times the number behind F, is the way a minute.",
    ),
    ("G94", "Remove it: F is always mm/min, or inches a minute."),
    (
        "G95",
        "Calculate F: revolutions a minute times the feed of one revolution is the way a minute.",
    ),
    ("G96", "Write the speed of the spindle as S, in r/min."),
    ("G97", "Remove it: S is always r/min."),
    ("END", NO_BRANCHES),
    ("GOTO", NO_BRANCHES),
    ("IF", NO_BRANCHES),
    ("M4", "Write M03: it alone starts the spindle."),
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

/// What to write for a name of another control, a code without leading zeros, with the value behind it.
pub(crate) fn help(all: &[Foreign], name: &str, value: &str) -> Option<String> {
    let (_, help) = all.iter().find(|(known, _)| known.eq_ignore_ascii_case(name))?;
    Some(help.replace("{}", if value.is_empty() { "_" } else { value }))
}

/// What to write for a variable `#n`: those of a call, and those that programs share.
pub(crate) fn variable(digits: &str) -> String {
    match digits.parse::<u32>() {
        Ok(1..=33) => format!("Write L{digits} for #{digits}, [L{digits}] as the value of a word."),
        Ok(100..=999) => {
            format!(
                "Write Q{digits} for #{digits}, [Q{digits}] as the value of a word, or P{digits} where it must be kept for other coordinate systems."
            )
        }
        Ok(1000..) => format!(
            "There are no system variables: ask the sequence program for what #{digits} says, by a Q variable."
        ),
        _ => {
            "Write L1, Q1 or P1, with the number of the variable, and [L1] as the value of a word.".to_owned()
        }
    }
}
