//! One connection to a broker, over MQTT 5 or 3.1.1. The differences between the two stay in this file.
//!
//! [`Connect`] and [`Wire`] are the interface to a broker; a simulation replaces it by a model.

use std::fmt;
use std::future::Future;
use std::time::Duration;

use plc_protocol::transport::backoff::Backoff;

use rumqttc::v5::mqttbytes::v5 as mqtt5;
use rumqttc::v5::mqttbytes::{QoS as QoS5, qos as qos_5};
use rumqttc::{
    LastWill, NetworkOptions, Outgoing, Packet, Publish, QoS, SubscribeFilter, SubscribeReasonCode,
    Transport, v5,
};
use tokio::sync::mpsc;
use tokio_util::task::AbortOnDropHandle;

use crate::broker_address::BrokerAddress;

/// A ping follows this time without traffic; the broker publishes the will after 1.5 times as long.
const KEEP_ALIVE: Duration = Duration::from_secs(10);
/// Time to connect, s.
const CONNECT_TIMEOUT_S: u64 = 5;
/// Largest number of bytes of an incoming packet. Reason: a larger one ends the connection, so the limit is generous.
const PACKET_IN_MAX: u32 = 8 * 1024 * 1024;
/// Largest number of bytes of an outgoing packet, unless the broker accepts less.
const PACKET_OUT_MAX: u32 = 1024 * 1024;
/// Bytes of a publish in addition to topic and payload: fixed header, length of the topic, packet id, properties.
const PUBLISH_OVERHEAD: usize = 5 + 2 + 2 + 1;
/// Publishes waiting in the client library.
const CHANNEL: usize = 64;
/// Largest number of publishes without an acknowledgement, unless the broker accepts fewer.
const IN_FLIGHT_MAX: u16 = 100;

/// Opens connections to a broker.
pub trait Connect: Send + Sync + 'static {
    /// A connection.
    type Wire: Wire;

    /// Starts connecting to a node of the broker, with a clean session. `will` is `None` if the connection publishes
    /// nothing.
    /// nothing.
    fn open(&self, node: usize, client_id: &str, will: Option<LastWill>, version: Version) -> Self::Wire;

    /// Returns the number of nodes.
    fn nodes(&self) -> usize {
        1
    }

    /// Returns the address of a node of an external broker.
    fn address(&self, _node: usize) -> Option<String> {
        None
    }

    /// Returns the delays between attempts.
    fn backoff(&self) -> Backoff {
        Backoff::default()
    }
}

/// A connection to a broker, from the first attempt to its end. Dropping a `Wire` ends the connection.
pub trait Wire: Send + 'static {
    /// Returns the next event. Cancel-safe.
    fn next(&mut self) -> impl Future<Output = Result<Event, ConnectionLoss>> + Send;

    /// Subscribes for delivery at least once and, over MQTT 5, with Retain As Published. False when there is no room.
    fn subscribe(&self, filters: impl Iterator<Item = String>) -> bool;

    /// Publishes with quality of service 0 or 1; over MQTT 5 the broker forgets it after `expiry_s`, s. False when there is no
    /// room.
    fn publish(&self, topic: String, qos: u8, retain: bool, payload: String, expiry_s: Option<u32>) -> bool;

    /// Sends DISCONNECT; then [`Event::Disconnected`] follows. Returns `false` when there is no room.
    fn disconnect(&self) -> bool;
}

/// The protocol version of a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Version {
    /// MQTT 5: live messages keep their retain flag (Retain As Published), and refusals have a reason.
    V5,
    /// MQTT 3.1.1.
    V3_1_1,
}

impl Version {
    /// Returns true for a message that is cleared at the broker: over 3.1.1 a live message does not keep its retain
    /// flag, so every command is cleared.
    pub(super) fn is_to_clear(self, path: &str) -> bool {
        self == Self::V3_1_1 && (path.contains("/command/") || path.contains("/lease/"))
    }
}

impl fmt::Display for Version {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::V5 => "MQTT 5",
            Self::V3_1_1 => "MQTT 3.1.1",
        })
    }
}

