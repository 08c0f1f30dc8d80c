//! Reads the checkout for the rules of the source that no compiler checks.
//!
//! Rust sources are read by their syntax tree: [`product::without_tests`] removes test items wherever they stand, and
//! [`product::sources`] follows the `mod` declarations of a crate, so that no product line is invisible to a rule.

#![expect(
    clippy::panic,
    reason = "only tests use this crate, and a panic is how a test reports what it cannot read"
)]

pub mod circles;
pub mod product;
pub mod prose;

use std::path::{Path, PathBuf};

/// Source folders of the crates.
pub const CRATES: [&str; 17] = [
    "plc-api/src",
    "plc-api/derive/src",
    "plc-api/protocol/src",
    "runtime/src",
    "runtime/config/src",
    "runtime/store/src",
    "runtime/testing/src",
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

/// Folders that tools write, or that hold the work of others.
const FOREIGN_FOLDERS: [&str; 8] = [
    "target",
    "node_modules",
    "dist",
    "vendor",
    ".git",
    "tandem-data",
    "out",
    "benches_out",
];

/// Returns the root of the checkout.
///
/// # Panics
/// Panics if this crate is not two folders below the root.
pub fn root() -> &'static Path {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    folder.ancestors().nth(2).unwrap_or(folder)
}

/// Returns the files of the checkout with one of these endings, relative to its root, in order.
///
/// # Panics
/// Panics if a folder cannot be read, or if no file has such an ending.
pub fn files(endings: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![root().to_owned()];
    while let Some(folder) = folders.pop() {
        let entries =
            std::fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
        for path in entries.flatten().map(|entry| entry.path()) {
            let name = path
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
            if path.is_dir() {
                if !FOREIGN_FOLDERS.contains(&name.as_str()) && !name.starts_with("target") {
                    folders.push(path);
                }
            } else if endings.iter().any(|ending| name.ends_with(ending)) {
                found.push(path.strip_prefix(root()).unwrap_or(&path).to_owned());
            }
        }
    }
    found.sort();
    assert!(!found.is_empty(), "no files with {endings:?}");
    found
}

/// Returns the text of a file of the checkout.
///
/// # Panics
/// Panics if the file cannot be read.
pub fn read(path: &Path) -> String {
    std::fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}
