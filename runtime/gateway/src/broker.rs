//! The embedded MQTT broker: on the loopback only, in memory only, anonymous because of the loopback only.
//!
//! Every setting of the broker is set here, since its defaults listen on all addresses and write files.
//! It refuses what no broker of ours may hold: a command, claim or set with the retain flag, which would be carried
//! out again at a later start.

use std::future::Future;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use mqtt5::broker::auth::AuthResult;
use mqtt5::broker::config::{AuthConfig, AuthMethod, RateLimitConfig, StorageBackend, StorageConfig};
use mqtt5::broker::events::{BrokerEventHandler, ClientPublishEvent, PublishAction};
use mqtt5::broker::{AuthProvider, BrokerConfig, BrokerShutdownHandle, MqttBroker};
use mqtt5::packet::connect::ConnectPacket;
use mqtt5::types::ReasonCode;
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tracing::warn;

use crate::error::GatewayError;
use crate::settings::{MQTT_LISTEN, listen_error};

/// Clients that may be connected; more are refused.
const CLIENTS_MAX: usize = 256;
/// Bytes of one packet. Reason: the largest message, `birth`, stays far below.
const PACKET_MAX: usize = 1024 * 1024;
/// Subscriptions of one client.
const SUBSCRIPTIONS_MAX: usize = 1024;
/// Retained messages. Reason: 8 coordinate systems of 15 topics fit 30 times.
const RETAINED_MAX: usize = 4096;
/// Bytes of one retained message.
const RETAINED_SIZE_MAX: usize = 256 * 1024;
/// How long the broker remembers a client that went; messages for it wait in memory.
const SESSION_EXPIRY: Duration = Duration::from_hours(1);
/// Messages that wait for one client; more are dropped by the broker.
const QUEUED_MAX: usize = 1000;
/// Bytes that wait for one client.
const QUEUED_BYTES_MAX: usize = 8 * 1024 * 1024;
/// Time to stop; then its task is ended.
const STOP_MAX: Duration = Duration::from_secs(2);

/// A message that the broker refused: its topic and payload.
pub(crate) type Refused = (String, Vec<u8>);

/// The embedded broker while it runs.
#[derive(Debug)]
pub(crate) struct Broker {
    addr: SocketAddr,
    handle: Handle,
    task: JoinHandle<()>,
}

struct Handle(BrokerShutdownHandle);

impl std::fmt::Debug for Handle {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("BrokerShutdownHandle")
    }
}

impl Broker {
    /// Starts the broker. Topics for which `is_inbound` holds may not be published with the retain flag; such
    /// messages go to `refused`, as far as there is room.
    pub(crate) async fn start(
        address: SocketAddr,
        is_inbound: Arc<dyn Fn(&str) -> bool + Send + Sync>,
        refused: mpsc::Sender<Refused>,
    ) -> Result<Broker, GatewayError> {
        let guard = Arc::new(Guard { is_inbound, refused });
        let broker = match MqttBroker::with_config(config(address, Arc::clone(&guard))).await {
            Ok(broker) => broker,
            Err(error) => return Err(why_not(address, &error).await),
        };
        let mut broker = broker.with_auth_provider(guard);
        let addr = broker.local_addr().unwrap_or(address);
        let handle = Handle(broker.shutdown_handle());
        let mut ready = broker.ready_receiver();
        let task = tokio::spawn(async move {
            if let Err(error) = broker.run().await {
                warn!("the embedded MQTT broker has ended: {error}");
            }
        });
        // false only when its task has ended already, which is logged there
        let _ = ready.wait_for(|ready| *ready).await;
        Ok(Broker { addr, handle, task })
    }

    /// Where it listens.
    pub(crate) fn addr(&self) -> SocketAddr {
        self.addr
    }

    /// Closes all connections and stops.
    pub(crate) async fn stop(mut self) {
        self.handle.0.shutdown();
        if tokio::time::timeout(STOP_MAX, &mut self.task).await.is_err() {
            self.task.abort();
        }
    }
}

