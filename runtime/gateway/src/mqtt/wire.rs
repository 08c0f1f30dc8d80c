//! One connection to a broker, over MQTT 5 or 3.1.1: what differs between the two ends here.

use std::fmt;
use std::time::Duration;

use rumqttc::v5::mqttbytes::QoS as QoS5;
use rumqttc::v5::mqttbytes::v5 as mqtt5;
use rumqttc::{NetworkOptions, Outgoing, Packet, QoS, SubscribeFilter, SubscribeReasonCode, v5};
use tokio::sync::mpsc;
use tokio_util::task::AbortOnDropHandle;

use crate::broker_address::BrokerAddress;

/// Pings after this long without traffic; the broker publishes the will after one and a half of it.
const KEEP_ALIVE: Duration = Duration::from_secs(10);
/// Time to connect, s.
const CONNECT_TIMEOUT_S: u64 = 5;
/// Bytes of a packet that comes in. Reason: more than a broker may carry ends the connection, so it is generous.
const PACKET_IN_MAX: u32 = 8 * 1024 * 1024;
/// Bytes of a packet that goes out, unless the broker wants less.
const PACKET_OUT_MAX: u32 = 1024 * 1024;
/// Bytes of a publish that are neither topic nor payload: fixed header, length of the topic, packet id, properties.
const PUBLISH_OVERHEAD: usize = 5 + 2 + 2 + 1;
/// Publishes that wait in the client library.
const CHANNEL: usize = 64;
/// Publishes without an acknowledgement yet, unless the broker wants fewer.
const IN_FLIGHT_MAX: u16 = 100;

/// What a connection speaks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Version {
    /// MQTT 5: live messages show their retain flag (Retain As Published), refusals are told.
    V5,
    /// MQTT 3.1.1.
    V3_1_1,
}

impl fmt::Display for Version {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::V5 => "MQTT 5",
            Self::V3_1_1 => "MQTT 3.1.1",
        })
    }
}

/// A message that the broker publishes when the runtime goes without a goodbye; at least once, retained.
#[derive(Debug, Clone)]
pub(super) struct Will {
    pub(super) topic: String,
    pub(super) payload: String,
}

/// What the broker says.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Heard {
    /// The connection stands. The broker takes packets of so many bytes.
    Connected { packet_max: usize },
    /// A message.
    Published(Inbound),
    /// The oldest publish has been dealt with; refused when a reason is given.
    Acknowledged { refused: Option<String> },
    /// A subscription is refused.
    SubscriptionRefused,
    /// The runtime's own goodbye is on its way.
    Disconnected,
}

/// A message from the broker.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Inbound {
    pub(super) topic: String,
    pub(super) payload: Vec<u8>,
    /// Its sender had it retained. Over 3.1.1 only known of messages that were there before the subscription.
    pub(super) retain: bool,
}

/// Why a connection ended.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Lost {
    pub(super) why: String,
    /// The broker was reached, and hung up as one does that does not know the version.
    pub(super) version_unknown: bool,
}

/// A connection, from the first try to its end. It ends when this is dropped.
#[derive(Debug)]
pub(super) struct Wire {
    client: Client,
    heard: mpsc::Receiver<Result<Heard, Lost>>,
    _poller: AbortOnDropHandle<()>,
}

#[derive(Debug)]
enum Client {
    V5(v5::AsyncClient),
    V3(rumqttc::AsyncClient),
}

impl Wire {
    /// Begins to connect.
    pub(super) fn open(client_id: &str, at: &BrokerAddress, will: Will, version: Version) -> Self {
        let (sender, heard) = mpsc::channel(CHANNEL);
        let (client, poller) = match version {
            Version::V5 => {
                let (client, events) = v5::AsyncClient::new(options_5(client_id, at, will), CHANNEL);
                (Client::V5(client), tokio::spawn(poll_5(events, sender)))
            }
            Version::V3_1_1 => {
                let (client, mut events) = rumqttc::AsyncClient::new(options_3(client_id, at, will), CHANNEL);
                events.set_network_options(network());
                (Client::V3(client), tokio::spawn(poll_3(events, sender)))
            }
        };
        Self {
            client,
            heard,
            _poller: AbortOnDropHandle::new(poller),
        }
    }

