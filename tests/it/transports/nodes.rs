//! A broker of several nodes: the runtime and its clients continue at another node when theirs fails.
//!
//! The nodes are independent brokers: all data of the second one arrives after the end of the first.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use plc_api::{Alarm, AuxOutput, SequenceProgram};
use serde_json::{Value, json};

use super::{connect, machine};
use crate::support::broker::Mosquitto;
use crate::support::served::Served;
use crate::support::wait::until;

async fn health(served: &Served, what: &str, fits: impl Fn(&Value) -> bool) -> Value {
    until(what, async || {
        let health = served.get("/health").await.expect(200).json();
        fits(&health).then_some(health)
    })
    .await
}

#[tokio::test]
async fn dead_broker_node_moves_all_to_the_next_one_named_in_health() {
    let mut nodes = [Mosquitto::start(), Mosquitto::start()];
    let [first, second] = [nodes[0].address(), nodes[1].address()];
    let machine = machine(&format!(
        "[http]\nlisten = \"127.0.0.1:0\"\n[mqtt]\nbroker = [\"mqtt://{first}\", \"mqtt://{second}\"]\n"
    ));
    let served = Served::start(&machine);
    let at = |address: &str| format!("mqtt://{address}");
    let is_at = |health: &Value, address: &str| health["broker"]["address"] == at(address);
    let before = health(&served, "the first node", |health| is_at(health, &first)).await;
    assert_eq!(before["status"], "ok");
    let plc = connect(&format!("mqtt://{first},{second}/test-1")).await;
    let done = Arc::new(AtomicU32::new(0));
    let count = Arc::clone(&done);
    let serving = plc.clone();
    let handlers = tokio::spawn(async move {
        let handler = move |_: AuxOutput| {
            count.fetch_add(1, Ordering::Relaxed);
            async { Ok::<(), Alarm>(()) }
        };
        let program = SequenceProgram::new().handler_id("tool").on(100, handler);
        program.run(&serving).await
    });
    let mill = plc.coordinate_system(1);
    mill.load(52).await.unwrap();
    mill.start().await.unwrap();
    served.execution(1, "PROGRAM_COMPLETED").await;
    assert_eq!(done.load(Ordering::Relaxed), 2);

    nodes[0].kill();
    let after = health(&served, "the second node", |health| is_at(health, &second)).await;
    assert_eq!(after["status"], "ok");
    let watch = served.watch(&["presence"]).await;
    watch
        .history
        .find("presence", |presence| presence["broker"] == after["broker"])
        .await;
    let metrics = served.get("/metrics").await.expect(200).body;
    let age = format!("tandem_mqtt_connection_age_seconds{{broker=\"{}\"}}", at(&second));
    assert!(metrics.contains(&age), "{metrics}");
    served.command(1, "start").await;
    served.execution(1, "PROGRAM_COMPLETED").await;
    assert_eq!(done.load(Ordering::Relaxed), 4, "each output is done once");

    nodes[1].kill();
    let without = health(&served, "no node", |health| health["status"] == "degraded").await;
    assert_eq!(without, json!({"status": "degraded"}));
    nodes[0].start_again();
    let again = health(&served, "the first node again", |health| is_at(health, &first)).await;
    assert_eq!(again["status"], "ok");
    served.command(1, "start").await;
    served.execution(1, "PROGRAM_COMPLETED").await;
    assert_eq!(done.load(Ordering::Relaxed), 6);
    handlers.abort();
}
