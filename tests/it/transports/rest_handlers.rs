//! Handlers that use only HTTP: registration, two processes of one name, a killed process that returns.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use serde_json::{Value, json};

use super::{machine, over_mosquitto};
use crate::support::http::{Answer, request};
use crate::support::machine::Machine;
use crate::support::mqtt::Bus;
use crate::support::served::{FREE_PORTS, Served};
use crate::support::wait::until;

const THREE_PARTS: &str = "M60\nM60\nM60\nM30\n";

/// Presence of a process that serves M60, which counts parts.
fn presence(instance: &str) -> Value {
    json!({"online": true, "handles": [{"cs": 1, "m": 60}], "instance": instance, "expires_ms": 60_000})
}

async fn register(http: &str, presence: &Value) -> Answer {
    let path = "/api/v1/handlers/counter";
    request(http, "PUT", path, "application/json", &presence.to_string()).await
}

/// Sends a claim or another request about an output, and returns the answer.
async fn say(http: &str, output: &Value, what: &str, body: &Value) -> Value {
    let path = format!("/api/v1/cs/1/m_codes/{}/{what}", output["seq"]);
    let answer = request(http, "POST", &path, "application/json", &body.to_string()).await;
    let told = if answer.status == 200 { "status" } else { "code" };
    answer.json()[told].clone()
}

/// The message about an output of a process with this instance.
fn named(pending: &Value, instance: Option<&str>) -> Value {
    let mut named = json!({"boot_id": pending["boot_id"], "handler_id": "counter"});
    if let Some(instance) = instance {
        named["instance"] = json!(instance);
    }
    named
}

async fn pending(http: &str) -> Value {
    let answer = request(http, "GET", "/api/v1/cs/1/m_codes", "application/json", "").await;
    answer.expect(200).json()
}

