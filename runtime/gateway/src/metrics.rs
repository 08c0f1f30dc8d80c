//! Counters of the servers, states of the machine, and timing of the servo thread, as Prometheus text.

mod machine;

use std::fmt::{Display, Write as _};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use plc_api::server::{Durations, ServoTiming};
use plc_api::types::machine::BrokerInUse;

pub(crate) use machine::States;
use machine::escaped;

/// Counters since the start.
#[derive(Debug, Default)]
pub(crate) struct Metrics {
    // by class of status: 1xx to 5xx
    http_responses: [AtomicU64; 5],
    pub(crate) websockets: AtomicU64,
    /// 1 while the runtime is connected to the MQTT broker, otherwise 0.
    pub(crate) mqtt_connected: AtomicU64,
    pub(crate) mqtt_connections: AtomicU64,
    pub(crate) mqtt_published: AtomicU64,
    pub(crate) mqtt_received: AtomicU64,
    pub(crate) mqtt_refused: AtomicU64,
    pub(crate) mqtt_events_lost: AtomicU64,
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

    /// The external broker that is connected.
    pub(crate) fn in_use(&self) -> Option<BrokerInUse> {
        self.0.lock().in_use.as_ref().map(|(broker, _)| broker.clone())
    }

    /// Whether no broker can be reached.
    pub(crate) fn is_lost(&self) -> bool {
        self.0.lock().is_lost
    }
}

/// Names and meanings of the counters without labels, in the order of [`Metrics`].
const COUNTERS: [(&str, &str); 7] = [
    ("tandem_websockets", "Open WebSockets."),
    ("tandem_mqtt_connected", "1 while the MQTT broker is connected."),
    (
        "tandem_mqtt_connections_total",
        "Connections made to the MQTT broker.",
    ),
    (
        "tandem_mqtt_published_total",
        "Messages handed to the MQTT broker.",
    ),
    ("tandem_mqtt_received_total", "Messages received over MQTT."),
    (
        "tandem_mqtt_refused_total",
        "Refused messages over MQTT: malformed, retained, or too many at once.",
    ),
    (
        "tandem_mqtt_events_lost_total",
        "Events dropped while the MQTT broker was offline.",
    ),
];

impl Metrics {
    pub(crate) fn count_response(&self, status: u16) {
        let class = usize::from(status / 100).clamp(1, self.http_responses.len()) - 1;
        if let Some(counter) = self.http_responses.get(class) {
            add(counter, 1);
        }
    }

    /// The text of `GET /metrics`.
    pub(crate) fn text(&self, states: &States, servo: Option<&ServoTiming>) -> String {
        let mut text = Text::default();
        let responses = "tandem_http_responses_total";
        text.head(responses, "HTTP responses by class of status.");
        for (class, counter) in (1..).zip(&self.http_responses) {
            text.value(&format!("{responses}{{class=\"{class}xx\"}}"), get(counter));
        }
        let counters = [
            &self.websockets,
            &self.mqtt_connected,
            &self.mqtt_connections,
            &self.mqtt_published,
            &self.mqtt_received,
            &self.mqtt_refused,
            &self.mqtt_events_lost,
        ];
        for (counter, (name, help)) in counters.into_iter().zip(COUNTERS) {
            text.number(name, help, get(counter));
        }
        if let Some((broker, since)) = &self.broker.0.lock().in_use {
            text.broker(&broker.address, since.elapsed());
        }
        text.states(states);
        if let Some(servo) = servo {
            text.servo(servo);
        }
        text.process();
        text.0
    }
}

/// Text under construction. Writing to a `String` cannot fail.
#[derive(Default)]
struct Text(String);

impl Text {
    /// Writes the help and kind of a metric. The name shows whether it is a counter.
    fn head(&mut self, name: &str, help: &str) {
        let kind = if name.ends_with("_total") {
            "counter"
        } else {
            "gauge"
        };
        let _ = writeln!(self.0, "# HELP {name} {help}\n# TYPE {name} {kind}");
    }

    fn value(&mut self, name: &str, value: impl Display) {
        let _ = writeln!(self.0, "{name} {value}");
    }

    fn number(&mut self, name: &str, help: &str, value: impl Display) {
        self.head(name, help);
        self.value(name, value);
    }

    fn broker(&mut self, address: &str, age: Duration) {
        let name = "tandem_mqtt_connection_age_seconds";
        self.head(name, "Age of the connection to this external MQTT broker.");
        self.value(
            &format!("{name}{{broker=\"{}\"}}", escaped(address)),
            age.as_secs_f64(),
        );
    }

    fn servo(&mut self, servo: &ServoTiming) {
        self.number("tandem_servo_period_seconds", "Servo period.", servo.period_s);
        let overruns =
            "Servo cycles that were not finished when the next one was due, including the cycles left out.";
        self.number("tandem_servo_overruns_total", overruns, servo.overruns);
        let missed = "Servo cycles that were left out because the servo was late.";
        self.number("tandem_servo_missed_cycles_total", missed, servo.missed);
        let late = "Exchanges with the drives that ended late.";
        self.number("tandem_servo_late_exchanges_total", late, servo.late_exchanges);
        let lost = "Frames to the drives that were lost.";
        self.number("tandem_servo_lost_frames_total", lost, servo.lost_frames);
        let late = "Delay of the start of a servo cycle";
        self.durations("tandem_servo_wakeup_lateness", late, &servo.lateness);
        let computing = "Duration of a servo cycle";
        self.durations("tandem_servo_cycle", computing, &servo.computing);
    }

    /// Writes a histogram with cumulative buckets, and its maximum.
    fn durations(&mut self, name: &str, help: &str, durations: &Durations) {
        let _ = writeln!(
            self.0,
            "# HELP {name}_seconds {help}.\n# TYPE {name}_seconds histogram"
        );
        let mut count = 0;
        for (bound_s, in_bucket) in &durations.buckets {
            count += in_bucket;
            let bound = if bound_s.is_finite() {
                bound_s.to_string()
            } else {
                "+Inf".to_owned()
            };
            self.value(&format!("{name}_seconds_bucket{{le=\"{bound}\"}}"), count);
        }
        self.value(&format!("{name}_seconds_sum"), durations.sum_s);
        self.value(&format!("{name}_seconds_count"), count);
        let most = format!("{help}, maximum since the start.");
        self.number(&format!("{name}_max_seconds"), &most, durations.max_s);
    }
}

/// Adds to a counter.
pub(crate) fn add(counter: &AtomicU64, count: u64) {
    counter.fetch_add(count, Ordering::Relaxed);
}

fn get(counter: &AtomicU64) -> u64 {
    counter.load(Ordering::Relaxed)
}
