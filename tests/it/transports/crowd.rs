//! Many clients at once: two that start, one that floods, and some that read nothing.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use rumqttc::{AsyncClient, Event, EventLoop, MqttOptions, NetworkOptions, Packet, QoS};
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpSocket, TcpStream};
use tokio_tungstenite::tungstenite::Message;

use super::{Reached, over_mosquitto, over_the_embedded_broker};
use crate::support::http::request_with;
use crate::support::mqtt::Bus;
use crate::support::schemas::check_frame;
use crate::support::wait::{until, within};

/// Motion of 2 s.
const MOTION: &str = "G01 X200 F6000\nM30\n";

fn command(command_id: &str, client_id: &str) -> Value {
    json!({"command_id": command_id, "client_id": client_id, "args": {}})
}

#[tokio::test]
async fn of_two_simultaneous_starts_over_mqtt_one_is_accepted_one_refused() {
    let reached = over_the_embedded_broker().await;
    let served = reached.served();
    let hmis = [
        Bus::connect(&served.broker, "test-1").await,
        Bus::connect(&served.broker, "test-1").await,
    ];
    served.load(1, 60, "M100\nM30\n").await;
    let (one, two) = (command("one", "hmi-1"), command("two", "hmi-2"));
    tokio::join!(
        hmis[0].publish("cs/1/command/start", &one),
        hmis[1].publish("cs/1/command/start", &two)
    );
    let replies = tokio::join!(hmis[0].reply("hmi-1", "one"), hmis[1].reply("hmi-2", "two"));
    let mut said = [&replies.0, &replies.1].map(|reply| reply["status"].as_str().unwrap());
    said.sort_unstable();
    assert_eq!(said, ["done", "rejected"]);
    let refused = [&replies.0, &replies.1]
        .into_iter()
        .find(|reply| reply["status"] == "rejected");
    assert_eq!(refused.unwrap()["code"], "not_allowed");
    served.execution(1, "WAIT").await;
    let outputs = served.get("/cs/1/m_codes").await.expect(200).json()["outputs"].clone();
    assert_eq!(outputs.as_array().unwrap().len(), 1, "{outputs}");
}

