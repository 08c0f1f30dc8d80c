//! The control lease over every transport: only its holder starts motion, and every client may stop motion.

use std::time::Duration;

use plc_api::{Error, Execution, LeaseGuard, Plc};
use plc_protocol::types::command::{Command, CommandMeta};
use plc_protocol::types::request::{Refusal, RefusalCode, Request};
use serde_json::{Value, json};

use super::{Reached, connect, in_process, over_mosquitto, over_rest, over_the_embedded_broker};
use crate::support::http::{Answer, request_with};
use crate::support::mqtt::Bus;
use crate::support::served::{FREE_PORTS, Served};
use crate::support::wait::{until, within};

const TTL: Duration = Duration::from_secs(30);

fn refusal<T: std::fmt::Debug>(result: Result<T, Error>) -> Refusal {
    match result {
        Err(Error::Refused(refusal)) => refusal,
        other => panic!("it is refused: {other:?}"),
    }
}

/// Creates a start command with an explicit fence.
async fn start_with(plc: &Plc, fence: u64) -> Result<(), Error> {
    let meta = CommandMeta {
        command_id: format!("start-{fence}"),
        client_id: "late".to_owned(),
        fence: Some(fence),
        ..CommandMeta::default()
    };
    let start = Request::Command {
        cs: 1,
        command: Command::Start,
        meta,
        wait: true,
    };
    Ok(plc.port().request(start).await.map(|_| ())?)
}

/// Waits until this commander has received the holder of the lease.
async fn holder_is(plc: &Plc, holder: Option<&str>) {
    until(&format!("the holder is {holder:?}"), async || {
        // over MQTT a client may be notified later
        let state = plc.coordinate_system(1).lease().await.ok()?;
        (state.holder.as_deref() == holder).then_some(())
    })
    .await;
}

/// Two commanders: one takes the lease, the other may only stop its motion.
async fn it_keeps_others_from_starting(reached: &Reached) {
    let other = if reached.url.is_empty() {
        Plc::in_process(std::sync::Arc::clone(reached.plc.port()))
    } else {
        connect(&reached.url).await
    };
    let (mine, others) = (reached.plc.coordinate_system(1), other.coordinate_system(1));
    within("load", others.load(51))
        .await
        .expect("nobody needs a lease that nobody holds");
    let lease = within("lease", mine.take_lease_as("mes-1", TTL))
        .await
        .expect("a lease");
    holder_is(&other, Some("mes-1")).await;
    for refused in [
        refusal(within("start", others.start()).await),
        refusal(within("load", others.load(50)).await),
        refusal(within("mdi", others.mdi("G00 X1")).await),
        refusal(within("home", others.home(&[])).await),
        refusal(within("jog", others.jog('X', 100.0, Some(1.0), "j")).await),
        refusal(within("lease", others.take_lease(TTL)).await),
        refusal(within("start without the fence", mine.start()).await),
    ] {
        assert_eq!(refused.code, RefusalCode::Busy);
        assert!(
            refused.text.contains("mes-1 holds it until 2"),
            "{}",
            refused.text
        );
    }
    let system = lease.coordinate_system();
    within("start", system.start()).await.expect("the holder starts");
    within("wait", others.wait_until(Execution::Wait))
        .await
        .expect("M12 waits");
    within("hold", others.hold()).await.expect("everyone may hold");
    let refused = refusal(within("resume", others.resume()).await);
    assert_eq!(refused.code, RefusalCode::Busy);
    within("resume", system.resume())
        .await
        .expect("the holder resumes");
    within("stop", others.stop()).await.expect("everyone may stop");
    within("reset", others.reset()).await.expect("everyone may reset");
    within("abort", others.abort()).await.expect("everyone may abort");
    it_ends(&other, lease).await;
}

