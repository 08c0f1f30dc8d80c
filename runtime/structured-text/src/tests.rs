//! Tests of the language. Expected values are those of IEC 61131-3, or of arithmetic.

mod conformance;
mod declarations;
mod faults;
mod functions;
mod literals;
mod machine;
mod operators;
mod refusals;
mod robustness;
mod statements;
mod units;

use plc_api::scan::{Image, ScanProgram};

use crate::Program;

/// Compiles a text without faults.
pub fn compiled(source: &str) -> Program {
    Program::compile("test.st", source).unwrap_or_else(|findings| panic!("{source}\n{findings:#?}"))
}

/// Returns a program with these variables and statements.
pub fn program(variables: &str, body: &str) -> String {
    format!("PROGRAM test\nVAR {variables} END_VAR\n{body}\nEND_PROGRAM\n")
}

/// Returns the program after one scan.
pub fn scanned(source: &str) -> Program {
    let mut program = compiled(source);
    program.scan(&mut Image::default());
    program
}

/// Returns the value of `r` after one scan.
pub fn result(variables: &str, body: &str) -> String {
    let program = scanned(&program(variables, body));
    assert_eq!(program.stopped(), None, "{body}");
    program
        .shown("R")
        .unwrap_or_else(|| panic!("no r in {variables}"))
}

/// Returns the value of an expression that is assigned to a variable of this type.
pub fn value(of: &str, expression: &str) -> String {
    result(&format!("r : {of};"), &format!("r := {expression};"))
}

/// Checks the values of expressions.
pub fn values(rows: &[(&str, &str, &str)]) {
    for (of, expression, expected) in rows {
        assert_eq!(value(of, expression), *expected, "{of}: {expression}");
    }
}

/// Returns the codes of findings, with their lines.
pub fn found(source: &str) -> Vec<(&'static str, usize)> {
    let findings = Program::compile("test.st", source).err().unwrap_or_default();
    let line = |start: u32| source[..start as usize].matches('\n').count() + 1;
    findings
        .iter()
        .map(|found| (found.code, line(found.span.start)))
        .collect()
}

/// Returns the code of the only finding.
pub fn only(source: &str) -> &'static str {
    let found = found(source);
    assert_eq!(
        found.len(),
        1,
        "{source}\n{:#?}",
        Program::compile("test.st", source).err()
    );
    found[0].0
}

/// Returns the reason why the program has stopped after one scan.
pub fn stopped(variables: &str, body: &str) -> String {
    let program = scanned(&program(variables, body));
    program
        .stopped()
        .unwrap_or_else(|| panic!("{body} does not stop"))
        .to_owned()
}