#[tokio::test]
async fn of_two_starts_with_the_same_etag_one_gets_precondition_failed() {
    let reached = over_the_embedded_broker().await;
    let served = reached.served();
    served.load(1, 60, "M100\nM30\n").await;
    let seen = served.get("/cs/1/state").await.expect(200);
    let if_match = format!("If-Match: {}\r\n", seen.header("etag").unwrap());
    let start = async || {
        let path = "/api/v1/cs/1/start?wait=1";
        request_with(&served.http, "POST", path, "", "", &if_match).await
    };
    let answers = tokio::join!(start(), start());
    let mut statuses = [answers.0.status, answers.1.status];
    statuses.sort_unstable();
    assert_eq!(statuses, [200, 412], "{answers:?}");
    let refused = [&answers.0, &answers.1]
        .into_iter()
        .find(|answer| answer.status == 412);
    assert_eq!(refused.unwrap().json()["code"], "precondition_failed");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn each_command_of_a_flood_is_refused_once_and_a_stop_passes_it() {
    const FLOOD: usize = 1000;
    let reached = over_the_embedded_broker().await;
    let served = reached.served();
    let flood = Bus::connect(&served.broker, "test-1").await;
    let panel = Bus::connect(&served.broker, "test-1").await;
    served.load(1, 60, "G01 X250 F600\nM30\n").await;
    served.command(1, "start").await;
    let stop = async {
        until("the flood", async || {
            (panel.history.on("reply/flood").len() > FLOOD / 10).then_some(())
        })
        .await;
        panel
            .publish("cs/1/command/stop", &command("stop", "panel"))
            .await;
        assert_eq!(panel.reply("panel", "stop").await["status"], "done");
        panel.history.on("reply/flood").len()
    };
    let flooding = async {
        for number in 0..FLOOD {
            let resume = command(&format!("flood-{number}"), "flood");
            flood.publish("cs/1/command/resume", &resume).await;
        }
    };
    let ((), _) = tokio::join!(flooding, stop);
    let replies = until("a reply to each", async || {
        let replies = panel.history.on("reply/flood");
        (replies.len() >= FLOOD).then_some(replies)
    })
    .await;
    let mut ids: Vec<_> = replies
        .iter()
        .map(|reply| reply["command_id"].to_string())
        .collect();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!((replies.len(), ids.len()), (FLOOD, FLOOD));
    assert!(replies.iter().all(|reply| reply["status"] == "rejected"));
    let state = served.state(1).await;
    assert_eq!(
        (&state["execution"], &state["reason"]),
        (&json!("STOPPED"), &json!("STOP"))
    );
}

/// A client with an id and the smallest buffer that its system allows, subscribed to a topic.
async fn subscribed(broker: &str, id: &str, topic: &str, buffer_bytes: u32) -> (AsyncClient, EventLoop) {
    let (host, port) = broker.rsplit_once(':').unwrap();
    let mut options = MqttOptions::new(id, host, port.parse().unwrap());
    options
        .set_max_packet_size(1 << 20, 1 << 20)
        .set_keep_alive(Duration::from_mins(1));
    let (client, mut events) = AsyncClient::new(options, 64);
    let mut network = NetworkOptions::new();
    network.set_tcp_recv_buffer_size(buffer_bytes);
    events.set_network_options(network);
    let topic = format!("tandem/v1/test-1/{topic}");
    client.subscribe(topic, QoS::AtLeastOnce).await.unwrap();
    let subscribed =
        async { while !matches!(events.poll().await.unwrap(), Event::Incoming(Packet::SubAck(_))) {} };
    within("a subscription", subscribed).await;
    (client, events)
}

/// Megabytes are sent to an MQTT subscriber and to a WebSocket that do not read, while the machine moves.
async fn who_reads_nothing_holds_up_neither_motion_nor_others(reached: &Reached, broker: &str) {
    const ASKED: usize = 400;
    let served = reached.served();
    let _silent = subscribed(broker, "silent", "#", 4096).await;
    let socket = TcpSocket::new_v4().unwrap();
    socket.set_recv_buffer_size(4096).unwrap();
    let stream = socket.connect(served.http.parse().unwrap()).await.unwrap();
    let url = format!("ws://{}/api/v1/ws", served.http);
    let (mut silent_socket, _) = tokio_tungstenite::client_async(url, stream).await.unwrap();
    let ask = json!({"subscribe": ["#"]}).to_string();
    silent_socket.send(Message::text(ask)).await.unwrap();

    let values = json!({"values": vec![0.123_456_789_012_345; 1024]});
    served.put("/variables/p?from=100", &values).await.expect(204);
    served.load(1, 60, MOTION).await;
    served.command(1, "start").await;
    let (client, mut events) = subscribed(broker, "asker", "reply/asker", 1 << 20).await;
    let answered = Arc::new(AtomicUsize::new(0));
    let counted = Arc::clone(&answered);
    let reading = tokio::spawn(async move {
        while let Ok(event) = events.poll().await {
            if let Event::Incoming(Packet::Publish(reply)) = event {
                assert!(reply.payload.len() > 10_000, "1024 values");
                counted.fetch_add(1, Ordering::Relaxed);
            }
        }
    });
    for number in 0..ASKED {
        let get = json!({"command_id": format!("get-{number}"), "client_id": "asker", "kind": "P", "from": 100,
            "count": 1024});
        let topic = "tandem/v1/test-1/cs/1/variable/get";
        client
            .publish(topic, QoS::AtLeastOnce, false, get.to_string())
            .await
            .unwrap();
    }
    until("an answer to each", async || {
        (answered.load(Ordering::Relaxed) >= ASKED).then_some(())
    })
    .await;
    served.execution(1, "PROGRAM_COMPLETED").await;
    assert_eq!(answered.load(Ordering::Relaxed), ASKED);
    reading.abort();
    // when it reads again, it reaches the latest state
    let latest = async {
        while let Some(Ok(frame)) = silent_socket.next().await {
            let Message::Text(said) = frame else { continue };
            let said: Value = serde_json::from_str(&said).unwrap();
            assert_eq!(check_frame(&said), Ok(()));
            if said["topic"] == "cs/1/state" && said["execution"] == "PROGRAM_COMPLETED" {
                return;
            }
        }
        panic!("the WebSocket was closed");
    };
    within("the latest state", latest).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn embedded_broker_client_that_reads_nothing_delays_no_motion_or_client() {
    let reached = over_the_embedded_broker().await;
    let broker = reached.served().broker.clone();
    who_reads_nothing_holds_up_neither_motion_nor_others(&reached, &broker).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn over_mosquitto_who_reads_nothing_holds_up_neither_motion_nor_others() {
    let (reached, broker) = over_mosquitto().await;
    who_reads_nothing_holds_up_neither_motion_nor_others(&reached, &broker.address()).await;
}

/// Returns whether a broker accepts a client, with or without a session that outlives the connection.
async fn is_let_in(broker: &str, id: u16, outlives: bool) -> bool {
    // MQTT 3.1.1, a minute of keep-alive, a client id of four letters
    let mut connect = b"\x10\x10\x00\x04MQTT\x04\x02\x00\x3c\x00\x04".to_vec();
    connect[9] = if outlives { 0 } else { 2 };
    connect.extend(format!("{id:04}").bytes());
    let mut stream = TcpStream::connect(broker).await.unwrap();
    let mut answer = [0; 4];
    let asked = async {
        stream.write_all(&connect).await?;
        stream.read_exact(&mut answer).await
    };
    within("an answer", asked).await.is_ok() && (answer[0], answer[3]) == (0x20, 0)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn silent_mqtt_connections_are_evicted_and_exclude_no_client() {
    let reached = over_the_embedded_broker().await;
    let served = reached.served();
    let panel = Bus::connect(&served.broker, "test-1").await;
    let mut silent = Vec::new();
    for n in 0..10 {
        for _ in 0..100 {
            silent.push(TcpStream::connect(&served.broker).await.unwrap());
        }
        let let_in = is_let_in(&served.broker, 1, false).await;
        assert!(let_in, "with {} silent connections", 100 * (n + 1));
    }
    let is_gone = |stream: &&TcpStream| {
        let read = stream.try_read(&mut [0]);
        !matches!(read, Err(error) if error.kind() == std::io::ErrorKind::WouldBlock)
    };
    let gone = async {
        while silent.iter().filter(is_gone).count() < 1000 - 192 {
            tokio::time::sleep(std::time::Duration::from_millis(10)).await;
        }
    };
    within(
        "all but the connections that there is room for have given way",
        gone,
    )
    .await;
    panel.publish("cs/1/override/set", &json!({"feed": 55})).await;
    let feed = panel
        .history
        .find("cs/1/override/state", |value| value["feed"] == 55.0);
    within("the override of a client that was there", feed).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn mqtt_sessions_that_outlive_their_connections_are_bounded() {
    let reached = over_the_embedded_broker().await;
    let broker = &reached.served().broker;
    let mut taken = 0;
    while is_let_in(broker, taken, true).await {
        taken += 1;
        assert!(taken < 300, "{taken} sessions wait for their clients");
    }
    assert!(taken >= 32, "only {taken} sessions");
    assert!(is_let_in(broker, 0, true).await, "one that is known comes back");
    assert!(is_let_in(broker, taken, false).await, "a clean session is taken");
}
