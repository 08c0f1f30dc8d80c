//! Test of the table of renamed names (`renamed.sed`). The table is applied to a sequence program that was
//! written against commit 71e10300. The result is in `renamed/after.rs`, which is built and tested here.
#![allow(clippy::unwrap_used, reason = "this crate contains only tests")]

use std::path::Path;
use std::process::Command;

#[rustfmt::skip]
#[path = "renamed/after.rs"]
mod after;

#[test]
fn the_table_of_renamed_names_makes_an_old_program_build() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let applied = Command::new("sed")
        .args(["-E", "-f"])
        .arg(folder.join("renamed.sed"))
        .arg(folder.join("tests/renamed/before.rs.txt"))
        .output()
        .unwrap();
    assert!(
        applied.status.success(),
        "{}",
        String::from_utf8_lossy(&applied.stderr)
    );
    let built = include_str!("renamed/after.rs");
    assert_eq!(String::from_utf8_lossy(&applied.stdout), built);
}
