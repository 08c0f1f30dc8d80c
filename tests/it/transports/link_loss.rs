//! The link to the broker is cut for longer than keep-alive, and the runtime is killed, while an output is
//! pending.

use plc_api::{AuxOutput, Error, SequenceProgram};
use serde_json::{Value, json};

use super::{broker_at, connect, machine};
use crate::support::broker::Mosquitto;
use crate::support::mqtt::Bus;
use crate::support::served::{FREE_PORTS, Served};
use crate::support::wait::{until, within};
use crate::support::wire::Wire;

/// Waits until the last presence has this value and a matching `boot_id`. The broker publishes it after one
/// and a half of the runtime's keep-alive of 10 s.
async fn presence(bus: &Bus, is_online: bool, fits: impl Fn(&Value) -> bool) -> Value {
    let last = async || {
        let said = bus.history.on("presence");
        said.last()
            .filter(|last| last["online"] == is_online && fits(&last["boot_id"]))
            .cloned()
    };
    // half of the time for the keep-alive
    for _ in 0..1000 {
        if let Some(last) = last().await {
            return last;
        }
        tokio::time::sleep(std::time::Duration::from_millis(10)).await;
    }
    until("the runtime's presence", last).await
}

fn reset_of(output: &Value) -> Value {
    json!({"boot_id": output["boot_id"], "seq": output["seq"], "handler_id": "arm", "result": "ok"})
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn link_cut_beyond_keep_alive_delays_no_motion_and_loses_no_output() {
    let broker = Mosquitto::start();
    let wire = Wire::to(&broker.address()).await;
    let machine = machine(&broker_at(wire.address()));
    let served = Served::start(&machine);
    let bus = Bus::connect(&broker.address(), "test-1").await;
    served
        .post("/cs/1/load?wait=1", &json!({"program": 52}))
        .await
        .expect(200);
    served.command(1, "start").await;
    let output = bus.history.find("cs/1/m_code/100/output", |_| true).await;

    wire.cut();
    served.load(2, 60, "G00 X50\nG00 X0\nM30\n").await;
    served.command(2, "start").await;
    served.execution(2, "PROGRAM_COMPLETED").await;
    presence(&bus, false, |_| true).await;
    let state = served.state(1).await;
    assert_eq!(
        (&state["execution"], &state["waiting_on"]["seq"]),
        (&json!("WAIT"), &output["seq"]),
        "what waits goes on waiting"
    );
    // published while the machine is offline: it is never delivered
    let stop = json!({"command_id": "missed", "client_id": "panel", "args": {}});
    bus.publish("cs/1/command/stop", &stop).await;

    wire.mend();
    presence(&bus, true, |_| true).await;
    let again = |said: &Value| said["seq"] == output["seq"] && said["redelivered"] == true;
    let again = bus.history.find("cs/1/m_code/100/output", again).await;
    assert_eq!(again["attempt"], 2);
    bus.publish("cs/1/m_code/100/reset", &reset_of(&again)).await;
    let second = |said: &Value| said["params"] == json!({"A": 2.0});
    let second = bus.history.find("cs/1/m_code/100/output", second).await;
    bus.publish("cs/1/m_code/100/reset", &reset_of(&second)).await;
    served.execution(1, "PROGRAM_COMPLETED").await;
    served.get("/commands/missed").await.expect(404);
}

#[tokio::test]
async fn killed_runtime_is_offline_by_its_will_and_its_requests_turn_stale() {
    let broker = Mosquitto::start();
    let machine = machine(&broker_at(&broker.address()));
    let served = Served::start(&machine);
    let bus = Bus::connect(&broker.address(), "test-1").await;
    served
        .post("/cs/1/load?wait=1", &json!({"program": 52}))
        .await
        .expect(200);
    served.command(1, "start").await;
    let output = bus.history.find("cs/1/m_code/100/output", |_| true).await;
    let old = output["boot_id"].clone();

    // kills it, as kill -9 does
    drop(served);
    presence(&bus, false, |boot_id| *boot_id == old).await;
    let served = Served::start(&machine);
    presence(&bus, true, |boot_id| *boot_id != old).await;
    let state = bus
        .history
        .find("cs/1/state", |state| state["boot_id"] != old)
        .await;
    assert_eq!(
        (&state["execution"], &state["reason"]),
        (&json!("STOPPED"), &json!("RESTARTED"))
    );
    let pending = |said: &Value| said["boot_id"] != old;
    let pending = bus.history.find("cs/1/m_code/pending", pending).await;
    assert_eq!(pending["outputs"], json!([]));
    bus.publish("cs/1/m_code/100/reset", &reset_of(&output)).await;
    let result = bus.history.find("cs/1/m_code/100/result", |_| true).await;
    assert_eq!(
        (&result["seq"], &result["status"]),
        (&output["seq"], &json!("stale"))
    );
    assert_eq!(served.state(1).await["execution"], "STOPPED");
}

#[tokio::test]
async fn unanswered_request_has_unknown_outcome_and_a_guard_waits_for_machine() {
    let machine = machine(FREE_PORTS);
    let served = Served::start(&machine);
    let wire = Wire::to(&served.broker).await;
    let plc = connect(&format!("mqtt://{}/test-1", wire.address())).await;
    let serving = plc.clone();
    let handlers = tokio::spawn(async move {
        let program = SequenceProgram::new().handler_id("cell");
        program
            .on(12, |_output: AuxOutput| async { Ok(()) })
            .run(&serving)
            .await
    });
    let online = async || {
        let handlers = served.get("/handlers").await.expect(200).json();
        (handlers["handlers"]["cell"]["online"] == true).then_some(())
    };
    until("the handlers are there", online).await;

    wire.cut();
    let mill = plc.coordinate_system(1);
    let guard = tokio::spawn(async move { mill.set_interlock(true, "the door is open").await });
    let unknown = within("no answer", plc.coordinate_system(1).select_tool(3)).await;
    assert!(
        matches!(&unknown, Err(Error::NoAnswer { command_id: None, text }) if text.contains("did not answer")),
        "{unknown:?}"
    );
    assert!(!guard.is_finished() && !handlers.is_finished());

    wire.mend();
    assert_eq!(within("the guard", guard).await.unwrap(), Ok(()));
    let lock = served.get("/cs/1/inputs/interlock").await.expect(200).json();
    assert_eq!(
        (&lock["value"], &lock["text"]),
        (&json!(true), &json!("the door is open"))
    );
    assert!(!handlers.is_finished());
}
