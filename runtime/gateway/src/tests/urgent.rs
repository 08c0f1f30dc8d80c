//! Hold, stop and abort during floods of other requests.

use plc_protocol::types::command::{Command, Verb};
use rumqttc::QoS;
use serde_json::json;

use super::access::mqtt_options;
use super::mqtt::{ROOT, TestClient};
use super::*;
use crate::access::Account;
use crate::urgent_slots::UrgentKind;

/// More requests than the machine leaves unanswered before it rejects further ones.
const MORE_THAN_UNANSWERED: usize = 300;

fn is_command(request: &Request, command_id: &str) -> bool {
    matches!(request, Request::Command { meta, .. } if meta.command_id == command_id)
}

#[tokio::test]
async fn urgent_requests_of_each_quality_pass_messages_that_nobody_takes() {
    let port = StubPort::new();
    let users = TestUsers::new();
    let gateway = start_with(&port, users.settings.clone()).await;
    let flood =
        TestClient::with_options(mqtt_options(&gateway, "flood", "view", users.token("view")), &[]).await;
    port.silent.store(true, Ordering::Relaxed);
    for n in 0..MORE_THAN_UNANSWERED {
        let get =
            json!({"command_id": n.to_string(), "client_id": "view", "kind": "P", "from": 0, "count": 1});
        flood.publish("cs/1/variable/get", false, &get).await;
    }
    let panel = TestClient::with_options(
        mqtt_options(&gateway, "panel", "operate", users.token("operate")),
        &[],
    )
    .await;
    for verb in ["hold", "stop", "abort"] {
        for qos in [QoS::AtMostOnce, QoS::AtLeastOnce, QoS::ExactlyOnce] {
            // the port answers none of them: one of a kind for each coordinate system is pending
            port.silent.store(false, Ordering::Relaxed);
            let id = format!("{verb}-{}", qos as u8);
            let payload = json!({"command_id": id, "client_id": "panel"}).to_string();
            let topic = format!("{ROOT}cs/1/command/{verb}");
            panel.mqtt.publish(topic, qos, false, payload).await.unwrap();
            port.asked_for(|request| is_command(request, &id)).await;
        }
    }
    gateway.shutdown().await;
}

#[tokio::test]
async fn unanswered_requests_of_a_viewer_leave_slots_to_an_operator() {
    let port = StubPort::new();
    let users = TestUsers::new();
    let gateway = start_with(&port, users.settings.clone()).await;
    let options = mqtt_options(&gateway, "flood", "view", users.token("view"));
    let mut flood = TestClient::with_options(options, &["reply/view"]).await;
    port.silent.store(true, Ordering::Relaxed);
    for n in 0..MORE_THAN_UNANSWERED {
        let id = n.to_string();
        let get = json!({"command_id": id, "client_id": "view", "kind": "P", "from": 0, "count": 1});
        flood.publish("cs/1/variable/get", false, &get).await;
    }
    // the last one is rejected, so all slots of the viewer are taken
    let last = (MORE_THAN_UNANSWERED - 1).to_string();
    let (_, refused) = flood
        .next("reply/view", |reply| reply["command_id"] == last)
        .await;
    assert_eq!(refused["code"], "unavailable");
    let options = mqtt_options(&gateway, "panel", "operate", users.token("operate"));
    let panel = TestClient::with_options(options, &[]).await;
    let start = json!({"command_id": "start", "client_id": "panel"});
    panel.publish("cs/1/command/start", false, &start).await;
    port.asked_for(|request| is_command(request, "start")).await;
    gateway.shutdown().await;
}

#[tokio::test]
async fn each_stop_is_answered_once_and_also_the_one_that_is_refused() {
    let port = StubPort::new();
    let users = TestUsers::new();
    let gateway = start_with(&port, users.settings.clone()).await;
    let options = mqtt_options(&gateway, "panel", "operate", users.token("operate"));
    let mut panel = TestClient::with_options(options, &["reply/panel"]).await;
    for n in 0..3 {
        let id = format!("stop-{n}");
        let stop = json!({"command_id": id, "client_id": "panel"});
        panel.publish("cs/1/command/stop", false, &stop).await;
        port.asked_for(|request| is_command(request, &id)).await;
        for status in [CommandStatus::Accepted, CommandStatus::Done] {
            let reply = reply(&id, status, "ok");
            port.say(Topic::Reply("panel".into()), None, Payload::Reply(reply));
        }
        panel
            .next("reply/panel", |reply| {
                reply["command_id"] == id && reply["status"] == "accepted"
            })
            .await;
        panel
            .next("reply/panel", |reply| {
                reply["command_id"] == id && reply["status"] == "done"
            })
            .await;
    }
    tokio::time::sleep(Duration::from_millis(100)).await;
    assert_eq!(panel.here(), [], "each reply comes once");
    gateway.shutdown().await;
}

