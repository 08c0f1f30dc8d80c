//! Additions by users through the public API only: a handler, a transport, a G code in a custom dialect, drives. Also
//! additions that need few places: a configuration key, a request, a state topic, a card of the HMI.

mod configuration_key;
mod cycle;
mod dialect;
mod drive_bus;
mod g81_drilling;
mod g_code;
mod handler;
mod hmi_card;
mod policy;
mod request;
mod runs;
mod spindle;
mod topic;
mod transport;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use tandem_tidy::product::without_tests;
use tandem_tidy::{files, read};

/// The files that the architecture page names as the cost of an addition.
fn costs(addition: &str) -> Vec<String> {
    let page = read("runtime/ARCHITECTURE.md".as_ref());
    let begin = format!("| {addition} |");
    let row = page.lines().find(|line| line.starts_with(&begin));
    let row = row.unwrap_or_else(|| panic!("no row of {addition}"));
    row.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

/// Folders and files that hold tests only; the worlds are simulated ones.
const TEST_FOLDERS: [&str; 5] = ["tests", "tests.rs", "benches", "world", "world.rs"];

/// Code of product files, without tests and comments. Kept, because many tests search it and parsing all files takes
/// seconds.
static CODE: Mutex<BTreeMap<PathBuf, Arc<str>>> = Mutex::new(BTreeMap::new());

/// Returns the code of a product file, without tests and comments.
fn code_of(path: &Path) -> Arc<str> {
    let is_code = |line: &&str| !line.trim_start().starts_with("//") && !line.trim_start().starts_with('*');
    let mut known = CODE.lock().unwrap();
    let code = known.entry(path.to_owned()).or_insert_with(|| {
        let text = read(path);
        let product = match path.extension() {
            Some(extension) if extension == "rs" => without_tests(path, &text),
            _ => text,
        };
        product
            .lines()
            .filter(is_code)
            .collect::<Vec<_>>()
            .join("\n")
            .into()
    });
    Arc::clone(code)
}

/// Returns product files of a folder with this ending and matching code, without tests and comments.
fn files_where(folder: &str, ending: &str, is_meant: impl Fn(&str) -> bool) -> Vec<PathBuf> {
    let mut found = files(&[ending]);
    found.retain(|path| {
        let is_test = path
            .components()
            .any(|part| TEST_FOLDERS.contains(&part.as_os_str().to_str().unwrap()));
        !is_test && path.starts_with(folder) && is_meant(&code_of(path))
    });
    found
}
