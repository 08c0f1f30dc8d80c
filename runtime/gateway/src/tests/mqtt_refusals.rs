//! Rejected MQTT messages.

use plc_protocol::types::request::Input;
use rumqttc::{LastWill, QoS};
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};

use super::mqtt::{ROOT, TestClient};
use super::*;

/// Returns a gateway with a connected MQTT task, and a client that reads its replies.
async fn connected(port: &Arc<StubPort>) -> (Gateway, TestClient) {
    let gateway = start(port).await;
    let filters = ["presence", "reply/hmi"];
    let mut client = TestClient::connect(gateway.mqtt_addr().unwrap(), "hmi", &filters).await;
    client.next("presence", |value| value["online"] == true).await;
    (gateway, client)
}

#[tokio::test]
async fn a_malformed_or_unknown_command_is_rejected_with_a_reply() {
    let port = StubPort::new();
    let (gateway, mut client) = connected(&port).await;
    for (verb, args, code) in [
        ("load", Value::Null, "invalid"),
        ("jump", Value::Null, "invalid"),
        ("jog", json!({"axis": "X"}), "invalid"),
        ("mdi", json!({"text": ""}), "invalid"),
        ("back_trace", json!({"on": "yes"}), "invalid"),
    ] {
        let command = json!({"command_id": verb, "client_id": "hmi", "args": args});
        client
            .publish(&format!("cs/1/command/{verb}"), false, &command)
            .await;
        let (_, reply) = client.next("reply/hmi", |_| true).await;
        assert_eq!(
            (&reply["command_id"], &reply["code"]),
            (&json!(verb), &json!(code))
        );
        assert_eq!(
            (&reply["status"], &reply["state_rev"]),
            (&json!("rejected"), &json!(12))
        );
    }
    let get = json!({"command_id": "v", "client_id": "hmi", "kind": "L", "from": 0, "count": 1});
    client.publish("cs/1/variable/get", false, &get).await;
    let (_, reply) = client.next("reply/hmi", |_| true).await;
    assert_eq!(
        (&reply["command_id"], &reply["code"]),
        (&json!("v"), &json!("invalid"))
    );
    assert_eq!(port.asked(), []);
    gateway.shutdown().await;
}

#[tokio::test]
async fn unanswerable_invalid_message_is_dropped_and_the_next_one_is_accepted() {
    let port = StubPort::new();
    let (gateway, client) = connected(&port).await;
    client
        .publish("cs/1/command/start", false, &json!("no object"))
        .await;
    client
        .publish("cs/1/m_code/5/claim", false, &json!({"seq": 1}))
        .await;
    client
        .publish("motor/1/skip_input/set", false, &json!({"on": true}))
        .await;
    client.publish("cs/1/tool/set", false, &json!({"id": 4})).await;
    port.asked_for(|request| *request == Request::Tool(1, 4)).await;
    assert_eq!(port.asked().len(), 1);
    gateway.shutdown().await;
}

#[tokio::test]
async fn invalid_claim_or_reset_is_answered_with_a_result_and_its_reason() {
    let port = StubPort::with(|request| match request {
        Request::Reset(..) => {
            let code = plc_protocol::types::request::RefusalCode::Invalid;
            Err(Refusal::new(code, "code 12000: write 0 to 9999"))
        }
        _ => Ok(Answer::Done),
    });
    let gateway = start(&port).await;
    let filters = ["presence", "cs/1/m_code/5/result"];
    let mut client = TestClient::connect(gateway.mqtt_addr().unwrap(), "hmi", &filters).await;
    client.next("presence", |value| value["online"] == true).await;
    let fault = |seq: u64, code: Value| json!({"boot_id": "boot-1", "seq": seq, "handler_id": "clamp", "result": "fault", "code": code, "text": "x"});
    for (path, said, why) in [
        ("reset", fault(1, json!(12_000)), "9999"),
        ("reset", fault(2, json!(-1)), "`-1`"),
        ("reset", fault(3, json!(5_000_000_000_u64)), "`5000000000`"),
        ("claim", json!({"seq": 4, "handler_id": "clamp"}), "boot_id"),
    ] {
        client
            .publish(&format!("cs/1/m_code/5/{path}"), false, &said)
            .await;
        let (_, result) = client.next("cs/1/m_code/5/result", |_| true).await;
        assert_eq!(
            (&result["seq"], &result["handler_id"], &result["status"]),
            (&said["seq"], &said["handler_id"], &json!("refused"))
        );
        let text = result["text"].as_str().unwrap();
        assert!(text.contains(why), "{text}");
    }
    gateway.shutdown().await;
}

