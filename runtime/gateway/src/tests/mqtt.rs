//! MQTT end through the embedded broker, with a common client library.

use plc_protocol::types::command::Command;
use plc_protocol::types::output::HandlerPresence;
use plc_protocol::types::request::Input;
use rumqttc::{AsyncClient, Event, LastWill, MqttOptions, Packet, Publish, QoS};
use serde_json::{Value, json};
use tokio::sync::mpsc;
use tokio_util::task::AbortOnDropHandle;

use super::*;
use crate::broker::{Broker, BrokerAccess, SLOT_LIMITS};
use crate::mqtt::{self, MqttEnd};
use crate::settings::MqttSettings;

pub(super) const ROOT: &str = "tandem/v1/mill-1/";

/// A client of the broker.
pub(super) struct TestClient {
    pub(super) mqtt: AsyncClient,
    received: mpsc::UnboundedReceiver<Publish>,
    _poller: AbortOnDropHandle<()>,
}

impl TestClient {
    /// Connects, and subscribes to these filters below the root.
    pub(super) async fn connect(address: std::net::SocketAddr, id: &str, filters: &[&str]) -> Self {
        Self::with_will(address, id, filters, None).await
    }

    pub(super) async fn with_will(
        address: std::net::SocketAddr,
        id: &str,
        filters: &[&str],
        will: Option<LastWill>,
    ) -> Self {
        let mut options = MqttOptions::new(id, address.ip().to_string(), address.port());
        if let Some(will) = will {
            options.set_last_will(will);
        }
        Self::with_options(options, filters).await
    }

