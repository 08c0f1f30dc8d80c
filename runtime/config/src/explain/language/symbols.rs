//! Pages about operators and brackets.

use super::super::{indented, page};

/// A symbol: its spellings, title, example and description.
type Symbol = (&'static [&'static str], &'static str, &'static str, &'static str);

const COMPARED: &str = "Compares two numbers; a comparison with NaN (not a number) is false. The result is \
                        a condition, not a number (D09).";
const ORDER: &str = "Order of evaluation: !, then comparisons, then &&, then ||. Parentheses change it.";

static ALL: &[Symbol] = &[
    (
        &["="],
        "assignment",
        "L1 = L2 + 1",
        "Assigns the value on its right to the variable on its left. Program codes are on separate lines.",
    ),
    (
        &["+"],
        "addition",
        "L1 = L2 + L3",
        "Adds two numbers. As a sign it can precede numbers only.",
    ),
    (
        &["-"],
        "subtraction, or sign",
        "L1 = -L2 - L3",
        "Subtracts the number on its right, or reverses its sign.",
    ),
    (
        &["*"],
        "multiplication",
        "L1 = L2 * L3",
        "Multiplies two numbers.",
    ),
    (
        &["/"],
        "division",
        "L1 = L2 / L3",
        "Divides by the number on its right. A division by 0 raises an alarm only if its result becomes the \
         value of a word (D07).",
    ),
    (
        &["%"],
        "remainder of a division",
        "L1 = 7 % 3",
        "Returns the remainder of the division, with the sign of the number on its left (D07).",
    ),
    (&["=="], "is equal", "if (L1 == 2) X5", COMPARED),
    (
        &["!="],
        "is not equal",
        "if (L1 != 2) X5",
        "Compares two numbers; NaN (not a number) equals no number. The result is a condition, not a number \
         (D09).",
    ),
    (&["<"], "is less", "if (L1 < 2) X5", COMPARED),
    (&[">"], "is greater", "if (L1 > 2) X5", COMPARED),
    (&["<="], "is less or equal", "if (L1 <= 2) X5", COMPARED),
    (&[">="], "is greater or equal", "if (L1 >= 2) X5", COMPARED),
    (
        &["&&"],
        "and",
        "if (L1 > 0 && L1 < 5) X5",
        "True if both conditions are true.",
    ),
    (
        &["||"],
        "or",
        "if (L1 < 0 || L1 > 5) X5",
        "True if at least one of the conditions is true.",
    ),
    (
        &["!"],
        "not",
        "if (!(L1 == 2)) X5",
        "True if the condition is false. The parentheses are required.",
    ),
    (
        &["[", "]"],
        "indirection",
        "X[L1] F[Q5]",
        "The word has the value of the variable when the block is interpreted. The brackets contain one \
         variable, no calculation (D04).",
    ),
    (
        &["(", ")"],
        "parentheses",
        "L1 = 2 * (L2 + sqrt(L3))",
        "Enclose conditions, arguments of functions, and parts that are calculated first.",
    ),
    (
        &["{", "}"],
        "commands of a branch or loop",
        "if (L1 == 2) {\n    X5\n}",
        "The commands between them are executed as one command.",
    ),
];

/// Returns the names of all symbols.
pub(super) fn names() -> impl Iterator<Item = String> {
    ALL.iter()
        .flat_map(|(names, ..)| names.iter().map(|name| (*name).to_owned()))
}

/// Returns the page of the symbol `what`; `None` if it is not a symbol.
pub(super) fn page_of(what: &str) -> Option<String> {
    let (names, title, form, text) = ALL.iter().find(|(names, ..)| names.contains(&what))?;
    let order = if matches!(*title, "and" | "or" | "not") {
        ORDER
    } else {
        ""
    };
    let name = names.join(" ");
    Some(page(
        &name,
        title,
        &[indented(form), (*text).to_owned(), order.to_owned()],
    ))
}