/// An event of the connection.
#[derive(Debug, PartialEq, Eq)]
pub enum Event {
    /// The connection is established.
    Connected {
        /// Limit of the size of packets that the broker accepts.
        packet_max: usize,
    },
    /// A message. Over 3.1.1 its retain flag is set only if it was published before the subscription.
    Published {
        /// The message.
        publish: Publish,
        /// The publisher of the message.
        named: BrokerStamp,
    },
    /// The oldest publish with quality of service 1 is completed.
    Acknowledged {
        /// The broker's reason, if it has rejected the message.
        refused: Option<String>,
    },
    /// The broker refuses a subscription.
    SubscriptionRefused,
    /// The runtime's own DISCONNECT is being sent.
    Disconnected,
}

/// Why a connection ended.
#[derive(Debug, PartialEq, Eq)]
pub struct ConnectionLoss {
    /// The reason as text.
    pub why: String,
    /// The broker was reached, and hung up like one that does not support the version.
    pub version_unknown: bool,
}

/// A connection to a real broker.
#[derive(Debug)]
pub(crate) struct BrokerWire {
    client: VersionedClient,
    events: mpsc::Receiver<Result<Event, ConnectionLoss>>,
    _poller: AbortOnDropHandle<()>,
}

#[derive(Debug)]
enum VersionedClient {
    V5(v5::AsyncClient),
    V3(rumqttc::AsyncClient),
}

enum EventLoop {
    V5(Box<v5::EventLoop>),
    V3(Box<rumqttc::EventLoop>),
}

impl Connect for BrokerAddress {
    type Wire = BrokerWire;

    fn nodes(&self) -> usize {
        self.nodes.len()
    }

    fn address(&self, node: usize) -> Option<String> {
        let (host, port) = self.nodes.get(node)?;
        let scheme = match self.transport {
            Transport::Tcp => "mqtt",
            _ => "mqtts",
        };
        Some(if host.contains(':') {
            format!("{scheme}://[{host}]:{port}")
        } else {
            format!("{scheme}://{host}:{port}")
        })
    }

    fn open(&self, node: usize, client_id: &str, will: Option<LastWill>, version: Version) -> BrokerWire {
        let (host, port) = self.nodes.get(node).cloned().unwrap_or_default();
        let (client, event_loop) = match version {
            Version::V5 => {
                let options = v5::MqttOptions::new(client_id, host, port);
                let (client, events) = v5::AsyncClient::new(options_5(options, self, will), CHANNEL);
                (VersionedClient::V5(client), EventLoop::V5(Box::new(events)))
            }
            Version::V3_1_1 => {
                let options = rumqttc::MqttOptions::new(client_id, host, port);
                let (client, mut events) = rumqttc::AsyncClient::new(options_3(options, self, will), CHANNEL);
                events.set_network_options(network());
                (VersionedClient::V3(client), EventLoop::V3(Box::new(events)))
            }
        };
        let (sender, events) = mpsc::channel(CHANNEL);
        BrokerWire {
            client,
            events,
            _poller: AbortOnDropHandle::new(tokio::spawn(event_loop.run(sender))),
        }
    }
}

impl Wire for BrokerWire {
    async fn next(&mut self) -> Result<Event, ConnectionLoss> {
        let ended = || ConnectionLoss {
            why: "the connection has ended".to_owned(),
            version_unknown: false,
        };
        self.events.recv().await.unwrap_or_else(|| Err(ended()))
    }

    fn subscribe(&self, filters: impl Iterator<Item = String>) -> bool {
        match &self.client {
            VersionedClient::V5(client) => {
                let filters = filters.map(|path| mqtt5::Filter {
                    preserve_retain: true,
                    ..mqtt5::Filter::new(path, QoS5::AtLeastOnce)
                });
                client.try_subscribe_many(filters).is_ok()
            }
            VersionedClient::V3(client) => {
                let filters = filters.map(|path| SubscribeFilter::new(path, QoS::AtLeastOnce));
                client.try_subscribe_many(filters).is_ok()
            }
        }
    }