#[tokio::test]
async fn nobody_is_told_a_refusal_in_the_name_of_another() {
    let users = TestUsers::new();
    let user = |name: &str| {
        crate::access::User::clone(
            &users
                .settings
                .tokens
                .as_ref()
                .unwrap()
                .user_of(users.token(name).as_bytes())
                .unwrap(),
        )
    };
    let may = |name: &str, handler_id: &str| {
        crate::access::rules::may_speak_as(&user(name), plc_protocol::wire::right::Right::Reset, handler_id)
    };
    assert!(may("handler", "handler") && may("operate", "handler") && may("admin", "x"));
    assert!(!may("handler", "other") && !may("view", "view"));
}

#[tokio::test]
async fn the_embedded_broker_refuses_a_retained_command_outright() {
    let port = StubPort::new();
    let (gateway, mut client) = connected(&port).await;
    let command = json!({"command_id": "c1", "client_id": "hmi"});
    client.publish("cs/1/command/start", true, &command).await;
    let (_, reply) = client.next("reply/hmi", |_| true).await;
    assert_eq!(
        (&reply["status"], &reply["code"]),
        (&json!("rejected"), &json!("retained"))
    );
    client
        .publish("cs/1/input/dry_run/set", true, &json!({"value": true}))
        .await;
    client
        .publish("cs/1/input/dry_run/set", false, &json!({"value": false}))
        .await;
    port.asked_for(|request| *request == Request::Input(1, Input::DryRun(false)))
        .await;
    let (asked, warnings) = (port.asked(), port.warnings());
    assert!(matches!(&asked[..], [Request::Input(..)]), "{asked:?}");
    assert!(
        matches!(&warnings[..], [text] if text.contains("command c1 of hmi")),
        "{warnings:?}"
    );
    let filters = ["cs/1/command/#", "cs/1/input/dry_run/set", "presence"];
    let mut late = TestClient::connect(gateway.mqtt_addr().unwrap(), "late", &filters).await;
    late.next("presence", |_| true).await;
    assert_eq!(late.here(), [], "the broker kept none of them");
    gateway.shutdown().await;
}

/// A client that sends raw bytes.
struct RawConnection {
    stream: tokio::net::TcpStream,
    version: u8,
}

impl RawConnection {
    async fn connect(gateway: &Gateway, version: u8) -> Self {
        let stream = tokio::net::TcpStream::connect(gateway.mqtt_addr().unwrap())
            .await
            .unwrap();
        let mut raw = Self { stream, version };
        // clean session, keep-alive 60 s
        let id = format!("raw-{version}");
        let length = u8::try_from(id.len()).unwrap();
        let properties = raw.properties();
        raw.send(
            0x10,
            &[
                b"\0\x04MQTT",
                &[version, 2, 0, 60],
                properties,
                &[0, length],
                id.as_bytes(),
            ],
        )
        .await;
        assert_eq!(raw.answer().await[0], 0x20);
        raw
    }

