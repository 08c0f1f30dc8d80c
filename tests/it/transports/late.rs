//! Messages that arrive twice, too late, or from before the start of the runtime.

use std::time::Duration;

use rumqttc::{AsyncClient, Event, MqttOptions, Packet, QoS};
use serde_json::{Value, json};

use super::{broker_at, machine, over_mosquitto};
use crate::support::broker::Mosquitto;
use crate::support::mqtt::Bus;
use crate::support::served::Served;
use crate::support::wait::{until, within};
use crate::support::wire::{Refusal, Wire};

fn load(command_id: &str, program: u16) -> Value {
    json!({"command_id": command_id, "client_id": "panel", "args": {"program": program}})
}

/// Returns the replies to a command, in order.
fn replies(bus: &Bus, command_id: &str) -> Vec<Value> {
    let replies = bus.history.on("reply/panel").into_iter();
    replies
        .filter(|reply| reply["command_id"] == command_id)
        .map(|reply| reply["status"].clone())
        .collect()
}

/// Waits until this runtime receives messages of the broker.
async fn listens(bus: &Bus, served: &Served) {
    let boot_id = served.state(1).await["boot_id"].clone();
    let online = |presence: &Value| presence["online"] == true && presence["boot_id"] == boot_id;
    bus.history.find("presence", online).await;
}

/// Waits until all earlier messages of the broker have arrived, because the broker delivers messages in
/// order.
async fn all_before_has_come(bus: &Bus, served: &Served) {
    listens(bus, served).await;
    bus.publish("cs/1/command/load", &load("last", 51)).await;
    assert_eq!(bus.reply("panel", "last").await["status"], "done");
    assert_eq!(served.state(1).await["program"], 51);
}

#[tokio::test]
async fn a_retained_command_is_never_acted_on_by_a_later_start_of_the_runtime() {
    let broker = Mosquitto::start();
    let machine = machine(&broker_at(&broker.address()));
    let bus = Bus::listen(&broker.address(), "test-1").await;
    bus.publish_retained("cs/1/command/load", &load("early", 50))
        .await;
    let is_there = |command: &Value| command["command_id"] == "early";
    bus.history.find("cs/1/command/load", is_there).await;
    let served = Served::start(&machine);
    let refused = bus.reply("panel", "early").await;
    assert_eq!(
        (&refused["status"], &refused["code"]),
        (&json!("rejected"), &json!("retained"))
    );
    assert_eq!(served.state(1).await["program"], Value::Null);
    let alarms = served.get("/alarms/history").await.expect(200).body;
    assert!(alarms.contains("retained command early of panel"), "{alarms}");

    // a message that arrives while the runtime is online shows its flag over MQTT 5
    bus.publish_retained("cs/1/command/load", &load("live", 50)).await;
    let refused = bus.reply("panel", "live").await;
    assert_eq!(
        (&refused["status"], &refused["code"]),
        (&json!("rejected"), &json!("retained"))
    );
    let cleared = |command: &Value| *command == Value::Null;
    bus.history.find("cs/1/command/load", cleared).await;
    assert_eq!(served.state(1).await["program"], Value::Null);
    drop(served);
    let served = Served::start(&machine);
    all_before_has_come(&bus, &served).await;
    assert_eq!(replies(&bus, "live"), ["rejected"]);
    served.get("/commands/live").await.expect(404);
}

#[tokio::test]
async fn mqtt_3_1_1_live_retained_command_is_executed_exactly_once() {
    for refusal in [Refusal::Answer, Refusal::HangUp] {
        let broker = Mosquitto::start();
        let old = Wire::to_version_3_1_1(&broker.address(), refusal).await;
        let machine = machine(&broker_at(old.address()));
        let bus = Bus::listen(&broker.address(), "test-1").await;
        let served = Served::start(&machine);
        listens(&bus, &served).await;
        bus.publish_retained("cs/1/command/load", &load("live", 50)).await;
        assert_eq!(bus.reply("panel", "live").await["status"], "done", "{refusal:?}");
        let cleared = |command: &Value| *command == Value::Null;
        bus.history.find("cs/1/command/load", cleared).await;
        drop(served);
        let served = Served::start(&machine);
        all_before_has_come(&bus, &served).await;
        assert_eq!(replies(&bus, "live"), ["accepted", "done"]);
        served.get("/commands/live").await.expect(404);
    }
}