/// A PUBLISH packet of quality 2 over MQTT 3.1.1.
fn publish_2(path: &str, id: u8, payload: &str) -> Vec<u8> {
    let topic = format!("{ROOT}{path}");
    let length = u16::try_from(topic.len()).unwrap().to_be_bytes();
    packet(0x34, &[&length, topic.as_bytes(), &[0, id], payload.as_bytes()])
}

#[tokio::test]
async fn a_start_of_quality_2_takes_effect_on_arrival_and_not_at_its_release() {
    let port = StubPort::new();
    let users = TestUsers::new();
    let gateway = start_with(&port, users.settings.clone()).await;
    let options = mqtt_options(&gateway, "panel", "operate", users.token("operate"));
    let panel = TestClient::with_options(options, &["reply/panel"]).await;
    let (mut slow, _) = mqtt_as(&gateway, 4, "operate", users.token("operate")).await;
    let command = |id: &str| json!({"command_id": id, "client_id": "panel"});
    let start = publish_2("cs/1/command/start", 7, &command("start").to_string());
    slow.write_all(&start).await.unwrap();
    let mut received = [0; 4];
    within(slow.read_exact(&mut received)).await.unwrap();
    assert_eq!(received, [0x50, 2, 0, 7], "PUBREC");
    port.asked_for(|request| is_command(request, "start")).await;
    panel.publish("cs/1/command/stop", false, &command("stop")).await;
    port.asked_for(|request| is_command(request, "stop")).await;
    // neither a repetition nor PUBREL executes it again, after the stop
    slow.write_all(&start).await.unwrap();
    slow.write_all(&[0x62, 2, 0, 7]).await.unwrap();
    panel
        .publish("cs/1/command/start", false, &command("again"))
        .await;
    port.asked_for(|request| is_command(request, "again")).await;
    let asked = port.asked();
    let starts = asked.iter().filter(|request| is_command(request, "start"));
    assert_eq!(starts.count(), 1);
    gateway.shutdown().await;
}

#[tokio::test]
async fn a_stop_over_rest_is_accepted_although_64_of_another_user_wait() {
    let port = StubPort::new();
    let shared = shared(Arc::clone(&port));
    let account = |name: &str| Account::User(name.to_owned());
    let waits: Vec<_> = std::iter::from_fn(|| shared.urgent_wait(&account("anna"))).collect();
    assert_eq!(waits.len(), 16);
    assert!(shared.urgent_wait(&account("bert")).is_some());
    let stop = (
        1,
        UrgentKind::of_request(&Request::Command {
            cs: 1,
            command: Command::Stop,
            meta: plc_protocol::types::command::CommandMeta::default(),
            wait: false,
        })
        .unwrap()
        .1,
    );
    assert_eq!(stop.1, UrgentKind::Verb(Verb::Stop));
    let _slot = shared.urgent.enter(account("anna"), stop).await;
    within(shared.urgent.enter(account("bert"), stop)).await;
    drop(waits);
    assert!(shared.urgent_wait(&account("anna")).is_some());
}

#[tokio::test]
async fn without_a_login_only_hold_stop_and_abort_pass_where_allowed() {
    for is_allowed in [false, true] {
        let port = StubPort::new();
        let mut users = TestUsers::new();
        users.settings.hmi.stop_without_login = is_allowed;
        let gateway = start_with(&port, users.settings).await;
        let status = async |method: &str, path: &str| {
            let mut stream = TcpStream::connect(gateway.http_addr()).await.unwrap();
            let host = gateway.http_addr();
            let request =
                format!("{method} /api/v1{path} HTTP/1.1\r\nHost: {host}\r\nContent-Length: 0\r\n\r\n");
            stream.write_all(request.as_bytes()).await.unwrap();
            let mut head = [0; 12];
            within(stream.read_exact(&mut head)).await.unwrap();
            String::from_utf8_lossy(&head[9..]).into_owned()
        };
        let expected = if is_allowed { "202" } else { "401" };
        for verb in ["hold", "stop", "abort"] {
            assert_eq!(status("POST", &format!("/cs/1/{verb}")).await, expected, "{verb}");
        }
        for (method, path) in [
            ("POST", "/cs/1/start"),
            ("POST", "/cs/1/reset"),
            ("GET", "/cs/1/state"),
        ] {
            assert_eq!(status(method, path).await, "401", "{method} {path}");
        }
        gateway.shutdown().await;
    }
}
