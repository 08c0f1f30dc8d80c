//! A broker of three nodes; each can be killed, started again, and separated from the others.

use std::net::TcpStream;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use tempfile::TempDir;

use super::broker::free_port;
use super::served::Process;
use super::wait::PATIENCE;
use super::wire::Wire;

/// Number of nodes of a cluster: the smallest number with a majority when one is offline.
pub const NODES: usize = 3;

/// Returns program and arguments that start a node.
pub type Start = (PathBuf, Vec<String>);

/// A link between nodes, or from a node to a shared process.
pub struct Link {
    /// Nodes that are separated when it is torn.
    pub ends: Vec<usize>,
    pub wire: Wire,
}

/// Nodes on free ports.
pub struct Cluster {
    folder: TempDir,
    starts: [Start; NODES],
    mqtt: [u16; NODES],
    links: Vec<Link>,
    nodes: [Option<Process>; NODES],
    /// Processes shared by the nodes.
    _beside: Vec<Process>,
}

/// A port for each node.
pub fn ports() -> [u16; NODES] {
    std::array::from_fn(|_| free_port())
}

impl Cluster {
    /// Starts all nodes in a folder with their files, and waits until they listen for MQTT.
    pub fn start(
        folder: TempDir,
        starts: [Start; NODES],
        mqtt: [u16; NODES],
        links: Vec<Link>,
        beside: Vec<Process>,
    ) -> Self {
        let mut cluster = Self {
            folder,
            starts,
            mqtt,
            links,
            nodes: [const { None }; NODES],
            _beside: beside,
        };
        for node in 0..NODES {
            cluster.launch(node);
        }
        for node in 0..NODES {
            cluster.until_it_listens(node);
        }
        cluster
    }

    /// `127.0.0.1:port` of a node.
    pub fn address(&self, node: usize) -> String {
        format!("127.0.0.1:{}", self.mqtt[node])
    }

    /// Kills a node, as kill -9 does.
    pub fn kill(&mut self, node: usize) {
        self.nodes[node] = None;
    }

    pub fn start_again(&mut self, node: usize) {
        self.launch(node);
        self.until_it_listens(node);
    }

    /// Interrupts the links of a node, which continues to serve its clients, until [`Cluster::join`].
    pub fn part(&self, node: usize) {
        self.links_of(node).for_each(|link| link.wire.tear());
    }

    pub fn join(&self, node: usize) {
        self.links_of(node).for_each(|link| link.wire.mend());
    }

    fn links_of(&self, node: usize) -> impl Iterator<Item = &Link> {
        self.links.iter().filter(move |link| link.ends.contains(&node))
    }

    fn launch(&mut self, node: usize) {
        let (program, arguments) = &self.starts[node];
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        self.nodes[node] = Some(Process::start(program, self.folder.path(), &arguments));
    }

    fn until_it_listens(&mut self, node: usize) {
        let end = Instant::now() + PATIENCE;
        while TcpStream::connect(self.address(node)).is_err() {
            let process = self.nodes[node].as_mut().expect("it was launched");
            if let Some(code) = process.exit_code_within(Duration::from_millis(20)) {
                panic!("node {node} ends with {code}:\n{}", process.output);
            }
            assert!(Instant::now() < end, "node {node} does not listen");
        }
    }
}

/// Returns the path of a Debian program that may be outside of `PATH`.
pub fn installed(program: &str) -> PathBuf {
    let places = ["/usr/sbin", "/usr/local/bin"].map(PathBuf::from);
    let path = std::env::var_os("PATH").unwrap_or_default();
    let mut all = std::env::split_paths(&path)
        .chain(places)
        .map(|folder| folder.join(program));
    all.find(|place| place.is_file()).unwrap_or_else(|| {
        panic!("{program} is not installed; run tests/run --long, which installs what tests need")
    })
}
