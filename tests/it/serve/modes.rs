//! Single block, interlock, manual data input, jog and homing over REST and MQTT.

use serde_json::{Value, json};

use super::served;
use crate::support::http::request;
use crate::support::mqtt::Bus;

#[tokio::test]
async fn mdi_and_home_over_rest_answer_after_the_run_or_with_diagnostics() {
    let (_machine, served) = served();
    served
        .post("/cs/1/mdi?wait=1", &json!({"text": "G91 G01 X2 F6000\nX3"}))
        .await
        .expect(200);
    let position = served.get("/cs/1/position").await.expect(200).json();
    assert_eq!(position["machine"]["X"], 5.0);
    assert_eq!(served.state(1).await["execution"], "READY");
    let program = served.get("/cs/1/program").await.expect(200).json();
    assert_eq!(program["number"], 0);
    let refusal = served
        .post("/cs/1/mdi", &json!({"text": "G00 X1\nG05"}))
        .await
        .expect(422)
        .json();
    assert_eq!(refusal["code"], "program_has_errors");
    assert_eq!(refusal["diagnostics"][0]["line"], 2, "{refusal}");
    served.post("/cs/1/mdi", &json!({"text": ""})).await.expect(400);
    served
        .post("/cs/1/home?wait=1", &json!({"axes": ["X"]}))
        .await
        .expect(200);
    let position = served.get("/cs/1/position").await.expect(200).json();
    assert_eq!(position["machine"]["X"], 0.0);
    // An alarm ends an input: the waiting client is notified.
    let answer = served
        .post("/cs/1/mdi?wait=1", &json!({"text": "G00 X900"}))
        .await;
    assert!(answer.status >= 400, "{answer:?}");
    assert_eq!(answer.json()["code"], "alarm", "{answer:?}");
    served
        .post("/cs/1/mdi", &json!({"text": "G00 X1"}))
        .await
        .expect(409);
    served.command(1, "reset").await;
    let answer = served
        .post("/cs/1/back_trace", &json!({"on": true}))
        .await
        .expect(409);
    assert_eq!(answer.json()["code"], "not_allowed");
}

#[tokio::test]
async fn a_jog_over_mqtt_runs_while_it_is_refreshed() {
    let (_machine, served) = served();
    let bus = Bus::connect(&served.broker, "test-1").await;
    let args = json!({"axis": "X", "velocity": 600.0, "refresh_id": "pendant-1"});
    let command = |id: u32| json!({"command_id": format!("jog-{id}"), "client_id": "pendant", "args": args});
    // One refresh follows at once, so that a slow computer does not end the jog before the first.
    bus.publish("cs/1/command/jog", &command(0)).await;
    bus.publish("cs/1/command/jog", &command(1)).await;
    bus.history
        .find("cs/1/state", |state| state["execution"] == "ACTIVE")
        .await;
    for id in 2..=10 {
        tokio::time::sleep(std::time::Duration::from_millis(50)).await;
        bus.publish("cs/1/command/jog", &command(id)).await;
    }
    // A refresh is done at once, the jog when its refreshes end.
    let done = |reply: &Value| reply["command_id"] != "jog-0" && reply["status"] == "done";
    bus.history.find("reply/pendant", done).await;
    let ended = |reply: &Value| reply["command_id"] == "jog-0" && reply["status"] == "done";
    bus.history.find("reply/pendant", ended).await;
    served.execution(1, "READY").await;
    let x = served.get("/cs/1/position").await.expect(200).json()["machine"]["X"].clone();
    assert!(x.as_f64().unwrap() > 0.0, "{x}");
    bus.publish("cs/1/command/jog", &command(11)).await;
    let rejected = |reply: &Value| reply["command_id"] == "jog-11";
    let reply = bus.history.find("reply/pendant", rejected).await;
    assert_eq!(
        (&reply["status"], &reply["code"]),
        (&json!("rejected"), &json!("not_allowed"))
    );
}

