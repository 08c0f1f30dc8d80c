//! An aedes cluster, which uses MQTT 3.1.1; its nodes communicate only through Redis.

use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use tempfile::TempDir;

use super::broker::free_port;
use super::cluster::{Cluster, Link, NODES, Start, installed, ports};
use super::served::Process;
use super::wait::PATIENCE;
use super::wire::Wire;

/// Starts the cluster.
pub async fn aedes() -> Cluster {
    let folder = TempDir::new().expect("a folder");
    let program = packages().join("node.mjs").display().to_string();
    let redis = free_port();
    let keeps = start_redis(redis, folder.path());
    let mqtt = ports();
    let mut links = Vec::new();
    let mut starts = Vec::new();
    for (node, port) in mqtt.iter().enumerate() {
        let wire = Wire::to(&format!("127.0.0.1:{redis}")).await;
        let (_, wired) = wire.address().rsplit_once(':').expect("a port");
        let arguments = vec![
            program.clone(),
            port.to_string(),
            wired.to_owned(),
            format!("n{node}"),
        ];
        starts.push((installed("node"), arguments));
        let ends = vec![node];
        links.push(Link { ends, wire });
    }
    let starts: [Start; NODES] = starts.try_into().expect("one for each node");
    Cluster::start(folder, starts, mqtt, links, vec![keeps])
}

fn start_redis(port: u16, folder: &Path) -> Process {
    let port = port.to_string();
    let arguments = ["--bind", "127.0.0.1", "--port", &port, "--save", ""];
    let process = Process::start(&installed("redis-server"), folder, &arguments);
    let end = Instant::now() + PATIENCE;
    while TcpStream::connect(format!("127.0.0.1:{port}")).is_err() {
        assert!(Instant::now() < end, "redis-server does not listen");
        std::thread::sleep(Duration::from_millis(20));
    }
    process
}

/// Returns the folder with a node and its packages, next to the other build results.
fn packages() -> PathBuf {
    let own = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/aedes");
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("target"),
        PathBuf::from,
    );
    let tools = target.join("tools/aedes");
    let read = |path: PathBuf| std::fs::read(path).ok();
    let lock = read(own.join("package-lock.json"));
    if read(tools.join("installed.json")) != lock {
        std::fs::create_dir_all(&tools).expect("a folder");
        for file in ["package.json", "package-lock.json", ".npmrc"] {
            std::fs::copy(own.join(file), tools.join(file)).expect(file);
        }
        let installed = Command::new("npm")
            .args(["ci", "--ignore-scripts", "--loglevel=error"])
            .current_dir(&tools)
            .status();
        assert!(installed.is_ok_and(|status| status.success()), "npm ci fails");
        std::fs::write(tools.join("installed.json"), lock.expect("the lock file")).expect("a note of it");
    }
    std::fs::copy(own.join("node.mjs"), tools.join("node.mjs")).expect("the node");
    tools
}
