//! Pages of the language, written from the tables that the checker and the interpreter read.

use std::fmt::Write as _;
use std::process::Command;

use plc_protocol::types::words::words;
use tandem_interp::codes::{Code, ModalGroup, WordSpec};
use tandem_interp::dialects::decisions::DECISIONS;
use tandem_interp::restrictions_of;
use tandem_interp::{Dialect, dialects};
use tandem_model::alarm::ALARMS;
use tandem_syntax::{DIAGNOSTICS, Function};

use super::generated::check;
use super::page::read;
use crate::support::binary::{root, tandem};

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
        describe(&mut page, code, dialect);
    }
    page.push_str("## M codes\n\n");
    for code in dialect.m_codes.codes.iter().chain([&dialect.auxiliary]) {
        describe(&mut page, code, dialect);
    }
    page.push_str("## Words that stay in force without a code\n\n");
    let modal: Vec<&WordSpec> = tandem_syntax::Address::ALL
        .iter()
        .filter(|address| dialect.modal_words.is_feed_word(**address))
        .filter_map(|address| dialect.modal_words.get(*address))
        .collect();
    table(&mut page, modal.into_iter(), dialect);
    for code in some {
        assert!(page.contains(&format!("### {code}: ")), "{code}");
    }
    check(file, &page);
}

fn describe(page: &mut String, code: &Code, dialect: &Dialect) {
    let _ = writeln!(page, "### {}: {}\n", code.code, dialect.name_of(code));
    if code.group != ModalGroup::NonModal {
        let _ = writeln!(
            page,
            "Modal group {} ({}).\n",
            code.group.number(),
            code.group.text()
        );
    }
    let _ = writeln!(page, "{}\n", dialect.docs_of(code));
    table(page, dialect.words_of(code), dialect);
    let restrictions = restrictions_of(code, dialect);
    for restriction in &restrictions {
        let _ = writeln!(page, "- {restriction}");
    }
    if !restrictions.is_empty() {
        page.push('\n');
    }
    if let (Some(example), Some((picture, in_z))) = (dialect.example(code), dialect.picture(code)) {
        let path = format!("docs/src/reference/pictures/{picture}");
        check(&path, &drawn(&example, dialect, in_z));
        let _ = writeln!(
            page,
            "```nc\n{example}```\n\n![Tool path of the example](pictures/{picture})\n"
        );
    }
}

/// The picture of an example, on the machine of the examples of its dialect.
fn drawn(example: &str, dialect: &Dialect, in_z: bool) -> String {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    std::fs::write(file("example.nc"), example).unwrap();
    std::fs::write(file("1000.nc"), "G91 G01 X10 F600\nM99\n").unwrap();
    let mut command = Command::new(tandem());
    command.args([
        "plot",
        "example.nc",
        "-o",
        "example.svg",
        "--plane",
        if in_z { "iso" } else { "xy" },
    ]);
    if dialect.name == "dgshape" {
        command
            .arg("--config")
            .arg(root().join("examples/config/dgshape.toml"));
    }
    let ran = command.current_dir(folder.path()).output().unwrap();
    assert!(
        ran.status.success(),
        "{example}{}",
        String::from_utf8_lossy(&ran.stdout)
    );
    std::fs::read_to_string(file("example.svg")).unwrap()
}

fn table<'a>(page: &mut String, words: impl Iterator<Item = &'a WordSpec>, dialect: &Dialect) {
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
            dialect.range_text(word)
        );
    }
    page.push('\n');
}

