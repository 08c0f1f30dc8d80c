//! The broker ends and returns while an output is pending.

use std::sync::{Arc, Mutex};

use plc_api::{Alarm, AuxOutput, SequenceProgram};
use serde_json::json;
use tokio::sync::Notify;

use super::{Reached, broker_at, connect, machine, over, over_mosquitto};
use crate::support::broker::Mosquitto;
use crate::support::served::Served;
use crate::support::wait::until;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_output_survives_the_death_of_the_broker_and_is_handled_once() {
    let (reached, broker) = over_mosquitto().await;
    an_output_survives_its_death(&reached, broker, async |_| {}).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn output_survives_the_death_of_a_persistent_broker_and_is_handled_once() {
    let (reached, broker) = over(Mosquitto::that_keeps()).await;
    an_output_survives_its_death(&reached, broker, async |broker| {
        let kept = broker.folder().join("mosquitto.db");
        let begun = std::time::SystemTime::now();
        until("the broker has written what it knows", async || {
            let written = std::fs::metadata(&kept).and_then(|file| file.modified());
            written.is_ok_and(|written| written > begun).then_some(())
        })
        .await;
    })
    .await;
}

/// Kills the broker while a handler works, after `before` has been waited for.
async fn an_output_survives_its_death(
    reached: &Reached,
    mut broker: Mosquitto,
    before: impl AsyncFnOnce(&Mosquitto),
) {
    let served = reached.served();
    let (calls, go_on) = (Arc::new(Mutex::new(Vec::new())), Arc::new(Notify::new()));
    let (handler_calls, handler_go_on) = (Arc::clone(&calls), Arc::clone(&go_on));
    let handler = move |output: AuxOutput| {
        let (calls, go_on) = (Arc::clone(&handler_calls), Arc::clone(&handler_go_on));
        async move {
            calls.lock().unwrap().push(output.params().a());
            if output.params().a() == Some(1.0) {
                go_on.notified().await;
            }
            Ok::<(), Alarm>(())
        }
    };
    let plc = reached.plc.clone();
    let handlers = tokio::spawn(async move { SequenceProgram::new().on(100, handler).run(&plc).await });
    served
        .post("/cs/1/load?wait=1", &json!({"program": 52}))
        .await
        .expect(200);
    served.command(1, "start").await;
    until("the handler works", async || {
        (!calls.lock().unwrap().is_empty()).then_some(())
    })
    .await;

    before(&broker).await;
    broker.kill();
    // The work ends while the machine cannot be notified.
    go_on.notify_one();
    let state = served.state(1).await;
    assert_eq!(
        (&state["execution"], &state["waiting_on"]["m"]),
        (&json!("WAIT"), &json!(100))
    );
    broker.start_again();
    served.execution(1, "PROGRAM_COMPLETED").await;
    assert_eq!(
        *calls.lock().unwrap(),
        [Some(1.0), Some(2.0)],
        "each output is handled once"
    );
    handlers.abort();
}

#[tokio::test]
async fn motion_never_waits_for_the_broker() {
    let (reached, mut broker) = over_mosquitto().await;
    let served = reached.served();
    broker.kill();
    served.load(1, 60, "G00 X50\nG00 X0\nM30\n").await;
    served.command(1, "start").await;
    served.execution(1, "PROGRAM_COMPLETED").await;
}

#[tokio::test]
async fn an_output_made_without_a_broker_is_there_when_it_is_back() {
    let (reached, mut broker) = over_mosquitto().await;
    let served = reached.served();
    served.load(1, 60, "M100 VA3\nM30\n").await;
    broker.kill();
    served.command(1, "start").await;
    let state = served.execution(1, "WAIT").await;
    broker.start_again();
    let bus = crate::support::mqtt::Bus::connect(&broker.address(), "test-1").await;
    let seq = &state["waiting_on"]["seq"];
    let pending = bus
        .history
        .find("cs/1/m_code/pending", |pending| {
            pending["outputs"][0]["seq"] == *seq
        })
        .await;
    assert_eq!(pending["outputs"][0]["params"], json!({"A": 3.0}));
    let reset = json!({"boot_id": state["boot_id"], "seq": seq, "handler_id": "late", "result": "ok"});
    bus.publish("cs/1/m_code/100/reset", &reset).await;
    served.execution(1, "PROGRAM_COMPLETED").await;
}

#[tokio::test]
async fn waiting_program_is_held_on_broker_loss_and_continues_after_it() {
    let mut broker = Mosquitto::start();
    let hold = format!("{}on_bus_loss = \"hold_at_wait\"\n", broker_at(&broker.address()));
    let machine = machine(&hold);
    let served = Served::start(&machine);
    connect(&served.mqtt_url()).await;
    served.load(1, 60, "G00 X5\nM100 VA3\nG00 X9\nM30\n").await;
    served.command(1, "start").await;
    served.execution(1, "WAIT").await;
    broker.kill();
    let held = served.execution(1, "FEED_HOLD").await;
    assert_eq!(
        (&held["reason"], &held["waiting_on"]["m"]),
        (&json!("BUS_LOST"), &json!(100))
    );
    served.reset_output(1, "operator", false).await.expect(200);
    broker.start_again();
    let bus = crate::support::mqtt::Bus::connect(&broker.address(), "test-1").await;
    let told = bus
        .history
        .find("cs/1/state", |state| state["reason"] == "BUS_LOST")
        .await;
    assert_eq!(told["waiting_on"], json!(null), "the reset is latched");
    bus.publish(
        "cs/1/command/resume",
        &json!({"command_id": "r", "client_id": "hmi"}),
    )
    .await;
    served.execution(1, "PROGRAM_COMPLETED").await;
}
