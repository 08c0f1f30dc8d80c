//! A cluster of NATS Server, which offers MQTT 3.1.1 over `JetStream`.

use tempfile::TempDir;

use super::cluster::{Cluster, Link, NODES, installed, ports};
use super::wire::Wire;

/// Starts the cluster. Consumers have one replica: with three, each filter of a subscription takes half a
/// second, and other requests of its connection wait in the meantime.
pub async fn nats() -> Cluster {
    let folder = TempDir::new().expect("a folder");
    let (own, mqtt, routes) = (ports(), ports(), ports());
    let mut links = Vec::new();
    for node in 0..NODES {
        let mut others = Vec::new();
        for other in (0..NODES).filter(|other| *other != node) {
            let wire = Wire::to(&format!("127.0.0.1:{}", routes[other])).await;
            others.push(format!("\"nats://{}\"", wire.address()));
            let ends = vec![node, other];
            links.push(Link { ends, wire });
        }
        let config = format!(
            "server_name: n{node}\nlisten: \"127.0.0.1:{}\"\njetstream {{ store_dir: \"{}\" }}\n\
             mqtt {{ host: \"127.0.0.1\", port: {}, consumer_replicas: 1, consumer_memory_storage: true }}\n\
             cluster {{ name: \"hall\", listen: \"127.0.0.1:{}\", no_advertise: true, routes: [{}] }}\n",
            own[node],
            folder.path().join(format!("store-{node}")).display(),
            mqtt[node],
            routes[node],
            others.join(", "),
        );
        std::fs::write(folder.path().join(format!("n{node}.conf")), config).expect("its configuration");
    }
    let program = installed("nats-server");
    let starts = std::array::from_fn(|node| (program.clone(), vec!["-c".into(), format!("n{node}.conf")]));
    Cluster::start(folder, starts, mqtt, links, Vec::new())
}
