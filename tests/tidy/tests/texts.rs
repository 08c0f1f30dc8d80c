//! Words and paths that no file contains, and names of files.

use tandem_tidy::{files, read};

/// Returns lines with a forbidden word.
fn lines_with(endings: &[&str], is_wrong: impl Fn(&str) -> bool) -> Vec<String> {
    let mut found = Vec::new();
    for path in files(endings) {
        // This file names what it looks for.
        if path.ends_with("tests/texts.rs") || path.ends_with("tidy/check") {
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
fn each_example_is_in_the_book_and_each_main_program_in_a_config() {
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
