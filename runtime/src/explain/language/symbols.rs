//! Pages of operators and brackets.

use super::super::{indented, page};

/// Spellings, title, example and description of a symbol.
type Symbol = (&'static [&'static str], &'static str, &'static str, &'static str);

const COMPARED: &str = "Compares two numbers; a comparison with what is not a number is false. It is a condition, and no number (D09).";
const ORDER: &str = "! comes first, then comparisons, then &&, then ||; parentheses say otherwise.";

static ALL: &[Symbol] = &[
    (
        &["="],
        "assignment",
        "L1 = L2 + 1",
        "Gives the variable on its left the value on its right. Program codes stand on lines of their own.",
    ),
    (
        &["+"],
        "addition",
        "L1 = L2 + L3",
        "Adds two numbers. As a sign it stands before numbers only.",
    ),
    (
        &["-"],
        "subtraction, or sign",
        "L1 = -L2 - L3",
        "Subtracts the number on its right, or turns its sign.",
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
        "Divides by the number on its right. A division by 0 is no alarm; its result is one where it is the value of a word (D07).",
    ),
    (
        &["%"],
        "remainder of a division",
        "L1 = 7 % 3",
        "Gives what is left over, with the sign of the number on its left (D07).",
    ),
    (&["=="], "is equal", "if (L1 == 2) X5", COMPARED),
    (
        &["!="],
        "is not equal",
        "if (L1 != 2) X5",
        "Compares two numbers; what is not a number is equal to none. It is a condition, and no number (D09).",
    ),
    (&["<"], "is less", "if (L1 < 2) X5", COMPARED),
    (&[">"], "is greater", "if (L1 > 2) X5", COMPARED),
    (&["<="], "is less or equal", "if (L1 <= 2) X5", COMPARED),
    (&[">="], "is greater or equal", "if (L1 >= 2) X5", COMPARED),
    (
        &["&&"],
        "and",
        "if (L1 > 0 && L1 < 5) X5",
        "Holds where both conditions hold.",
    ),
    (
        &["||"],
        "or",
        "if (L1 < 0 || L1 > 5) X5",
        "Holds where one of the conditions holds, or both.",
    ),
    (
        &["!"],
        "not",
        "if (!(L1 == 2)) X5",
        "Holds where the condition does not. Its parentheses are needed.",
    ),
    (
        &["[", "]"],
        "indirection",
        "X[L1] F[Q5]",
        "The value of the word is that of the variable when the block is interpreted. One variable stands in the brackets, and no calculation (D04).",
    ),
    (
        &["(", ")"],
        "parentheses",
        "L1 = 2 * (L2 + sqrt(L3))",
        "Stand around conditions, arguments of functions, and what is calculated first.",
    ),
    (
        &["{", "}"],
        "commands of a branch or loop",
        "if (L1 == 2) {\n    X5\n}",
        "What stands between them is carried out as one command.",
    ),
];

/// Returns all symbols.
pub(super) fn names() -> impl Iterator<Item = String> {
    ALL.iter()
        .flat_map(|(names, ..)| names.iter().map(|name| (*name).to_owned()))
}

/// Returns the page of a symbol.
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
