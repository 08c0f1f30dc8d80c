//! With an external broker, topics name the senders of requests.

use plc_protocol::types::request::Input;
use serde_json::json;

use super::mqtt::{TestClient, broker, mqtt_end_that};
use super::*;

#[tokio::test]
async fn behind_a_foreign_broker_the_topic_names_the_sender() {
    let port = StubPort::new();
    let (broker, address) = broker("127.0.0.1:0".parse().unwrap());
    let end = mqtt_end_that(false, &port, address);
    let mut client =
        TestClient::connect(address, "raw", &["reply/+", "presence", "cs/1/m_code/5/result"]).await;
    client.next("presence", |value| value["online"] == true).await;
    let door = |owner: &str| json!({"source": "door", "value": false, "handler_id": owner});
    let command = |id: &str, client_id: &str| json!({"command_id": id, "client_id": client_id});
    let variables =
        json!({"command_id": "v", "client_id": "clamp", "kind": "Q", "from": 3, "values": [77.0]});
    // none of these reaches the machine
    for (path, payload) in [
        ("cs/1/input/interlock/set", &door("clamp")),
        ("handler/clamp/cs/1/input/interlock/set", &door("magazine")),
        ("handler/clamp/cs/1/input/dry_run/set", &json!({"value": true})),
        ("handler/clamp/cs/1/variable/set", &variables),
        ("cs/1/command/start", &command("unnamed", "panel")),
        ("client/panel/cs/1/command/start", &command("other", "board")),
        (
            "cs/1/m_code/5/claim",
            &json!({"boot_id": "boot-1", "seq": 3, "handler_id": "clamp"}),
        ),
    ] {
        client.publish(path, false, payload).await;
    }
    for (client_id, id) in [("clamp", "v"), ("panel", "unnamed"), ("board", "other")] {
        let path = format!("reply/{client_id}");
        let (_, reply) = client.next(&path, |reply| reply["command_id"] == id).await;
        assert_eq!(
            (&reply["status"], &reply["code"]),
            (&json!("rejected"), &json!("forbidden")),
            "{id}"
        );
    }
    client
        .next("cs/1/m_code/5/result", |result| result["status"] == "refused")
        .await;
    assert_eq!(port.asked(), []);
    // each of these does
    for (path, payload) in [
        ("client/panel/cs/1/command/start", &command("start", "panel")),
        ("client/panel/cs/1/command/hold", &command("hold", "panel-plc-1")),
        ("cs/1/command/stop", &command("stop", "anyone")),
        (
            "handler/clamp/cs/1/input/interlock/set",
            &json!({"source": "door", "value": true}),
        ),
    ] {
        client.publish(path, false, payload).await;
    }
    let is_owned = |request: &Request| matches!(request, Request::Input(1, Input::Interlock(set)) if set.handler_id.as_deref() == Some("clamp"));
    port.asked_for(is_owned).await;
    let answer = json!({"decision": "refuse"});
    client
        .publish("client/panel/stored_data/answer", false, &answer)
        .await;
    port.asked_for(|request| matches!(request, Request::AnswerStoredData(_)))
        .await;
    for id in ["start", "hold", "stop"] {
        port.asked_for(|request| matches!(request, Request::Command { meta, .. } if meta.command_id == id))
            .await;
    }
    end.stop().await;
    broker.stop().await;
}
