//! Interlock and start lock with owners, over REST and MQTT.

use serde_json::json;

use super::served_with;
use crate::support::http::{Answer, request};
use crate::support::mqtt::Bus;
use crate::support::served::Served;

const DOOR: &str = "[input.interlock]\non_loss = \"keep\"\n[input.interlock.source.door]\non_loss = \"on\"\n\
                    coordinate_systems = [1]\n";

async fn put(served: &Served, body: serde_json::Value) -> Answer {
    let path = "/api/v1/cs/1/inputs/interlock";
    request(&served.http, "PUT", path, "application/json", &body.to_string()).await
}

#[tokio::test]
async fn declared_source_is_on_until_its_handler_sets_it_and_when_it_is_lost() {
    let (_machine, served) = served_with(DOOR);
    let bus = Bus::connect(&served.broker, "test-1").await;
    let state = |value: bool| move |state: &serde_json::Value| state["value"] == value;
    let at_start = bus.history.find("cs/1/input/interlock/state", state(true)).await;
    assert_eq!(at_start["sources"][0]["lost"], true, "{at_start}");
    bus.history.find("cs/2/input/interlock/state", state(false)).await;
    served.load(1, 50, "G01 F6000 X10\nM30\n").await;
    let refusal = served.post("/cs/1/start", &json!({})).await.expect(409).json();
    assert_eq!(refusal["code"], "start_locked");
    // an offline handler owns nothing
    let set = json!({"value": false, "source": "door", "handler_id": "cell"});
    assert_eq!(
        put(&served, set.clone()).await.expect(503).json()["code"],
        "unavailable"
    );
    let refusal = put(&served, json!({"value": false, "source": "door"}))
        .await
        .expect(409);
    assert!(
        refusal.json()["detail"].as_str().unwrap().contains("force"),
        "{refusal:?}"
    );
    let presence = json!({"online": true, "handles": [], "validates": false});
    bus.publish_retained("handler/cell/presence", &presence).await;
    bus.publish("cs/1/input/interlock/set", &set).await;
    let cleared = bus.history.find("cs/1/input/interlock/state", state(false)).await;
    assert_eq!(cleared["sources"][0]["handler_id"], "cell", "{cleared}");
    served.command(1, "start").await;
    served.execution(1, "PROGRAM_COMPLETED").await;
    bus.publish_retained("handler/cell/presence", &json!({"online": false}))
        .await;
    let lost =
        |state: &serde_json::Value| state["value"] == true && state["sources"][0]["handler_id"] == "cell";
    let lost = bus.history.find("cs/1/input/interlock/state", lost).await;
    assert!(lost["text"].as_str().unwrap().contains("handler cell"), "{lost}");
    // an operator continues without it, with a mark
    let force = json!({"value": false, "source": "door", "force": true, "handler_id": "panel"});
    put(&served, force).await.expect(204);
    let forced = served.get("/cs/1/inputs/interlock").await.expect(200).json();
    assert_eq!(
        (&forced["value"], &forced["sources"][0]["forced_by"]),
        (&json!(false), &json!("panel"))
    );
}

#[tokio::test]
async fn a_set_without_a_source_is_one_more_source_and_counts_as_ever() {
    let (_machine, served) = served_with("");
    put(&served, json!({"value": true, "text": "by hand"}))
        .await
        .expect(204);
    put(&served, json!({"value": true, "text": "no air", "source": "air"}))
        .await
        .expect(204);
    put(&served, json!({"value": false})).await.expect(204);
    let lock = served.get("/cs/1/inputs/interlock").await.expect(200).json();
    assert_eq!((&lock["value"], &lock["text"]), (&json!(true), &json!("no air")));
    put(&served, json!({"value": false, "source": "air"}))
        .await
        .expect(204);
    let lock = served.get("/cs/1/inputs/interlock").await.expect(200).json();
    assert_eq!((&lock["value"], &lock["sources"]), (&json!(false), &json!([])));
    put(&served, json!({"value": true, "source": "a/b"}))
        .await
        .expect(400);
}
