//! Rules of the source itself that no compiler checks.

mod architecture;
mod circles;
mod codes;
mod crates;
mod rules;
mod source;

use std::path::{Path, PathBuf};

use crate::support::binary::root;

/// Sources of each crate.
const CRATES: [&str; 12] = [
    "plc-api/src",
    "runtime/src",
    "runtime/model/src",
    "runtime/syntax/src",
    "runtime/interp/src",
    "runtime/path/src",
    "runtime/motion/src",
    "runtime/servo/src",
    "runtime/gateway/src",
    "runtime/mtconnect/src",
    "runtime/structured-text/src",
    "runtime/opcua/src",
];

/// Folders that are made by tools, or of what others have written.
const MADE: [&str; 8] = [
    "target",
    "node_modules",
    "dist",
    "vendor",
    ".git",
    "tandem-data",
    "out",
    "benches_out",
];

/// Files of the checkout with one of these endings, relative to its root.
pub(crate) fn files(endings: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![root().to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("a folder of the checkout") {
            let path = entry.expect("an entry").path();
            let name = path.file_name().expect("a name").to_string_lossy().into_owned();
            if path.is_dir() {
                if !MADE.contains(&name.as_str()) && !name.starts_with("target") {
                    folders.push(path);
                }
            } else if endings.iter().any(|ending| name.ends_with(ending)) {
                found.push(path.strip_prefix(root()).expect("below the root").to_owned());
            }
        }
    }
    found.sort();
    assert!(!found.is_empty(), "no files with {endings:?}");
    found
}

pub(crate) fn read(path: &Path) -> String {
    std::fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The text before unit tests.
pub(crate) fn without_unit_tests(text: &str) -> &str {
    text.split("\n#[cfg(test)]").next().unwrap_or(text)
}
