//! A broker that does not accept all messages of the runtime.

use serde_json::json;
use tempfile::TempDir;

use super::{broker_at, machine};
use crate::support::broker::Mosquitto;
use crate::support::machine::Machine;
use crate::support::mqtt::Bus;
use crate::support::served::Served;

/// Starts a machine at this broker, and a listener that sees it online.
async fn served_at(broker: &Mosquitto) -> (Machine, Served, Bus) {
    let machine = machine(&broker_at(&broker.address()));
    let served = Served::start(&machine);
    let bus = Bus::listen(&broker.address(), "test-1").await;
    bus.history
        .find("presence", |presence| presence["online"] == true)
        .await;
    (machine, served, bus)
}

/// Checks that the connection exists and is the first one.
async fn is_still_connected(served: &Served) {
    let metrics = served.get("/metrics").await.expect(200).body;
    for line in ["tandem_mqtt_connected 1", "tandem_mqtt_connections_total 1"] {
        assert!(metrics.lines().any(|one| one == line), "{line}: {metrics}");
    }
}

/// A line of the log, which may have been there before the addresses.
fn logged(served: &mut Served, what: &str) -> String {
    let fits = |line: &str| line.contains(what);
    let before = served
        .process
        .output
        .lines()
        .find(|line| fits(line))
        .map(str::to_owned);
    before.unwrap_or_else(|| served.process.line(what, fits))
}

#[tokio::test]
async fn message_above_the_broker_limit_is_dropped_and_the_connection_stays() {
    let broker = Mosquitto::with(
        TempDir::new().expect("a folder"),
        "allow_anonymous true\nmax_packet_size 3000\n",
    );
    let (_machine, mut served, bus) = served_at(&broker).await;
    // 1000 numbers of at least three bytes each
    let get = |command_id: &str, count: u16| json!({"command_id": command_id, "client_id": "panel", "kind": "P", "from": 0, "count": count});
    bus.publish("cs/1/variable/get", &get("large", 1000)).await;
    bus.publish("cs/1/variable/get", &get("small", 1)).await;
    assert_eq!(bus.reply("panel", "small").await["status"], "done");
    let large = bus.history.on("reply/panel").into_iter();
    let large: Vec<_> = large
        .filter(|reply| reply["command_id"] == "large" && reply["status"] == "done")
        .collect();
    assert_eq!(large, [] as [serde_json::Value; 0]);
    is_still_connected(&served).await;
    let line = logged(&mut served, "message on reply/panel dropped");
    assert!(line.contains("in a packet of 3000 bytes"), "{line}");
}

#[tokio::test]
async fn broker_that_refuses_messages_is_logged_and_the_connection_stays() {
    let folder = TempDir::new().expect("a folder");
    std::fs::write(
        folder.path().join("acl"),
        "topic read #\ntopic write tandem/v1/test-1/presence\n",
    )
    .expect("written");
    let broker = Mosquitto::with(folder, "allow_anonymous true\nacl_file acl\n");
    let (_machine, mut served, _bus) = served_at(&broker).await;
    let line = logged(&mut served, "the MQTT broker refuses a message (NotAuthorized)");
    assert!(line.contains("write below tandem/v1/test-1/"), "{line}");
    is_still_connected(&served).await;
}