    fn publish(&self, topic: String, qos: u8, retain: bool, payload: String, expiry_s: Option<u32>) -> bool {
        match &self.client {
            VersionedClient::V5(client) => {
                let qos = qos_5(qos).unwrap_or(QoS5::AtLeastOnce);
                let Some(expiry_s) = expiry_s else {
                    return client.try_publish(topic, qos, retain, payload).is_ok();
                };
                let properties = mqtt5::PublishProperties {
                    message_expiry_interval: Some(expiry_s),
                    ..mqtt5::PublishProperties::default()
                };
                client
                    .try_publish_with_properties(topic, qos, retain, payload, properties)
                    .is_ok()
            }
            VersionedClient::V3(client) => {
                let qos = rumqttc::qos(qos).unwrap_or(QoS::AtLeastOnce);
                client.try_publish(topic, qos, retain, payload).is_ok()
            }
        }
    }

    fn disconnect(&self) -> bool {
        match &self.client {
            VersionedClient::V5(client) => client.try_disconnect().is_ok(),
            VersionedClient::V3(client) => client.try_disconnect().is_ok(),
        }
    }
}

/// Returns true if a message fits into a packet of this size.
pub(super) fn fits(topic: &str, payload: &str, packet_max: usize) -> bool {
    PUBLISH_OVERHEAD + topic.len() + payload.len() <= packet_max
}

impl EventLoop {
    /// Polls until the connection ends: the next poll would connect again. It runs in a separate task, because a poll
    /// must not be cancelled half-way.
    async fn run(mut self, sender: mpsc::Sender<Result<Event, ConnectionLoss>>) {
        let mut connected = false;
        loop {
            let Some(event) = self.poll(connected).await.transpose() else {
                continue;
            };
            connected |= matches!(event, Ok(Event::Connected { .. }));
            let is_last = matches!(event, Err(_) | Ok(Event::Disconnected));
            if sender.send(event).await.is_err() || is_last {
                return;
            }
        }
    }

    async fn poll(&mut self, connected: bool) -> Result<Option<Event>, ConnectionLoss> {
        match self {
            Self::V5(events) => match events.poll().await {
                Ok(event) => Ok(event_5(event)),
                Err(error) => Err(lost_5(&error, connected)),
            },
            Self::V3(events) => match events.poll().await {
                Ok(event) => Ok(event_3(event)),
                Err(error) => Err(ConnectionLoss {
                    why: error.to_string(),
                    version_unknown: false,
                }),
            },
        }
    }
}

fn event_5(event: v5::Event) -> Option<Event> {
    Some(match event {
        v5::Event::Incoming(mqtt5::Packet::ConnAck(ack)) => {
            let wanted = ack.properties.and_then(|properties| properties.max_packet_size);
            let packet_max = wanted.unwrap_or(PACKET_OUT_MAX).min(PACKET_OUT_MAX);
            Event::Connected {
                packet_max: usize::try_from(packet_max).unwrap_or(usize::MAX),
            }
        }
        v5::Event::Incoming(mqtt5::Packet::Publish(publish)) => {
            let topic = String::from_utf8(publish.topic.into()).ok()?;
            let mut taken = Publish::new(topic, QoS::AtLeastOnce, publish.payload);
            taken.retain = publish.retain;
            Event::Published {
                publish: taken,
                named: BrokerStamp::default(),
            }
        }
        // brokers acknowledge in the order of publishing (MQTT-4.6.0-2)
        v5::Event::Incoming(mqtt5::Packet::PubAck(ack)) => {
            use mqtt5::PubAckReason::{NoMatchingSubscribers, Success};
            let taken = matches!(ack.reason, Success | NoMatchingSubscribers);
            Event::Acknowledged {
                refused: (!taken).then(|| format!("{:?}", ack.reason)),
            }
        }
        v5::Event::Incoming(mqtt5::Packet::SubAck(ack)) => {
            let taken = |code: &_| matches!(code, mqtt5::SubscribeReasonCode::Success(_));
            if ack.return_codes.iter().all(taken) {
                return None;
            }
            Event::SubscriptionRefused
        }
        v5::Event::Outgoing(Outgoing::Disconnect) => Event::Disconnected,
        _ => return None,
    })
}

