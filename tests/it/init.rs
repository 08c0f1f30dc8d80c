//! `tandem init` writes a machine that works without changes.

use std::path::Path;
use std::process::Command;

use crate::support::binary::{build_beside, root, select_features_of_tests};
use crate::support::simulated::run;

/// A project with the dependencies of this checkout.
fn init(folder: &Path, name: &str) -> std::path::PathBuf {
    let checkout = root().display().to_string();
    let ran = run(folder, &["init", name, "--checkout", &checkout]);
    assert_eq!(ran.code, 0, "{}{}", ran.stdout, ran.stderr);
    assert!(ran.stdout.contains("cargo test"), "{}", ran.stdout);
    folder.join(name)
}

#[test]
fn what_init_writes_builds_and_its_test_passes() {
    let folder = tempfile::tempdir().unwrap();
    let project = init(folder.path(), "My Mill");
    build_beside(folder.path());
    select_features_of_tests(&project);
    let built = Command::new(env!("CARGO"))
        .args(["test", "--quiet"])
        .current_dir(&project)
        .output()
        .expect("cargo starts");
    let said = String::from_utf8_lossy(&built.stdout).into_owned() + &String::from_utf8_lossy(&built.stderr);
    assert!(built.status.success(), "{said}");
    assert!(said.contains("2 passed"), "{said}");
}

#[test]
fn what_init_writes_is_a_good_machine_with_a_good_program() {
    let folder = tempfile::tempdir().unwrap();
    let project = init(folder.path(), "mill");
    let checked = run(&project, &["check", "--config", "tandem.toml"]);
    assert_eq!(checked.code, 0, "{}{}", checked.stdout, checked.stderr);
    let simulated = run(
        &project,
        &["simulate", "nc/1.nc", "--config", "tandem.toml", "--json"],
    );
    assert_eq!(simulated.code, 0, "{}{}", simulated.stdout, simulated.stderr);
    assert_eq!(simulated.json()["outcome"], "completed");
}

#[test]
fn init_writes_into_no_folder_that_holds_something() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("precious"), "").unwrap();
    let ran = run(folder.path(), &["init", "."]);
    assert_eq!(ran.code, 2);
    assert!(ran.stderr.contains("not empty"), "{}", ran.stderr);
    assert!(!folder.path().join("Cargo.toml").exists());
    let ran = run(folder.path(), &["init", "new", "--checkout", "."]);
    assert_eq!(
        (ran.code, folder.path().join("new").exists()),
        (2, false),
        "{}",
        ran.stderr
    );
}
