//! Outputs of the plant over a killed runtime and a killed handler, with a real disk and real connections.

use serde_json::{Value, json};

use crate::support::machine::Machine;
use crate::support::mqtt::Bus;
use crate::support::served::{FREE_PORTS, Served};
use crate::support::wait::until;

const OUTPUTS: &str = "[io.out.clamp]\non_loss = \"keep\"\nat_start = \"last\"\n\
                       [io.out.gate]\non_loss = \"keep\"\nat_start = true\n\
                       [io.out.valve]\n";

fn machine() -> Machine {
    Machine::new(&format!("{OUTPUTS}{FREE_PORTS}"))
}

async fn output(served: &Served, name: &str) -> Value {
    served.get(&format!("/io/out/{name}")).await.expect(200).json()
}

async fn write(served: &Served, name: &str, value: bool) {
    let path = format!("/io/out/{name}");
    served.put(&path, &json!({"value": value})).await.expect(204);
}

#[tokio::test]
async fn a_closed_clamp_stays_closed_over_a_killed_runtime() {
    let machine = machine();
    let served = Served::start(&machine);
    for (name, value) in [("clamp", true), ("gate", false), ("valve", true)] {
        write(&served, name, value).await;
    }
    // as kill -9
    drop(served);
    let served = Served::start(&machine);
    for (name, value) in [("clamp", true), ("gate", true), ("valve", false)] {
        assert_eq!(output(&served, name).await["value"], value, "{name}");
    }
    write(&served, "clamp", false).await;
    drop(served);
    let served = Served::start(&machine);
    assert_eq!(
        output(&served, "clamp").await["value"],
        false,
        "the last value counts"
    );
}

#[tokio::test]
async fn an_output_of_a_killed_handler_stays_for_the_grace_time_alone() {
    let machine = machine();
    let served = Served::start(&machine);
    let handler = Bus::connect(&served.broker, "test-1").await;
    let presence = json!({"online": true, "handles": [], "instance": "a"});
    handler.publish_retained("handler/cell/presence", &presence).await;
    handler
        .history
        .find("handler/cell/result", |said| said["status"] == "accepted")
        .await;
    let closed = json!({"value": true, "handler_id": "cell", "instance": "a"});
    for name in ["clamp", "valve"] {
        handler.publish(&format!("io/out/{name}/set"), &closed).await;
        until("it is written", async || {
            (output(&served, name).await["value"] == true).then_some(())
        })
        .await;
    }
    let will = json!({"online": false, "instance": "a"});
    handler.publish_retained("handler/cell/presence", &will).await;
    handler
        .history
        .find("handler/cell/presence", |said| said["online"] == false)
        .await;
    assert_eq!(
        output(&served, "valve").await["value"],
        true,
        "within the grace time"
    );
    let lost = until("the grace time ends", async || {
        let valve = output(&served, "valve").await;
        (valve["lost"] == true).then_some(valve)
    })
    .await;
    assert_eq!(lost["value"], false);
    let clamp = output(&served, "clamp").await;
    assert_eq!((&clamp["value"], &clamp["lost"]), (&json!(true), &json!(true)));
    // the journal is written a little later than states are published
    until("writes and losses in the journal", async || {
        let journal = served.get("/journal?count=50").await.expect(200).json();
        let lines = journal["lines"].as_array().expect("lines").clone();
        let of_cell = |event: &str| {
            let is_of_cell = |line: &&Value| line["event"] == event && line["handler_id"] == "cell";
            lines.iter().filter(is_of_cell).count()
        };
        ((of_cell("io_write"), of_cell("io_lost")) == (2, 2)).then_some(())
    })
    .await;
}

#[tokio::test]
async fn a_process_whose_place_another_took_writes_nothing_over_mqtt() {
    let machine = machine();
    let served = Served::start(&machine);
    let old = Bus::connect(&served.broker, "test-1").await;
    let new = Bus::connect(&served.broker, "test-1").await;
    for (bus, instance) in [(&old, "a"), (&new, "b")] {
        let presence = json!({"online": true, "handles": [], "instance": instance, "take_over": true});
        bus.publish_retained("handler/cell/presence", &presence).await;
        bus.history
            .find("handler/cell/result", |said| {
                said["status"] == "accepted" && said["instance"] == instance
            })
            .await;
    }
    let of = |instance: &str| json!({"value": true, "handler_id": "cell", "instance": instance});
    let writes = async |bus: &Bus, instance: &str| {
        bus.publish("handler/cell/io/out/clamp/set", &of(instance)).await;
        for input in ["interlock", "start_lock"] {
            let topic = format!("handler/cell/cs/1/input/{input}/set");
            let mut lock = of(instance);
            lock["source"] = json!("door");
            bus.publish(&topic, &lock).await;
        }
    };
    let is_set = async || {
        let mut is_set = vec![output(&served, "clamp").await["value"] == true];
        for input in ["interlock", "start_lock"] {
            let lock = served.get(&format!("/cs/1/inputs/{input}")).await;
            is_set.push(lock.expect(200).json()["value"] == true);
        }
        is_set
    };
    writes(&old, "a").await;
    // a later message on the same connection has been processed, and so have all earlier ones
    old.publish("handler/cell/io/out/gate/set", &of("a")).await;
    let presence = json!({"online": true, "handles": [], "instance": "a"});
    old.publish("handler/cell/presence", &presence).await;
    old.history
        .find("handler/cell/result", |said| {
            said["status"] == "refused" && said["instance"] == "a"
        })
        .await;
    assert_eq!(is_set().await, [false; 3]);
    writes(&new, "b").await;
    until("the writes of the new one", async || {
        (is_set().await == [true; 3]).then_some(())
    })
    .await;
}