    fn properties(&self) -> &'static [u8] {
        if self.version == 5 { &[0] } else { &[] }
    }

    async fn send(&mut self, kind: u8, body: &[&[u8]]) {
        self.stream.write_all(&packet(kind, body)).await.unwrap();
    }

    async fn answer(&mut self) -> Vec<u8> {
        let mut head = [0; 2];
        within(self.stream.read_exact(&mut head)).await.unwrap();
        let mut body = vec![0; head[1].into()];
        within(self.stream.read_exact(&mut body)).await.unwrap();
        [&head[..], &body].concat()
    }

    /// Returns the broker's answer to a message with packet id 7.
    async fn publish(&mut self, topic: &str, qos: u8, retain: bool, payload: &[u8]) -> Vec<u8> {
        let length = u16::try_from(topic.len()).unwrap().to_be_bytes();
        let properties = self.properties();
        let flags = qos << 1 | u8::from(retain);
        self.send(
            0x30 | flags,
            &[&length, topic.as_bytes(), &[0, 7], properties, payload],
        )
        .await;
        self.answer().await
    }
}

/// Returns the broker's answer, byte for byte, to a client of this protocol version that publishes a state with this
/// quality of service.
async fn answer_to_a_published_state(gateway: &Gateway, version: u8, qos: u8) -> Vec<u8> {
    let mut raw = RawConnection::connect(gateway, version).await;
    raw.publish(&format!("{ROOT}cs/1/state"), qos, false, b"{}").await
}

#[tokio::test]
async fn retained_message_over_limit_is_refused_with_reason_presences_pass() {
    let port = StubPort::new();
    let gateway = start(&port).await;
    let mut new = RawConnection::connect(&gateway, 5).await;
    let large = vec![b'x'; 255 * 1024];
    let mut kept = 0;
    while new.publish(&format!("plant/{kept}"), 1, true, &large).await == [0x40, 2, 0, 7] {
        kept += 1;
    }
    assert_eq!(kept, 128, "32 MiB");
    // MQTT 5 sections 3.4.2.1 and 3.5.2.1: 0x97, quota exceeded
    assert_eq!(
        new.publish("plant/new", 1, true, &large).await,
        [0x40, 3, 0, 7, 0x97]
    );
    assert_eq!(
        new.publish("plant/new", 2, true, &large).await,
        [0x50, 3, 0, 7, 0x97]
    );
    assert_eq!(new.publish("plant/new", 1, false, &large).await, [0x40, 2, 0, 7]);
    let mut old = RawConnection::connect(&gateway, 4).await;
    assert_eq!(old.publish("plant/new", 1, true, &large).await, [0x40, 2, 0, 7]);
    let told = || {
        let told = port.notices.lock().unwrap();
        let last = told.iter().rev().find_map(|notice| match notice {
            ServerNotice::NotRetained(text) => Some(text.clone()),
            _ => None,
        });
        last.flatten()
    };
    // a client of MQTT 3.1.1 gets no other notification
    let stands = told().unwrap();
    assert!(
        stands.contains("plant/128 of raw-5") && stands.contains("32 MiB"),
        "{stands}"
    );
    let presence = format!("{ROOT}handler/arm/presence");
    let online = br#"{"online":true,"handles":[]}"#;
    assert_eq!(new.publish(&presence, 1, true, online).await, [0x40, 2, 0, 7]);
    port.say_dry_run(7, true);
    let filters = ["handler/arm/presence", "cs/1/input/dry_run/state", "presence"];
    let mut late = TestClient::connect(gateway.mqtt_addr().unwrap(), "late", &filters).await;
    late.next("handler/arm/presence", |value| value["online"] == true)
        .await;
    late.next("cs/1/input/dry_run/state", |value| value["value"] == true)
        .await;
    // clearing a topic makes room
    assert_eq!(new.publish("plant/0", 1, true, b"").await[0], 0x40);
    assert_eq!(told(), None, "the warning ends when there is room again");
    assert_eq!(new.publish("plant/new", 1, true, &large).await, [0x40, 2, 0, 7]);
    gateway.shutdown().await;
}

