//! The table of diagnostics: every code that the lexer, the parser or the checker can report.

use tandem_model::{Diagnostic, Severity, Span};

/// One entry of the table of diagnostics.
#[derive(Debug, PartialEq, Eq)]
pub struct DiagnosticEntry {
    /// Code of the diagnostic: `E0123` for errors, `W0123` for warnings.
    pub code: &'static str,
    /// Name of the diagnostic, as a short sentence.
    pub title: &'static str,
    /// Reason why the text is wrong, with the rule.
    pub explanation: &'static str,
    /// A wrong and a right text, or a remedy.
    pub example: &'static str,
}

impl DiagnosticEntry {
    /// Returns the severity, error or warning, given by the letter of the code.
    pub fn severity(&self) -> Severity {
        if self.code.starts_with('W') {
            Severity::Warning
        } else {
            Severity::Error
        }
    }

    /// Creates a finding of this diagnostic: `message` describes the error at `span`, `help` its correction.
    pub fn at(&'static self, span: Span, message: impl Into<String>, help: impl Into<String>) -> Diagnostic {
        Diagnostic {
            code: self.code,
            severity: self.severity(),
            span,
            message: message.into(),
            help: help.into(),
        }
    }

    /// Returns the diagnostic with this code; upper and lower case are equal.
    pub fn find(code: &str) -> Option<&'static DiagnosticEntry> {
        DIAGNOSTICS
            .iter()
            .copied()
            .find(|entry| entry.code.eq_ignore_ascii_case(code))
    }
}

macro_rules! diagnostics {
    ($($name:ident = $code:literal, $title:literal, $explanation:literal, $example:literal;)*) => {
        $(#[doc = concat!($code, ": ", $title, ".")]
        pub static $name: DiagnosticEntry = DiagnosticEntry {
            code: $code, title: $title, explanation: $explanation, example: $example,
        };)*

        /// All diagnostics, ascending by code.
        pub static DIAGNOSTICS: &[&DiagnosticEntry] = &[$(&$name),*];
    };
}

