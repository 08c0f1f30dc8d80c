//! What the architecture page names is there.

use std::path::Path;

use super::read;

/// The names in backticks of a cell.
fn names(cell: &str) -> impl Iterator<Item = &str> {
    cell.split('`').skip(1).step_by(2)
}

/// The cells of each row of the tables.
fn rows(text: &str) -> impl Iterator<Item = Vec<&str>> {
    text.lines()
        .filter_map(|line| line.strip_prefix("| ")?.strip_suffix(" |"))
        .map(|row| row.split(" | ").collect())
}

/// True when a source has a function or a constant of this name.
fn defines(source: &str, name: &str) -> bool {
    ["fn ", "const "].iter().any(|what| {
        source.match_indices(&format!("{what}{name}")).any(|(at, found)| {
            let after = source[at + found.len()..].chars().next();
            !after.is_some_and(|letter| letter.is_alphanumeric() || letter == '_')
        })
    })
}

#[test]
fn every_function_and_limit_of_the_architecture_page_is_in_the_file_beside_it() {
    let mut seen = 0;
    let mut missing = Vec::new();
    for row in rows(&read("runtime/ARCHITECTURE.md".as_ref())) {
        // step, file, functions; or limit, value, constants and their file, what happens
        let (file, wanted) = match row.as_slice() {
            [_, file, wanted] => (names(file).next(), *wanted),
            [_, _, place, _] => (names(place).last(), *place),
            _ => continue,
        };
        let is_source = |file: &&str| {
            let is_ours = ["runtime", "plc-api"]
                .iter()
                .any(|folder| Path::new(file).starts_with(folder));
            is_ours && Path::new(file).extension().is_some_and(|ending| ending == "rs")
        };
        let Some(file) = file.filter(is_source) else {
            continue;
        };
        let source = read(file.as_ref());
        for name in names(wanted).filter(|name| !name.contains(['.', '/'])) {
            seen += 1;
            if !defines(&source, name) {
                missing.push(format!("{name} is not in {file}"));
            }
        }
    }
    assert!(seen > 100, "only {seen} names found");
    assert!(missing.is_empty(), "{missing:#?}");
}