async fn it_ends(other: &Plc, lease: LeaseGuard) {
    let fence = lease.fence();
    within("release", lease.release()).await.expect("the own lease");
    holder_is(other, None).await;
    let refused = refusal(within("stale", start_with(other, fence)).await);
    assert_eq!(refused.code, RefusalCode::LeaseLost);
    let system = other.coordinate_system(1);
    let next = within("the next lease", system.take_lease_as("mes-2", TTL))
        .await
        .expect("it is free");
    assert!(next.fence() > fence);
    holder_is(other, Some("mes-2")).await;
    drop(next);
    holder_is(other, None).await;
    within("start", system.start())
        .await
        .expect("nobody needs a lease that nobody holds");
    within("stop", system.stop()).await.expect("a stop");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn in_process_a_lease_keeps_others_from_starting() {
    let reached = in_process().await;
    it_keeps_others_from_starting(&reached).await;
    reached.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn over_mqtt_a_lease_keeps_others_from_starting() {
    it_keeps_others_from_starting(&over_the_embedded_broker().await).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn over_mosquitto_a_lease_keeps_others_from_starting() {
    let (reached, _broker) = over_mosquitto().await;
    it_keeps_others_from_starting(&reached).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn over_rest_a_lease_keeps_others_from_starting() {
    it_keeps_others_from_starting(&over_rest().await).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_lease_is_renewed_in_the_background_until_it_is_broken() {
    let reached = over_rest().await;
    let served = reached.served();
    let ttl = Duration::from_secs(9);
    let lease = reached
        .plc
        .coordinate_system(1)
        .take_lease(ttl)
        .await
        .expect("a lease");
    let first = served.get("/cs/1/lease").await.expect(200).json();
    assert_eq!(first["fence"], lease.fence());
    let renewed = async || {
        let now = served.get("/cs/1/lease").await.expect(200).json();
        (now["fence"] == first["fence"] && now["expires_at"].as_str() > first["expires_at"].as_str())
            .then_some(())
    };
    until("it is renewed", renewed).await;
    served.post("/cs/1/lease/break", &json!(null)).await.expect(200);
    let after = served.get("/cs/1/lease").await.expect(200).json();
    assert!(after["holder"].is_null() && after["fence"].is_null(), "{after}");
    until("its holder is told", async || lease.is_lost().then_some(())).await;
}

/// A request with a body and the header of a lease.
async fn send(served: &Served, (method, path): (&str, &str), body: &Value, fence: &str) -> Answer {
    let path = format!("/api/v1{path}");
    let body = if body.is_null() {
        String::new()
    } else {
        body.to_string()
    };
    let header = match fence {
        "" => String::new(),
        fence => format!("Lease-Fence: {fence}\r\n"),
    };
    request_with(&served.http, method, &path, "application/json", &body, &header).await
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn rest_and_mqtt_obey_the_same_lease() {
    let reached = over_the_embedded_broker().await;
    let served = reached.served();
    let load = served.post("/cs/1/load?wait=1", &json!({"program": 51})).await;
    load.expect(200);
    let bus = Bus::connect(&served.broker, "test-1").await;
    let take = json!({"command_id": "t1", "client_id": "mes", "ttl_ms": 60000});
    bus.publish("cs/1/lease/take", &take).await;
    let granted = bus.reply("mes", "t1").await;
    assert_eq!(
        (&granted["status"], &granted["lease"]["holder"]),
        (&json!("done"), &json!("mes"))
    );
    let fence = &granted["lease"]["fence"];
    let is_told = |state: &Value| state["fence"] == *fence && state["holder"] == "mes";
    bus.history.find("cs/1/lease/state", is_told).await;

    let busy = served.post("/cs/1/start", &json!(null)).await.expect(409).json();
    assert_eq!(busy["code"], "busy");
    let allowed = busy["allowed"].as_array().expect("a list");
    assert!(
        allowed.contains(&json!("hold")) && !allowed.contains(&json!("start")),
        "{busy}"
    );
    let detail = busy["detail"].as_str().expect("a text");
    assert!(detail.contains("mes holds it until"), "{detail}");
    let start = json!({"command_id": "s1", "client_id": "hmi"});
    bus.publish("cs/1/command/start", &start).await;
    assert_eq!(bus.reply("hmi", "s1").await["code"], "busy");

    // with its fence, over any transport
    let own = fence.to_string();
    let start = send(served, ("POST", "/cs/1/start?wait=1"), &json!(null), &own).await;
    start.expect(200);
    served.execution(1, "WAIT").await;
    served.command(1, "stop").await;
    served.command(1, "reset").await;
    let release = send(served, ("DELETE", "/cs/1/lease"), &json!(null), &own).await;
    release.expect(200);
    let lost = send(served, ("POST", "/cs/1/start"), &json!(null), &own).await;
    assert_eq!(lost.expect(409).json()["code"], "lease_lost");
    let start = json!({"command_id": "s2", "client_id": "hmi", "fence": fence});
    bus.publish("cs/1/command/start", &start).await;
    assert_eq!(bus.reply("hmi", "s2").await["code"], "lease_lost");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_lease_is_renewed_over_rest_and_what_is_wrong_with_a_request_is_said() {
    let reached = over_rest().await;
    let served = reached.served();
    let lease = ("POST", "/cs/1/lease");
    let taken = send(served, lease, &json!({"holder": "mes"}), "")
        .await
        .expect(200)
        .json();
    assert_eq!(
        (&taken["status"], &taken["lease"]["holder"]),
        (&json!("done"), &json!("mes"))
    );
    let fence = &taken["lease"]["fence"];
    let renewal = json!({"fence": fence, "ttl_ms": 600_000});
    let renewed = send(served, lease, &renewal, "").await.expect(200).json();
    assert_eq!(renewed["lease"]["fence"], *fence);
    assert!(renewed["lease"]["expires_at"].as_str() > taken["lease"]["expires_at"].as_str());
    let again = send(served, lease, &json!({}), "").await.expect(409).json();
    assert_eq!(again["code"], "busy");
    for (asked, body, header) in [
        (lease, json!({"ttl_ms": 10}), ""),
        (lease, json!({"holder": ""}), ""),
        (lease, json!({"fence": "x"}), ""),
        (("POST", "/cs/1/start"), json!(null), "x"),
        (("DELETE", "/cs/1/lease"), json!(null), ""),
    ] {
        let wrong = send(served, asked, &body, header).await.expect(400).json();
        assert_eq!(wrong["code"], "invalid", "{asked:?} {body}");
    }
    send(served, ("GET", "/cs/9/lease"), &json!(null), "")
        .await
        .expect(404);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nobody_holds_the_lease_after_a_restart_of_the_runtime() {
    let machine = super::machine(FREE_PORTS);
    let mut served = Served::start(&machine);
    served
        .post("/cs/1/lease", &json!({"ttl_ms": 600_000, "holder": "mes"}))
        .await
        .expect(200);
    served.process.signal("KILL");
    assert_eq!(
        served.process.exit_code_within(Duration::from_secs(10)),
        None,
        "killed"
    );
    let served = Served::start(&machine);
    assert!(served.get("/cs/1/lease").await.expect(200).json()["holder"].is_null());
}
