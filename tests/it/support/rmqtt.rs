//! A cluster of rmqtt, which uses MQTT 5; its nodes communicate over gRPC.

use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;

use super::cluster::{Cluster, Link, NODES, Start, ports};
use super::wire::Wire;

/// Starts the cluster.
pub async fn rmqtt() -> Cluster {
    let program = build();
    let folder = TempDir::new().expect("a folder");
    let (mqtt, grpc) = (ports(), ports());
    let mut links = Vec::new();
    let mut starts = Vec::new();
    for node in 0..NODES {
        let mut arguments = vec![
            (node + 1).to_string(),
            mqtt[node].to_string(),
            grpc[node].to_string(),
        ];
        for (other, port) in grpc.iter().enumerate() {
            let mut address = format!("127.0.0.1:{port}");
            if other != node {
                let wire = Wire::to(&address).await;
                wire.address().clone_into(&mut address);
                let ends = vec![node, other];
                links.push(Link { ends, wire });
            }
            arguments.push(format!("{}@{address}", other + 1));
        }
        starts.push((program.clone(), arguments));
    }
    let starts: [Start; NODES] = starts.try_into().expect("one for each node");
    Cluster::start(folder, starts, mqtt, links, Vec::new())
}

/// Builds a node, next to the other build results.
fn build() -> PathBuf {
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| own.join("target"), PathBuf::from);
    let folder = target.join("tools/rmqtt");
    let built = Command::new("cargo")
        .args(["build", "--locked", "--quiet", "--manifest-path"])
        .arg(own.join("tests/rmqtt/Cargo.toml"))
        .arg("--target-dir")
        .arg(&folder)
        .status();
    assert!(
        built.is_ok_and(|status| status.success()),
        "rmqtt cannot be built"
    );
    folder.join("debug/tandem-rmqtt-test")
}