/// A process that counts its work. It claims every output that it receives, registered or not.
async fn process(http: String, instance: &'static str, done: Arc<AtomicU32>) {
    loop {
        register(&http, &presence(instance)).await;
        let open = pending(&http).await;
        for output in open["outputs"].as_array().expect("outputs") {
            let by = named(&open, Some(instance));
            if say(&http, output, "claim", &by).await == "accepted" {
                done.fetch_add(1, Ordering::SeqCst);
                let mut reset = by;
                reset["result"] = json!("ok");
                say(&http, output, "reset", &reset).await;
            }
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

fn served() -> (Machine, Served) {
    let machine = machine(FREE_PORTS);
    let served = Served::start(&machine);
    (machine, served)
}

/// Starts a run that waits at M60, and returns the pending output.
async fn at_m60(served: &Served) -> Value {
    served.load(1, 60, THREE_PARTS).await;
    served.command(1, "start").await;
    served.execution(1, "WAIT").await;
    pending(&served.http).await
}

#[tokio::test]
async fn of_two_processes_of_one_name_over_rest_one_does_each_output() {
    let (_machine, served) = served();
    register(&served.http, &presence("a")).await.expect(204);
    let done = [(); 2].map(|()| Arc::<AtomicU32>::default());
    let [a, b] = [("a", 0), ("b", 1)].map(|(instance, place): (_, usize)| {
        tokio::spawn(process(served.http.clone(), instance, Arc::clone(&done[place])))
    });
    served.load(1, 60, THREE_PARTS).await;
    served.command(1, "start").await;
    served.execution(1, "PROGRAM_COMPLETED").await;
    let counts = done.map(|done| done.load(Ordering::SeqCst));
    assert_eq!(counts, [3, 0]);
    a.abort();
    b.abort();
}

#[tokio::test]
async fn a_claim_over_rest_needs_a_registration_with_its_instance() {
    let (_machine, served) = served();
    for wrong in [
        json!({"online": true, "expires_ms": 900}),
        json!({"online": true, "instance": "a"}),
        json!({"online": true, "instance": "~a", "expires_ms": 900}),
    ] {
        register(&served.http, &wrong).await.expect(400);
    }
    register(&served.http, &presence("a")).await.expect(204);
    let open = at_m60(&served).await;
    let output = &open["outputs"][0];
    for (instance, status) in [
        (None, "not_owner"),
        (Some("b"), "not_owner"),
        (Some("a"), "accepted"),
    ] {
        let by = named(&open, instance);
        assert_eq!(
            say(&served.http, output, "claim", &by).await,
            status,
            "{instance:?}"
        );
    }
    let by = json!({"boot_id": open["boot_id"], "handler_id": "other", "instance": "a"});
    assert_eq!(say(&served.http, output, "claim", &by).await, "not_owner");
}

/// A handler over MQTT without an instance is known by its connection, which no request over REST has.
#[tokio::test]
async fn h19_unnamed_rest_request_never_acts_for_a_handler_over_mqtt() {
    let (_machine, served) = served();
    let bus = Bus::connect(&served.broker, "test-1").await;
    let online = json!({"online": true, "handles": [{"cs": 1, "m": 60}]});
    bus.publish_retained("handler/counter/presence", &online).await;
    bus.history
        .find("handler/counter/result", |said| said["status"] == "accepted")
        .await;
    let open = at_m60(&served).await;
    let output = &open["outputs"][0];
    for instance in [None, Some("~rest"), Some("~mqtt-counter")] {
        let by = named(&open, instance);
        assert_eq!(say(&served.http, output, "claim", &by).await, "not_owner");
        let mut reset = by;
        reset["result"] = json!("ok");
        assert_eq!(say(&served.http, output, "reset", &reset).await, "not_owner");
        let mut door = json!({"source": "door", "value": true, "handler_id": "counter"});
        if let Some(instance) = instance {
            door["instance"] = json!(instance);
        }
        let path = "/api/v1/cs/1/inputs/interlock";
        let refused = request(&served.http, "PUT", path, "application/json", &door.to_string()).await;
        let text = refused.expect(409).json()["detail"]
            .as_str()
            .unwrap_or_default()
            .to_owned();
        assert!(text.contains("in use by a program without instance"), "{text}");
        assert!(!text.contains('~'), "{text}");
    }
    let claim = json!({"boot_id": open["boot_id"], "seq": output["seq"], "handler_id": "counter"});
    bus.publish("cs/1/m_code/60/claim", &claim).await;
    let accepted = |said: &Value| said["status"] == "accepted";
    bus.history.find("cs/1/m_code/60/result", accepted).await;
}

#[tokio::test]
async fn a_killed_process_that_returns_over_rest_is_given_nothing_unasked() {
    let (_machine, served) = served();
    let mut short = presence("a");
    short["expires_ms"] = json!(2000);
    register(&served.http, &short).await.expect(204);
    let open = at_m60(&served).await;
    register(&served.http, &short).await.expect(204);
    let output = &open["outputs"][0];
    let first = named(&open, Some("a"));
    assert_eq!(say(&served.http, output, "claim", &first).await, "accepted");
    // it is killed, and its next instance is refused until the registration has expired
    register(&served.http, &presence("b")).await.expect(409);
    until("the registration expires", async || {
        (register(&served.http, &presence("b")).await.status == 204).then_some(())
    })
    .await;
    let again = named(&open, Some("b"));
    assert_eq!(say(&served.http, output, "claim", &again).await, "withheld");
    served
        .state_where(1, "the loss", |state| state["reason"] == "HANDLER_LOST")
        .await;
    let redeliver = json!({"boot_id": open["boot_id"], "how": "redo"});
    let path = format!("/cs/1/m_codes/{}/redeliver", output["seq"]);
    served.post(&path, &redeliver).await;
    assert_eq!(say(&served.http, output, "claim", &again).await, "accepted");
    assert_eq!(say(&served.http, output, "claim", &first).await, "not_owner");
}

#[tokio::test]
async fn a_process_takes_over_the_registration_of_another_over_rest() {
    let (_machine, served) = served();
    register(&served.http, &presence("a")).await.expect(204);
    let mut next = presence("b");
    next["take_over"] = json!(true);
    register(&served.http, &next).await.expect(204);
    let refused = register(&served.http, &presence("a")).await.expect(409).json();
    assert_eq!(refused["code"], "handler_taken");
    let leaves = json!({"online": false, "instance": "b"});
    register(&served.http, &leaves).await.expect(204);
    register(&served.http, &presence("a")).await.expect(204);
}

#[tokio::test]
async fn other_broker_requires_an_instance_and_marks_pending_redelivered() {
    let (reached, mut broker) = over_mosquitto().await;
    let served = reached.served();
    let bus = Bus::connect(&broker.address(), "test-1").await;
    let mut anonymous = presence("a");
    anonymous.as_object_mut().expect("an object").remove("instance");
    bus.publish_retained("handler/counter/presence", &anonymous).await;
    let refused = |said: &Value| said["status"] == "refused" && said["code"] == "invalid";
    bus.history.find("handler/counter/result", refused).await;
    let topic = "handler/counter/presence";
    bus.publish_retained(topic, &presence("a")).await;
    at_m60(served).await;
    drop(bus);
    broker.kill();
    served
        .state_where(1, "WAIT", |state| state["execution"] == "WAIT")
        .await;
    broker.start_again();
    let bus = Bus::listen(&broker.address(), "test-1").await;
    let shows = |said: &Value| {
        said["outputs"]
            .as_array()
            .is_some_and(|outputs| !outputs.is_empty())
    };
    let first = bus.history.find("cs/1/m_code/pending", shows).await;
    assert_eq!(first["outputs"][0]["redelivered"], true, "{first}");
}
