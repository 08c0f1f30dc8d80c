//! Pages of the language, written from the tables that the checker and the interpreter read.

use std::fmt::Write as _;

use tandem_interp::codes::{Code, ModalGroup, WordSpec};
use tandem_interp::decisions::DECISIONS;
use tandem_interp::{Dialect, dialects};
use tandem_syntax::{DIAGNOSTICS, Function};

use super::generated::check;

#[test]
fn the_page_of_the_codes_is_that_of_the_dialect() {
    let some = ["G00", "G50.1", "G84", "G501", "M30", "M98"];
    page_of_codes(dialects::nj(), &some, "docs/src/reference/codes.md");
    let some = ["G00", "G10", "G39", "G83", "G92", "M06", "M30"];
    page_of_codes(dialects::dgshape(), &some, "docs/src/reference/codes-dgshape.md");
}

fn page_of_codes(dialect: &Dialect, some: &[&str], file: &str) {
    let mut page = format!("# Codes of dialect {}\n\n## G codes\n\n", dialect.name);
    for code in dialect.g_codes.codes {
        describe(&mut page, code);
    }
    page.push_str("## M codes\n\n");
    for code in dialect.m_codes.codes.iter().chain([&dialect.auxiliary]) {
        describe(&mut page, code);
    }
    page.push_str("## Words that stay in force without a code\n\n");
    let modal: Vec<&WordSpec> = tandem_syntax::Address::ALL
        .iter()
        .filter(|address| dialect.modal_words.is_feed_word(**address))
        .filter_map(|address| dialect.modal_words.get(*address))
        .collect();
    table(&mut page, modal.into_iter());
    for code in some {
        assert!(page.contains(&format!("### {code}: ")), "{code}");
    }
    check(file, &page);
}

fn describe(page: &mut String, code: &Code) {
    let _ = writeln!(page, "### {}: {}\n", code.code, code.name);
    if code.group != ModalGroup::NonModal {
        let _ = writeln!(
            page,
            "Modal group {} ({}).\n",
            code.group.number(),
            code.group.text()
        );
    }
    let _ = writeln!(page, "{}\n", code.docs);
    table(page, code.words.iter());
}

fn table<'a>(page: &mut String, words: impl Iterator<Item = &'a WordSpec>) {
    let mut words = words.peekable();
    if words.peek().is_none() {
        return;
    }
    page.push_str("| word | meaning | range | needed |\n| --- | --- | --- | --- |\n");
    for word in words {
        let needed = if word.required { "yes" } else { "" };
        let whole = if word.integer { ", whole" } else { "" };
        let _ = writeln!(
            page,
            "| {} | {} | {}{whole} | {needed} |",
            word.address.text(),
            word.meaning,
            word.range_text()
        );
    }
    page.push('\n');
}

#[test]
fn the_page_of_the_functions_is_that_of_their_table() {
    let mut page = String::from(
        "# Functions\n\nA name that ends in `d` takes or gives degrees, the others radians. Outside its domain a \
         function gives what is not a number; where that reaches a word, the block is an alarm (D07).\n\n\
         | function | gives | domain |\n| --- | --- | --- |\n",
    );
    for function in Function::ALL {
        let arguments = if function.arguments() == 2 { "x, y" } else { "x" };
        let _ = writeln!(
            page,
            "| `{}({arguments})` | {} | {} |",
            function.text(),
            function.meaning(),
            function.domain()
        );
    }
    check("docs/src/reference/functions.md", &page);
}

#[test]
fn the_page_of_the_diagnostics_is_that_of_their_table() {
    let mut page = String::from("# Diagnostics\n\nE: the program cannot run. W: it can.\n\n");
    for entry in DIAGNOSTICS {
        let _ = writeln!(
            page,
            "## {}: {}\n\n{}\n\n```text\n{}\n```\n",
            entry.code, entry.title, entry.explanation, entry.example
        );
    }
    check("docs/src/reference/diagnostics.md", &page);
}

#[test]
fn the_page_of_the_decisions_is_that_of_their_table() {
    let mut page = String::from(
        "# Decisions\n\nWhere the manual is silent, this is how Tandem reads a program.\n\n| number | decision |\n\
         | --- | --- |\n",
    );
    for (number, text) in DECISIONS {
        let _ = writeln!(page, "| {number} | {text} |");
    }
    check("docs/src/reference/decisions.md", &page);
}
