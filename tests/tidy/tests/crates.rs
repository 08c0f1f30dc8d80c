//! The layout: which crates there are, and what each may import.

use std::collections::BTreeSet;
use std::process::Command;

use tandem_tidy::product::without_tests;
use tandem_tidy::{files, read, root};

/// Stages: plain data in and out.
const STAGES: [&str; 5] = ["syntax", "interp", "path", "motion", "servo"];

/// Returns true if a package is one of this project.
fn is_ours(name: &str) -> bool {
    name.starts_with("tandem") || name.starts_with("plc-")
}

/// Names of a manifest's `[dependencies]`.
fn dependencies(folder: &str) -> BTreeSet<String> {
    let manifest = read(format!("{folder}/Cargo.toml").as_ref());
    let mut inside = false;
    let mut found = BTreeSet::new();
    for line in manifest.lines() {
        if line.starts_with('[') {
            inside = line.trim() == "[dependencies]";
        } else if inside && line.starts_with(|letter: char| letter.is_ascii_lowercase()) {
            found.insert(line.split(['.', ' ', '=']).next().unwrap_or_default().to_owned());
        }
    }
    found
}

#[test]
fn every_crate_of_the_layout_is_there_with_its_name() {
    for (folder, name) in [
        ("plc-api", "plc-api"),
        ("plc-api/protocol", "plc-protocol"),
        ("runtime", "tandem-runtime"),
        ("runtime/config", "tandem-config"),
        ("runtime/store", "tandem-store"),
        ("runtime/testing", "tandem-testing"),
        ("runtime/model", "tandem-model"),
        ("runtime/syntax", "tandem-syntax"),
        ("runtime/interp", "tandem-interp"),
        ("runtime/path", "tandem-path"),
        ("runtime/motion", "tandem-motion"),
        ("runtime/servo", "tandem-servo"),
        ("runtime/gateway", "tandem-gateway"),
        ("runtime/mtconnect", "tandem-mtconnect"),
        ("runtime/structured-text", "tandem-structured-text"),
    ] {
        let manifest = read(format!("{folder}/Cargo.toml").as_ref());
        assert!(
            manifest.contains(&format!("name = \"{name}\"")),
            "{folder} is not {name}"
        );
    }
}

#[test]
fn no_stage_imports_another_but_interp_imports_syntax() {
    for stage in STAGES {
        let mut ours = dependencies(&format!("runtime/{stage}"));
        ours.retain(|name| is_ours(name));
        let mut allowed = BTreeSet::from(["tandem-model".to_owned()]);
        if stage == "interp" {
            allowed.insert("tandem-syntax".into());
        }
        assert!(ours.is_subset(&allowed), "{stage} imports {ours:?}");
    }
}

#[test]
fn stages_and_model_know_no_executor_no_socket_and_no_clock() {
    for stage in STAGES.iter().chain(&["model"]) {
        let found = dependencies(&format!("runtime/{stage}"));
        for outside in ["tokio", "axum", "rumqttc", "mqtt5", "tracing", "humantime"] {
            assert!(!found.contains(outside), "{stage} imports {outside}");
        }
        for path in files(&[".rs"]) {
            if path.starts_with(format!("runtime/{stage}/src")) {
                let text = read(&path);
                let text = without_tests(&path, &text);
                for outside in [
                    "std::time::",
                    "std::fs",
                    "std::net",
                    "thread::spawn",
                    "thread::sleep",
                ] {
                    assert!(!text.contains(outside), "{} uses {outside}", path.display());
                }
            }
        }
    }
}

#[test]
fn protocol_imports_no_crate_and_servers_import_the_protocol() {
    let ours = |folder: &str| {
        let mut found = dependencies(folder);
        found.retain(|name| is_ours(name));
        found
    };
    let of = |names: &[&str]| {
        names
            .iter()
            .map(|name| (*name).to_owned())
            .collect::<BTreeSet<_>>()
    };
    assert_eq!(ours("runtime/gateway"), of(&["plc-protocol", "tandem-mtconnect"]));
    assert_eq!(ours("runtime/mtconnect"), of(&["plc-protocol"]));
    assert_eq!(
        ours("runtime/structured-text"),
        of(&["plc-api", "plc-protocol", "tandem-model"])
    );
    assert_eq!(
        ours("runtime/store"),
        of(&["plc-protocol", "tandem-interp", "tandem-model", "tandem-syntax"])
    );
    for below in ["runtime/store", "runtime/config"] {
        assert!(!ours(below).contains("tandem-runtime"), "{below}");
    }
    assert_eq!(ours("plc-api"), of(&["plc-api-derive", "plc-protocol"]));
    assert_eq!(ours("plc-api/protocol"), BTreeSet::new());
    assert_eq!(ours("runtime/model"), BTreeSet::new());
}

#[test]
fn plc_api_without_its_features_is_tokio_serde_and_little_more() {
    let mut needed = BTreeSet::new();
    for folder in ["plc-api", "plc-api/protocol"] {
        let manifest = read(format!("{folder}/Cargo.toml").as_ref());
        needed.extend(dependencies(folder).into_iter().filter(|name| {
            let line = manifest.lines().find(|line| line.starts_with(name.as_str()));
            line.is_some_and(|line| !line.contains("optional = true"))
        }));
    }
    let known = [
        "futures-util",
        "humantime",
        "percent-encoding",
        "plc-api-derive",
        "plc-protocol",
        "serde",
        "serde_json",
        "thiserror",
        "tokio",
        "tracing",
    ];
    assert_eq!(needed, known.map(str::to_owned).into());
}

#[test]
fn the_manifests_are_read() {
    assert!(dependencies("runtime/interp").contains("tandem-syntax"));
    assert!(dependencies("plc-api").contains("serde"));
}

#[test]
fn the_command_has_no_test_feature_of_a_dependency() {
    let mut cargo = Command::new(env!("CARGO"));
    cargo.args(["tree", "--offline", "--locked", "-p", "tandem-runtime"]);
    cargo.args(["--edges", "features,no-dev", "--prefix", "none"]);
    let tree = cargo.current_dir(root()).output().expect("cargo");
    let text = String::from_utf8_lossy(&tree.stdout);
    assert!(tree.status.success(), "{}", String::from_utf8_lossy(&tree.stderr));
    assert!(text.contains("tokio feature \"rt\""), "no features in:\n{text}");
    let found: Vec<&str> = text
        .lines()
        .filter(|line| line.contains("feature \"test"))
        .collect();
    assert!(found.is_empty(), "{found:#?}");
}
