//! Hold, stop and abort over MQTT with each quality of service, under a flood of every inbound topic by every role. With
//! `TANDEM_LONG` 1,000 attempts within 250 ms each.

#![allow(clippy::print_stdout, reason = "it reports what was measured")]

use std::process::Command;
use std::time::{Duration, Instant};

use rumqttc::{AsyncClient, Event, EventLoop, MqttOptions, Packet, QoS};
use serde_json::{Value, json};
use tokio::task::JoinSet;

use crate::support::binary::tandem;
use crate::support::machine::Machine;
use crate::support::served::{FREE_PORTS, Served};

const ROLES: [&str; 4] = ["view", "operate", "handler", "admin"];
const VERBS: [&str; 3] = ["hold", "stop", "abort"];
const QUALITIES: [QoS; 3] = [QoS::AtMostOnce, QoS::AtLeastOnce, QoS::ExactlyOnce];

/// Longest time until a request is accepted.
const ACCEPTED_MAX: Duration = Duration::from_millis(250);

/// A reply that takes longer is lost. Reason: other tests share the processors; a message in a full queue would never be answered.
const LOST_AFTER: Duration = Duration::from_secs(20);

/// A machine, and a token of each role and one of a panel.
pub(super) fn machine() -> (Machine, Vec<(&'static str, String)>) {
    let ports = FREE_PORTS.replace("[http]\n", "[http]\ntoken_file = \"tokens.toml\"\n");
    let machine = Machine::new(&format!("[io.out.lamp]\n{ports}"));
    let users = ROLES.iter().copied().map(|role| (role, role));
    let users = users.chain([("panel", "operate")]);
    let tokens = users.map(|(name, role)| {
        let made = Command::new(tandem())
            .args(["token", name, "--role", role, "--file", "tokens.toml"])
            .current_dir(machine.folder())
            .output()
            .expect("tandem starts");
        let text = String::from_utf8_lossy(&made.stdout).into_owned();
        let token = text.lines().find_map(|line| line.strip_prefix("token: "));
        (name, token.expect("a token").to_owned())
    });
    let tokens = tokens.collect();
    (machine, tokens)
}

fn connect(broker: &str, id: &str, (user, token): &(&'static str, String)) -> (AsyncClient, EventLoop) {
    let (host, port) = broker.rsplit_once(':').unwrap();
    let mut options = MqttOptions::new(id, host, port.parse().unwrap());
    options.set_credentials(*user, token);
    options.set_max_packet_size(1 << 20, 1 << 20);
    AsyncClient::new(options, 64)
}

/// Returns every inbound topic of the `AsyncAPI` document, with coordinate system 2.
fn inbound_topics(user: &str) -> Vec<String> {
    let text = include_str!("../../../runtime/gateway/api/asyncapi.json");
    let document: Value = serde_json::from_str(text).unwrap();
    let operations = document["operations"].as_object().unwrap().values();
    let received = operations.filter(|operation| operation["action"] == "receive");
    let addresses = received.filter_map(|operation| {
        let channel = operation["channel"]["$ref"].as_str()?.rsplit('/').next()?;
        document["channels"][channel]["address"].as_str()
    });
    let topics = addresses.filter(|address| address.starts_with("tandem/v1/"));
    let fill = |verb: &str, address: &str| {
        [
            ("{machine}", "test-1"),
            ("{cs}", "2"),
            ("{id}", user),
            ("{m}", "100"),
            ("{verb}", verb),
            ("{input}", "dry_run"),
            ("{side}", "out"),
            ("{name}", "lamp"),
            ("{number}", "1"),
        ]
        .iter()
        .fold(address.to_owned(), |path, (name, value)| {
            path.replace(name, value)
        })
    };
    let verbs = ["start", "resume", "reset", "jog", "hold", "stop", "abort"];
    let topics = topics.flat_map(|address| {
        if address.contains("{verb}") {
            verbs.iter().map(|verb| fill(verb, address)).collect()
        } else {
            vec![fill("", address)]
        }
    });
    topics.collect()
}

/// Publishes on every inbound topic, without end. `pause`: after each round.
async fn flood(broker: String, id: String, user: (&'static str, String), pause: Duration) {
    let (client, mut events) = connect(&broker, &id, &user);
    let topics = inbound_topics(user.0);
    let publishing = async {
        for number in 0_u64.. {
            for topic in &topics {
                let payload = json!({
                    "command_id": format!("{id}-{number}"), "client_id": id, "args": {}, "kind": "P", "from": 0, "count": 1,
                    "boot_id": "none", "seq": number, "handler_id": user.0, "value": true, "set": {},
                });
                let sent = client.publish(topic, QoS::AtMostOnce, false, payload.to_string());
                if sent.await.is_err() {
                    return;
                }
            }
            tokio::time::sleep(pause).await;
        }
    };
    let receiving = async {
        loop {
            if events.poll().await.is_err() {
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        }
    };
    tokio::join!(publishing, receiving);
}

/// Returns the times until the first reply of this number of requests, with each verb and quality in turn.
async fn request(broker: &str, panel: &(&'static str, String), count: usize) -> Vec<(String, Duration)> {
    let (client, mut events) = connect(broker, "panel", panel);
    let subscribed = client
        .subscribe("tandem/v1/test-1/reply/panel", QoS::AtLeastOnce)
        .await;
    subscribed.expect("a subscription");
    while !matches!(
        events.poll().await.expect("a connection"),
        Event::Incoming(Packet::SubAck(_))
    ) {}
    let mut taken = Vec::new();
    for number in 0..count {
        let (verb, qos) = (VERBS[number % 3], QUALITIES[number / 3 % 3]);
        let id = format!("{verb}-{number}");
        let command = json!({"command_id": id, "client_id": "panel", "args": {}}).to_string();
        let begun = Instant::now();
        let topic = format!("tandem/v1/test-1/cs/1/command/{verb}");
        client
            .publish(topic, qos, false, command)
            .await
            .expect("a command");
        let answered = async {
            loop {
                let Event::Incoming(Packet::Publish(reply)) = events.poll().await.expect("a connection")
                else {
                    continue;
                };
                let reply: Value = serde_json::from_slice(&reply.payload).expect("a reply");
                if reply["command_id"] == id.as_str() {
                    assert_ne!(reply["status"], "rejected", "{reply}");
                    return begun.elapsed();
                }
            }
        };
        let answered = tokio::time::timeout(LOST_AFTER, answered).await;
        let what = format!("{verb} with quality {}", qos as u8);
        taken.push((
            what.clone(),
            answered.unwrap_or_else(|_| panic!("{what} is lost")),
        ));
    }
    taken
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn hold_stop_abort_pass_floods_of_each_topic_by_each_role() {
    let is_long = std::env::var_os("TANDEM_LONG").is_some();
    // next to other tests, the flood leaves processor time for them
    let (count, connections, pause_ms) = if is_long { (1000, 2, 0) } else { (18, 1, 20) };
    let (machine, users) = machine();
    let served = Served::start(&machine);
    let mut floods = JoinSet::new();
    for user in &users[..ROLES.len()] {
        for number in 0..connections {
            let id = format!("flood-{}-{number}", user.0);
            let pause = Duration::from_millis(pause_ms);
            floods.spawn(flood(served.broker.clone(), id, user.clone(), pause));
        }
    }
    tokio::time::sleep(Duration::from_secs(1)).await;
    let mut taken = request(&served.broker, users.last().unwrap(), count).await;
    assert!(floods.try_join_next().is_none(), "each flood goes on until now");
    floods.shutdown().await;
    taken.sort_by_key(|(_, taken)| *taken);
    let (slowest, largest) = taken.last().unwrap();
    let place = |percent: usize| taken[(taken.len() - 1) * percent / 100].1;
    println!(
        "{count} requests: median {:?}, 99 percent {:?}, largest {largest:?} ({slowest}), none lost",
        place(50),
        place(99)
    );
    if is_long {
        assert!(*largest < ACCEPTED_MAX, "{slowest}: {largest:?}");
    }
}
