//! The decisions, by the numbers that tests and messages name.

/// Number and text, ascending.
pub(super) static DECISIONS: &[(&str, &str)] = &[
    (
        "D01",
        "Letters are read without regard to case, leading zeros mean nothing, and a decimal G code is a code of its own.",
    ),
    (
        "D02",
        "Words of a block stand in any order behind block skip and N. One word of an address, one G code of a modal group and one M code stand in a block.",
    ),
    (
        "D03",
        "A line of the intermediate code is at most 1020 bytes long, its end-of-block word counted.",
    ),
    (
        "D04",
        "A word's value is a number or one variable in brackets. Program codes have no indirection.",
    ),
    ("D05", "Main programs are 1 to 999, subprograms 1000 to 9999."),
    (
        "D06",
        "A program that can come to its end without M02, M30 or M99 is an error.",
    ),
    (
        "D07",
        "`%` keeps the sign of the dividend. Division by zero is no alarm; a value that is not finite is one where it reaches a word.",
    ),
    (
        "D08",
        "`int` and `floor` round down, `rint` rounds half to even, `sgn(0)` is 0.",
    ),
    (
        "D09",
        "A condition is a comparison, a join, `!(condition)` or `isnan`; it is no number, a number is no condition, and comparisons do not chain. `isnan` is 0 or 1 as a number too, as the manual's table says.",
    ),
    (
        "D10",
        "`switch` truncates toward zero and takes `default` for what is not a number; labels are whole constants, each once. `break` leaves `switch`, `while` and `do`.",
    ),
    (
        "D11",
        "Ranges are errors for numbers and alarms for calculated values. F above the maximum is clipped with a warning, a thread keeping the pitch of F as it is written; S above it is an alarm.",
    ),
    (
        "D12",
        "M98 with L0 calls nothing, a call deeper than 8 is not made, L is zero in each call, and M99 in a main program ends it.",
    ),
    (
        "D13",
        "Block skip is read when its block is interpreted; it stands before blocks of words only.",
    ),
    ("D14", "M00 and M01 act when motion has come to them."),
    (
        "D15",
        "The pre-read goes on behind a G31; what moves there begins where the motors have ended. While the G31 is unfinished, a read of a captured position waits for its end, and so does a block that takes the position of the tool into its own: G51 and G68 with an axis of the centre left out, and the first block of a fixed cycle.",
    ),
    (
        "D16",
        "Variables, tools, offsets and skip inputs are read when their block is interpreted. Captured positions count from 0 over the motors of the coordinate system, ascending.",
    ),
    (
        "D17",
        "G41 to G44 take the tool that is selected when they are interpreted.",
    ),
    (
        "D19",
        "In a G04 block F, P and X are times; the modal feedrate stays.",
    ),
    (
        "D20",
        "Transforms from the programmed point on: mirror, scale, rotation, local, work offset, tool length. Switching one on moves nothing.",
    ),
    (
        "D22",
        "G43, G44 and G49 move nothing; the next motion ends at the corrected Z.",
    ),
    (
        "D23",
        "G28, G30 and G53 with cutter compensation or a tool offset are refused.",
    ),
    (
        "D24",
        "G28 or G30 without axis words moves all axes straight to the reference point.",
    ),
    (
        "D25",
        "G20 changes the reading of lengths and feedrates; settings, offsets and tools stay in mm. F of a block that moves rotary axes only is in degrees a minute in G20 too.",
    ),
    (
        "D26",
        "I, J, K count from the start point in G90 and G91. A radius is at least half the way, less `arc_radius_tolerance` (0.01 mm) in the machine. R wins over I, J, K with a warning; neither in the plane is an error.",
    ),
    (
        "D27",
        "G09 before the axis words stops before the block's motion, behind them after it.",
    ),
    ("D30", "An M code with parameters is always output after motion."),
    (
        "D35",
        "M00, M01, M02, M30, M98 and M99 are handled by the runtime; all others are outputs, M03, M04, M05 and M19 among them. Whoever handles them commands the spindle: where the runtime does, a changed S acts on the turning spindle when the motion has come to its block.",
    ),
    (
        "D41",
        "Captured positions are machine positions in mm or degrees, whatever G20 says; a motor without a capture tells where it stopped.",
    ),
    (
        "D42",
        "Each block of a fixed cycle expands on its own, with repetitions between orientation and spindle stop. Z, R, P and K stay until G80. In G91 R counts from the initial level, Z from R; the initial level is Z where the cycle began, as in the manual's examples.",
    ),
    (
        "D43",
        "The end-of-block word of the intermediate code is M999.002; `return` stands once for each M99.",
    ),
];
