//! A presence expires: a client that does not renew it is offline, even without a last will.

use std::sync::Arc;
use std::time::Duration;

use plc_api::{Alarm, AuxOutput, MqttOptions, Plc, SequenceProgram};
use serde_json::{Value, json};
use tokio::sync::Notify;
use tokio::task::JoinHandle;

use super::{broker_at, machine};
use crate::support::broker::Mosquitto;
use crate::support::machine::Machine;
use crate::support::mqtt::Bus;
use crate::support::served::Served;
use crate::support::wait::{until, within};

/// Age of the presences in these tests, ms.
const EXPIRES_MS: u64 = 3_000;

/// Age of presences in tests in which both sides return after an outage: longer than the waits between their
/// attempts.
const OUTAGE_EXPIRES_MS: u64 = 12_000;

/// The machine of the transports, whose own presence has this age.
fn aging_machine(broker: &Mosquitto, expires_ms: u64) -> Machine {
    let machine = machine(&broker_at(&broker.address()));
    let config = std::fs::read_to_string(machine.config()).expect("its configuration");
    let config = config.replace(
        "[machine]\n",
        &format!("[machine]\npresence_expires_ms = {expires_ms}\n"),
    );
    machine.write("tandem.toml", &config);
    machine
}

async fn connect(served: &Served, expires_ms: u64) -> Plc {
    let options = MqttOptions {
        presence_expires: Duration::from_millis(expires_ms),
        ..MqttOptions::default()
    };
    let url = served.mqtt_url();
    let connecting = Plc::connect_with(&url, options);
    within("Plc::connect", connecting).await.expect("a machine there")
}

/// A sequence program whose M100 works until it is released.
fn serve(plc: &Plc) -> (JoinHandle<()>, Arc<Notify>) {
    let go_on = Arc::new(Notify::new());
    let (plc, told) = (plc.clone(), Arc::clone(&go_on));
    let serving = tokio::spawn(async move {
        let handler = move |_: AuxOutput| {
            let told = Arc::clone(&told);
            async move {
                told.notified().await;
                Ok::<(), Alarm>(())
            }
        };
        let program = SequenceProgram::new().handler_id("tool").on(100, handler);
        let _ = program.run(&plc).await;
    });
    (serving, go_on)
}

async fn start(served: &Served, program: u16) {
    let load = json!({"program": program});
    served.post("/cs/1/load?wait=1", &load).await.expect(200);
    served.command(1, "start").await;
}

#[tokio::test]
async fn handler_without_repeated_presence_is_lost_as_by_its_last_will() {
    let broker = Mosquitto::start();
    let machine = aging_machine(&broker, EXPIRES_MS);
    let served = Served::start(&machine);
    let bus = Bus::connect(&broker.address(), "test-1").await;
    let presence = json!({
        "online": true, "handles": [{"cs": 1, "m": 100}], "instance": "a", "expires_ms": EXPIRES_MS,
    });
    let say = async || bus.publish_retained("handler/tool/presence", &presence).await;
    say().await;
    start(&served, 50).await;
    let boot_id = served.state(1).await["boot_id"].clone();
    let output = bus.history.find("cs/1/m_code/100/output", |_| true).await;
    let claim = json!({"boot_id": boot_id, "seq": output["seq"], "handler_id": "tool", "instance": "a"});
    bus.publish("cs/1/m_code/100/claim", &claim).await;
    let claimed = |pending: &Value| pending["outputs"][0]["state"] == "CLAIMED";
    bus.history.find("cs/1/m_code/pending", claimed).await;
    for _ in 0..6 {
        tokio::time::sleep(Duration::from_millis(EXPIRES_MS / 3)).await;
        say().await;
    }
    assert_eq!(
        served.state(1).await["reason"],
        Value::Null,
        "twice its age, it is there"
    );
    let outputs = bus.history.on("cs/1/m_code/100/output");
    assert_eq!(
        outputs.len(),
        1,
        "a presence that is said again publishes nothing again: {outputs:?}"
    );

    let lost = |state: &Value| state["reason"] == "HANDLER_LOST";
    served.state_where(1, "HANDLER_LOST", lost).await;
    let gone = |said: &Value| said["online"] == false && said["instance"] == "a";
    bus.history.find("handler/tool/presence", gone).await;
    let pending = served.get("/cs/1/m_codes").await.expect(200).json();
    assert_eq!(
        pending["outputs"][0]["state"], "OUTPUT",
        "its claim is given back: {pending}"
    );
    say().await;
    until("the handler is back", async || {
        let handlers = served.get("/handlers").await.expect(200).json();
        (handlers["handlers"]["tool"]["online"] == true).then_some(())
    })
    .await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn broker_outage_longer_than_a_presence_loses_no_handler() {
    let mut broker = Mosquitto::start();
    let machine = aging_machine(&broker, OUTAGE_EXPIRES_MS);
    let served = Served::start(&machine);
    let plc = connect(&served, OUTAGE_EXPIRES_MS).await;
    let (serving, go_on) = serve(&plc);
    let watch = served.watch(&["cs/1/state"]).await;
    start(&served, 50).await;
    until("the handler works", async || {
        let pending = served.get("/cs/1/m_codes").await.expect(200).json();
        (pending["outputs"][0]["handler_id"] == "tool").then_some(())
    })
    .await;

    broker.kill();
    tokio::time::sleep(Duration::from_millis(OUTAGE_EXPIRES_MS * 9 / 8)).await;
    assert!(plc.is_online().await, "who is cut off knows nothing of the other");
    broker.start_again();
    until("the connections", async || {
        let health = served.get("/health").await.expect(200).json();
        (health["status"] == "ok").then_some(())
    })
    .await;
    tokio::time::sleep(Duration::from_millis(OUTAGE_EXPIRES_MS * 9 / 8)).await;
    assert!(plc.is_online().await, "each has said again that it is there");
    go_on.notify_one();
    served.execution(1, "PROGRAM_COMPLETED").await;
    let states = watch.history.on("cs/1/state");
    assert!(
        states.iter().all(|state| state["reason"] != "HANDLER_LOST"),
        "{states:?}"
    );
    serving.abort();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn machine_without_repeated_presence_is_offline_until_it_repeats_it() {
    let broker = Mosquitto::start();
    let machine = aging_machine(&broker, EXPIRES_MS);
    let served = Served::start(&machine);
    let plc = connect(&served, EXPIRES_MS).await;
    tokio::time::sleep(Duration::from_millis(2 * EXPIRES_MS)).await;
    assert!(plc.is_online().await, "it has said so again");
    served.process.signal("STOP");
    until("the machine is offline, long before its last will", async || {
        (!plc.is_online().await).then_some(())
    })
    .await;
    served.process.signal("CONT");
    until("it is online again", async || plc.is_online().await.then_some(())).await;
}
