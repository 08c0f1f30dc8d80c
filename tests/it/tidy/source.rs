//! Sizes and words.

use super::{files, read, without_unit_tests};

const LINES_MAX: usize = 600;
/// Tables of texts grow with the screen, one line a text.
const TEXTS_MAX: usize = 2000;
const FUNCTION_LINES_MAX: usize = 70;

#[test]
fn no_file_is_longer_than_600_lines_without_its_unit_tests() {
    let too_long: Vec<String> = files(&[".rs", ".js", ".mjs"])
        .iter()
        .map(|path| (path, without_unit_tests(&read(path)).lines().count()))
        .filter(|(path, lines)| {
            let is_table = path
                .parent()
                .is_some_and(|folder| folder.ends_with("web/language"));
            *lines > if is_table { TEXTS_MAX } else { LINES_MAX }
        })
        .map(|(path, lines)| format!("{}: {lines} lines", path.display()))
        .collect();
    assert!(too_long.is_empty(), "{too_long:#?}");
}

fn indent(line: &str) -> usize {
    line.len() - line.trim_start().len()
}

fn begins_function(line: &str) -> bool {
    let mut words = line.trim_start().split([' ', '(']);
    let Some(word) = words.find(|word| {
        let before = [
            "pub", "crate)", "super)", "const", "async", "unsafe", "extern", "export", "default", "\"C\"",
        ];
        !before.contains(word) && !word.starts_with("in ")
    }) else {
        return false;
    };
    word == "fn" || word == "function"
}

/// Lines of each function: from its first line to the brace that closes it at the same indent.
fn functions(text: &str) -> Vec<(usize, usize)> {
    let lines: Vec<&str> = text.lines().collect();
    let mut found = Vec::new();
    for (begin, line) in lines.iter().enumerate() {
        if !begins_function(line) || line.ends_with('}') || line.ends_with(';') {
            continue;
        }
        let same = |at: &str| !at.trim().is_empty() && indent(at) == indent(line);
        let end = lines[begin + 1..]
            .iter()
            .position(|at| same(at) && (at.trim_start().starts_with('}') || at.ends_with(';')));
        if let Some(end) = end {
            found.push((begin + 1, end + 2));
        }
    }
    found
}

#[test]
fn no_function_is_longer_than_70_lines() {
    let mut too_long = Vec::new();
    let mut seen = 0;
    for path in files(&[".rs", ".js", ".mjs"]) {
        for (line, lines) in functions(&read(&path)) {
            seen += 1;
            if lines > FUNCTION_LINES_MAX {
                too_long.push(format!("{}:{line}: {lines} lines", path.display()));
            }
        }
    }
    assert!(seen > 500, "only {seen} functions found");
    assert!(too_long.is_empty(), "{too_long:#?}");
}

#[test]
fn functions_are_found_and_measured() {
    let text = "pub(crate) async fn a(\n    x: u8,\n) -> u8 {\n    x\n}\n\nfn b() {}\n\ntrait T {\n    fn c(&self);\n    fn d() {\n        1;\n    }\n}\n";
    assert_eq!(functions(text), [(1, 5), (11, 3)]);
}

/// Returns lines with a forbidden word.
fn lines_with(endings: &[&str], is_wrong: impl Fn(&str) -> bool) -> Vec<String> {
    let mut found = Vec::new();
    for path in files(endings) {
        // This file names what it looks for.
        if path.ends_with("tidy/source.rs") || path.ends_with("tidy/check") {
            continue;
        }
        for (number, line) in read(&path).lines().enumerate() {
            if is_wrong(line) {
                found.push(format!("{}:{}: {}", path.display(), number + 1, line.trim()));
            }
        }
    }
    found
}

const TEXTS: [&str; 9] = [
    ".rs", ".js", ".mjs", ".ts", ".css", ".html", ".toml", ".md", ".nc",
];

fn words(line: &str) -> impl Iterator<Item = &str> {
    line.split(|letter: char| !letter.is_alphanumeric() && letter != '_')
}

#[test]
fn nothing_is_left_for_later() {
    let found = lines_with(&TEXTS, |line| {
        words(line).any(|word| {
            [
                concat!("TO", "DO"),
                concat!("FIX", "ME"),
                concat!("X", "XX"),
                concat!("HA", "CK"),
            ]
            .contains(&word)
        }) || ["unimplemented!", "todo!(", "#[ignore"]
            .iter()
            .any(|what| line.contains(what))
    });
    assert!(found.is_empty(), "{found:#?}");
}

#[test]
fn no_path_of_a_computer_stands_in_a_file() {
    let found = lines_with(&TEXTS, |line| {
        ["/home/", "/root/", "/Users/", "/work/", "C:\\Users"]
            .iter()
            .any(|path| line.contains(path))
    });
    assert!(found.is_empty(), "{found:#?}");
}

#[test]
fn the_text_speaks_of_the_machine_and_not_of_how_it_was_written() {
    let mut found = lines_with(&TEXTS, |line| {
        let line = line.to_lowercase();
        words(&line).any(|word| ["agent", "agents", "subagent", "chatbot", "llm"].contains(&word))
            || ["this session", "helper machinery", "issue #", "as an ai"]
                .iter()
                .any(|what| line.contains(what))
    });
    // its own word for what answers requests
    found.retain(|place| !place.to_lowercase().contains("mtconnect"));
    assert!(found.is_empty(), "{found:#?}");
}

#[test]
fn every_example_is_named_in_the_book_and_every_main_program_in_a_configuration() {
    let page = read("docs/src/reference/rust.md".as_ref());
    let configurations: String = files(&[".toml"])
        .iter()
        .filter(|path| path.starts_with("examples/config"))
        .map(|path| read(path))
        .collect();
    for path in files(&[".rs", ".nc"]) {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let stem = path.file_stem().unwrap().to_string_lossy().into_owned();
        let folder = path.parent().unwrap();
        if folder.ends_with("examples") {
            assert!(page.contains(&stem), "the page of Rust does not name {stem}");
        } else if folder.ends_with("examples/nc") {
            assert!(configurations.contains(&name), "no configuration loads {name}");
        }
    }
}

#[test]
fn there_is_no_drawer_for_everything() {
    for path in files(&[".rs", ".js"]) {
        let stem = path.file_stem().unwrap().to_string_lossy().into_owned();
        let drawer =
            ["util", "utils", "helper", "helpers", "common", "misc", "manager"].contains(&stem.as_str());
        assert!(!drawer, "{}", path.display());
    }
}
