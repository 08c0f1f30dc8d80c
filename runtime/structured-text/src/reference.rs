//! The page of the book, generated from the tables of the compiler.

use std::fmt::Write;

use crate::blocks::{BuiltIn, Direction, Port, machine_blocks, standard};
use crate::conformance::FEATURES;
use crate::finding::FINDINGS;
use crate::functions::{FUNCTIONS, OPERATORS};
use crate::limits;
use crate::machine::MACHINE_FUNCTIONS;

/// Returns `docs/src/reference/structured-text.md`.
pub fn page() -> String {
    let mut page = String::from(INTRODUCTION);
    for title in titles() {
        let _ = write!(page, "\n### {title}\n\n| feature | difference |\n| --- | --- |\n");
        for feature in FEATURES.iter().filter(|feature| feature.table == title) {
            let _ = writeln!(
                page,
                "| {} | {} |",
                feature.feature,
                or(feature.note, "as in the standard")
            );
        }
    }
    page.push_str(NOT_THERE);
    page.push_str("\n## Function blocks of the machine\n");
    page.push_str(MACHINE);
    machine_blocks().for_each(|block| block_of(&mut page, block));
    page.push_str("\n## Functions of the machine\n\n| function | |\n| --- | --- |\n");
    for function in &MACHINE_FUNCTIONS {
        let parameters = function
            .parameters
            .iter()
            .map(|(name, of)| format!("{name} : {}", of.text()));
        let gives = function
            .gives
            .map_or_else(String::new, |of| format!(" : {}", of.text()));
        let parameters = parameters.collect::<Vec<_>>().join(", ");
        let _ = writeln!(
            page,
            "| `{}({parameters}){gives}` | {} |",
            function.name, function.about
        );
    }
    page.push_str("\n## Standard function blocks\n");
    standard().for_each(|block| block_of(&mut page, block));
    page.push_str("\n## Standard functions\n\n");
    let functions = FUNCTIONS.iter().map(|function| {
        let parameters = function
            .parameters
            .iter()
            .map(|(name, _)| *name)
            .collect::<Vec<_>>()
            .join(", ");
        format!(
            "`{}({parameters}{})`",
            function.name,
            if function.is_extensible { ", ..." } else { "" }
        )
    });
    let operators = OPERATORS.iter().map(|(name, _)| format!("`{name}`"));
    let _ = writeln!(page, "{},", functions.collect::<Vec<_>>().join(", "));
    let _ = writeln!(
        page,
        "and the operators as functions: {}.",
        operators.collect::<Vec<_>>().join(", ")
    );
    limits_of(&mut page);
    page.push_str("\n## Findings\n\n`tandem explain ST031` explains a finding with an example.\n\n| code | |\n| --- | --- |\n");
    for entry in FINDINGS {
        let _ = writeln!(
            page,
            "| {} | {}. {} |",
            entry.code, entry.title, entry.explanation
        );
    }
    page
}

const INTRODUCTION: &str = "# Structured Text

A sequence program may be written in Structured Text (ST) of IEC 61131-3, third edition. `tandem st FILE.st --check` lists the faults
of a program, `tandem st FILE.st --run --connect ADDRESS` runs it on a machine. For an example, see
[Write a PLC scan](../how-to/scan.md#structured-text). In Rust, the type is `tandem_structured_text::Program`.

Tandem implements its own subset, because no other implementation can be a part of it. The nearest one is IronPLC (MIT). The registry
of crates has only an early version of its parser, and its virtual machine exchanges no values with another process while it runs.

A text has one `PROGRAM`, which is called in each scan, and the functions, function blocks and types that the program uses. Any element
that is not listed on this page is rejected with line, column, fault and remedy; nothing is ignored.

If a program has a fault, such as a division by zero, it stops: an alarm of the whole machine names the line and the piece of the
source, the M codes that the program serves fail with this alarm, and its locks stay locked. Until the program is started again, a
reset does not end the alarm: it is raised again.

## Conformance

A test proves each row; its expected values are those of the standard.
";

const NOT_THERE: &str = "
### Not in this subset

`RETAIN` (keep values in P variables), `AT` and `%` addresses, `VAR_GLOBAL`, `VAR_EXTERNAL`, `CONFIGURATION`, `RESOURCE`, `TASK`,
references and pointers, classes, methods, interfaces, namespaces, `WSTRING`, `CHAR`, dates and times of day, `LTIME`, subranges,
single bits of bit strings, `EN` and `ENO`, steps and transitions, pragmas. The languages IL, LD, FBD and SFC.
";

const MACHINE: &str = "
Inputs that are *constant* are numbers or `VAR CONSTANT`, set in the call or in the declaration
(`clamp : MCODE := (M := 10);`): they are known before the program runs. Outputs show the machine before the scan, and written values
take effect after the scan. `INTERLOCK`, `START_LOCK` and `ALARM` are levels: an instance that is not called keeps its level.
";

fn titles() -> Vec<&'static str> {
    let mut titles: Vec<&str> = FEATURES.iter().map(|feature| feature.table).collect();
    titles.dedup();
    titles
}

fn or<'a>(text: &'a str, otherwise: &'a str) -> &'a str {
    if text.is_empty() { otherwise } else { text }
}

fn block_of(page: &mut String, block: &BuiltIn) {
    let _ = write!(
        page,
        "\n### {}\n\n{}.\n\n| | | |\n| --- | --- | --- |\n",
        block.name,
        capitalised(block.about)
    );
    for port in block.ports {
        let (how, default) = how(port);
        let _ = writeln!(
            page,
            "| {how} | `{} : {}`{default} | {} |",
            port.name,
            port.of.text(),
            port.about
        );
    }
}

/// Returns the kind of a port, and its default value.
fn how(port: &Port) -> (&'static str, String) {
    match port.direction {
        Direction::Input => ("input", String::new()),
        Direction::InputOr(value) => ("input", format!(" := {value:?}")),
        Direction::Constant(low, high, Some(value)) => ("constant", format!(" := {value}, {low} to {high}")),
        Direction::Constant(low, high, None) => ("constant", format!(", {low} to {high}")),
        Direction::Output | Direction::OutputOn => ("output", String::new()),
    }
}

fn capitalised(text: &str) -> String {
    let mut letters = text.chars();
    letters
        .next()
        .map(|first| first.to_uppercase().chain(letters).collect())
        .unwrap_or_default()
}

fn limits_of(page: &mut String) {
    let rows = [
        ("bytes of a text", limits::SOURCE_BYTES_MAX.to_string()),
        (
            "programs, functions, function blocks and types of a text",
            limits::UNITS_MAX.to_string(),
        ),
        (
            "nested statements, and operators that are nested or in a row",
            limits::NESTING_MAX.to_string(),
        ),
        (
            "nested calls of functions and function blocks",
            limits::CALL_DEPTH_MAX.to_string(),
        ),
        (
            "values of all variables; a `STRING` has one value for each 16 characters",
            limits::MEMORY_MAX.to_string(),
        ),
        ("characters of a `STRING`", limits::STRING_MAX.to_string()),
        ("dimensions of an array", limits::DIMENSIONS_MAX.to_string()),
        (
            "steps of a scan: statements, operations and copied values",
            limits::STEPS_MAX.to_string(),
        ),
        ("listed findings", limits::FINDINGS_MAX.to_string()),
    ];
    page.push_str("\n## Limits\n\n| at most | |\n| --- | --- |\n");
    for (what, limit) in rows {
        let _ = writeln!(page, "| {what} | {limit} |");
    }
}