/// The broker says its errors as text only: asks the system itself why it cannot listen.
async fn why_not(address: SocketAddr, error: &impl std::fmt::Display) -> GatewayError {
    match TcpListener::bind(address).await {
        Err(source) => listen_error(MQTT_LISTEN, address, source),
        Ok(_) => GatewayError::Broker(error.to_string()),
    }
}

fn config(address: SocketAddr, guard: Arc<Guard>) -> BrokerConfig {
    let auth = AuthConfig {
        allow_anonymous: true,
        auth_method: AuthMethod::None,
        rate_limit: RateLimitConfig {
            enabled: false,
            ..RateLimitConfig::default()
        },
        ..AuthConfig::default()
    };
    let storage = StorageConfig::new()
        .with_backend(StorageBackend::Memory)
        .with_persistence(true)
        .with_cleanup_interval(Duration::from_mins(1))
        .with_max_queued_messages_per_client(QUEUED_MAX)
        .with_max_queued_bytes_per_client(QUEUED_BYTES_MAX);
    BrokerConfig {
        bind_addresses: vec![address],
        max_clients: CLIENTS_MAX,
        session_expiry_interval: SESSION_EXPIRY,
        max_packet_size: PACKET_MAX,
        topic_alias_maximum: 64,
        retain_available: true,
        maximum_qos: 2,
        wildcard_subscription_available: true,
        subscription_identifier_available: true,
        shared_subscription_available: true,
        max_subscriptions_per_client: SUBSCRIPTIONS_MAX,
        max_retained_messages: RETAINED_MAX,
        max_retained_message_size: RETAINED_SIZE_MAX,
        client_channel_capacity: QUEUED_MAX,
        server_keep_alive: None,
        auth_config: auth,
        tls_config: None,
        websocket_config: None,
        websocket_tls_config: None,
        quic_config: None,
        cluster_listener_config: None,
        storage_config: storage,
        sys_topics_enabled: false,
        max_outbound_rate_per_client: 0,
        max_message_rate_per_client: 0,
        max_bandwidth_per_client: 0,
        bridges: Vec::new(),
        load_balancer: None,
        event_handler: Some(guard),
        ..BrokerConfig::default()
    }
}

/// Lets everyone in, and refuses commands with the retain flag.
struct Guard {
    is_inbound: Arc<dyn Fn(&str) -> bool + Send + Sync>,
    refused: mpsc::Sender<Refused>,
}

type Answer<'a, T> = Pin<Box<dyn Future<Output = T> + Send + 'a>>;

impl BrokerEventHandler for Guard {
    fn on_client_publish(&self, event: ClientPublishEvent) -> Answer<'_, PublishAction> {
        let action = if event.retain && !event.payload.is_empty() && (self.is_inbound)(&event.topic) {
            // when nobody takes them any more, refusing without a word is enough
            let _ = self
                .refused
                .try_send((event.topic.to_string(), event.payload.to_vec()));
            PublishAction::Handled
        } else {
            PublishAction::Continue
        };
        Box::pin(std::future::ready(action))
    }
}

impl AuthProvider for Guard {
    fn authenticate<'a>(
        &'a self,
        connect: &'a ConnectPacket,
        _: SocketAddr,
    ) -> Answer<'a, mqtt5::Result<AuthResult>> {
        let retained_will = connect
            .will
            .as_ref()
            .filter(|will| will.retain && (self.is_inbound)(&will.topic));
        let result = match retained_will {
            Some(will) => {
                warn!(
                    "MQTT client {} refused: its will on {} has the retain flag, which commands may not have",
                    connect.client_id, will.topic
                );
                AuthResult::fail(ReasonCode::NotAuthorized)
            }
            None => AuthResult::success(),
        };
        Box::pin(std::future::ready(Ok(result)))
    }

    fn authorize_publish<'a>(&'a self, _: &str, _: Option<&'a str>, _: &'a str) -> Answer<'a, bool> {
        Box::pin(std::future::ready(true))
    }

    fn authorize_subscribe<'a>(&'a self, _: &str, _: Option<&'a str>, _: &'a str) -> Answer<'a, bool> {
        Box::pin(std::future::ready(true))
    }
}
