//! What comes in over MQTT and is refused.

use plc_api::types::request::Input;
use rumqttc::{LastWill, QoS};
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};

use super::mqtt::{Client, ROOT};
use super::*;

/// A gateway whose MQTT end is connected, and a client that reads its replies.
async fn connected(port: &Arc<StubPort>) -> (Gateway, Client) {
    let gateway = start(port).await;
    let filters = ["presence", "reply/hmi"];
    let mut client = Client::connect(gateway.mqtt_addr().unwrap(), "hmi", &filters).await;
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
async fn a_message_that_nobody_can_be_told_about_is_dropped_and_the_next_one_counts() {
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
    let mut late = Client::connect(gateway.mqtt_addr().unwrap(), "late", &filters).await;
    late.next("presence", |_| true).await;
    assert_eq!(late.here(), [], "the broker kept none of them");
    gateway.shutdown().await;
}

/// What the broker answers, byte for byte, to a client of this protocol version that publishes a state with this
/// quality of service.
async fn answer_to_a_published_state(gateway: &Gateway, version: u8, qos: u8) -> Vec<u8> {
    let mut stream = tokio::net::TcpStream::connect(gateway.mqtt_addr().unwrap())
        .await
        .unwrap();
    let properties: &[u8] = if version == 5 { &[0] } else { &[] };
    let packet = |kind: u8, body: &[&[u8]]| {
        let body = body.concat();
        [&[kind, u8::try_from(body.len()).unwrap()], &body[..]].concat()
    };
    // clean session, keep-alive 60 s, client id "raw"
    let connect = packet(
        0x10,
        &[b"\0\x04MQTT", &[version, 2, 0, 60], properties, b"\0\x03raw"],
    );
    stream.write_all(&connect).await.unwrap();
    let mut acknowledged = [0; 2];
    stream.read_exact(&mut acknowledged).await.unwrap();
    assert_eq!(acknowledged[0], 0x20);
    stream
        .read_exact(&mut vec![0; acknowledged[1].into()])
        .await
        .unwrap();
    let topic = format!("{ROOT}cs/1/state");
    let length = u16::try_from(topic.len()).unwrap().to_be_bytes();
    let publish = packet(
        0x30 | qos << 1,
        &[&length, topic.as_bytes(), &[0, 7], properties, b"{}"],
    );
    stream.write_all(&publish).await.unwrap();
    let mut head = [0; 2];
    stream.read_exact(&mut head).await.unwrap();
    let mut body = vec![0; head[1].into()];
    stream.read_exact(&mut body).await.unwrap();
    [&head[..], &body].concat()
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
    let mut reader = Client::connect(gateway.mqtt_addr().unwrap(), "reader", &filters).await;
    reader.next("presence", |_| true).await;
    assert!(!reader.here().iter().any(|publish| &publish.payload[..] == b"{}"));
    gateway.shutdown().await;
}

#[tokio::test]
async fn a_client_whose_will_is_a_command_is_not_let_in() {
    let gateway = start(&StubPort::new()).await;
    let address = gateway.mqtt_addr().unwrap();
    for (path, retain, is_let_in) in [
        ("cs/1/command/start", true, false),
        ("cs/1/command/start", false, false),
        ("cs/1/m_code/7/reset", false, false),
        ("cs/1/input/dry_run/set", false, false),
        ("handler/arm/presence", true, true),
    ] {
        let mut options = rumqttc::MqttOptions::new("hmi", address.ip().to_string(), address.port());
        options.set_last_will(LastWill::new(
            format!("{ROOT}{path}"),
            "{}",
            QoS::AtLeastOnce,
            retain,
        ));
        let (_client, mut eventloop) = rumqttc::AsyncClient::new(options, 8);
        assert_eq!(
            within(eventloop.poll()).await.is_ok(),
            is_let_in,
            "{path}, retain {retain}"
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
    let done = || Payload::Reply(reply("c", plc_api::types::command::CommandStatus::Done, "ok"));
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