#[tokio::test]
async fn a_refused_message_is_acknowledged_in_the_words_of_the_clients_version() {
    let gateway = start(&StubPort::new()).await;
    for (qos, kind) in [(1, 0x40), (2, 0x50)] {
        // MQTT 3.1.1 sections 3.4 and 3.5: two bytes follow, the packet identifier
        let old = within(answer_to_a_published_state(&gateway, 4, qos)).await;
        assert_eq!(old, [kind, 2, 0, 7]);
        // MQTT 5 section 3.4.2.1: 0x87, not authorized
        let new = within(answer_to_a_published_state(&gateway, 5, qos)).await;
        assert_eq!((new[0], &new[2..5]), (kind, &[0, 7, 0x87][..]));
    }
    let filters = ["presence", "cs/1/state"];
    let mut reader = TestClient::connect(gateway.mqtt_addr().unwrap(), "reader", &filters).await;
    reader.next("presence", |_| true).await;
    assert!(!reader.here().iter().any(|publish| &publish.payload[..] == b"{}"));
    gateway.shutdown().await;
}

#[tokio::test]
async fn a_client_whose_will_is_a_command_is_not_let_in() {
    let gateway = start(&StubPort::new()).await;
    let address = gateway.mqtt_addr().unwrap();
    for (path, payload, retain, is_let_in) in [
        ("cs/1/command/start", "{}", true, false),
        ("cs/1/command/start", "{}", false, false),
        ("cs/1/m_code/7/reset", "{}", false, false),
        ("cs/1/input/dry_run/set", "{}", false, false),
        ("handler/arm/presence", r#"{"online": false}"#, true, true),
        ("handler/arm/presence", r#"{"online": true}"#, true, false),
        (
            "handler/arm/presence",
            r#"{"online": false, "returns_within_ms": 60000}"#,
            true,
            false,
        ),
        ("handler/arm/presence", "{}", true, false),
        ("handler/arm/presence", "", true, false),
        ("client/arm/heartbeat", r#"{"ttl_ms": 500}"#, false, false),
    ] {
        let mut options = rumqttc::MqttOptions::new("hmi", address.ip().to_string(), address.port());
        options.set_last_will(LastWill::new(
            format!("{ROOT}{path}"),
            payload,
            QoS::AtLeastOnce,
            retain,
        ));
        let (_client, mut eventloop) = rumqttc::AsyncClient::new(options, 8);
        assert_eq!(
            within(eventloop.poll()).await.is_ok(),
            is_let_in,
            "{path} {payload}, retain {retain}"
        );
    }
    gateway.shutdown().await;
}

#[tokio::test]
async fn a_port_that_answers_slowly_holds_up_no_stop() {
    let port = StubPort::new();
    let (gateway, client) = connected(&port).await;
    port.silent.store(true, std::sync::atomic::Ordering::Relaxed);
    for number in 0..300 {
        let command = json!({"command_id": format!("c{number}"), "client_id": "other"});
        client.publish("cs/1/command/start", false, &command).await;
    }
    let stop = json!({"command_id": "stop", "client_id": "hmi"});
    client.publish("cs/1/command/stop", false, &stop).await;
    port.asked_for(|request| matches!(request, Request::Command { meta, .. } if meta.command_id == "stop"))
        .await;
    // 256 unanswered starts are the limit; the others were rejected, the stop passed them
    assert_eq!(port.asked().len(), 256 + 1);
    gateway.shutdown().await;
}

#[tokio::test]
async fn a_message_that_no_broker_takes_holds_up_no_other() {
    let port = StubPort::new();
    let (gateway, mut client) = connected(&port).await;
    let done = || {
        Payload::Reply(reply(
            "c",
            plc_protocol::types::command::CommandStatus::Done,
            "ok",
        ))
    };
    port.say(Topic::Reply("a#".into()), None, done());
    let large = State {
        run_id: Some("r".repeat(300_000)),
        ..State::default()
    };
    port.say(Topic::cs(1, CsTopic::State), Some(13), Payload::State(large));
    port.say(Topic::Reply("hmi".into()), None, done());
    client.next("reply/hmi", |value| value["status"] == "done").await;
    gateway.shutdown().await;
}
