//! Clients of the broker that do not read.

use axum::body::Bytes;
use mqtt5::broker::storage::StorageBackend as _;
use plc_protocol::types::command::Verb;
use serde_json::json;
use tokio::time::Instant;

use super::*;

/// A publisher or a subscriber that speaks in bytes, over MQTT 5.
struct RawClient(TcpStream);

impl RawClient {
    async fn connect(gateway: &Gateway) -> Self {
        let (stream, answer) = mqtt_as(gateway, 5, "", "").await;
        assert_eq!(answer, [0x20, 0]);
        Self(stream)
    }

    async fn send(&mut self, kind: u8, body: &[&[u8]]) {
        self.0.write_all(&packet(kind, body)).await.unwrap();
    }

    /// Subscribes, and reads nothing from then on.
    async fn unresponsive(gateway: &Gateway, filter: &str) -> Self {
        let mut raw = Self::connect(gateway).await;
        let length = u16::try_from(filter.len()).unwrap().to_be_bytes();
        raw.send(0x82, &[&[0, 1, 0], &length, filter.as_bytes(), &[1]])
            .await;
        assert_eq!(raw.answer().await[0], 0x90);
        raw
    }

    async fn answer(&mut self) -> Vec<u8> {
        let mut head = [0; 2];
        within(self.0.read_exact(&mut head)).await.unwrap();
        let mut body = vec![0; head[1].into()];
        within(self.0.read_exact(&mut body)).await.unwrap();
        [&head[..], &body].concat()
    }

    /// Publishes with quality 1, and returns the answer and the time until then.
    async fn publish(&mut self, payload: &[u8]) -> (Vec<u8>, Duration) {
        let begun = Instant::now();
        (self.publish_on("plant", payload).await, begun.elapsed())
    }

    async fn publish_on(&mut self, topic: &str, payload: &[u8]) -> Vec<u8> {
        let length = u16::try_from(topic.len()).unwrap().to_be_bytes();
        self.send(0x32, &[&length, topic.as_bytes(), &[0, 7, 0], payload])
            .await;
        self.answer().await
    }
}

#[tokio::test]
async fn a_subscriber_that_takes_nothing_holds_up_nobody_who_publishes() {
    let gateway = start(&StubPort::new()).await;
    let _deaf = RawClient::unresponsive(&gateway, "#").await;
    let mut publisher = RawClient::connect(&gateway).await;
    let mut longest = Duration::ZERO;
    // far more than the connection and the queue can hold
    for _ in 0..600 {
        let (answer, time) = publisher.publish(&vec![b'x'; 50_000]).await;
        assert_eq!(answer, [0x40, 2, 0, 7]);
        longest = longest.max(time);
    }
    // 2 s before a message goes into a queue would be the library's own limit
    assert!(longest < Duration::from_millis(1500), "{longest:?}");
    gateway.shutdown().await;
}

