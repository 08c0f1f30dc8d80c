//! A Mosquitto with exactly the rules that `tandem mqtt-acl` prints: each user sends in its own name only.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use rumqttc::{AsyncClient, Event, MqttOptions, Packet, QoS};
use serde_json::{Value, json};
use tempfile::TempDir;
use tokio::sync::mpsc;

use super::machine;
use crate::support::binary::tandem;
use crate::support::broker::Mosquitto;
use crate::support::served::Served;
use crate::support::wait::within;

const ROOT: &str = "tandem/v1/test-1/";
const USERS: [(&str, &str); 5] = [
    ("clamp", "handler"),
    ("magazine", "handler"),
    ("panel", "operate"),
    ("board", "view"),
    ("boss", "admin"),
];

/// Roles that may send requests of a right, according to docs/src/reference/users.md.
fn roles(right: &str) -> &'static [&'static str] {
    match right {
        "read" => &["view", "handler", "operate", "admin"],
        "operate" => &["operate", "admin"],
        "handle" => &["handler", "admin"],
        "reset" | "set" | "set_input" | "raise" => &["handler", "operate", "admin"],
        "administrate" => &["admin"],
        other => panic!("{other}"),
    }
}

/// A value for each name in a topic.
const LEVELS: [(&str, &str); 9] = [
    ("{cs}", "1"),
    ("{m}", "100"),
    ("{verb}", "start"),
    ("{input}", "interlock"),
    ("{side}", "out"),
    ("{name}", "lamp"),
    ("{number}", "1"),
    ("{id}", "clamp"),
    ("{client_id}", "panel"),
];

/// Topics of the document that clients publish (`receive`), with their roles, and topics that only the
/// runtime publishes (`send`). Topics that name their sender are left out: [`SENDERS`] are added in front of
/// the others.
fn topics(action: &str) -> Vec<(String, &'static [&'static str])> {
    let document = include_str!("../../../runtime/gateway/api/asyncapi.json");
    let document: Value = serde_json::from_str(document).expect("JSON");
    let operations = document["operations"].as_object().expect("operations").values();
    let of_action = operations.filter(|operation| operation["action"] == action);
    let found = of_action.filter_map(|operation| {
        let channel = operation["channel"]["$ref"].as_str()?.strip_prefix('#')?;
        let address = document.pointer(channel)?["address"].as_str()?;
        let path = address.strip_prefix("tandem/v1/{machine}/")?;
        let path = LEVELS
            .iter()
            .fold(path.to_owned(), |path, (name, value)| path.replace(name, value));
        let roles = operation["x-right"].as_str().map_or(&[][..], roles);
        Some((path, roles))
    });
    let names_sender = |path: &str| path.starts_with("handler/") || path.starts_with("client/");
    found
        .filter(|(path, _)| action == "send" || !names_sender(path))
        .collect()
}

struct Plant {
    broker: Mosquitto,
    _served: Served,
    tokens: BTreeMap<&'static str, String>,
    _machine: crate::support::machine::Machine,
}

fn printed(folder: &Path, arguments: &[&str]) -> String {
    let mut command = Command::new(tandem());
    let output = command
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("tandem starts");
    assert!(output.status.success(), "{arguments:?}");
    String::from_utf8(output.stdout).expect("UTF-8")
}

fn add_password(file: &Path, name: &str, password: &str) {
    let mut command = Command::new("mosquitto_passwd");
    let create: &[&str] = if file.exists() { &[] } else { &["-c"] };
    let status = command
        .args(create)
        .arg("-b")
        .arg(file)
        .args([name, password])
        .status();
    assert!(status.expect("mosquitto_passwd is installed").success());
}

impl Plant {
    fn new() -> Self {
        let folder = TempDir::new().expect("a folder");
        let path = folder.path().to_owned();
        let passwords = path.join("passwords");
        add_password(&passwords, "mill-1", "runtime-secret");
        std::fs::write(path.join("acl"), "").expect("written");
        std::fs::write(path.join("password"), "runtime-secret\n").expect("written");
        let mut broker = Mosquitto::with(
            folder,
            "allow_anonymous false\npassword_file passwords\nacl_file acl\n",
        );
        let machine = machine(&format!(
            "[http]\nlisten = \"127.0.0.1:0\"\ntoken_file = \"tokens.toml\"\n[mqtt]\nbroker = \"mqtt://{}\"\nusername = \"mill-1\"\npassword_file = \"{}\"\n",
            broker.address(),
            path.join("password").display()
        ));
        let tokens = USERS.map(|(name, role)| {
            let text = printed(
                machine.folder(),
                &["token", name, "--role", role, "--file", "tokens.toml"],
            );
            let token = text.lines().find_map(|line| line.strip_prefix("token: "));
            let token = token.expect("a token").to_owned();
            add_password(&passwords, name, &token);
            (name, token)
        });
        let config = machine.config();
        let rules = printed(
            machine.folder(),
            &["mqtt-acl", "--config", config.to_str().expect("UTF-8")],
        );
        std::fs::write(path.join("acl"), rules).expect("written");
        broker.kill();
        broker.start_again();
        let served = Served::start(&machine);
        Self {
            broker,
            _served: served,
            tokens: tokens.into(),
            _machine: machine,
        }
    }

