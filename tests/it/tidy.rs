//! Rules of the source that need its tables: numbers of rules, and names of tasks and threads.

mod rules;

use tandem_tidy::product::without_tests;
use tandem_tidy::{files, read};

/// Calls whose first argument is the name of a task or thread.
const NAMING: [&str; 5] = [
    ".contained(",
    ".restarted(",
    ".essential(",
    ".catch_panic(",
    "Thread::start(",
];

#[test]
fn every_named_task_and_thread_has_an_injected_fault() {
    let known: Vec<&str> = crate::faults::names().collect();
    let (mut seen, mut missing) = (0, Vec::new());
    for path in files(&[".rs"]) {
        if !path.starts_with("runtime") {
            continue;
        }
        let text = read(&path);
        let text = without_tests(&path, &text);
        for (at, naming) in NAMING.iter().flat_map(|naming| text.match_indices(naming)) {
            let Some(name) = text[at + naming.len()..].trim_start().strip_prefix('"') else {
                continue;
            };
            let name = name.split('"').next().unwrap_or_default();
            seen += 1;
            if !known.contains(&name) {
                missing.push(format!("{}: {name}", path.display()));
            }
        }
    }
    assert!(seen > 20, "only {seen} names found");
    assert!(missing.is_empty(), "{missing:#?}");
}
