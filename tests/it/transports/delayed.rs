//! A broker that delivers requests late: those with an age limit have no effect then.

use std::time::Duration;

use plc_api::{Error, Plc};
use plc_protocol::types::refusal::RefusalCode;
use plc_protocol::types::state::Execution;
use serde_json::{Value, json};

use super::{broker_at, machine};
use crate::support::broker::Mosquitto;
use crate::support::mqtt::Bus;
use crate::support::served::Served;
use crate::support::wait::{until, within};
use crate::support::wire::Wire;

fn start(command_id: &str, heartbeat: &Value, within_ms: u64) -> Value {
    let not_after =
        json!({"boot_id": heartbeat["boot_id"], "heartbeat": heartbeat["cycle"], "within_ms": within_ms});
    json!({"command_id": command_id, "client_id": "panel", "not_after": not_after})
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_start_that_a_broker_delivers_late_is_rejected_as_expired() {
    let broker = Mosquitto::start();
    let wire = Wire::to(&broker.address()).await;
    let served = Served::start(&machine(&broker_at(wire.address())));
    let bus = Bus::connect(&broker.address(), "test-1").await;
    served
        .post("/cs/1/load?wait=1", &json!({"program": 50}))
        .await
        .expect(200);
    bus.history.find("heartbeat", |_| true).await;

    wire.cut();
    let pressed = bus.history.on("heartbeat");
    let pressed = pressed.last().expect("a heartbeat");
    bus.publish("cs/1/command/start", &start("late", pressed, 1000))
        .await;
    let lock = json!({"value": true, "text": "set by a press that is late", "not_after": start("", pressed, 1000)["not_after"]});
    bus.publish("cs/1/input/start_lock/set", &lock).await;
    tokio::time::sleep(Duration::from_millis(1500)).await;
    wire.mend();
    let reply = bus
        .history
        .find("reply/panel", |reply| reply["command_id"] == "late")
        .await;
    assert_eq!(
        (&reply["status"], &reply["code"]),
        (&json!("rejected"), &json!("expired")),
        "{reply}"
    );
    assert_eq!(served.state(1).await["execution"], "READY");
    let locks = bus.history.on("cs/1/input/start_lock/state");
    assert!(locks.iter().all(|lock| lock["value"] == false), "{locks:?}");

    let newer = bus.history.find("heartbeat", |beat| {
        beat["cycle"].as_u64() > pressed["cycle"].as_u64()
    });
    let newer = newer.await;
    bus.publish("cs/1/command/start", &start("in-time", &newer, 60_000))
        .await;
    let is_accepted = |reply: &Value| reply["command_id"] == "in-time" && reply["status"] == "accepted";
    bus.history.find("reply/panel", is_accepted).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_request_of_for_person_that_arrives_late_is_rejected_as_expired() {
    let broker = Mosquitto::start();
    let served = Served::start(&machine(&broker_at(&broker.address())));
    served
        .post("/cs/1/load?wait=1", &json!({"program": 50}))
        .await
        .expect(200);
    let wire = Wire::to(&broker.address()).await;
    let over_mqtt = format!("mqtt://{}/test-1", wire.address());
    for url in [over_mqtt, served.http_url()] {
        let plc = within("a connection", Plc::connect(&url)).await.unwrap();
        let pressed = until("a heartbeat", async || plc.for_person().await.ok()).await;
        let pressed = pressed.coordinate_system(1);
        // the request waits at the wire; over REST, which has none, in the client
        wire.cut();
        let is_over_rest = url.starts_with("http");
        let late = tokio::spawn(async move {
            if is_over_rest {
                tokio::time::sleep(Duration::from_millis(1500)).await;
            }
            pressed.start().await
        });
        tokio::time::sleep(Duration::from_millis(1500)).await;
        wire.mend();
        let late = within("the answer", late).await.unwrap();
        assert!(
            matches!(&late, Err(Error::Refused(refusal)) if refusal.code == RefusalCode::Expired),
            "{url}: {late:?}"
        );
        assert_eq!(served.state(1).await["execution"], "READY", "{url}");

        until("an accepted start", async || {
            let pressed = plc.for_person().await.ok()?;
            pressed.coordinate_system(1).start().await.ok()
        })
        .await;
        let system = plc.coordinate_system(1);
        system.stop().await.unwrap();
        within("the stop", system.wait_until(Execution::Stopped))
            .await
            .unwrap();
        system.reset().await.unwrap();
    }
}