/// The publisher of a message, if the broker is the embedded one; other brokers do not name it.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct BrokerStamp {
    /// Its user.
    pub user: Option<String>,
    /// Its client id.
    pub client_id: Option<String>,
    /// Its number in the order of arrival.
    pub arrival: Option<u64>,
    /// True for an urgent request that the broker has passed to the machine already.
    pub is_executed: bool,
}

fn event_3(event: rumqttc::Event) -> Option<Event> {
    Some(match event {
        rumqttc::Event::Incoming(Packet::ConnAck(_)) => Event::Connected {
            packet_max: usize::try_from(PACKET_OUT_MAX).unwrap_or(usize::MAX),
        },
        rumqttc::Event::Incoming(Packet::Publish(publish)) => Event::Published {
            publish,
            named: BrokerStamp::default(),
        },
        rumqttc::Event::Incoming(Packet::PubAck(_)) => Event::Acknowledged { refused: None },
        rumqttc::Event::Incoming(Packet::SubAck(ack)) => {
            if !ack.return_codes.contains(&SubscribeReasonCode::Failure) {
                return None;
            }
            Event::SubscriptionRefused
        }
        rumqttc::Event::Outgoing(Outgoing::Disconnect) => Event::Disconnected,
        _ => return None,
    })
}

/// Returns the reason of a lost connection over MQTT 5. A broker of 3.1.1 answers a higher version with a code and
/// hangs up, or only hangs up (MQTT-3.1.2-2). The library may fail to read that code, because the properties of
/// MQTT 5 do not follow it.
fn lost_5(error: &v5::ConnectionError, connected: bool) -> ConnectionLoss {
    use mqtt5::ConnectReturnCode::{RefusedProtocolVersion, UnsupportedProtocolVersion};
    use v5::{ConnectionError, StateError};
    let version_unknown = !connected
        && matches!(
            error,
            ConnectionError::ConnectionRefused(RefusedProtocolVersion | UnsupportedProtocolVersion)
                | ConnectionError::NotConnAck(_)
                | ConnectionError::MqttState(
                    StateError::Io(_) | StateError::Deserialization(_) | StateError::ConnectionAborted
                )
        );
    ConnectionLoss {
        why: error.to_string(),
        version_unknown,
    }
}

fn network() -> NetworkOptions {
    let mut network = NetworkOptions::new();
    network.set_tcp_nodelay(true);
    network.set_connection_timeout(CONNECT_TIMEOUT_S);
    network
}

fn options_5(mut options: v5::MqttOptions, at: &BrokerAddress, will: Option<LastWill>) -> v5::MqttOptions {
    options
        .set_transport(at.transport.clone())
        .set_keep_alive(KEEP_ALIVE)
        .set_clean_start(true)
        .set_max_packet_size(Some(PACKET_IN_MAX))
        .set_outgoing_inflight_upper_limit(IN_FLIGHT_MAX)
        .set_connection_timeout(CONNECT_TIMEOUT_S)
        .set_network_options(network());
    if let Some(will) = will {
        options.set_last_will(mqtt5::LastWill::new(
            will.topic,
            will.message,
            QoS5::AtLeastOnce,
            will.retain,
            None,
        ));
    }
    if let Some((user, password)) = &at.credentials {
        options.set_credentials(user, password);
    }
    options
}

fn options_3(
    mut options: rumqttc::MqttOptions,
    at: &BrokerAddress,
    will: Option<LastWill>,
) -> rumqttc::MqttOptions {
    let size = |bytes: u32| usize::try_from(bytes).unwrap_or(usize::MAX);
    options
        .set_transport(at.transport.clone())
        .set_keep_alive(KEEP_ALIVE)
        .set_clean_session(true)
        .set_max_packet_size(size(PACKET_IN_MAX), size(PACKET_OUT_MAX))
        .set_inflight(IN_FLIGHT_MAX);
    if let Some(will) = will {
        options.set_last_will(will);
    }
    if let Some((user, password)) = &at.credentials {
        options.set_credentials(user, password);
    }
    options
}