#[tokio::test]
async fn message_memory_limit_closes_non_reading_clients_and_keeps_the_rest() {
    let gateway = start(&StubPort::new()).await;
    let mut deaf = RawClient::unresponsive(&gateway, "plant").await;
    let mut publisher = RawClient::connect(&gateway).await;
    let large = vec![b'x'; 1_000_000];
    let mut count = 0;
    let refused = loop {
        let (answer, _) = publisher.publish(&large).await;
        if answer != [0x40, 2, 0, 7] {
            break answer;
        }
        count += 1;
        assert!(count < 100, "64 MiB are the limit");
    };
    // MQTT 5 section 3.4.2.1: 0x97, quota exceeded
    assert_eq!(refused, [0x40, 3, 0, 7, 0x97]);
    assert!(count > 50, "{count}");
    let begun = Instant::now();
    while publisher.publish(&large).await.0.len() > 4 {
        assert!(
            begun.elapsed() < Duration::from_secs(8),
            "it is closed within a second or two"
        );
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let mut rest = Vec::new();
    within(deaf.0.read_to_end(&mut rest)).await.ok();
    for _ in 0..100 {
        assert_eq!(publisher.publish(&large).await.0, [0x40, 2, 0, 7]);
    }
    gateway.shutdown().await;
}

#[tokio::test]
async fn where_memory_for_messages_has_run_out_what_brings_to_rest_is_taken() {
    let port = StubPort::new();
    let gateway = start(&port).await;
    let mut publisher = RawClient::connect(&gateway).await;
    let exchange = gateway.broker.as_ref().unwrap().exchange();
    let on_the_way = exchange.count(Bytes::from(vec![0; 64 * 1024 * 1024]));
    let command = |verb: &str| (format!("tandem/v1/mill-1/cs/1/command/{verb}"), verb.to_owned());
    for ((topic, id), is_taken) in [
        (command("start"), false),
        (command("hold"), true),
        (command("stop"), true),
        (command("abort"), true),
    ] {
        let said = json!({"command_id": id, "client_id": "panel"}).to_string();
        let answer = publisher.publish_on(&topic, said.as_bytes()).await;
        let taken: &[u8] = &[0x40, 2, 0, 7];
        let refused: &[u8] = &[0x40, 3, 0, 7, 0x97];
        assert_eq!(answer, if is_taken { taken } else { refused }, "{id}");
    }
    port.asked_for(
        |request| matches!(request, Request::Command { command, .. } if command.verb() == Verb::Abort),
    )
    .await;
    drop(on_the_way);
    gateway.shutdown().await;
}

#[tokio::test]
async fn message_of_quality_2_is_delivered_at_once_and_waits_for_no_release() {
    let gateway = start(&StubPort::new()).await;
    let mut reader = RawClient::connect(&gateway).await;
    reader.send(0x82, &[&[0, 1, 0, 0, 5], b"plant", &[0]]).await;
    assert_eq!(reader.answer().await[0], 0x90);
    let mut publisher = RawClient::connect(&gateway).await;
    // DUP does not matter: the packet id tells a repetition
    for (kind, id, payload) in [(0x34, 7, b"a"), (0x3c, 7, b"a"), (0x34, 8, b"b")] {
        publisher
            .send(kind, &[&[0, 5], b"plant", &[0, id, 0], payload])
            .await;
        assert_eq!(publisher.answer().await, [0x50, 2, 0, id]);
    }
    publisher.send(0x62, &[&[0, 7]]).await;
    assert_eq!(publisher.answer().await, [0x70, 2, 0, 7]);
    publisher.send(0x34, &[&[0, 5], b"plant", &[0, 7, 0], b"c"]).await;
    assert_eq!(publisher.answer().await, [0x50, 2, 0, 7]);
    for payload in [b'a', b'b', b'c'] {
        let message = reader.answer().await;
        assert_eq!((message[0], message.last()), (0x30, Some(&payload)));
    }
    gateway.shutdown().await;
}

#[tokio::test]
async fn unacknowledged_copies_end_with_a_session_that_ends_with_its_connection() {
    let gateway = start(&StubPort::new()).await;
    let storage = gateway.broker.as_ref().unwrap().storage();
    let mut publisher = RawClient::connect(&gateway).await;
    let deaf = RawClient::unresponsive(&gateway, "plant").await;
    assert_eq!(publisher.publish(b"x").await.0, [0x40, 2, 0, 7]);
    let copies = async || {
        let mut count = 0;
        for n in 0..2000 {
            let of_client = storage.get_inflight_messages(&format!("raw-{n}")).await;
            count += of_client.unwrap().len();
        }
        count
    };
    within(async {
        while copies().await == 0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    })
    .await;
    drop(deaf);
    within(async {
        while copies().await > 0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    })
    .await;
    gateway.shutdown().await;
}

#[tokio::test]
async fn message_with_large_properties_is_refused_and_its_client_stays() {
    let gateway = start(&StubPort::new()).await;
    let mut publisher = RawClient::connect(&gateway).await;
    // one user property: name of 1 byte, value of this size
    for (size, answer) in [(4000_u16, &[0x40, 2, 0, 7][..]), (5000, &[0x40, 3, 0, 7, 0x97])] {
        let value = vec![b'v'; size.into()];
        let bytes = size + 6;
        let length = [
            u8::try_from(bytes % 128).unwrap() | 0x80,
            u8::try_from(bytes / 128).unwrap(),
        ];
        let name = [0x26, 0, 1, b'n'];
        publisher
            .send(
                0x32,
                &[
                    &[0, 5],
                    b"plant",
                    &[0, 7],
                    &length,
                    &name,
                    &size.to_be_bytes(),
                    &value,
                    b"x",
                ],
            )
            .await;
        assert_eq!(publisher.answer().await, answer, "{size}");
    }
    gateway.shutdown().await;
}