diagnostics! {
    // E0001 to E0099: errors in the form of the text
    SOURCE_TOO_LARGE = "E0001", "The program is too large",
        "A program is at most 64 MiB of text. The program was not read.",
        "Split the program and call the parts with M98.";
    TOO_MANY = "E0002", "Too many errors",
        "The list of findings of one program ends at 1000; further findings are not listed.",
        "Correct the errors above, then check again.";
    UNEXPECTED_CHARACTER = "E0003", "A character is not part of the language",
        "Outside comments a block consists of words: letters, digits, signs and brackets of ASCII.",
        "wrong: G01 X1O,5   right: G01 X10.5";
    COMMENT_NOT_CLOSED = "E0004", "A comment is not closed",
        "A comment that begins with /* ends with */. Without */, the whole rest of the text is a comment.",
        "wrong: /* roughing   right: /* roughing */";
    VALUE_MISSING = "E0005", "A word has no value",
        "A word is an address and a number, or an address and a variable in brackets (D04).",
        "wrong: G01 X Y10   right: G01 X0 Y10";
    NUMBER_MALFORMED = "E0006", "A number is malformed",
        "A number consists of an optional sign, digits, and at most one decimal point. It has no exponent.",
        "wrong: X1.2.3 Y--4   right: X1.23 Y-4";
    WORD_UNKNOWN = "E0007", "A word is not part of the language",
        "The addresses of this dialect are listed in the manual's table of instruction parameters.",
        "wrong: G01 W10   right: G01 Z10";
    SKIP_NUMBER = "E0008", "A block skip number is out of range",
        "Block skip numbers are 1 to 31; / alone is /1 (D13).",
        "wrong: /32 X10   right: /31 X10";
    SKIP_PLACE = "E0009", "A block skip is not at the beginning of its line",
        "Block skip comes first in its line, also before the block number (D02, D13).",
        "wrong: N10 /1 X10   right: /1 N10 X10";
    BLOCK_NUMBER_PLACE = "E0010", "A block number is not at the beginning of its block",
        "N comes before the other words of its block (D02).",
        "wrong: G01 N10 X5   right: N10 G01 X5";
    BLOCK_TOO_LONG = "E0011", "A block is too long",
        "A block is at most 1020 bytes, comments not counted (D03).",
        "Write the words in several blocks.";
    INDIRECTION_MALFORMED = "E0012", "An indirection is malformed",
        "The brackets contain the name of one variable and nothing else (D04).",
        "wrong: X[L1+1]   right: L2=L1+1 and then X[L2]";
    VARIABLE_UNKNOWN = "E0013", "A variable does not exist",
        "Variables are L0 to L255, Q0 to Q4095, P0 to P32767 and _CNC_CapturedPosition0 to 7 (manual 4-3).",
        "wrong: L256=1   right: L255=1";
    EXPRESSION_MALFORMED = "E0014", "An expression is not complete",
        "An expression consists of numbers, variables, functions, + - * / % and parentheses (manual 4-1). A plus without a left operand may only stand directly before a number.",
        "wrong: L1=2*(3+   right: L1=2*(3+4)";
    NESTING_TOO_DEEP = "E0015", "Nesting is too deep",
        "Parentheses and signs nest at most 64 deep, and so do branches and repetitions.",
        "Assign parts of the expression to variables, or move commands to a subprogram.";
    BRACE_UNMATCHED = "E0016", "A bracket has no partner",
        "Every opening parenthesis or brace needs a closing one, and every closing one an opening one.",
        "wrong: if(L1==1){M30   right: if(L1==1){M30}";
    SKIP_BEFORE_PROGRAM_CODE = "E0017", "Block skip before a program code",
        "Block skip works on G-code blocks only, not on assignments, branches and repetitions (D13).",
        "wrong: /1 L1=5   right: L1=5";
    ASSIGNMENT_PLACE = "E0018", "An assignment is in a block with words",
        "A line contains either words or program codes, not both.",
        "wrong: G01 L1=5 X10   right: L1=5 on a line of its own";
    NUMBER_TOO_LARGE = "E0019", "A number is too large, or a value is no number",
        "The number is too large for a 64-bit floating point number, or the calculation of a word's value gives no finite number (D07).",
        "wrong: L1=0 L2=1/L1 and then X[L2]   right: L1=4 L2=1/L1 and then X[L2]";
    KEYWORD_PLACE = "E0020", "A program code is at a wrong place",
        "else is allowed only after if; case, default and break only within switch (break also within while and do).",
        "wrong: else X10   right: if(L1==1) X5 else X10";
    CONDITION_KIND = "E0021", "A condition and a number are mixed up",
        "A condition is a comparison, conditions joined with && or ||, !(condition) or isnan(...). A number alone is no condition, a condition is no number, and comparisons cannot be chained (D09).",
        "wrong: if(L1) X5   right: if(L1!=0) X5";
    COMMAND_MISSING = "E0022", "A program code lacks its commands",
        "if, else, while and do need one command or commands in braces, switch needs cases in braces.",
        "wrong: if(L1==1)   right: if(L1==1) X5";
    CASE_LABEL = "E0023", "A case label is wrong",
        "case is followed by a whole constant and a colon, default by a colon. Each label is allowed once in its switch (D10).",
        "wrong: case L1:   right: case 1:";
    MARK_MISSING = "E0024", "The program does not begin with %",
        "A program of dialect dgshape begins with a line that contains only %. Without that line, it is not executed (manual dgshape, 1-1).",
        "wrong: G90 in the first line   right: % in the first line, G90 in the next";
    NOT_ALONE = "E0025", "More than % or O on a line",
        "% is alone on its line, and the program number O too (manual dgshape, 2-6).",
        "wrong: % O0001   right: % and O0001 on lines of their own";
    PROGRAM_NUMBER = "E0026", "A program number is wrong",
        "O is followed by one to eight digits, and is allowed once in a program (manual dgshape, 2-6).",
        "wrong: O1.5   right: O0015";
    // E0100 to E0199: errors in the meaning of words and codes
    G_UNKNOWN = "E0101", "There is no such G code",
        "The dialect has the G codes of the manual's table.",
        "wrong: G05   right: G04 P500";
    CODE_NUMBER = "E0103", "The number of a G, M or N word is invalid",
        "The number after G, M or N is a constant that is not negative; after M and N it has no decimals.",
        "wrong: M3.5   right: M3";
    M_UNKNOWN = "E0104", "There is no such M code",
        "M codes are M0 to M191.",
        "wrong: M200   right: M100";
    WORD_TWICE = "E0105", "A word appears twice in a block",
        "Each address except G appears at most once in a block (D02).",
        "wrong: G01 X1 X2   right: G01 X1 and then X2 in the next block";
    GROUP_TWICE = "E0106", "Two G codes of one modal group in a block",
        "G codes of one group exclude each other (D02).",
        "wrong: G90 G91 X1   right: G91 X1";
    M_TWICE = "E0107", "Two M codes in a block",
        "A block makes at most one auxiliary function output (D02).",
        "wrong: M03 M08   right: M03 and M08 in blocks of their own";
    WORD_NOT_TAKEN = "E0108", "No code of the block takes a word",
        "Each word must belong to a code of its block, or to the motion in force.",
        "wrong: G01 X1 R5   right: G01 X1";
    OUT_OF_RANGE = "E0109", "A value is out of its range",
        "The manual's table of instruction parameters gives the ranges (D11).",
        "wrong: ts200000   right: ts125000";
    INTEGER_NEEDED = "E0110", "A value must be a whole number",
        "Program numbers and numbers of repetitions have no decimals.",
        "wrong: M98 P1000.5   right: M98 P1000";
    WORD_MISSING = "E0111", "A code lacks a word that it needs",
        "Some codes need a certain word: M98 needs P.",
        "wrong: M98   right: M98 P1000";
    PARAMETERS_REFUSED = "E0112", "The M code takes no parameters",
        "The codes M00, M01, M02, M30, M98 and M99 take none of VA to VH (manual, M code descriptions).",
        "wrong: M30 VA1   right: M30";
    DWELL_TWICE = "E0113", "A dwell has two times",
        "A dwell (G04) takes one of F, P and X.",
        "wrong: G04 P500 X1   right: G04 P500";
    AXIS_UNKNOWN = "E0114", "The coordinate system does not have this axis",
        "The axes of a coordinate system are those to which its configuration assigns a motor.",
        "Remove the word, or assign a motor to the axis.";
    END_MISSING = "E0115", "The program has no end",
        "A program ends with M02 or M30, a subprogram with M99, in a block that is never skipped (D06).",
        "Write M30 (in a subprogram M99) in the last block.";
    WORD_SHARED = "E0118", "Two codes of the block take the same word",
        "The text does not show to which of the codes the value belongs.",
        "wrong: G04 M98 P1000   right: G04 P500 and M98 P1000 in blocks of their own";
    COMPENSATION_RULE = "E0119", "Not allowed with cutter compensation",
        "Cutter compensation is led in by G01 and led out by G00 or G01. In between, motions are only G01, G02 and G03, and the plane and the side stay. M00, M01, M02, M30, M codes with parameters, G28, G30 and G53 are not allowed there (D23).",
        "wrong: G41 and then G00 X5   right: G41 and then G01 X5";
    TOOL_OFFSET_RULE = "E0120", "Not allowed with a tool offset",
        "The codes G28, G30 and G53 need G49 before them (D23). The first motion after G49 goes to its Z without the offset: under G91, Z comes down by the offset.",
        "wrong: G43 and then G28   right: G43, then G90 G49 G00 Z100, and then G28";
    FIXED_CYCLE_RULE = "E0121", "Not allowed in a fixed cycle",
        "From G74 or G84 to G80, only these codes, G98 and G99 are allowed; G00 to G03 end the cycle. The first block needs Z and R.",
        "wrong: G84 Z-5 R1 and then M98 P1000   right: G80 before M98";
    ARC_SHAPE = "E0122", "An arc is not defined",
        "An arc (G02, G03) needs its centre by I, J, K of the plane in force, or the radius R. R is at least half the distance from start to end (D26).",
        "wrong: G02 X10 Y0   right: G02 X10 Y0 R5";
    M_NOT_ALONE = "E0123", "An M code is not alone in its block",
        "In dialect dgshape, M00, M01, M02 and M30 need a block of their own (manual dgshape, 2-3).",
        "wrong: G00 Z5.0 M30   right: G00 Z5.0 and M30 in blocks of their own";
    UNIT_CHANGE = "E0124", "The unit of lengths changes",
        "A program of dialect dgshape selects its unit (G20 or G21) at the start, before all coordinates, and then keeps it (manual dgshape, G20 and G21).",
        "wrong: G21 and later G20   right: G20 in the first block";
    MACHINE_POSITION_RULE = "E0125", "Not allowed in incremental programming",
        "Positions of the machine are absolute: in dialect dgshape, G53 is allowed only in G90 (manual dgshape, G53).",
        "wrong: G91 and then G53 Z0   right: G90 G53 Z0";
    FEEDRATE_MISSING = "E0126", "No feedrate is programmed",
        "If the coordinate system has no default_feedrate, a motion at the feedrate needs F before it or in its block. A run would stop with alarm 101.",
        "wrong: G01 X10   right: G01 X10 F300";
    SPEED_MISSING = "E0127", "No spindle speed is programmed",
        "The pitch of a thread is F / S: a cycle that cuts a thread needs S before it or in its block. A run would stop with alarm 113.",
        "wrong: G84 Z-10 R2 F100   right: G84 Z-10 R2 F100 S100";
    STOPS = "E0128", "An alarm stops the program here",
        "The check has run the program without motion, and the alarm came under every assumption about the machine (geometry, cutter compensation, soft limits, loops that do not end). `tandem explain` with the number of the alarm shows its cause and remedy.",
        "wrong: G00 X0 and then G02 X10 Y0 I3   right: G00 X0 and then G02 X10 Y0 I5";
    HANDLER_REFUSES = "E0190", "A handler refuses the parameters of an M code",
        "When a program is loaded, the machine asks the handlers of its M codes whether they accept the parameters; the message is from the handler.",
        "Correct the parameters as the message says.";
    PARAMS_REFUSED = "E0191", "A parameter is outside the declaration of the M code",
        "Handlers and the configuration declare the parameters of an M code: their ranges, their units, and which parameters are optional. A parameter with the value of a variable is checked when the block runs.",
        "With M12 declared to take VA, 1 to 20 kN: wrong: M12 VA50   right: M12 VA5";
    // W0001 to W0099: warnings; the program can run
    PROGRAM_MISSING = "W0001", "A called program is missing",
        "A call (M98) of a missing program is an alarm when the block is interpreted (D12).",
        "Load the subprogram before the program starts.";
    UNREACHABLE = "W0002", "Blocks after the end of the program",
        "Nothing after M02, M30 or M99 is executed.",
        "Remove the blocks, or move the end below them.";
    M_WITHOUT_SETTINGS = "W0003", "An M code has no settings",
        "The M code is output after motion, and is an alarm if no handler is registered.",
        "Add an [m_code.100] table to the configuration.";
    FEEDRATE_CLIPPED = "W0004", "A feedrate is above the maximum",
        "F above the coordinate system's max_feedrate is reduced to it (D11).",
        "Write a lower F, or raise max_feedrate.";
    TOO_MANY_WARNINGS = "W0005", "Too many warnings",
        "The list of warnings of one program ends at 1000; further warnings are not listed.",
        "Look at the warnings above, then check again.";
    SKIP_UNUSED = "W0006", "A block skip number is not used",
        "Block skip skips the words of its own line. Without words on the line, it has no effect. A number that is repeated on the line has no effect either (D13).",
        "wrong: /2 on a line of its own   right: /2 X10";
    PROGRAM_NUMBER_LATE = "W0007", "The program number follows a block",
        "O belongs on the line after the first % (manual dgshape, 1-1). At this place it is accepted, because the manual's own example of a comment has it there (2-6).",
        "wrong: G90 and then O0001   right: O0001 and then G90";
    BLOCKS_AT_REST = "W0008", "Two blocks in a row do not move in the plane of the offset",
        "In tool-diameter offset of dialect dgshape, two blocks in a row without a motion along X or Y may cut too much or too little (manual dgshape, G40 to G42).",
        "wrong: G41 D1 and later M12 and G04 P100 in a row   right: M12 and G04 P100 after G40";
    WRONG_IN_SOME = "W0009", "Wrong on some paths through the program",
        "The codes in force at this block, or the value of a variable, depend on the path through the program: on branches, loops, block skip and calls. On the path that the message names, the block has the error in parentheses, and an alarm stops the machine there.",
        "wrong: if (P1 > 0) { G02 X1 R5 } and then X3 R5   right: G02 X3 R5";
    NO_RESULT = "W0010", "A calculation gives no number",
        "A division by zero or a function outside its domain gives no alarm. If a word takes the result, the block is an alarm (D07).",
        "wrong: L1 = sqrt(0 - 4)   right: L1 = sqrt(4)";
    ANGLE_BEYOND_TABLE = "W0011", "An angle is beyond the manual's table",
        "The table of instruction parameters limits R of G68 to 300 degrees, the description of G68 has no limit. Angles up to 360 degrees are executed as written.",
        "wrong: G68 X0 Y0 R330   right: G68 X0 Y0 R-30";
    ARC_WORD_UNUSED = "W0012", "A word of an arc is not used",
        "The centre of an arc lies in the plane in force: K is not used in G17, J not in G18, I not in G19. With R, none of the three is used (D26).",
        "wrong: G17 G02 X10 I5 K3   right: G17 G02 X10 I5";
    STOPS_IF = "W0013", "An alarm may stop the program here",
        "The check has run the program without motion, and the alarm came under the assumptions that the message names: values that the program does not write, block skip inputs, or positions of the axes.",
        "Set the value in the program, or make sure that the machine has another value.";
    WARNS_IN_RUN = "W0014", "A run of the program gives a warning here",
        "The check has run the program with the configuration, without motion. Examples: a tool that is not in the tool table has length and radius 0; a calculated F above the maximum is reduced.",
        "Add the tool to [tool] of the configuration, or correct its number.";
    OUTPUT_BEFORE_MOTION_ENDS = "W0015", "An M code with_motion does not wait for the motion before it",
        "With `timing = \"with_motion\"` an M code is output when its block is interpreted (D32). Blocks are interpreted ahead, so that the motion before the M code may not have begun. Only the first such block of each M code is named.",
        "Let [m_code.9] have timing = \"after_motion\" where M09 must come after the cut, or write M09 after an M code that waits.";
    NOT_SERVED = "W0016", "No handler serves an M code",
        "The M code is neither in the file of [machine] served nor served by the stock sequence program. On the machine, it is alarm 300 unless another handler is online.",
        "Add a handler, write the file again, or correct the M code.";
    ARC_END_OFF = "W0017", "The end of an arc is not on its circle",
        "I, J and K are distances from the start point, in G90 and G91 alike (manual dgshape, G02 and G03). If the distances of the start and the end from the centre differ by more than a hundredth, the tool moves on a spiral (D26), which the manual of dialect dgshape does not have. Often the cause is that I, J and K were written as the position of the centre.",
        "wrong: G00 X10 Y0 and G03 X0 Y10 I0 J0.5   right: G00 X10 Y0 and G03 X0 Y10 I-10 J0";
    FEEDRATE_OPEN = "W0018", "No feedrate is programmed",
        "A motion at the feedrate without F before it or in its block takes default_feedrate of the coordinate system. If that is 0, which is its default, the motion is alarm 101; with --config, the check reports E0126.",
        "wrong: G01 X10   right: G01 X10 F300";
    CALL_TOO_DEEP = "W0019", "A call is too deep",
        "Calls can be nested 8 deep. A deeper call is skipped with a warning of the run, and the next block follows (D12). Depending on values that are unknown here, a run may not reach the call.",
        "wrong: program 1001 with M98 P1001   right: M98 P1001 L9 in the main program";
    CORNER_MISSED = "W0020", "The path misses a corner",
        "In G64 the path is rounded at a corner: the distance grows with F, with ta and with ts (M1b.3), or is within path_tolerance with G500 (M1d.8). The check reports distances above corner_warning of the coordinate system. A smaller F or ta, G09 in the block, G61, or G500 with path_tolerance reduces the distance.",
        "wrong: G01 X50 F6000 and X0   right: G01 X50 G09 F6000 and X0";
    LIMIT_EXCEEDED = "W0021", "A motor exceeds its limit",
        "With G501, the motion follows the programmed ramps, whatever acceleration and jerk they need (M1a.7). The check compares them with max_acceleration and max_jerk of each motor, and reports the largest factor. A smaller F, longer ta, td and ts, or G500, which respects the limits, avoids the warning.",
        "wrong: G501 and G01 X50 F20000 ta5   right: G500 and G01 X50 F20000 ta5";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_unique_and_ascend() {
        assert!(DIAGNOSTICS.windows(2).all(|pair| pair[0].code < pair[1].code));
    }

    #[test]
    fn a_code_is_a_letter_and_four_digits() {
        for entry in DIAGNOSTICS {
            let (letter, digits) = entry.code.split_at(1);
            assert!(matches!(letter, "E" | "W"), "{}", entry.code);
            assert!(digits.len() == 4 && digits.bytes().all(|digit| digit.is_ascii_digit()));
        }
    }

    #[test]
    fn an_entry_is_found_without_regard_to_case() {
        assert_eq!(DiagnosticEntry::find("e0005"), Some(&VALUE_MISSING));
        assert_eq!(DiagnosticEntry::find("E9999"), None);
    }
}