#[test]
fn the_page_of_the_functions_is_that_of_their_table() {
    let mut page = String::from(
        "# Functions\n\nA function whose name ends in `d` takes or gives degrees, any other radians. Outside its domain, a \
         function gives a result that is not a number; if a word takes that result, the block is an alarm (D07).\n\n\
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
    let mut page =
        String::from("# Diagnostics\n\nE: errors, with which the program cannot run. W: warnings.\n\n");
    for entry in DIAGNOSTICS {
        let _ = writeln!(
            page,
            "## {}: {}\n\n{}\n\n```text\n{}\n```\n",
            entry.code, entry.title, entry.explanation, entry.example
        );
        let (rule, example) = dialects::dgshape().explained(entry);
        if (rule, example) != (entry.explanation, entry.example) {
            let _ = writeln!(page, "In dialect dgshape: {rule}\n\n```text\n{example}\n```\n");
        }
    }
    check("docs/src/reference/diagnostics.md", &page);
}

#[test]
fn the_page_of_the_alarms_is_that_of_their_table() {
    let mut page = String::from(
        "# Alarms\n\n`tandem explain alarm 412`, `GET /explain/alarm 412` and a press on the number in the HMI show this text. Alarms \
         with numbers from 10000 are raised by sequence programs: with `--config`, their texts come from `[alarm.N]` of the \
         configuration, and on the machine also from its handlers.\n\n",
    );
    for entry in ALARMS {
        let _ = writeln!(
            page,
            "## {}: {}\n\n{}\n\nRemedy: {}\n\nHow to continue: {}\n",
            entry.number,
            entry.title,
            entry.cause,
            entry.remedy,
            entry.after.text()
        );
    }
    check("docs/src/reference/alarms.md", &page);
}

/// Alarms that depend only on the text of a program, so that a check finds them.
const OF_TEXT: [u16; 9] = [22, 23, 41, 42, 43, 110, 112, 113, 114];

/// Alarms that stop no program on a machine: warnings, ends of a simulation, and a limit of zero, which no
/// configuration has.
const OF_NO_PROGRAM: [u16; 5] = [30, 103, 310, 390, 391];

#[test]
fn each_alarm_depends_on_the_text_or_is_listed_with_its_cause() {
    let page = read("docs/src/how-to/programs.md");
    let (_, table) = page
        .split_once("| alarms | depend on |\n| --- | --- |\n")
        .unwrap();
    let rows = table.lines().take_while(|line| line.starts_with('|'));
    let mut listed = Vec::new();
    for row in rows {
        let cell = row.split('|').nth(1).unwrap().trim();
        let numbers = cell.split(" without ").next().unwrap();
        for part in numbers.split(", ") {
            let (first, last) = part.split_once(" to ").unwrap_or((part, part));
            let bound = |text: &str| text.parse::<u16>().unwrap_or_else(|_| panic!("{row}"));
            listed.extend(bound(first)..=bound(last));
        }
    }
    for entry in ALARMS {
        let places = [&listed[..], &OF_TEXT, &OF_NO_PROGRAM];
        let places = places.into_iter().filter(|place| place.contains(&entry.number));
        assert_eq!(places.count(), 1, "alarm {}", entry.number);
    }
}

#[test]
fn the_page_of_the_words_is_that_of_their_tables() {
    let mut page = String::from(
        "# States, reasons, refusals and answers\n\nThe words of states, requests and the handshake. `tandem explain WORD`, \
         `GET /explain/WORD` and the HMI show the same text.\n",
    );
    let mut of = "";
    for word in words() {
        if word.of != of {
            of = word.of;
            let _ = writeln!(
                page,
                "\n## {of}\n\n| word | means | how to continue |\n| --- | --- | --- |"
            );
        }
        let _ = writeln!(page, "| `{}` |{} | {} |", word.word, word.meaning, word.way_on);
    }
    check("docs/src/reference/words.md", &page);
}

#[test]
fn the_page_of_the_decisions_is_that_of_their_table() {
    let mut page = String::from(
        "# Decisions\n\nThe behaviour of Tandem where the manual is silent.\n\n| number | decision |\n\
         | --- | --- |\n",
    );
    for (number, text) in DECISIONS {
        let _ = writeln!(page, "| {number} | {text} |");
    }
    check("docs/src/reference/decisions.md", &page);
}
