//! Several programs that were started with one `handler_id`, and a lost output that is not repeated without a request.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use plc_api::{AuxOutput, Error, Plc, SequenceProgram};
use plc_protocol::types::request::RefusalCode;
use serde_json::{Value, json};
use tokio::task::JoinHandle;

use super::{Reached, connect, machine, over_mosquitto, over_rest, over_the_embedded_broker};
use crate::support::mqtt::Bus;
use crate::support::served::{FREE_PORTS, Served};
use crate::support::wait::{until, within};

const THREE_PARTS: &str = "M60\nM60\nM60\nM30\n";

/// Counts parts; M60 is its handler.
#[derive(Clone, Default)]
struct Counter(Arc<AtomicU32>);

impl Counter {
    fn count(&self) -> u32 {
        self.0.load(Ordering::SeqCst)
    }

    fn program(&self) -> SequenceProgram {
        let parts = Arc::clone(&self.0);
        SequenceProgram::new()
            .handler_id("counter")
            .on(60, move |_output: AuxOutput| {
                parts.fetch_add(1, Ordering::SeqCst);
                async { Ok(()) }
            })
    }
}

fn serve(plc: Plc, program: SequenceProgram) -> JoinHandle<Result<(), Error>> {
    tokio::spawn(async move { program.run(&plc).await })
}

async fn served_by_somebody(served: &Served) {
    until("the handler is there", async || {
        let handlers = served.get("/handlers").await.expect(200).json();
        (handlers["handlers"]["counter"]["online"] == true).then_some(())
    })
    .await;
}

async fn run_60(served: &Served) {
    served.command(1, "start").await;
    served.execution(1, "PROGRAM_COMPLETED").await;
}

async fn of_two_programs_of_one_name_one_works(reached: &Reached) {
    let (served, counter) = (reached.served(), Counter::default());
    served.load(1, 60, THREE_PARTS).await;
    let first = serve(reached.plc.clone(), counter.program());
    served_by_somebody(served).await;
    let second = serve(connect(&reached.url).await, counter.program());
    run_60(served).await;
    assert_eq!(counter.count(), 3);
    let Err(Error::Refused(refusal)) = within("the second ends", second).await.unwrap() else {
        panic!("the second serves");
    };
    assert_eq!(refusal.code, RefusalCode::HandlerTaken);
    for word in ["counter", "instance", "since", "take_over"] {
        assert!(refusal.text.contains(word), "{refusal}");
    }
    run_60(served).await;
    assert_eq!(counter.count(), 6, "the first is as it was");

    let third = serve(connect(&reached.url).await, counter.program().take_over());
    let Err(Error::TakenOver { text, .. }) = within("the first ends", first).await.unwrap() else {
        panic!("the first goes on");
    };
    assert!(text.contains("has taken over"), "{text}");
    served_by_somebody(served).await;
    run_60(served).await;
    assert_eq!(counter.count(), 9);
    assert!(!third.is_finished());
}

#[tokio::test]
async fn of_two_programs_of_one_name_over_the_embedded_broker_one_works() {
    of_two_programs_of_one_name_one_works(&over_the_embedded_broker().await).await;
}

#[tokio::test]
async fn of_two_programs_of_one_name_over_mosquitto_one_works() {
    let (reached, _broker) = over_mosquitto().await;
    of_two_programs_of_one_name_one_works(&reached).await;
}

#[tokio::test]
async fn of_two_programs_of_one_name_over_rest_one_works() {
    of_two_programs_of_one_name_one_works(&over_rest().await).await;
}

/// A handler in any language, which names no instance.
struct Raw {
    bus: Bus,
}

impl Raw {
    async fn new(served: &Served) -> Self {
        Self {
            bus: Bus::connect(&served.broker, "test-1").await,
        }
    }

    async fn say(&self, presence: &Value) {
        self.bus
            .publish_retained("handler/counter/presence", presence)
            .await;
    }

    async fn come(&self, more: &Value) {
        let mut presence = json!({"online": true, "handles": [{"cs": 1, "m": 60}]});
        let more = more.as_object().expect("an object").clone();
        presence.as_object_mut().expect("an object").extend(more);
        self.say(&presence).await;
    }

    /// Claims or resets the pending output; returns the answer.
    async fn send(&self, served: &Served, what: &str, instance: Option<&str>) -> Value {
        let state = served.execution(1, "WAIT").await;
        let mut body = json!({
            "boot_id": state["boot_id"], "seq": state["waiting_on"]["seq"], "handler_id": "counter",
        });
        if what == "reset" {
            body["result"] = json!("ok");
        }
        if let Some(instance) = instance {
            body["instance"] = json!(instance);
        }
        let topic = "cs/1/m_code/60/result";
        let before = self.bus.history.on(topic).len();
        self.bus.publish(&format!("cs/1/m_code/60/{what}"), &body).await;
        until("the answer", async || {
            let results = self.bus.history.on(topic).split_off(before);
            results.into_iter().find(|result| result["of"] == what)
        })
        .await
    }
}

fn served_with(more: &str) -> (crate::support::machine::Machine, Served) {
    let machine = machine(&format!("[m_code.60]\nunhandled = \"wait\"\n{more}{FREE_PORTS}"));
    let served = Served::start(&machine);
    (machine, served)
}

