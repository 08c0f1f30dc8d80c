//! A handler in a separate process is killed by kill -9 while the program waits for it.

use std::path::Path;

use serde_json::{Value, json};

use super::{Reached, over_mosquitto, over_rest, over_the_embedded_broker};
use crate::support::binary::example;
use crate::support::served::{Process, Served};
use crate::support::wait::until;

/// Starts the example handler of M12 against a machine, and waits until it serves it.
fn start_handler(url: &str) -> Process {
    let mut handler = Process::start(&example("04_mqtt_handler"), Path::new("/"), &[url]);
    handler.line("the handler is there", |line| line.contains(url));
    handler
}

async fn online(served: &Served) -> bool {
    let handlers = served.get("/handlers").await.expect(200).json();
    handlers["handlers"]["clamp"]["online"] == true || handlers["clamp"]["online"] == true
}

/// Runs program 51 and kills the handler in the middle of M12; leaves WAIT with `HANDLER_LOST`.
async fn lose_the_handler(served: &Served, url: &str) -> Value {
    served
        .post("/cs/1/load?wait=1", &json!({"program": 51}))
        .await
        .expect(200);
    for _ in 0..5 {
        let handler = start_handler(url);
        served.command(1, "start").await;
        let working = |state: &Value| {
            !state["waiting_on"]["progress"].is_null() || state["execution"] == "PROGRAM_COMPLETED"
        };
        served.state_where(1, "the handler works", working).await;
        // Kills the handler, as kill -9 does.
        drop(handler);
        let after =
            |state: &Value| state["reason"] == "HANDLER_LOST" || state["execution"] == "PROGRAM_COMPLETED";
        let state = served.state_where(1, "HANDLER_LOST", after).await;
        if state["execution"] == "WAIT" {
            return state;
        }
        // The handler was faster than this test; the test tries again.
    }
    panic!("the handler was never caught at work");
}

async fn kill_9_leaves_wait_handler_lost_and_a_reset_by_hand_completes(reached: &Reached) {
    let served = reached.served();
    let state = lose_the_handler(served, &reached.url).await;
    assert_eq!(
        (&state["execution"], &state["waiting_on"]["m"]),
        (&json!("WAIT"), &json!(12))
    );
    let pending = served.get("/cs/1/m_codes").await.expect(200).json();
    assert_eq!(
        pending["outputs"][0]["state"], "OUTPUT",
        "the claim is given back: {pending}"
    );
    let history = served.get("/alarms/history").await.expect(200).json();
    let warnings = history["alarms"].as_array().expect("a list");
    let last = warnings.last().expect("a warning");
    assert_eq!(
        (&last["severity"], &last["number"], &last["line"]),
        (&json!("warning"), &json!(302), &json!(2))
    );
    assert_eq!(last["text"], "The handler of an M code is lost: M12 of clamp");
    assert_eq!(
        served.get("/alarms").await.expect(200).json()["alarms"],
        json!([]),
        "it prevents nothing"
    );
    let position = served.get("/cs/1/position").await.expect(200).json();
    assert_eq!(position["machine"]["X"], 5.0, "the next block waits");
    served.reset_output(1, "operator", true).await.expect(200);
    served.execution(1, "PROGRAM_COMPLETED").await;
}

async fn a_handler_that_returns_leaves_it_until_it_is_redelivered(reached: &Reached) {
    let served = reached.served();
    let lost = lose_the_handler(served, &reached.url).await;
    let mut handler = start_handler(&reached.url);
    until("the handler is online again", async || {
        online(served).await.then_some(())
    })
    .await;
    // on_redelivery is `ask`: work that the dead handler had begun is not repeated automatically.
    tokio::time::sleep(std::time::Duration::from_millis(500)).await;
    let state = served.state(1).await;
    assert_eq!(
        (&state["execution"], &state["reason"]),
        (&json!("WAIT"), &json!("HANDLER_LOST")),
        "{state}"
    );
    assert!(!handler.output.contains("closing"), "{}", handler.output);

    let seq = &lost["waiting_on"]["seq"];
    let redo = json!({"boot_id": lost["boot_id"], "how": "redo"});
    served
        .post(&format!("/cs/1/m_codes/{seq}/redeliver"), &redo)
        .await
        .expect(204);
    served.execution(1, "PROGRAM_COMPLETED").await;
    handler.line("the handler did it again", |line| line.contains("closed"));
}

#[tokio::test]
async fn embedded_broker_kill_9_leaves_handler_lost_until_a_manual_reset() {
    let reached = over_the_embedded_broker().await;
    kill_9_leaves_wait_handler_lost_and_a_reset_by_hand_completes(&reached).await;
}

#[tokio::test]
async fn mosquitto_kill_9_leaves_handler_lost_until_a_manual_reset() {
    let (reached, _broker) = over_mosquitto().await;
    kill_9_leaves_wait_handler_lost_and_a_reset_by_hand_completes(&reached).await;
}

#[tokio::test]
async fn embedded_broker_returning_handler_repeats_only_a_redelivered_output() {
    let reached = over_the_embedded_broker().await;
    a_handler_that_returns_leaves_it_until_it_is_redelivered(&reached).await;
}

#[tokio::test]
async fn a_handler_that_returns_over_mosquitto_does_it_again_only_when_told() {
    let (reached, _broker) = over_mosquitto().await;
    a_handler_that_returns_leaves_it_until_it_is_redelivered(&reached).await;
}

#[tokio::test]
async fn rest_kill_9_leaves_handler_lost_until_a_manual_reset() {
    let reached = over_rest().await;
    kill_9_leaves_wait_handler_lost_and_a_reset_by_hand_completes(&reached).await;
}

#[tokio::test]
async fn a_handler_that_returns_over_rest_does_it_again_only_when_told() {
    let reached = over_rest().await;
    a_handler_that_returns_leaves_it_until_it_is_redelivered(&reached).await;
}
