//! One list of behaviours of sequence clients (`clients/behaviours.toml`), tested with each client.

mod stage;

use std::panic::AssertUnwindSafe;
use std::path::{Path, PathBuf};
use std::process::Command;

use futures_util::FutureExt;
use serde_json::Value;

use crate::support::binary::{example, root};
use stage::{Driver, Stage};

/// Keys of a behaviour.
#[allow(clippy::struct_excessive_bools, reason = "they are keys of the list")]
pub struct Behaviour {
    name: String,
    program: String,
    /// Redelivery of lost outputs that the driver declares; `none`: not declared.
    redelivery: String,
    /// Redelivery of M22 in the configuration.
    configured: Option<String>,
    /// Return time that a leaving driver reports, ms.
    returns_within_ms: u64,
    /// Time limit that a leaving driver gives its handlers, ms.
    ends_within_ms: u64,
    /// Whether the machine uses a broker of its own, which dies or outlives it.
    broker: bool,
    /// Whether a source `door` of the interlock is on while it has no owner.
    door: bool,
    /// Whether the plant has an output `lamp`.
    plant: bool,
    steps: Vec<String>,
    /// Expected output of the driver, in this order if `ordered`.
    driver: Vec<String>,
    ordered: bool,
    /// Expected journal of the coordinate system; empty: not compared.
    journal: Vec<String>,
}

fn texts(value: &Value) -> Vec<String> {
    let texts = value.as_array().into_iter().flatten();
    texts
        .map(|text| text.as_str().expect("a text").to_owned())
        .collect()
}

fn behaviours() -> Vec<Behaviour> {
    let text = std::fs::read_to_string(root().join("tests/it/clients/behaviours.toml")).expect("the list");
    let list: Value = toml::from_str(&text).expect("TOML");
    let text = |value: &Value, or: &str| value.as_str().unwrap_or(or).to_owned();
    let entries = list["behaviour"].as_array().expect("behaviours");
    let read = |entry: &Value| Behaviour {
        name: text(&entry["name"], ""),
        program: text(&entry["program"], ""),
        redelivery: text(&entry["redelivery"], "ask"),
        configured: entry["configured"].as_str().map(str::to_owned),
        returns_within_ms: entry["returns_within_ms"].as_u64().unwrap_or(60_000),
        ends_within_ms: entry["ends_within_ms"].as_u64().unwrap_or(60_000),
        broker: entry["broker"] == true,
        door: entry["door"] == true,
        plant: entry["plant"] == true,
        steps: texts(&entry["steps"]),
        driver: texts(&entry["driver"]),
        ordered: entry["ordered"] != false,
        journal: texts(&entry["journal"]),
    };
    entries.iter().map(read).collect()
}

/// Runs each behaviour, and reports all that differ. `TANDEM_BEHAVIOUR` selects by the beginning of the name.
async fn behaves(driver: Driver) {
    let mut wrong = Vec::new();
    let behaviours = behaviours();
    assert!(behaviours.len() >= 20, "only {} behaviours", behaviours.len());
    let only = std::env::var("TANDEM_BEHAVIOUR").unwrap_or_default();
    for behaviour in behaviours.into_iter().filter(|it| it.name.starts_with(&only)) {
        let run = async {
            Stage::set(&behaviour, driver.clone())
                .await
                .play(&behaviour)
                .await;
        };
        if AssertUnwindSafe(run).catch_unwind().await.is_err() {
            wrong.push(behaviour.name);
        }
    }
    assert!(
        wrong.is_empty(),
        "not as said (the reasons are above): {wrong:#?}"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_rust_client_does_what_the_list_says() {
    behaves(Driver {
        program: example("client_driver"),
        arguments: Vec::new(),
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_python_client_does_what_the_list_says() {
    let path = format!("PYTHONPATH={}", root().join("clients/python/src").display());
    let python = python().display().to_string();
    let script = root().join("tests/it/clients/driver.py").display().to_string();
    behaves(Driver {
        program: PathBuf::from("/usr/bin/env"),
        arguments: vec![path, "PYTHONDONTWRITEBYTECODE=1".to_owned(), python, script],
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_node_client_does_what_the_list_says() {
    let made = Command::new(root().join("tests/node/environment")).output();
    let made = made.expect("tests/node/environment starts");
    let said = String::from_utf8_lossy(&made.stderr);
    assert!(made.status.success(), "tests/node/environment: {said}");
    let script = root().join("tests/it/clients/driver.mjs").display().to_string();
    behaves(Driver {
        program: PathBuf::from("/usr/bin/env"),
        arguments: vec!["node".to_owned(), script],
    })
    .await;
}

/// A Python with the libraries of the package, installed where it is missing.
fn python() -> PathBuf {
    let made = Command::new(root().join("tests/python/environment")).output();
    let made = made.expect("tests/python/environment starts");
    let said = String::from_utf8_lossy(&made.stderr);
    assert!(made.status.success(), "tests/python/environment: {said}");
    let path = String::from_utf8(made.stdout).expect("a path in UTF-8");
    Path::new(path.trim()).join("bin/python")
}
