//! The programs under test, built once when they are needed first.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// The root of the checkout.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Returns the `tandem` command: `TANDEM_BIN` if it is set, otherwise built here with the profile and folder
/// of this test.
pub fn tandem() -> &'static Path {
    static BUILT: OnceLock<PathBuf> = OnceLock::new();
    BUILT.get_or_init(|| {
        if let Some(path) = std::env::var_os("TANDEM_BIN") {
            let path = PathBuf::from(path);
            assert!(path.is_file(), "TANDEM_BIN = {}: no such file", path.display());
            return path;
        }
        build(&["--workspace", "--bin", "tandem"]);
        built("tandem")
    })
}

/// One of the programs in `examples/`.
pub fn example(name: &str) -> PathBuf {
    static BUILT: OnceLock<()> = OnceLock::new();
    // of the whole workspace, because a part would select other features of dependencies, and build them again
    BUILT.get_or_init(|| build(&["--workspace", "--examples"]));
    built(&format!("examples/{name}"))
}

/// Configures cargo to build below this folder, offline, in the target folder and profile of these tests, which already
/// contain most of a reader's dependencies.
pub fn build_beside(folder: &Path) {
    let manifest = std::fs::read_to_string(root().join("Cargo.toml")).expect("the manifest of the workspace");
    let manifest: toml::Table = manifest.parse().expect("a manifest");
    let target = tandem().parent().and_then(Path::parent).expect("a target folder");
    let mut config = toml::Table::new();
    let mut dev = manifest["profile"]["dev"].clone();
    // A reader's project compiles the crates of this workspace again in any case, and faster without optimisation.
    let packages = dev.get_mut("package").and_then(toml::Value::as_table_mut);
    for (name, package) in packages.into_iter().flatten() {
        if name.starts_with("tandem-") {
            package["opt-level"] = 0.into();
        }
    }
    config.insert(
        "profile".to_owned(),
        toml::Table::from_iter([("dev".to_owned(), dev)]).into(),
    );
    config.insert(
        "net".to_owned(),
        toml::Table::from_iter([("offline".to_owned(), true.into())]).into(),
    );
    let target = target.display().to_string();
    config.insert(
        "build".to_owned(),
        toml::Table::from_iter([("target-dir".to_owned(), target.into())]).into(),
    );
    let cargo = folder.join(".cargo");
    std::fs::create_dir(&cargo).expect("a folder for the configuration of cargo");
    std::fs::write(cargo.join("config.toml"), config.to_string()).expect("the configuration of cargo");
}

/// Features of libraries that only the tests of the workspace select, through `jsonschema`.
const FEATURES_OF_TESTS: &str = r#"
[dev-dependencies.idna]
version = "1"

[dev-dependencies.regex-automata]
version = "0.4"
default-features = false
features = ["dfa", "nfa", "perf"]
"#;

/// Selects these features in a project that `tandem init` has written, so that its tests link the libraries of these
/// tests. Otherwise cargo compiles seven libraries again, among them the MQTT broker.
pub fn select_features_of_tests(project: &Path) {
    let path = project.join("Cargo.toml");
    let manifest = std::fs::read_to_string(&path).expect("the manifest of a project");
    if !manifest.contains(FEATURES_OF_TESTS) {
        std::fs::write(path, manifest + FEATURES_OF_TESTS).expect("the manifest of a project");
    }
}

fn built(name: &str) -> PathBuf {
    let path = folder().join(name);
    assert!(
        path.is_file(),
        "{} is missing: run `cargo build --workspace --examples`",
        path.display()
    );
    path
}

/// `target/debug`, from `target/debug/deps/it-...`.
fn folder() -> PathBuf {
    let test = std::env::current_exe().expect("the path of this test");
    let folder = test
        .parent()
        .and_then(Path::parent)
        .expect("a test in target/*/deps");
    folder.to_owned()
}

/// Removes cargo's environment variables about the package of the test, because they would make build scripts
/// run again.
pub fn forget_package(command: &mut Command) {
    for (key, _) in std::env::vars_os() {
        let name = key.to_string_lossy();
        if [
            "CARGO_PKG_",
            "CARGO_MANIFEST_",
            "CARGO_CRATE_",
            "CARGO_BIN_",
            "CARGO_PRIMARY_",
        ]
        .iter()
        .any(|prefix| name.starts_with(prefix))
        {
            command.env_remove(&key);
        }
    }
}

fn build(what: &[&str]) {
    let folder = folder();
    let mut cargo = Command::new(env!("CARGO"));
    cargo.arg("build").args(what).current_dir(root());
    forget_package(&mut cargo);
    cargo.env("CARGO_TARGET_DIR", folder.parent().expect("a target folder"));
    if folder.file_name().is_some_and(|name| name == "release") {
        cargo.arg("--release");
    }
    let output = cargo.output().expect("cargo starts");
    assert!(
        output.status.success(),
        "cargo build {} fails:\n{}",
        what.join(" "),
        String::from_utf8_lossy(&output.stderr)
    );
}
