//! A listener of a machine over MQTT, with its own client.

use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use plc_protocol::types::message::Message;
use plc_protocol::types::topic::Topic;
use rumqttc::{AsyncClient, Event, MqttOptions, Packet, QoS};
use serde_json::Value;

use super::schemas::check_message;
use super::wait::{History, within};

/// A connected client; everything below the machine's root is in `history`.
pub struct Bus {
    pub history: History,
    /// Messages outside of the interface, with the reason.
    pub unreadable: History,
    client: AsyncClient,
    root: String,
    task: tokio::task::JoinHandle<()>,
}

impl Bus {
    /// Connects to a broker and subscribes to all topics of a machine, which must be online.
    pub async fn connect(broker: &str, machine: &str) -> Self {
        let bus = Self::listen(broker, machine).await;
        let online = bus.history.find("presence", |value| value["online"] == true);
        within("presence over MQTT", online).await;
        bus
    }

    /// Listens to a machine that may be offline.
    pub async fn listen(broker: &str, machine: &str) -> Self {
        static LISTENERS: AtomicU32 = AtomicU32::new(0);
        let (host, port) = broker.rsplit_once(':').expect("host:port");
        let number = LISTENERS.fetch_add(1, Ordering::Relaxed);
        let id = format!("listener-{number}-{}", broker.replace(['.', ':'], "-"));
        let mut options = MqttOptions::new(id, host, port.parse().expect("a port"));
        options.set_keep_alive(Duration::from_secs(5));
        options.set_max_packet_size(1 << 20, 1 << 20);
        let (client, mut events) = AsyncClient::new(options, 64);
        let root = format!("tandem/v1/{machine}/");
        client
            .subscribe(format!("{root}#"), QoS::AtLeastOnce)
            .await
            .expect("a subscription");
        let history = History::default();
        let unreadable = History::default();
        let (sink, wrong, prefix) = (history.clone(), unreadable.clone(), root.clone());
        let again = client.clone();
        let task = tokio::spawn(async move {
            let mut connections = 0;
            loop {
                match events.poll().await {
                    Ok(Event::Incoming(Packet::ConnAck(_))) => {
                        connections += 1;
                        // the broker has removed it
                        if connections > 1 {
                            let filter = format!("{prefix}#");
                            again
                                .try_subscribe(filter, QoS::AtLeastOnce)
                                .expect("room for it");
                        }
                    }
                    Ok(Event::Incoming(Packet::Publish(publish))) => {
                        let topic = publish
                            .topic
                            .strip_prefix(&prefix)
                            .unwrap_or(&publish.topic)
                            .to_owned();
                        if let Some(known) = Topic::parse(&topic)
                            && let Err(error) = Message::from_json(known, &publish.payload)
                        {
                            wrong.push("unreadable".into(), Value::from(format!("{topic}: {error}")));
                        }
                        let value = serde_json::from_slice(&publish.payload).unwrap_or(Value::Null);
                        // a cleared topic has no payload
                        if !publish.payload.is_empty()
                            && let Err(error) = check_message(&topic, &value)
                        {
                            wrong.push("unreadable".into(), Value::from(error));
                        }
                        sink.push(topic, value);
                    }
                    Ok(_) => {}
                    Err(_) => tokio::time::sleep(Duration::from_millis(50)).await,
                }
            }
        });
        Self {
            history,
            unreadable,
            client,
            root,
            task,
        }
    }

    pub async fn publish(&self, topic: &str, value: &Value) {
        self.say(topic, value, false).await;
    }

    /// Publishes with the retain flag.
    pub async fn publish_retained(&self, topic: &str, value: &Value) {
        self.say(topic, value, true).await;
    }

    async fn say(&self, topic: &str, value: &Value, retain: bool) {
        let topic = format!("{}{topic}", self.root);
        let sent = self
            .client
            .publish(topic, QoS::AtLeastOnce, retain, value.to_string());
        sent.await.expect("a publish");
    }

    /// The last reply to a command, `rejected`, `done` or `failed`.
    pub async fn reply(&self, client_id: &str, command_id: &str) -> Value {
        let is_last = |reply: &Value| reply["command_id"] == command_id && reply["status"] != "accepted";
        self.history.find(&format!("reply/{client_id}"), is_last).await
    }
}

impl Drop for Bus {
    fn drop(&mut self) {
        self.task.abort();
        if !std::thread::panicking() {
            assert_eq!(
                self.unreadable.on("unreadable"),
                [] as [Value; 0],
                "messages that are not of their form"
            );
        }
    }
}