#[tokio::test]
async fn broker_known_to_speak_mqtt_5_is_not_downgraded_after_one_hang_up() {
    let mut broker = Mosquitto::start();
    let mut wire = Wire::to(&broker.address()).await;
    let machine = machine(&broker_at(wire.address()));
    let served = Served::start(&machine);
    listens(&Bus::listen(&broker.address(), "test-1").await, &served).await;
    broker.kill();
    wire.hangs_up().await;
    broker.start_again();
    let bus = Bus::listen(&broker.address(), "test-1").await;
    listens(&bus, &served).await;
    bus.publish_retained("cs/1/command/load", &load("live", 50)).await;
    assert_eq!(bus.reply("panel", "live").await["code"], "retained");
}

#[tokio::test]
async fn commands_kept_by_a_persistent_session_while_offline_are_not_executed() {
    let broker = Mosquitto::start();
    let machine = machine(&broker_at(&broker.address()));
    // another client made the broker keep the runtime's session
    let (host, port) = (
        "127.0.0.1",
        broker.address().rsplit_once(':').unwrap().1.to_owned(),
    );
    let mut options = MqttOptions::new("tandem-test-1", host, port.parse().unwrap());
    options
        .set_clean_session(false)
        .set_keep_alive(Duration::from_secs(5));
    let (client, mut events) = AsyncClient::new(options, 8);
    let commands = "tandem/v1/test-1/cs/+/command/+";
    client.subscribe(commands, QoS::AtLeastOnce).await.unwrap();
    let subscribed =
        async { while !matches!(events.poll().await.unwrap(), Event::Incoming(Packet::SubAck(_))) {} };
    within("a subscription", subscribed).await;
    drop((client, events));

    let bus = Bus::listen(&broker.address(), "test-1").await;
    bus.publish("cs/1/command/load", &load("kept", 50)).await;
    let is_there = |command: &Value| command["command_id"] == "kept";
    bus.history.find("cs/1/command/load", is_there).await;
    let served = Served::start(&machine);
    all_before_has_come(&bus, &served).await;
    assert_eq!(replies(&bus, "kept"), [] as [Value; 0]);
    served.get("/commands/kept").await.expect(404);
}

#[tokio::test]
async fn duplicate_and_late_resets_count_for_nothing_and_their_senders_are_told() {
    let (reached, broker) = over_mosquitto().await;
    let served = reached.served();
    let bus = Bus::connect(&broker.address(), "test-1").await;
    let reset = async |output: &Value| {
        let body =
            json!({"boot_id": output["boot_id"], "seq": output["seq"], "handler_id": "arm", "result": "ok"});
        bus.publish("cs/1/m_code/100/reset", &body).await;
    };
    let results = async |output: &Value, count: usize| {
        until("its results", async || {
            let all = bus.history.on("cs/1/m_code/100/result").into_iter();
            let of_it: Vec<_> = all
                .filter(|result| result["seq"] == output["seq"])
                .map(|result| result["status"].clone())
                .collect();
            (of_it.len() >= count).then_some(of_it)
        })
        .await
    };
    let output_after = async |seq: u64| {
        let later = |output: &Value| output["seq"].as_u64().unwrap() > seq;
        bus.history.find("cs/1/m_code/100/output", later).await
    };
    served
        .post("/cs/1/load?wait=1", &json!({"program": 52}))
        .await
        .expect(200);
    served.command(1, "start").await;
    let first = output_after(0).await;
    for _ in 0..3 {
        reset(&first).await;
    }
    assert_eq!(results(&first, 3).await, ["accepted", "duplicate", "duplicate"]);
    let second = output_after(first["seq"].as_u64().unwrap()).await;
    let waiting = served.execution(1, "WAIT").await;
    assert_eq!(
        waiting["waiting_on"]["seq"], second["seq"],
        "one reset, one output"
    );

    served.command(1, "stop").await;
    reset(&second).await;
    assert_eq!(results(&second, 1).await, ["stale"]);
    // they do not apply to the next run, either, because its outputs have other numbers
    served.command(1, "reset").await;
    served.command(1, "start").await;
    let third = output_after(second["seq"].as_u64().unwrap()).await;
    reset(&first).await;
    reset(&second).await;
    let late = results(&second, 2).await;
    assert_eq!(late, ["stale", "stale"]);
    let waiting = served.execution(1, "WAIT").await;
    assert_eq!(waiting["waiting_on"]["seq"], third["seq"]);
}
