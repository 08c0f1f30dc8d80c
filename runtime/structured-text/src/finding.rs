//! What can be wrong with a program: the table of findings.

use tandem_model::{Diagnostic, Severity, Span};

use crate::limits::FINDINGS_MAX;

/// One line of the table of findings.
#[derive(Debug, PartialEq, Eq)]
pub struct FindingEntry {
    /// `ST001` and so on.
    pub code: &'static str,
    /// What it is called.
    pub title: &'static str,
    /// Why it is wrong.
    pub explanation: &'static str,
    /// Text that causes it, and text that is right.
    pub example: &'static str,
}

impl FindingEntry {
    /// The entry of a code, read without regard to case.
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
        "The list of findings ends at 100; what follows has not been listed.",
        "Correct the errors above, then check again.";
    CHARACTER = "ST003", "A character is not part of the language",
        "Outside comments and strings a text consists of names, numbers and signs of ASCII.",
        "wrong: größe := 1;   right: size := 1;";
    NOT_CLOSED = "ST004", "A comment or a string is not closed",
        "A comment (* ends with *), and a string ends with ' in its line.",
        "wrong: (* door   right: (* door *)";
    LITERAL = "ST005", "A literal is not written as one",
        "Numbers are 5, 1_000, 16#FF, 2#1010, 1.0E-3; times T#1s500ms; a type may stand before them: INT#5. Underscores stand \
         between digits.",
        "wrong: T#5   right: T#5s";
    LITERAL_RANGE = "ST006", "A value does not fit its type",
        "Each type has its range, such as INT -32768 to 32767.",
        "wrong: SINT#200   right: INT#200";
    SYNTAX = "ST010", "Something else is expected here",
        "The text does not follow the grammar of Structured Text.",
        "wrong: IF a THEN b := 1;   right: IF a THEN b := 1; END_IF;";
    TOO_DEEP = "ST011", "Too much within each other",
        "Statements and expressions may stand 40 deep within each other, and calls 10 deep.",
        "Write a part as a FUNCTION, or give a part of an expression a variable.";
    NOT_IN_SUBSET = "ST012", "Not part of this subset",
        "The page Structured Text lists what a program may use. What is not listed is refused, never ignored.",
        "wrong: VAR RETAIN n : INT; END_VAR   right: VAR n : INT; END_VAR, and P variables for what must be kept";
    UNKNOWN = "ST020", "A name is not known",
        "Variables, types, functions and function blocks are declared. Upper and lower case make no difference.",
        "wrong: coutn := 1;   right: count := 1;";
    TWICE = "ST021", "A name is declared twice",
        "A name has one meaning in its program organization unit, and one in the text.",
        "wrong: VAR a : INT; A : BOOL; END_VAR   right: VAR a : INT; b : BOOL; END_VAR";
    RESERVED = "ST022", "A name is a word of the language",
        "Keywords, and the names of standard types, functions and function blocks, cannot be declared.",
        "wrong: VAR ton : BOOL; END_VAR   right: VAR delay_is_over : BOOL; END_VAR";
    TYPE = "ST030", "A type does not fit",
        "Operators, conditions and parameters take certain types; nothing is converted where a value could be lost.",
        "wrong: IF count THEN   right: IF count > 0 THEN";
    NARROWING = "ST031", "A value could be lost",
        "A type becomes a wider one by itself, such as INT to DINT; the other way is written as a conversion.",
        "wrong: an_int := a_dint;   right: an_int := DINT_TO_INT(a_dint);";
    NOT_ASSIGNABLE = "ST032", "This cannot be assigned",
        "Constants, inputs within their block, outputs of others, and the variable of a running FOR keep their values.",
        "wrong: timer.Q := TRUE;   right: timer(IN := TRUE);";
    NOT_CONSTANT = "ST033", "A constant is expected",
        "Array bounds, labels of CASE, lengths, initial values, and the numbers of M codes and variables are known before the \
         program runs: literals, VAR CONSTANT, and operations on these.",
        "wrong: MCODE(M := n)   right: MCODE(M := 10)";
    CONSTANT_FAULT = "ST034", "A constant cannot be calculated",
        "The calculation divides by zero, or its result does not fit its type.",
        "wrong: n := 1 / 0;   right: n := 1;";
    PARAMETERS = "ST040", "Parameters of a call are wrong",
        "A call gives parameters in their order, or by name with := for inputs and => for outputs; not both.",
        "wrong: MAX(1)   right: MAX(1, 2)";
    RECURSION = "ST041", "Something contains or calls itself",
        "IEC 61131-3 allows no recursion: no function calls itself, also not through others, and no type contains itself.",
        "Write a loop.";
    NOT_CALLABLE = "ST042", "This cannot be called so",
        "Functions are called by their names and give a value; of a function block an instance is called, as a statement.",
        "wrong: TON(IN := a);   right: VAR t : TON; END_VAR t(IN := a);";
    BOUNDS = "ST050", "An index is out of range",
        "An array has its bounds, the lower first.",
        "wrong: ARRAY[5..1] OF INT   right: ARRAY[1..5] OF INT";
    LABELS = "ST051", "A label of CASE stands there twice",
        "Each value has one branch.",
        "wrong: 1..3: a(); 2: b();   right: 1, 3: a(); 2: b();";
    PROGRAM_COUNT = "ST060", "There is not one PROGRAM",
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
                "there are more findings, which are not listed".to_owned(),
                "correct those above, then check again".to_owned(),
            ));
        }
    }

    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// In the order of their places.
    pub fn into_list(mut self) -> Vec<Diagnostic> {
        self.list
            .sort_by_key(|found| (found.code == TOO_MANY.code, found.span.start, found.span.end));
        self.list
    }
}