    /// A connection of a user, and what it receives of these filters.
    async fn connect(
        &self,
        user: &str,
        password: &str,
        filters: &[&str],
    ) -> (AsyncClient, mpsc::UnboundedReceiver<(String, Value)>) {
        let address = self.broker.address();
        let (host, port) = address.rsplit_once(':').unwrap();
        let mut options = MqttOptions::new(format!("raw-{user}"), host, port.parse().unwrap());
        options.set_credentials(user, password);
        let (client, mut events) = AsyncClient::new(options, 512);
        let (sender, received) = mpsc::unbounded_channel();
        let (ready, is_ready) = tokio::sync::oneshot::channel();
        for filter in filters {
            client
                .subscribe(format!("{ROOT}{filter}"), QoS::AtLeastOnce)
                .await
                .unwrap();
        }
        let mut ready = Some(ready);
        let subscribes = !filters.is_empty();
        tokio::spawn(async move {
            while let Ok(event) = events.poll().await {
                match event {
                    Event::Incoming(Packet::Publish(publish)) => {
                        let payload = serde_json::from_slice(&publish.payload).unwrap_or_default();
                        let _ = sender.send((publish.topic, payload));
                    }
                    Event::Incoming(Packet::ConnAck(_)) if !subscribes => {
                        ready.take().map(|ready| ready.send(()));
                    }
                    Event::Incoming(Packet::SubAck(_)) => {
                        ready.take().map(|ready| ready.send(()));
                    }
                    _ => {}
                }
            }
        });
        within("a connection", is_ready).await.expect("connected");
        (client, received)
    }

    async fn connect_as(&self, user: &str) -> AsyncClient {
        self.connect(user, &self.tokens[user], &[]).await.0
    }
}

async fn publish(client: &AsyncClient, path: &str, payload: &Value) {
    let sent = client.publish(
        format!("{ROOT}{path}"),
        QoS::AtLeastOnce,
        false,
        payload.to_string(),
    );
    sent.await.expect("a connection");
}

/// Levels of senders, including no level.
const SENDERS: [&str; 7] = [
    "",
    "handler/clamp/",
    "handler/magazine/",
    "client/panel/",
    "client/board/",
    "client/clamp/",
    "client/boss/",
];

/// Returns true if a user may publish a request with these levels of a sender.
fn may_publish((user, role): (&str, &str), sender: &str, roles: &[&str]) -> bool {
    let is_own = match role {
        "handler" => sender == format!("handler/{user}/"),
        "admin" if sender.starts_with("handler/") => roles.contains(&"handler"),
        _ => sender == format!("client/{user}/"),
    };
    is_own && roles.contains(&role)
}

/// Returns whether a user may publish its own presence or heartbeats, or those of another handler.
fn may_report((user, role): (&str, &str), path: &str) -> bool {
    let is_own = path.split('/').nth(1) == Some(user);
    match role {
        "admin" => true,
        "handler" => is_own,
        "operate" => is_own && path.starts_with("client/"),
        _ => false,
    }
}

/// Publications of each user, and whether the rules permit them.
fn attempts(
    requests: &[(String, &[&str])],
    states: &[(String, &[&str])],
) -> Vec<(&'static str, String, bool)> {
    let mut all = Vec::new();
    for (user, role) in USERS {
        for sender in SENDERS {
            let of_sender = requests.iter().map(|(path, roles)| {
                (
                    user,
                    format!("{sender}{path}"),
                    may_publish((user, role), sender, roles),
                )
            });
            all.extend(of_sender);
        }
        all.extend(states.iter().map(|(path, _)| (user, path.clone(), false)));
        for name in ["clamp", "magazine", "panel", "board", "boss", "nobody"] {
            for path in [
                format!("client/{name}/heartbeat"),
                format!("handler/{name}/presence"),
            ] {
                let may = may_report((user, role), &path);
                all.push((user, path, may));
            }
        }
    }
    all
}

#[tokio::test]
async fn the_printed_rules_let_each_user_speak_in_its_own_name_only() {
    let (requests, states) = (topics("receive"), topics("send"));
    assert!(
        requests.len() >= 23 && states.len() >= 37,
        "{requests:?} {states:?}"
    );
    let plant = Plant::new();
    let (_runtime, mut received) = plant.connect("mill-1", "runtime-secret", &["#"]).await;
    let mut expected = Vec::new();
    let mut clients = BTreeMap::new();
    for (user, _) in USERS {
        clients.insert(user, plant.connect_as(user).await);
    }
    for (user, path, passes) in attempts(&requests, &states) {
        let mark = format!("{user} {path}");
        publish(&clients[user], &path, &json!({"mark": mark})).await;
        expected.extend(passes.then_some(mark));
    }
    // messages of other connections may arrive after it
    tokio::time::sleep(Duration::from_secs(1)).await;
    let boss = plant.connect_as("boss").await;
    publish(
        &boss,
        "client/boss/cs/1/variable/get",
        &json!({"mark": "the end"}),
    )
    .await;
    let mut delivered = Vec::new();
    loop {
        let (_, payload) = within("the end", received.recv()).await.expect("connected");
        match payload["mark"].as_str() {
            Some("the end") => break,
            Some(mark) => delivered.push(mark.to_owned()),
            None => {}
        }
    }
    delivered.sort();
    expected.sort();
    assert_eq!(delivered, expected);
}