    pub(super) async fn with_options(options: MqttOptions, filters: &[&str]) -> Self {
        let (client, mut eventloop) = AsyncClient::new(options, 64);
        let (sender, received) = mpsc::unbounded_channel();
        let (ready, is_ready) = tokio::sync::oneshot::channel();
        let mut ready = Some(ready);
        let subscribes = !filters.is_empty();
        let poller = AbortOnDropHandle::new(tokio::spawn(async move {
            while let Ok(event) = eventloop.poll().await {
                match event {
                    Event::Incoming(Packet::Publish(publish)) => {
                        let _ = sender.send(publish);
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
        }));
        for filter in filters {
            client
                .subscribe(format!("{ROOT}{filter}"), QoS::AtLeastOnce)
                .await
                .unwrap();
        }
        within(is_ready).await.unwrap();
        Self {
            mqtt: client,
            received,
            _poller: poller,
        }
    }

    pub(super) async fn publish(&self, path: &str, retain: bool, payload: &Value) {
        let topic = format!("{ROOT}{path}");
        let publish = self
            .mqtt
            .publish(topic, QoS::AtLeastOnce, retain, payload.to_string());
        within(publish).await.unwrap();
    }

    /// Publishes a text that need not be JSON.
    pub(super) async fn publish_text(&self, path: &str, payload: &str) {
        let topic = format!("{ROOT}{path}");
        let publish = self.mqtt.publish(topic, QoS::AtLeastOnce, false, payload);
        within(publish).await.unwrap();
    }

    /// The next message on this path for which the check holds; others are skipped.
    pub(super) async fn next(&mut self, path: &str, fits: impl Fn(&Value) -> bool) -> (Publish, Value) {
        within(async {
            loop {
                let publish = self.received.recv().await.expect("still connected");
                if publish.topic.strip_prefix(ROOT) != Some(path) {
                    continue;
                }
                let value = serde_json::from_slice(&publish.payload).unwrap_or_default();
                if fits(&value) {
                    return (publish, value);
                }
            }
        })
        .await
    }

    /// Returns the messages received so far.
    pub(super) fn here(&mut self) -> Vec<Publish> {
        std::iter::from_fn(|| self.received.try_recv().ok()).collect()
    }
}

fn is_command(request: &Request) -> bool {
    matches!(request, Request::Command { .. })
}

#[tokio::test]
async fn states_are_retained_and_the_position_is_a_stream() {
    let port = StubPort::new();
    let gateway = start(&port).await;
    let address = gateway.mqtt_addr().unwrap();
    // a first client sees them come, so that they are at the broker when the second one subscribes
    let mut early = TestClient::connect(address, "early", &["#"]).await;
    early.next("cs/1/state", |_| true).await;
    let mut late = TestClient::connect(address, "late", &["#"]).await;
    let (publish, state) = late.next("cs/1/state", |_| true).await;
    assert!(publish.retain);
    assert_eq!(
        (&state["v"], &state["boot_id"], &state["rev"]),
        (&json!(1), &json!("boot-1"), &json!(12))
    );
    port.say_dry_run(1, true);
    late.next("cs/1/input/dry_run/state", |value| value["value"] == true)
        .await;
    for feedrate in 0..200 {
        port.say_position(f64::from(feedrate));
        tokio::task::yield_now().await;
    }
    let (publish, _) = late
        .next("cs/1/position", |value| value["feedrate"] == 199.0)
        .await;
    assert_eq!((publish.qos, publish.retain), (QoS::AtMostOnce, false));
    let others = early.here();
    let positions = others
        .iter()
        .filter(|publish| publish.topic.ends_with("position"))
        .count();
    assert!(positions < 100, "{positions} of 200 positions were published");
    let mut later = TestClient::connect(address, "later", &["cs/1/position", "presence"]).await;
    let (publish, _) = later.next("presence", |value| value["online"] == true).await;
    assert!(publish.retain);
    let (publish, value) = later.next("cs/1/position", |_| true).await;
    assert!(!publish.retain, "the position is a stream");
    assert_eq!(value["feedrate"], 199.0, "which goes on at rest");
    gateway.shutdown().await;
}

#[tokio::test]
async fn commands_settings_and_handshakes_reach_the_port() {
    let port = StubPort::new();
    let gateway = start(&port).await;
    let mut client = TestClient::connect(gateway.mqtt_addr().unwrap(), "hmi", &["presence"]).await;
    client.next("presence", |value| value["online"] == true).await;
    let command =
        json!({"command_id": "c1", "client_id": "hmi", "expect": {"state_rev": 12}, "args": {"program": 7}});
    client.publish("cs/1/command/load", false, &command).await;
    let Request::Command {
        cs: 1, command, meta, ..
    } = port.asked_for(is_command).await
    else {
        panic!("a command");
    };
    assert_eq!(command, Command::Load { program: 7 });
    assert_eq!((meta.command_id.as_str(), meta.client_id.as_str()), ("c1", "hmi"));
    client
        .publish("cs/1/input/dry_run/set", false, &json!({"value": true}))
        .await;
    port.asked_for(|request| *request == Request::Input(1, Input::DryRun(true)))
        .await;
    let claim = json!({"boot_id": "boot-1", "seq": 3, "handler_id": "h"});
    client.publish("cs/1/m_code/100/claim", false, &claim).await;
    port.asked_for(|request| matches!(request, Request::Claim(1, Some(100), claim) if claim.seq == 3))
        .await;
    gateway.shutdown().await;
}

#[tokio::test]
async fn commands_reach_the_port_in_the_order_of_publishing() {
    let port = StubPort::new();
    let gateway = start(&port).await;
    let mut client = TestClient::connect(gateway.mqtt_addr().unwrap(), "hmi", &["presence"]).await;
    client.next("presence", |value| value["online"] == true).await;
    let verbs = ["start", "hold", "resume", "stop", "reset", "start", "abort"];
    for (number, verb) in verbs.iter().enumerate() {
        let command = json!({"command_id": format!("c{number}"), "client_id": "hmi"});
        client
            .publish(&format!("cs/1/command/{verb}"), false, &command)
            .await;
    }
    let last = format!("c{}", verbs.len() - 1);
    port.asked_for(|request| matches!(request, Request::Command { meta, .. } if meta.command_id == last))
        .await;
    let order: Vec<_> = port
        .asked()
        .into_iter()
        .filter_map(|request| match request {
            Request::Command { command, .. } => Some(serde_json::to_value(command.verb()).unwrap()),
            _ => None,
        })
        .collect();
    assert_eq!(order, verbs.map(Value::from));
    gateway.shutdown().await;
}

#[tokio::test]
async fn a_handler_that_dies_goes_offline_by_its_will() {
    let port = StubPort::new();
    let gateway = start(&port).await;
    let address = gateway.mqtt_addr().unwrap();
    let topic = format!("{ROOT}handler/h1/presence");
    let will = LastWill::new(&topic, r#"{"online":false}"#, QoS::AtLeastOnce, true);
    let handler = TestClient::with_will(address, "h1", &[], Some(will)).await;
    let presence = json!({"online": true, "handles": [{"cs": 1, "m": 100}], "validates": false});
    handler.publish("handler/h1/presence", true, &presence).await;
    let is = |online: bool| move |request: &Request| matches!(request, Request::Handler(id, HandlerPresence { online: now, .. }) if id == "h1" && *now == online);
    port.asked_for(is(true)).await;
    drop(handler); // no goodbye: the socket just closes
    port.asked_for(is(false)).await;
    gateway.shutdown().await;
}

#[tokio::test]
async fn presence_is_offline_after_a_shutdown_and_by_the_will_after_a_crash() {
    let port = StubPort::new();
    let (broker, address) = broker("127.0.0.1:0".parse().unwrap());
    let end = mqtt_end(&port, address);
    let mut client = TestClient::connect(address, "hmi", &["presence"]).await;
    client.next("presence", |value| value["online"] == true).await;
    end.stop().await;
    let (_, value) = client.next("presence", |value| value["online"] == false).await;
    assert_eq!(
        (&value["boot_id"], &value["version"]),
        (&json!("boot-1"), &json!("0.1.0"))
    );
    let end = mqtt_end(&port, address);
    client.next("presence", |value| value["online"] == true).await;
    end.crash();
    client.next("presence", |value| value["online"] == false).await;
    broker.stop().await;
}

#[tokio::test]
async fn each_connection_republishes_presence_birth_and_all_retained_state() {
    let port = StubPort::new();
    let (first, address) = broker("127.0.0.1:0".parse().unwrap());
    let end = mqtt_end(&port, address);
    let mut client = TestClient::connect(address, "one", &["#"]).await;
    client.next("cs/1/state", |_| true).await;
    drop(client);
    first.stop().await;
    // published while no client listens, and lost when the broker forgets everything
    port.say_dry_run(1, true);
    port.say_dry_run(2, false);
    let (second, _) = broker(address);
    let mut client = TestClient::connect(address, "two", &["#"]).await;
    client.next("presence", |value| value["online"] == true).await;
    client.next("birth", |value| value["machine"] == "mill-1").await;
    client.next("cs/1/state", |value| value["rev"] == 12).await;
    client
        .next("cs/1/input/dry_run/state", |value| value["rev"] == 2)
        .await;
    let command = json!({"command_id": "c1", "client_id": "hmi"});
    client.publish("cs/1/command/hold", false, &command).await;
    port.asked_for(is_command).await;
    end.stop().await;
    second.stop().await;
}

#[tokio::test]
async fn an_external_broker_keeps_no_command() {
    let port = StubPort::new();
    let (broker, address) = broker("127.0.0.1:0".parse().unwrap());
    let client = TestClient::connect(address, "one", &[]).await;
    let command = json!({"command_id": "old", "client_id": "hmi"});
    client.publish("cs/1/command/start", true, &command).await;
    client
        .publish("cs/1/input/dry_run/set", true, &json!({"value": true}))
        .await;
    let mut hmi = TestClient::connect(address, "two", &["reply/hmi", "cs/1/command/start"]).await;
    hmi.next("cs/1/command/start", |value| value["command_id"] == "old")
        .await;
    let end = mqtt_end(&port, address);
    let (_, reply) = hmi.next("reply/hmi", |_| true).await;
    assert_eq!(
        (&reply["status"], &reply["code"]),
        (&json!("rejected"), &json!("retained"))
    );
    // a live one is executed, and its topic is cleared as well
    let command = json!({"command_id": "new", "client_id": "hmi"});
    client.publish("cs/1/command/hold", false, &command).await;
    port.asked_for(is_command).await;
    let commands: Vec<_> = port
        .asked()
        .into_iter()
        .filter(|request| !matches!(request, Request::Handler(..)))
        .collect();
    assert!(
        matches!(
            &commands[..],
            [Request::Command { meta, .. }] if meta.command_id == "new"
        ),
        "{commands:?}"
    );
    let warnings = port.warnings();
    assert!(
        matches!(&warnings[..], [warning] if warning.contains("retained command old of hmi")),
        "{warnings:?}"
    );
    end.stop().await;
    let mut late =
        TestClient::connect(address, "three", &["cs/1/command/#", "cs/1/input/#", "presence"]).await;
    late.next("presence", |value| value["online"] == false).await;
    assert_eq!(late.here(), [], "everything retained was cleared");
    broker.stop().await;
}

/// A broker that knows nothing of commands, as an external one.
pub(super) fn broker(address: std::net::SocketAddr) -> (Broker, std::net::SocketAddr) {
    let (refused, _) = mpsc::channel(1);
    // has other topics, like a foreign broker
    let access = BrokerAccess {
        root: "none/".into(),
        runtime_client_id: "none".into(),
        users: None,
        machine: crate::machine::Machine::new(StubPort::new()),
    };
    let broker = Broker::start(address, access, None, refused, SLOT_LIMITS).unwrap();
    let address = broker.addr();
    (broker, address)
}

fn mqtt_end(port: &Arc<StubPort>, address: std::net::SocketAddr) -> MqttEnd {
    mqtt_end_that(true, port, address)
}

/// Returns an MQTT task that accepts senders that topics do not name, or not.
pub(super) fn mqtt_end_that(accepts: bool, port: &Arc<StubPort>, address: std::net::SocketAddr) -> MqttEnd {
    let (_, refused) = mpsc::channel(1);
    let parts = mqtt::Parts {
        machine: crate::machine::Machine::new(Arc::<StubPort>::clone(port)),
        tokens: None,
        clients: None,
        settings: MqttSettings {
            embedded_listen: None,
            accept_unverified_senders: accepts,
            ..MqttSettings::default()
        },
        machine_name: "mill-1".into(),
        root: ROOT.into(),
        position_interval: Duration::from_millis(20),
        refused,
        metrics: Arc::default(),
        arrivals: Arc::default(),
        urgent_replies: Arc::default(),
    };
    let at = crate::broker_address::BrokerAddress {
        nodes: vec![(address.ip().to_string(), address.port())],
        credentials: None,
        transport: rumqttc::Transport::tcp(),
    };
    MqttEnd::start(parts, at)
}

/// A broker of two nodes; a silent one accepts everything and acknowledges nothing.
#[derive(Clone, Default)]
struct TwoNodes {
    silent: Option<usize>,
    opened: Arc<parking_lot::Mutex<Vec<(usize, tokio::time::Instant)>>>,
    /// Topics of all that was published.
    published: Arc<parking_lot::Mutex<Vec<String>>>,
}

struct Node {
    is_silent: bool,
    is_connected: bool,
    unacknowledged: parking_lot::Mutex<usize>,
    published: Arc<parking_lot::Mutex<Vec<String>>>,
}

impl mqtt::Connect for TwoNodes {
    type Wire = Node;

    fn open(&self, node: usize, _: &str, _: Option<LastWill>, _: mqtt::Version) -> Node {
        self.opened.lock().push((node, tokio::time::Instant::now()));
        Node {
            is_silent: self.silent == Some(node),
            is_connected: false,
            unacknowledged: parking_lot::Mutex::default(),
            published: Arc::clone(&self.published),
        }
    }

    fn nodes(&self) -> usize {
        2
    }
}

impl mqtt::Wire for Node {
    async fn next(&mut self) -> Result<mqtt::Event, mqtt::ConnectionLoss> {
        if !std::mem::replace(&mut self.is_connected, true) {
            return Ok(mqtt::Event::Connected { packet_max: 100_000 });
        }
        let unacknowledged = self.unacknowledged.get_mut();
        if self.is_silent || *unacknowledged == 0 {
            return std::future::pending().await;
        }
        *unacknowledged -= 1;
        Ok(mqtt::Event::Acknowledged { refused: None })
    }

    fn subscribe(&self, _: impl Iterator<Item = String>) -> bool {
        true
    }

    fn publish(&self, topic: String, qos: u8, _: bool, _: String, _: Option<u32>) -> bool {
        *self.unacknowledged.lock() += usize::from(qos);
        self.published.lock().push(topic);
        true
    }

    fn disconnect(&self) -> bool {
        false
    }
}

#[tokio::test(start_paused = true)]
async fn node_not_acknowledging_for_10_s_is_replaced_and_the_next_is_kept() {
    let nodes = TwoNodes {
        silent: Some(0),
        ..TwoNodes::default()
    };
    let end = MqttEnd::over(StubPort::new(), &GatewaySettings::default(), nodes.clone());
    tokio::time::sleep(Duration::from_mins(1)).await;
    let opened = nodes.opened.lock().clone();
    let [(0, begun), (1, left)] = opened[..] else {
        panic!("{opened:?}");
    };
    assert_eq!((left - begun).as_secs(), 10);
    end.crash();
}

/// Disconnected nodes have lost the messages that they were to exchange, and their clients never receive them.
#[tokio::test(start_paused = true)]
async fn every_state_is_published_again_with_the_third_presence() {
    let (port, nodes) = (StubPort::new(), TwoNodes::default());
    let end = MqttEnd::over(
        Arc::<StubPort>::clone(&port),
        &GatewaySettings::default(),
        nodes.clone(),
    );
    let mut states = Vec::new();
    for rev in 2..=7 {
        tokio::time::sleep(Duration::from_secs(10)).await;
        nodes.published.lock().clear();
        port.say_presence(rev);
        tokio::time::sleep(Duration::from_secs(1)).await;
        let published = nodes.published.lock();
        let count = |path: &str| published.iter().filter(|topic| topic.ends_with(path)).count();
        states.push((count("/cs/1/state"), count("/birth")));
    }
    assert_eq!(states, [(0, 0), (0, 0), (1, 1), (0, 0), (0, 0), (1, 1)]);
    end.crash();
}
