//! The table of findings: the faults that a program can have.

use tandem_model::{Diagnostic, Severity, Span};

use crate::limits::FINDINGS_MAX;

/// One line of the table of findings.
#[derive(Debug, PartialEq, Eq)]
pub struct FindingEntry {
    /// `ST001` and so on.
    pub code: &'static str,
    /// Name of the finding.
    pub title: &'static str,
    /// Reason why the text is wrong.
    pub explanation: &'static str,
    /// Text that causes the finding, and the right text.
    pub example: &'static str,
}

impl FindingEntry {
    /// Returns the entry of a code; upper and lower case are equal.
    pub fn find(code: &str) -> Option<&'static FindingEntry> {
        FINDINGS
            .iter()
            .copied()
            .find(|entry| entry.code.eq_ignore_ascii_case(code))
    }
}

macro_rules! findings {
    ($($name:ident = $code:literal, $title:literal, $explanation:literal, $example:literal;)*) => {
        $(pub(crate) static $name: FindingEntry = FindingEntry {
            code: $code, title: $title, explanation: $explanation, example: $example,
        };)*

        /// All findings in Structured Text, ascending by code.
        pub static FINDINGS: &[&FindingEntry] = &[$(&$name),*];
    };
}

findings! {
    TOO_LARGE = "ST001", "The text is too large",
        "A source text is at most 1 MiB, with 256 program organization units and types, and 100,000 values of all variables.",
        "wrong: ARRAY[1..1000000] OF INT   right: ARRAY[1..1000] OF INT";
    TOO_MANY = "ST002", "Too many findings",
        "The list of findings ends at 100; further findings are not listed.",
        "Correct the errors above, then check again.";
    CHARACTER = "ST003", "A character is not part of the language",
        "Outside comments and strings, a text consists of names, numbers and symbols of ASCII.",
        "wrong: größe := 1;   right: size := 1;";
    NOT_CLOSED = "ST004", "A comment or a string is not closed",
        "A comment (* must end with *), and a string must end with ' in its line.",
        "wrong: (* door   right: (* door *)";
    LITERAL = "ST005", "A literal is malformed",
        "Numbers are written as 5, 1_000, 16#FF, 2#1010 or 1.0E-3, times as T#1s500ms. A type may precede \
         them: INT#5. Underscores are allowed between digits.",
        "wrong: T#5   right: T#5s";
    LITERAL_RANGE = "ST006", "A value does not fit its type",
        "Each type has a range, such as -32768 to 32767 for INT.",
        "wrong: SINT#200   right: INT#200";
    SYNTAX = "ST010", "Another symbol or word is expected here",
        "The text does not follow the grammar of Structured Text.",
        "wrong: IF a THEN b := 1;   right: IF a THEN b := 1; END_IF;";
    TOO_DEEP = "ST011", "Nesting is too deep",
        "Statements and expressions may be nested 40 deep, and calls 10 deep.",
        "Write a part as a FUNCTION, or assign a part of an expression to a variable.";
    NOT_IN_SUBSET = "ST012", "Not part of this subset",
        "The page Structured Text lists the elements that a program may use. Any other element is an error, and is never ignored.",
        "wrong: VAR RETAIN n : INT; END_VAR   right: VAR n : INT; END_VAR, and P variables for values that must be kept";
    UNKNOWN = "ST020", "A name is unknown",
        "Variables, types, functions and function blocks must be declared. Upper and lower case are equal.",
        "wrong: coutn := 1;   right: count := 1;";
    TWICE = "ST021", "A name is declared twice",
        "A name is declared at most once in a program organization unit, and at most once outside of them.",
        "wrong: VAR a : INT; A : BOOL; END_VAR   right: VAR a : INT; b : BOOL; END_VAR";
    RESERVED = "ST022", "A name is a word of the language",
        "Keywords, and the names of standard types, functions and function blocks, cannot be declared.",
        "wrong: VAR ton : BOOL; END_VAR   right: VAR delay_is_over : BOOL; END_VAR";
    TYPE = "ST030", "A type does not fit",
        "Operators, conditions and parameters accept certain types; no value is converted implicitly if it could be lost.",
        "wrong: IF count THEN   right: IF count > 0 THEN";
    NARROWING = "ST031", "A value could be lost",
        "A value is converted implicitly to a wider type, such as INT to DINT; the opposite direction needs a conversion function.",
        "wrong: an_int := a_dint;   right: an_int := DINT_TO_INT(a_dint);";
    NOT_ASSIGNABLE = "ST032", "This cannot be assigned",
        "A program cannot assign constants, inputs within their unit, outputs of other units, and the variable of a running FOR.",
        "wrong: timer.Q := TRUE;   right: timer(IN := TRUE);";
    NOT_CONSTANT = "ST033", "A constant is expected",
        "Array bounds, labels of CASE, lengths, initial values, and the numbers of M codes and variables \
         must be known before the program runs: literals, VAR CONSTANT, and operations on these.",
        "wrong: MCODE(M := n)   right: MCODE(M := 10)";
    CONSTANT_FAULT = "ST034", "A constant cannot be calculated",
        "The calculation divides by zero, or its result does not fit its type.",
        "wrong: n := 1 / 0;   right: n := 1;";
    PARAMETERS = "ST040", "Parameters of a call are wrong",
        "A call has its parameters by order, or by name with := for inputs and => for outputs, not both.",
        "wrong: MAX(1)   right: MAX(1, 2)";
    RECURSION = "ST041", "A unit calls itself, or a type contains itself",
        "IEC 61131-3 allows no recursion: a function must not call itself, directly or through others, and a type must not contain itself.",
        "Write a loop.";
    NOT_CALLABLE = "ST042", "This cannot be called in this way",
        "A function is called by its name and has a value. A function block is called by an instance, as a statement.",
        "wrong: TON(IN := a);   right: VAR t : TON; END_VAR t(IN := a);";
    BOUNDS = "ST050", "An index is out of range",
        "An index must be within the bounds of its array; the lower bound comes first.",
        "wrong: ARRAY[5..1] OF INT   right: ARRAY[1..5] OF INT";
    LABELS = "ST051", "A label of CASE appears twice",
        "Each value selects one branch.",
        "wrong: 1..3: a(); 2: b();   right: 1, 3: a(); 2: b();";
    PROGRAM_COUNT = "ST060", "The text does not have exactly one PROGRAM",
        "A text has one PROGRAM, which is called in each scan.",
        "wrong: x := 1;   right: PROGRAM main VAR x : INT; END_VAR x := 1; END_PROGRAM";
    NUMBER_RANGE = "ST061", "A number of the machine is out of range",
        "M codes are 0 to 191 without those of the runtime (M00, M01, M02, M30, M98, M99), coordinate systems 1 to 8.",
        "wrong: MCODE(M := 30)   right: MCODE(M := 31)";
}

/// Findings of one text.
#[derive(Debug, Default)]
pub(crate) struct Findings {
    list: Vec<Diagnostic>,
}

impl Findings {
    pub fn push(
        &mut self,
        entry: &'static FindingEntry,
        span: Span,
        message: impl Into<String>,
        help: impl Into<String>,
    ) {
        let (message, help) = (message.into(), help.into());
        let found = |entry: &'static FindingEntry, message, help| Diagnostic {
            code: entry.code,
            severity: Severity::Error,
            span,
            message,
            help,
        };
        if self.list.len() < FINDINGS_MAX {
            self.list.push(found(entry, message, help));
        } else if self.list.len() == FINDINGS_MAX {
            self.list.push(found(
                &TOO_MANY,
                "further findings are not listed".to_owned(),
                "correct the findings above, then check again".to_owned(),
            ));
        }
    }

    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Returns the findings in the order of their positions.
    pub fn into_list(mut self) -> Vec<Diagnostic> {
        self.list
            .sort_by_key(|found| (found.code == TOO_MANY.code, found.span.start, found.span.end));
        self.list
    }
}
