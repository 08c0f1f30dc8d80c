//! Everything that the architecture page names exists.

use std::path::Path;

use tandem_tidy::product::without_tests;
use tandem_tidy::{files, read};

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
fn each_name_on_the_architecture_page_is_defined_in_its_file() {
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

/// Places where a task or thread begins without a call of the supervisor next to it, and why.
const SUPERVISED_ELSEWHERE: [(&str, &str); 11] = [
    ("runtime/gateway/src/broker.rs", "`accepting` is essential"),
    (
        "runtime/gateway/src/mqtt/inside.rs",
        "one message, the will of a client that has left",
    ),
    (
        "runtime/gateway/src/mqtt/link.rs",
        "`Machine::republish` is contained",
    ),
    (
        "runtime/gateway/src/mqtt/wire.rs",
        "the link sees the end of its poller",
    ),
    (
        "runtime/store/src/clock.rs",
        "`within_real` ends its wait when the thread ends",
    ),
    (
        "runtime/src/coordinator.rs",
        "the task of the time left is restarted in `Previews::tell_time_left`",
    ),
    (
        "runtime/src/port/background.rs",
        "the request that waits for the check is answered",
    ),
    (
        "runtime/src/preview/mod.rs",
        "`start_thread` reports and continues",
    ),
    (
        "runtime/store/src/program_store/program.rs",
        "`with_sum` makes the sum itself where the thread has not",
    ),
    (
        "runtime/src/servo_thread.rs",
        "the relay and the servo thread watch one another",
    ),
    (
        "runtime/store/src/threads.rs",
        "`Supervised::round` reports and continues",
    ),
];

/// Folders of programs that end with what they do: the command line.
const NOT_SERVING: [&str; 1] = ["runtime/src/cli"];

#[test]
fn every_task_and_thread_of_the_runtime_has_a_supervisor() {
    let (mut seen, mut missing) = (0, Vec::new());
    for path in files(&[".rs"]) {
        let is_serving = ["runtime/src", "runtime/store/src", "runtime/gateway/src"]
            .iter()
            .any(|folder| path.starts_with(folder))
            && !NOT_SERVING.iter().any(|folder| path.starts_with(folder));
        let is_test = path
            .components()
            .any(|part| ["tests", "tests.rs"].iter().any(|name| part.as_os_str() == *name));
        if !is_serving || is_test {
            continue;
        }
        let text = read(&path);
        let text = without_tests(&path, &text);
        let lines: Vec<&str> = text.lines().collect();
        for (at, line) in lines.iter().enumerate() {
            if !(line.contains("spawn(") || line.contains("thread::Builder")) || line.contains("fn ") {
                continue;
            }
            seen += 1;
            let beside = &lines[at.saturating_sub(4)..=(at + 1).min(lines.len() - 1)];
            let is_listed = SUPERVISED_ELSEWHERE
                .iter()
                .any(|(file, _)| path == Path::new(file));
            if !is_listed && !beside.iter().any(|line| line.contains("supervisor")) {
                missing.push(format!("{}:{}: {}", path.display(), at + 1, line.trim()));
            }
        }
    }
    assert!(seen > 10, "only {seen} places found");
    assert!(missing.is_empty(), "{missing:#?}");
}
