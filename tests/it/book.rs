//! The README and the book in `docs/`: their commands give the described results, their links have targets,
//! and their lists are complete.

mod commands;
mod container;
mod contract;
pub mod generated;
mod language;
mod links;
mod page;
mod rules;
mod units;

use std::collections::BTreeSet;

use page::{pages, read};

#[test]
fn every_page_is_in_the_summary_and_every_entry_of_the_summary_is_a_page() {
    let summary = read("docs/src/SUMMARY.md");
    let listed: BTreeSet<String> = links::targets(&summary)
        .into_iter()
        .map(|(_, target)| format!("docs/src/{target}"))
        .collect();
    let there: BTreeSet<String> = pages()
        .into_iter()
        .filter(|path| !path.ends_with("SUMMARY.md"))
        .collect();
    assert_eq!(listed, there);
}

#[test]
fn every_page_whose_rust_compiles_as_it_stands_is_a_doc_test() {
    let tested = read("docs/book.rs");
    let mut found = 0;
    for path in pages() {
        let has_rust = page::blocks(&read(&path))
            .iter()
            .any(|block| block.info == "rust");
        if has_rust {
            found += 1;
            let name = path.trim_start_matches("docs/");
            assert!(
                tested.contains(&format!("\"{name}\"")),
                "docs/book.rs does not test {path}"
            );
        }
    }
    assert!(found > 0, "no page shows Rust");
}