#[tokio::test]
async fn client_without_instance_is_its_connection_and_a_second_is_refused() {
    let (_machine, served) = served_with("");
    served.load(1, 60, THREE_PARTS).await;
    let (first, second) = (Raw::new(&served).await, Raw::new(&served).await);
    first.come(&json!({})).await;
    served_by_somebody(&served).await;
    second.come(&json!({})).await;
    let refused = second
        .bus
        .history
        .find("handler/counter/result", |result| result["status"] == "refused");
    let refused = within("a refusal", refused).await;
    assert_eq!(
        (&refused["of"], &refused["code"]),
        (&json!("presence"), &json!("handler_taken"))
    );
    served.command(1, "start").await;
    let denied = second.send(&served, "claim", None).await;
    assert_eq!(denied["status"], "not_owner");
    assert!(
        denied["text"].as_str().expect("why").contains("in use by"),
        "{denied}"
    );
    for what in ["claim", "reset"] {
        let answer = first.send(&served, what, None).await;
        assert_eq!(answer["status"], "accepted", "{answer}");
    }
    // killed without a last will: with its connection the handler has ended
    drop(first);
    until("another is let in", async || {
        second.come(&json!({})).await;
        let claim = second.send(&served, "claim", None).await;
        (claim["status"] == "accepted").then_some(())
    })
    .await;
}

#[tokio::test]
async fn returning_handler_gets_its_claimed_outputs_only_after_a_decision() {
    let (_machine, served) = served_with("");
    served.load(1, 60, THREE_PARTS).await;
    let raw = Raw::new(&served).await;
    raw.come(&json!({})).await;
    served_by_somebody(&served).await;
    served.command(1, "start").await;
    assert_eq!(raw.send(&served, "claim", None).await["status"], "accepted");
    raw.say(&json!({"online": false})).await;
    served
        .state_where(1, "lost", |state| state["reason"] == "HANDLER_LOST")
        .await;
    let told = raw.bus.history.on("cs/1/m_code/60/output").len();
    raw.come(&json!({})).await;
    served_by_somebody(&served).await;
    for what in ["claim", "reset"] {
        let answer = raw.send(&served, what, None).await;
        assert_eq!(answer["status"], "withheld", "{answer}");
        assert!(
            answer["text"].as_str().expect("why").contains("operator"),
            "{answer}"
        );
    }
    assert_eq!(
        raw.bus.history.on("cs/1/m_code/60/output").len(),
        told,
        "nobody is told of it"
    );
    let state = served.state(1).await;
    let redo = json!({"boot_id": state["boot_id"], "how": "redo"});
    let path = format!("/cs/1/m_codes/{}/redeliver", state["waiting_on"]["seq"]);
    served.post(&path, &redo).await.expect(204);
    let again = raw.send(&served, "claim", None).await;
    assert_eq!(
        (&again["status"], &again["how"]),
        (&json!("accepted"), &json!("redo"))
    );
    assert_eq!(raw.send(&served, "reset", None).await["status"], "accepted");
    // an unclaimed output is offered to each new handler, as always
    let seq = served.execution(1, "WAIT").await["waiting_on"]["seq"].clone();
    raw.come(&json!({"validates": true})).await;
    let told = raw.bus.history.find("cs/1/m_code/60/output", |output| {
        output["seq"] == seq && output["attempt"] == 2
    });
    within("it is published again", told).await;
}

#[tokio::test]
async fn stricter_of_configuration_and_presence_decides_a_lost_output() {
    let (_machine, served) = served_with("redelivery = \"verify\"\n");
    served.load(1, 60, THREE_PARTS).await;
    let raw = Raw::new(&served).await;
    for (said, status, how) in [
        (json!({"redelivery": "redo"}), "accepted", json!("verify")),
        (json!({}), "accepted", json!("verify")),
        (json!({"redelivery": "ask"}), "withheld", Value::Null),
    ] {
        raw.come(&said).await;
        served_by_somebody(&served).await;
        served.command(1, "start").await;
        assert_eq!(raw.send(&served, "claim", None).await["status"], "accepted");
        raw.say(&json!({"online": false})).await;
        served
            .state_where(1, "lost", |state| state["reason"] == "HANDLER_LOST")
            .await;
        raw.come(&said).await;
        served_by_somebody(&served).await;
        let answer = raw.send(&served, "claim", None).await;
        assert_eq!(
            (&answer["status"], &answer["how"]),
            (&json!(status), &how),
            "{said}"
        );
        served.command(1, "reset").await;
        served.execution(1, "READY").await;
    }
}

#[tokio::test]
async fn instance_that_lost_only_its_connection_continues_its_claim() {
    let (_machine, served) = served_with("");
    served.load(1, 60, THREE_PARTS).await;
    let raw = Raw::new(&served).await;
    let of = |instance: &str| json!({"instance": instance});
    raw.come(&of("a")).await;
    served_by_somebody(&served).await;
    served.command(1, "start").await;
    let claim = raw.send(&served, "claim", Some("a")).await;
    assert_eq!(
        (&claim["status"], &claim["instance"]),
        (&json!("accepted"), &json!("a"))
    );
    raw.say(&json!({"online": false, "instance": "a"})).await;
    served
        .state_where(1, "lost", |state| state["reason"] == "HANDLER_LOST")
        .await;
    raw.come(&of("a")).await;
    served_by_somebody(&served).await;
    let claim = raw.send(&served, "claim", Some("a")).await;
    assert_eq!(
        (&claim["status"], &claim["how"]),
        (&json!("accepted"), &Value::Null)
    );
    assert_eq!(raw.send(&served, "claim", Some("b")).await["status"], "not_owner");
    assert_eq!(raw.send(&served, "reset", Some("a")).await["status"], "accepted");
}