    /// What comes next. Cancel-safe.
    pub(super) async fn next(&mut self) -> Result<Heard, Lost> {
        let ended = || Lost {
            why: "the connection has ended".to_owned(),
            version_unknown: false,
        };
        self.heard.recv().await.unwrap_or_else(|| Err(ended()))
    }

    /// Subscribes for delivery at least once and, over MQTT 5, with Retain As Published. False when the library is full.
    pub(super) fn subscribe(&self, filters: impl Iterator<Item = String>) -> bool {
        match &self.client {
            Client::V5(client) => {
                let filters = filters.map(|path| mqtt5::Filter {
                    preserve_retain: true,
                    ..mqtt5::Filter::new(path, QoS5::AtLeastOnce)
                });
                client.try_subscribe_many(filters).is_ok()
            }
            Client::V3(client) => {
                let filters = filters.map(|path| SubscribeFilter::new(path, QoS::AtLeastOnce));
                client.try_subscribe_many(filters).is_ok()
            }
        }
    }

    /// Hands a message over, at most once (0) or at least once (1). False when the library is full.
    pub(super) fn publish(&self, topic: String, qos: u8, retain: bool, payload: String) -> bool {
        match &self.client {
            Client::V5(client) => {
                let qos = if qos == 0 {
                    QoS5::AtMostOnce
                } else {
                    QoS5::AtLeastOnce
                };
                client.try_publish(topic, qos, retain, payload).is_ok()
            }
            Client::V3(client) => {
                let qos = if qos == 0 {
                    QoS::AtMostOnce
                } else {
                    QoS::AtLeastOnce
                };
                client.try_publish(topic, qos, retain, payload).is_ok()
            }
        }
    }

    /// Says goodbye; then comes [`Heard::Disconnected`]. False when the library is full.
    pub(super) fn disconnect(&self) -> bool {
        match &self.client {
            Client::V5(client) => client.try_disconnect().is_ok(),
            Client::V3(client) => client.try_disconnect().is_ok(),
        }
    }
}

/// True when a message fits into a packet of so many bytes.
pub(super) fn fits(topic: &str, payload: &str, packet_max: usize) -> bool {
    PUBLISH_OVERHEAD + topic.len() + payload.len() <= packet_max
}

// The polling of a connection must not be given up half-way, so that it has a task of its own; after an error or a
// goodbye the next poll would connect again.

async fn poll_5(mut events: v5::EventLoop, sender: mpsc::Sender<Result<Heard, Lost>>) {
    let mut connected = false;
    loop {
        let heard = match events.poll().await {
            Ok(event) => heard_5(event).map(Ok),
            Err(error) => Some(Err(lost_5(&error, connected))),
        };
        connected |= matches!(heard, Some(Ok(Heard::Connected { .. })));
        if !pass_on(heard, &sender).await {
            return;
        }
    }
}

async fn poll_3(mut events: rumqttc::EventLoop, sender: mpsc::Sender<Result<Heard, Lost>>) {
    loop {
        let heard = match events.poll().await {
            Ok(event) => heard_3(event).map(Ok),
            Err(error) => Some(Err(Lost {
                why: error.to_string(),
                version_unknown: false,
            })),
        };
        if !pass_on(heard, &sender).await {
            return;
        }
    }
}

/// False when it was the last.
async fn pass_on(heard: Option<Result<Heard, Lost>>, sender: &mpsc::Sender<Result<Heard, Lost>>) -> bool {
    let Some(heard) = heard else {
        return true;
    };
    let last = matches!(heard, Err(_) | Ok(Heard::Disconnected));
    sender.send(heard).await.is_ok() && !last
}