#[tokio::test]
async fn single_block_and_interlock_are_inputs_over_rest_and_mqtt() {
    let (_machine, served) = served();
    let bus = Bus::connect(&served.broker, "test-1").await;
    let put = async |input: &str, body: Value| {
        let path = format!("/api/v1/cs/1/inputs/{input}");
        request(&served.http, "PUT", &path, "application/json", &body.to_string()).await
    };
    put("single_block", json!({"value": true})).await.expect(204);
    bus.history
        .find("cs/1/input/single_block/state", |state| state["value"] == true)
        .await;
    served.load(1, 50, "G01 F6000 X10\nX20\nM30\n").await;
    served.command(1, "start").await;
    let state = served.execution(1, "INTERRUPTED").await;
    assert_eq!(
        (&state["reason"], &state["single_block"]),
        (&json!("SINGLE_BLOCK"), &json!(true))
    );
    let lock = json!({"value": true, "text": "the door is open"});
    bus.publish("cs/1/input/interlock/set", &lock).await;
    bus.history
        .find("cs/1/input/interlock/state", |state| {
            state["text"] == "the door is open"
        })
        .await;
    let refusal = served.post("/cs/1/resume", &Value::Null).await.expect(409).json();
    assert_eq!(refusal["code"], "start_locked");
    put("interlock", json!({"value": false, "text": ""}))
        .await
        .expect(204);
    put("single_block", json!({"value": false})).await.expect(204);
    put("dry_run", json!({"value": true})).await.expect(204);
    bus.history
        .find("cs/1/input/dry_run/state", |state| state["value"] == true)
        .await;
    bus.history
        .find("cs/1/state", |state| state["dry_run"] == true)
        .await;
    served.command(1, "resume").await;
    served.execution(1, "PROGRAM_COMPLETED").await;
}

#[tokio::test]
async fn a_step_needs_no_refresh_on_any_transport_and_a_longer_jog_fails() {
    let (_machine, served) = served();
    let x = async || {
        let position = served.get("/cs/1/position").await.expect(200).json();
        position["machine"]["X"].as_f64().unwrap()
    };
    let args = |id: &str, distance: f64| json!({"axis": "X", "velocity": 600.0, "distance": distance, "refresh_id": id});
    let done = served.post("/cs/1/jog?wait=1", &args("rest-1", 5.0)).await;
    assert_eq!(done.expect(200).json()["status"], "done");
    assert!((x().await - 5.0).abs() < 1e-6);
    let bus = Bus::connect(&served.broker, "test-1").await;
    let step = json!({"command_id": "step-1", "client_id": "pendant", "args": args("mqtt-1", 5.0)});
    bus.publish("cs/1/command/jog", &step).await;
    let done = |reply: &Value| reply["command_id"] == "step-1" && reply["status"] == "done";
    bus.history.find("reply/pendant", done).await;
    assert!((x().await - 10.0).abs() < 1e-6);
    let failed = served.post("/cs/1/jog?wait=1", &args("rest-2", 50.0)).await;
    let failed = failed.expect(409).json();
    assert_eq!(failed["code"], "not_refreshed", "{failed}");
    let moved = failed["reply"]["moved"]["X"].as_f64().unwrap();
    assert!(
        (x().await - 10.0 - moved).abs() < 1e-6 && moved < 50.0,
        "{failed}"
    );
    let plc = plc_api::Plc::connect(&format!("http://{}", served.http))
        .await
        .unwrap();
    let begun = x().await;
    let system = plc.coordinate_system(1);
    system.jog('X', -600.0, Some(5.0), "rust-1").await.unwrap();
    assert!((x().await - begun + 5.0).abs() < 1e-6);
    match system.jog('X', -600.0, Some(50.0), "rust-2").await {
        Err(plc_api::Error::CommandFailed { code, text, .. }) => {
            assert_eq!(code, "not_refreshed");
            assert!(text.contains("of 50.000 mm"), "{text}");
        }
        other => panic!("{other:?}"),
    }
    system.mdi("G90").await.unwrap();
    system.mdi_macro("G91 G01 X1 F600").await.unwrap();
    let modal = served.get("/cs/1/modal").await.expect(200).json();
    assert_eq!(modal["g"]["03"], "G90", "{modal}");
}
