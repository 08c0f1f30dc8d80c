//! Counters of the servers, states of the machine, and timing of the servo thread, as Prometheus text.

mod machine;
mod scrape;

use std::time::{Duration, Instant};

use parking_lot::Mutex;
use plc_protocol::server::ServoTiming;
use plc_protocol::types::machine::BrokerInUse;
use prometheus_client::encoding::prometheus_text;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;

pub(crate) use machine::States;
use scrape::Scrape;

/// Classes of the status of an HTTP response: a status divided by 100, minus 1, is the index.
const STATUS_CLASSES: [&str; 5] = ["1xx", "2xx", "3xx", "4xx", "5xx"];

/// Counters since the start.
#[derive(Debug)]
pub(crate) struct Metrics {
    /// Refers to all counters and gauges below.
    registry: Registry,
    http_responses: [Counter; STATUS_CLASSES.len()],
    pub(crate) websockets: Gauge,
    /// 1 while the runtime is connected to the MQTT broker, otherwise 0.
    pub(crate) mqtt_connected: Gauge,
    pub(crate) mqtt_connections: Counter,
    pub(crate) mqtt_published: Counter,
    pub(crate) mqtt_received: Counter,
    pub(crate) mqtt_refused: Counter,
    pub(crate) mqtt_events_lost: Counter,
    pub(crate) broker: BrokerLink,
}

/// State of the connection to the broker.
#[derive(Debug, Default)]
pub(crate) struct BrokerLink(Mutex<LinkState>);

#[derive(Debug, Default)]
struct LinkState {
    /// The external broker, and when it was connected.
    in_use: Option<(BrokerInUse, Instant)>,
    /// The last attempt has failed, or the connection was lost.
    is_lost: bool,
}

impl BrokerLink {
    /// Records a connection.
    pub(crate) fn record_connection(&self, broker: Option<BrokerInUse>) {
        *self.0.lock() = LinkState {
            in_use: broker.map(|broker| (broker, Instant::now())),
            is_lost: false,
        };
    }

    /// Records a lost connection or a failed attempt.
    pub(crate) fn record_loss(&self) {
        *self.0.lock() = LinkState {
            in_use: None,
            is_lost: true,
        };
    }

    /// Returns the external broker that is connected.
    pub(crate) fn in_use(&self) -> Option<BrokerInUse> {
        self.0.lock().in_use.as_ref().map(|(broker, _)| broker.clone())
    }

    /// Returns the address of the external broker that is connected, and the age of the connection.
    fn age(&self) -> Option<(String, Duration)> {
        let state = self.0.lock();
        let (broker, since) = state.in_use.as_ref()?;
        Some((broker.address.clone(), since.elapsed()))
    }

    /// Returns true if no broker can be reached.
    pub(crate) fn is_lost(&self) -> bool {
        self.0.lock().is_lost
    }
}

impl Default for Metrics {
    /// Creates and registers all counters. The registry adds `_total` to the name of a counter, and a full stop to a help text.
    fn default() -> Self {
        let mut registry = Registry::default();
        let responses = Family::<[(&str, &str); 1], Counter>::default();
        let http_responses = STATUS_CLASSES.map(|class| responses.get_or_create_owned(&[("class", class)]));
        registry.register(
            "tandem_http_responses",
            "HTTP responses by class of status",
            responses,
        );
        let mut gauge = |name, help| {
            let gauge = Gauge::default();
            registry.register(name, help, gauge.clone());
            gauge
        };
        let websockets = gauge("tandem_websockets", "Open WebSockets");
        let mqtt_connected = gauge("tandem_mqtt_connected", "1 while the MQTT broker is connected");
        let mut counter = |name, help| {
            let counter = Counter::default();
            registry.register(name, help, counter.clone());
            counter
        };
        Self {
            http_responses,
            websockets,
            mqtt_connected,
            mqtt_connections: counter("tandem_mqtt_connections", "Connections made to the MQTT broker"),
            mqtt_published: counter("tandem_mqtt_published", "Messages handed to the MQTT broker"),
            mqtt_received: counter("tandem_mqtt_received", "Messages received over MQTT"),
            mqtt_refused: counter(
                "tandem_mqtt_refused",
                "Refused messages over MQTT: malformed, retained, or too many at once",
            ),
            mqtt_events_lost: counter(
                "tandem_mqtt_events_lost",
                "Events dropped while the MQTT broker was offline",
            ),
            broker: BrokerLink::default(),
            registry,
        }
    }
}

impl Metrics {
    pub(crate) fn count_response(&self, status: u16) {
        let class = usize::from(status / 100).clamp(1, STATUS_CLASSES.len()) - 1;
        if let Some(counter) = self.http_responses.get(class) {
            counter.inc();
        }
    }

    /// Returns the text of `GET /metrics`, of type [`prometheus_text::CONTENT_TYPE`].
    pub(crate) fn text(&self, states: States, servo: Option<ServoTiming>) -> String {
        let mut scraped = Registry::default();
        scraped.register_collector(Box::new(Scrape {
            broker: self.broker.age(),
            states,
            servo,
        }));
        let mut text = String::new();
        for registry in [&self.registry, &scraped] {
            let encoded = prometheus_text::encode(&mut text, registry);
            debug_assert!(encoded.is_ok(), "writing to a `String` cannot fail");
        }
        text
    }
}