fn heard_5(event: v5::Event) -> Option<Heard> {
    Some(match event {
        v5::Event::Incoming(mqtt5::Packet::ConnAck(ack)) => {
            let wanted = ack.properties.and_then(|properties| properties.max_packet_size);
            let packet_max = wanted.unwrap_or(PACKET_OUT_MAX).min(PACKET_OUT_MAX);
            Heard::Connected {
                packet_max: usize::try_from(packet_max).unwrap_or(usize::MAX),
            }
        }
        v5::Event::Incoming(mqtt5::Packet::Publish(publish)) => Heard::Published(Inbound {
            topic: String::from_utf8(publish.topic.into()).ok()?,
            payload: publish.payload.into(),
            retain: publish.retain,
        }),
        // brokers acknowledge in the order of publishing (MQTT-4.6.0-2)
        v5::Event::Incoming(mqtt5::Packet::PubAck(ack)) => {
            use mqtt5::PubAckReason::{NoMatchingSubscribers, Success};
            let taken = matches!(ack.reason, Success | NoMatchingSubscribers);
            Heard::Acknowledged {
                refused: (!taken).then(|| format!("{:?}", ack.reason)),
            }
        }
        v5::Event::Incoming(mqtt5::Packet::SubAck(ack)) => {
            let taken = |code: &_| matches!(code, mqtt5::SubscribeReasonCode::Success(_));
            if ack.return_codes.iter().all(taken) {
                return None;
            }
            Heard::SubscriptionRefused
        }
        v5::Event::Outgoing(Outgoing::Disconnect) => Heard::Disconnected,
        _ => return None,
    })
}

fn heard_3(event: rumqttc::Event) -> Option<Heard> {
    Some(match event {
        rumqttc::Event::Incoming(Packet::ConnAck(_)) => Heard::Connected {
            packet_max: usize::try_from(PACKET_OUT_MAX).unwrap_or(usize::MAX),
        },
        rumqttc::Event::Incoming(Packet::Publish(publish)) => Heard::Published(Inbound {
            topic: publish.topic,
            payload: publish.payload.into(),
            retain: publish.retain,
        }),
        rumqttc::Event::Incoming(Packet::PubAck(_)) => Heard::Acknowledged { refused: None },
        rumqttc::Event::Incoming(Packet::SubAck(ack)) => {
            if !ack.return_codes.contains(&SubscribeReasonCode::Failure) {
                return None;
            }
            Heard::SubscriptionRefused
        }
        rumqttc::Event::Outgoing(Outgoing::Disconnect) => Heard::Disconnected,
        _ => return None,
    })
}

/// A broker of 3.1.1 answers a higher version with a code and hangs up, some only hang up (MQTT-3.1.2-2). The code is
/// followed by nothing, where MQTT 5 would have properties, so that it may be lost on the way here.
fn lost_5(error: &v5::ConnectionError, connected: bool) -> Lost {
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
    Lost {
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

fn options_5(client_id: &str, at: &BrokerAddress, will: Will) -> v5::MqttOptions {
    let mut options = v5::MqttOptions::new(client_id, at.host.clone(), at.port);
    options
        .set_transport(at.transport.clone())
        .set_keep_alive(KEEP_ALIVE)
        .set_clean_start(true)
        .set_max_packet_size(Some(PACKET_IN_MAX))
        .set_outgoing_inflight_upper_limit(IN_FLIGHT_MAX)
        .set_connection_timeout(CONNECT_TIMEOUT_S)
        .set_network_options(network())
        .set_last_will(mqtt5::LastWill::new(
            will.topic,
            will.payload,
            QoS5::AtLeastOnce,
            true,
            None,
        ));
    if let Some((user, password)) = &at.credentials {
        options.set_credentials(user, password);
    }
    options
}

fn options_3(client_id: &str, at: &BrokerAddress, will: Will) -> rumqttc::MqttOptions {
    let mut options = rumqttc::MqttOptions::new(client_id, at.host.clone(), at.port);
    let size = |bytes: u32| usize::try_from(bytes).unwrap_or(usize::MAX);
    options
        .set_transport(at.transport.clone())
        .set_keep_alive(KEEP_ALIVE)
        .set_clean_session(true)
        .set_max_packet_size(size(PACKET_IN_MAX), size(PACKET_OUT_MAX))
        .set_inflight(IN_FLIGHT_MAX)
        .set_last_will(rumqttc::LastWill::new(
            will.topic,
            will.payload,
            QoS::AtLeastOnce,
            true,
        ));
    if let Some((user, password)) = &at.credentials {
        options.set_credentials(user, password);
    }
    options
}
