//! The life of a program: over REST, WebSocket and MQTT at once; hold, resume, stop, reset and refusals.

use std::time::Duration;

use serde_json::{Value, json};

use super::served;
use crate::support::mqtt::Bus;
use crate::support::served::Served;
use crate::support::wait::{History, until};

const WAITS: &str = "G00 X50\nM100 VA3\nG00 X0\nM30\n";
const LIFE: [&str; 5] = ["READY", "ACTIVE", "WAIT", "ACTIVE", "PROGRAM_COMPLETED"];

/// Requests the state repeatedly, and records the answers.
fn poll(http: String) -> History {
    let history = History::default();
    let sink = history.clone();
    tokio::spawn(async move {
        loop {
            let answer = crate::support::http::request(&http, "GET", "/api/v1/cs/1/state", "", "").await;
            sink.push("cs/1/state".into(), answer.json());
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    });
    history
}

/// The execution words from READY on.
fn life(history: &History) -> Vec<String> {
    let mut words = history.executions(1);
    let ready = words
        .iter()
        .position(|word| word == "READY")
        .unwrap_or(words.len());
    words.split_off(ready)
}

#[tokio::test]
async fn rest_websocket_and_mqtt_see_the_same_states_of_a_run() {
    let (_machine, served) = served();
    let socket = served.watch(&["cs/1/state", "cs/1/m_code/pending"]).await;
    let bus = Bus::connect(&served.broker, "test-1").await;
    let polled = poll(served.http.clone());
    served.load(1, 50, WAITS).await;
    // a client that is slow receives the latest state only
    for history in [&socket.history, &bus.history, &polled] {
        history
            .find("cs/1/state", |state| state["execution"] == "READY")
            .await;
    }
    served.post("/cs/1/start", &Value::Null).await.expect(202);

    let state = served.execution(1, "WAIT").await;
    assert_eq!(state["wait_state"], "TOOL_LOAD");
    assert_eq!(state["waiting_on"]["m"], 100);
    assert_eq!(state["program"], 50);
    for history in [&socket.history, &bus.history, &polled] {
        let seen = history
            .find("cs/1/state", |state| state["execution"] == "WAIT")
            .await;
        assert_eq!(seen["waiting_on"]["seq"], state["waiting_on"]["seq"]);
        assert_eq!((&seen["boot_id"], &seen["v"]), (&state["boot_id"], &json!(1)));
    }
    let output = bus.history.find("cs/1/m_code/100/output", |_| true).await;
    assert_eq!(
        (&output["params"], &output["line"]),
        (&json!({"A": 3.0}), &json!(2))
    );
    let open = |pending: &Value| {
        pending["outputs"]
            .as_array()
            .is_some_and(|outputs| !outputs.is_empty())
    };
    let pending = socket.history.find("cs/1/m_code/pending", open).await;
    assert_eq!(pending["outputs"][0]["seq"], output["seq"]);
    assert_eq!(pending["outputs"][0]["state"], "OUTPUT");

    let reset = served.reset_output(1, "test", false).await.expect(200).json();
    assert_eq!(reset["status"], "accepted");
    served.execution(1, "PROGRAM_COMPLETED").await;
    for (name, history) in [
        ("WebSocket", &socket.history),
        ("MQTT", &bus.history),
        ("REST", &polled),
    ] {
        history
            .find("cs/1/state", |state| state["execution"] == "PROGRAM_COMPLETED")
            .await;
        assert_eq!(life(history), LIFE, "over {name}");
    }
    let position = served.get("/cs/1/position").await.expect(200).json();
    assert_eq!(position["machine"]["X"], 0.0);
    for topic in [
        "birth",
        "cs/1/modal",
        "cs/1/program",
        "cs/1/position",
        "cs/2/state",
    ] {
        bus.history.find(topic, |_| true).await;
    }
    let unreadable = bus.unreadable.on("unreadable");
    assert!(
        unreadable.is_empty(),
        "every message has the type of its topic: {unreadable:#?}"
    );
}

#[tokio::test]
async fn pending_is_published_before_the_output_itself() {
    let (_machine, served) = served();
    let bus = Bus::connect(&served.broker, "test-1").await;
    served.load(1, 50, "M100\nM30\n").await;
    served.command(1, "start").await;
    let output = bus.history.find("cs/1/m_code/100/output", |_| true).await;
    let seen = bus.history.on("cs/1/m_code/pending");
    let named = seen
        .iter()
        .any(|pending| pending["outputs"][0]["seq"] == output["seq"]);
    assert!(named, "{seen:?}");
}

#[tokio::test]
async fn an_output_can_be_claimed_and_reset_over_mqtt_alone() {
    let (_machine, served) = served();
    let bus = Bus::connect(&served.broker, "test-1").await;
    let command = |id: &str, args: Value| json!({"command_id": id, "client_id": "panel", "args": args});
    served.put_program(50, WAITS).await.expect(201);
    bus.publish("cs/1/command/load", &command("load-1", json!({"program": 50})))
        .await;
    let done = |id: &'static str| move |reply: &Value| reply["command_id"] == id && reply["status"] == "done";
    bus.history.find("reply/panel", done("load-1")).await;
    bus.publish("cs/1/command/start", &command("start-1", json!({})))
        .await;
    let output = bus.history.find("cs/1/m_code/100/output", |_| true).await;
    let (boot_id, seq) = (&output["boot_id"], &output["seq"]);
    let claim = json!({"boot_id": boot_id, "seq": seq, "handler_id": "h1"});
    bus.publish("cs/1/m_code/100/claim", &claim).await;
    bus.history
        .find("cs/1/m_code/100/result", |result| result["status"] == "not_owner")
        .await;
    let presence = json!({"online": true});
    bus.publish_retained("handler/h1/presence", &presence).await;
    bus.publish("cs/1/m_code/100/claim", &claim).await;
    bus.history
        .find("cs/1/m_code/100/result", |result| result["status"] == "accepted")
        .await;

    let foreign = json!({"boot_id": boot_id, "seq": seq, "handler_id": "h2", "result": "ok"});
    bus.publish("cs/1/m_code/100/reset", &foreign).await;
    bus.history
        .find("cs/1/m_code/100/result", |result| result["status"] == "not_owner")
        .await;
    let other_boot = json!({"boot_id": "another", "seq": seq, "handler_id": "h1", "result": "ok"});
    bus.publish("cs/1/m_code/100/reset", &other_boot).await;
    bus.history
        .find("cs/1/m_code/100/result", |result| result["status"] == "stale")
        .await;
    assert_eq!(served.state(1).await["execution"], "WAIT");

    let own = json!({"boot_id": boot_id, "seq": seq, "handler_id": "h1", "result": "ok"});
    bus.publish("cs/1/m_code/100/reset", &own).await;
    bus.history
        .find("cs/1/state", |state| state["execution"] == "PROGRAM_COMPLETED")
        .await;
    bus.publish("cs/1/m_code/100/reset", &own).await;
    bus.history
        .find("cs/1/m_code/100/result", |result| result["status"] == "duplicate")
        .await;
}

#[tokio::test]
async fn hold_comes_to_rest_on_the_path_and_resume_goes_on() {
    let (_machine, served) = served();
    served.load(1, 50, "G01 X100 F6000\nM30\n").await;
    served.command(1, "start").await;
    served.command(1, "hold").await;
    let state = served.state(1).await;
    assert_eq!(
        (&state["execution"], &state["transition"]),
        (&json!("FEED_HOLD"), &Value::Null)
    );
    let x = async || {
        served.get("/cs/1/position").await.expect(200).json()["machine"]["X"]
            .as_f64()
            .unwrap()
    };
    let rest = x().await;
    assert!((0.0..100.0).contains(&rest), "{rest}");
    assert_eq!(x().await, rest, "at rest under hold");
    served.command(1, "resume").await;
    served.execution(1, "PROGRAM_COMPLETED").await;
    assert_eq!(x().await, 100.0);
}

#[tokio::test]
async fn under_hold_a_reset_is_latched_and_the_block_stays_until_resume() {
    let (_machine, served) = served();
    served.load(1, 50, "M100\nG00 X5\nM30\n").await;
    served.command(1, "start").await;
    served.execution(1, "WAIT").await;
    served.command(1, "hold").await;
    let state = served.execution(1, "FEED_HOLD").await;
    assert_eq!(state["waiting_on"]["m"], 100, "what is waited for stays");
    served.reset_output(1, "test", false).await.expect(200);
    assert_eq!(served.state(1).await["execution"], "FEED_HOLD");
    assert_eq!(served.get("/cs/1/position").await.json()["machine"]["X"], 0.0);
    served.command(1, "resume").await;
    served.execution(1, "PROGRAM_COMPLETED").await;
}

#[tokio::test]
async fn d34_stop_cancels_open_outputs_and_their_reset_is_stale() {
    let (_machine, served) = served();
    let bus = Bus::connect(&served.broker, "test-1").await;
    served.load(1, 50, WAITS).await;
    served.command(1, "start").await;
    let waiting = served.execution(1, "WAIT").await;
    served.command(1, "stop").await;
    let state = served.state(1).await;
    assert_eq!(
        (&state["execution"], &state["reason"]),
        (&json!("STOPPED"), &json!("STOP"))
    );
    assert_eq!(state["waiting_on"], Value::Null);
    let cancel = bus.history.find("cs/1/m_code/100/cancel", |_| true).await;
    assert_eq!(
        (&cancel["seq"], &cancel["reason"]),
        (&waiting["waiting_on"]["seq"], &json!("stop"))
    );
    let seq = &waiting["waiting_on"]["seq"];
    let body = json!({"boot_id": waiting["boot_id"], "handler_id": "late", "result": "ok"});
    let late = served
        .post(&format!("/cs/1/m_codes/{seq}/reset"), &body)
        .await
        .expect(409)
        .json();
    assert_eq!(late["code"], "stale");
    let pending = served.get("/cs/1/m_codes").await.expect(200).json();
    assert_eq!(pending["outputs"], json!([]));
}

async fn allowed(served: &Served, verb: &str) -> (Value, Vec<String>) {
    let refused = served
        .post(&format!("/cs/1/{verb}"), &Value::Null)
        .await
        .expect(409);
    let kind = refused.header("content-type").unwrap().to_owned();
    assert!(kind.starts_with("application/problem+json"), "{kind}");
    let body = refused.json();
    assert_eq!(
        (&body["code"], &body["status"]),
        (&json!("not_allowed"), &json!(409))
    );
    let allowed = body["allowed"]
        .as_array()
        .expect("allowed[]")
        .iter()
        .map(|verb| verb.as_str().unwrap().to_owned());
    (body["state"].clone(), allowed.collect())
}

#[tokio::test]
async fn command_not_allowed_in_the_state_is_409_with_state_and_verbs() {
    let (_machine, served) = served();
    let (state, verbs) = allowed(&served, "start").await;
    assert_eq!(state, "STOPPED");
    for verb in ["load", "hold", "stop", "abort", "reset"] {
        assert!(
            verbs.iter().any(|one| one == verb),
            "{verb} is allowed in STOPPED: {verbs:?}"
        );
    }
    served.load(1, 50, WAITS).await;
    let (state, verbs) = allowed(&served, "resume").await;
    assert_eq!(state, "READY");
    assert!(
        verbs.contains(&"start".to_owned()) && !verbs.contains(&"resume".to_owned()),
        "{verbs:?}"
    );
    served.command(1, "start").await;
    let (state, verbs) = allowed(&served, "reset").await;
    assert_eq!(state, "ACTIVE");
    assert!(
        verbs.contains(&"hold".to_owned()) && !verbs.contains(&"load".to_owned()),
        "{verbs:?}"
    );
}

#[tokio::test]
async fn reset_ends_a_waiting_run_clears_and_is_ready_for_a_new_one() {
    let (_machine, served) = served();
    served.load(1, 50, WAITS).await;
    served.command(1, "start").await;
    let first = served.execution(1, "WAIT").await;
    served.command(1, "reset").await;
    assert_eq!(served.state(1).await["execution"], "READY");
    served.command(1, "start").await;
    let second = served.execution(1, "WAIT").await;
    assert_ne!(first["run_id"], second["run_id"]);
    let seq = |state: &Value| state["waiting_on"]["seq"].as_u64().unwrap();
    assert!(seq(&second) > seq(&first), "D33: a number never comes again");
}

#[tokio::test]
async fn an_alarm_stops_and_stays_until_reset_clears_it() {
    let (_machine, served) = served();
    served.load(1, 50, "G00 X900\nM30\n").await;
    served.command(1, "start").await;
    let state = served.execution(1, "STOPPED").await;
    assert_eq!(
        (&state["reason"], &state["alarm_count"]),
        (&json!("ALARM"), &json!(1))
    );
    let alarms = served.get("/alarms").await.expect(200).json();
    assert!(alarms.to_string().contains("102"), "{alarms}");
    served
        .post("/cs/1/load", &json!({"program": 50}))
        .await
        .expect(409);
    served.command(1, "reset").await;
    let state = served.state(1).await;
    assert_eq!(
        (&state["execution"], &state["alarm_count"]),
        (&json!("READY"), &json!(0))
    );
}

#[tokio::test]
async fn repeated_command_id_gets_the_stored_reply_without_execution() {
    let (_machine, served) = served();
    let bus = Bus::connect(&served.broker, "test-1").await;
    served.load(1, 50, "M100\nM30\n").await;
    let start = json!({"command_id": "once", "client_id": "panel", "args": {}});
    bus.publish("cs/1/command/start", &start).await;
    let first = served.execution(1, "WAIT").await;
    served.reset_output(1, "test", false).await.expect(200);
    served.execution(1, "PROGRAM_COMPLETED").await;
    let replies = bus.history.on("reply/panel").len();
    bus.publish("cs/1/command/start", &start).await;
    until("the stored reply", async || {
        (bus.history.on("reply/panel").len() > replies).then_some(())
    })
    .await;
    let state = served.state(1).await;
    assert_eq!(
        (&state["execution"], &state["run_id"]),
        (&json!("PROGRAM_COMPLETED"), &first["run_id"])
    );
}
