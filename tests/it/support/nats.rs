//! A cluster of three nodes of NATS Server, which speak MQTT 3.1.1 over `JetStream`.

use std::net::TcpStream;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use tempfile::TempDir;

use super::broker::free_port;
use super::served::Process;
use super::wait::PATIENCE;

/// Nodes of the cluster: the fewest that keep a majority when one is away.
pub const NODES: usize = 3;

/// Three nodes on ports that were free. Each can be killed and started again there.
pub struct NatsCluster {
    folder: TempDir,
    mqtt: [u16; NODES],
    nodes: [Option<Process>; NODES],
}

impl NatsCluster {
    /// Starts all nodes, and waits until they listen. Consumers have one replica: with three, each filter of a subscription takes
    /// half a second, and nothing else of its connection is answered meanwhile.
    pub fn start() -> Self {
        let folder = TempDir::new().expect("a folder");
        let ports = || std::array::from_fn::<u16, NODES, _>(|_| free_port());
        let (own, mqtt, routes) = (ports(), ports(), ports());
        let all_routes = routes
            .map(|port| format!("\"nats://127.0.0.1:{port}\""))
            .join(", ");
        for node in 0..NODES {
            let store = folder.path().join(format!("store-{node}"));
            let config = format!(
                "server_name: n{node}\nlisten: \"127.0.0.1:{}\"\njetstream {{ store_dir: \"{}\" }}\n\
                 mqtt {{ host: \"127.0.0.1\", port: {}, consumer_replicas: 1, consumer_memory_storage: true }}\n\
                 cluster {{ name: \"hall\", listen: \"127.0.0.1:{}\", no_advertise: true, routes: [{all_routes}] }}\n",
                own[node],
                store.display(),
                mqtt[node],
                routes[node],
            );
            std::fs::write(folder.path().join(format!("n{node}.conf")), config).expect("its configuration");
        }
        let mut cluster = Self {
            folder,
            mqtt,
            nodes: [const { None }; NODES],
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

    /// As kill -9.
    pub fn kill(&mut self, node: usize) {
        self.nodes[node] = None;
    }

    pub fn start_again(&mut self, node: usize) {
        self.launch(node);
        self.until_it_listens(node);
    }

    fn launch(&mut self, node: usize) {
        let config = format!("n{node}.conf");
        let process = Process::start(&program(), self.folder.path(), &["-c", &config]);
        self.nodes[node] = Some(process);
    }

    fn until_it_listens(&mut self, node: usize) {
        let end = Instant::now() + PATIENCE;
        while TcpStream::connect(self.address(node)).is_err() {
            let process = self.nodes[node].as_mut().expect("it was launched");
            if let Some(code) = process.exit_code_within(Duration::from_millis(20)) {
                panic!("nats-server ends with {code}:\n{}", process.output);
            }
            assert!(Instant::now() < end, "nats-server does not listen");
        }
    }
}

fn program() -> PathBuf {
    let places = ["/usr/sbin/nats-server", "/usr/local/bin/nats-server"];
    let path = std::env::var_os("PATH").unwrap_or_default();
    let mut all = std::env::split_paths(&path)
        .map(|folder| folder.join("nats-server"))
        .chain(places.map(PathBuf::from));
    all.find(|place| place.is_file()).expect(
        "nats-server is not installed; `apt-get install nats-server`, or run tests/run, which installs what tests need",
    )
}
