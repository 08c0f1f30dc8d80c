//! Counters of the server ends and the timing of the servo thread, as Prometheus text.

use std::fmt::Write as _;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use plc_api::server::{Durations, ServoTiming};

/// Counters since the start.
#[derive(Debug, Default)]
pub(crate) struct Metrics {
    // by hundreds of the status: 1xx to 5xx
    http_responses: [AtomicU64; 5],
    pub(crate) websockets: AtomicU64,
    pub(crate) mqtt_connected: AtomicBool,
    pub(crate) mqtt_connections: AtomicU64,
    pub(crate) mqtt_published: AtomicU64,
    pub(crate) mqtt_received: AtomicU64,
    pub(crate) mqtt_refused: AtomicU64,
    pub(crate) mqtt_events_lost: AtomicU64,
}

impl Metrics {
    pub(crate) fn count_response(&self, status: u16) {
        let class = usize::from(status / 100).clamp(1, self.http_responses.len()) - 1;
        if let Some(counter) = self.http_responses.get(class) {
            add(counter, 1);
        }
    }

    /// The text of `GET /metrics`.
    pub(crate) fn text(&self, servo: Option<&ServoTiming>) -> String {
        let mut text = String::new();
        let mut put = |name: &str, kind: &str, help: &str, values: &[(String, u64)]| {
            // writing to a String cannot fail
            let _ = writeln!(text, "# HELP {name} {help}\n# TYPE {name} {kind}");
            for (labels, value) in values {
                let _ = writeln!(text, "{name}{labels} {value}");
            }
        };
        let classes: Vec<_> = (1..)
            .zip(&self.http_responses)
            .map(|(class, counter)| (format!("{{class=\"{class}xx\"}}"), get(counter)))
            .collect();
        put(
            "tandem_http_responses_total",
            "counter",
            "HTTP responses by class of status.",
            &classes,
        );
        let one = |value: u64| [(String::new(), value)];
        put(
            "tandem_websockets",
            "gauge",
            "WebSockets that are open.",
            &one(get(&self.websockets)),
        );
        put(
            "tandem_mqtt_connected",
            "gauge",
            "1 while the MQTT broker is connected.",
            &one(u64::from(self.mqtt_connected.load(Ordering::Relaxed))),
        );
        put(
            "tandem_mqtt_connections_total",
            "counter",
            "Connections made to the MQTT broker.",
            &one(get(&self.mqtt_connections)),
        );
        put(
            "tandem_mqtt_published_total",
            "counter",
            "Messages handed to the MQTT broker.",
            &one(get(&self.mqtt_published)),
        );
        put(
            "tandem_mqtt_received_total",
            "counter",
            "Messages received over MQTT.",
            &one(get(&self.mqtt_received)),
        );
        put(
            "tandem_mqtt_refused_total",
            "counter",
            "Messages over MQTT that were refused: malformed, retained, or too many at once.",
            &one(get(&self.mqtt_refused)),
        );
        put(
            "tandem_mqtt_events_lost_total",
            "counter",
            "Events dropped while the MQTT broker was away.",
            &one(get(&self.mqtt_events_lost)),
        );
        if let Some(servo) = servo {
            put_servo(&mut text, servo);
        }
        text
    }
}

/// The metrics of the servo thread.
fn put_servo(text: &mut String, servo: &ServoTiming) {
    let number = |text: &mut String, name: &str, kind: &str, help: &str, value: f64| {
        // writing to a String cannot fail
        let _ = writeln!(text, "# HELP {name} {help}\n# TYPE {name} {kind}\n{name} {value}");
    };
    let period = "Servo period.";
    number(
        text,
        "tandem_servo_period_seconds",
        "gauge",
        period,
        servo.period_s,
    );
    for (name, help, count) in [
        (
            "overruns",
            "Servo cycles that were not finished when the next one was due.",
            servo.overruns,
        ),
        (
            "late_exchanges",
            "Exchanges with the drives that ended late.",
            servo.late_exchanges,
        ),
        (
            "lost_frames",
            "Frames to the drives that were lost.",
            servo.lost_frames,
        ),
    ] {
        let name = format!("tandem_servo_{name}_total");
        number(text, &name, "counter", help, count as f64);
    }
    for (name, what, durations) in [
        (
            "tandem_servo_wakeup_lateness",
            "How late after its time a servo cycle began",
            &servo.lateness,
        ),
        (
            "tandem_servo_cycle",
            "How long a servo cycle computed",
            &servo.computing,
        ),
    ] {
        put_histogram(text, &format!("{name}_seconds"), what, durations);
        let most = format!("{what}, the most since the start.");
        number(
            text,
            &format!("{name}_max_seconds"),
            "gauge",
            &most,
            durations.max_s,
        );
    }
}

/// Buckets of a histogram count all that is not above their bound.
fn put_histogram(text: &mut String, name: &str, help: &str, durations: &Durations) {
    let _ = writeln!(text, "# HELP {name} {help}.\n# TYPE {name} histogram");
    let mut count = 0;
    for (bound_s, in_bucket) in &durations.buckets {
        count += in_bucket;
        let bound = if bound_s.is_finite() {
            bound_s.to_string()
        } else {
            "+Inf".to_owned()
        };
        let _ = writeln!(text, "{name}_bucket{{le=\"{bound}\"}} {count}");
    }
    let sum_s = durations.sum_s;
    let _ = writeln!(text, "{name}_sum {sum_s}\n{name}_count {count}");
}

/// Adds to a counter.
pub(crate) fn add(counter: &AtomicU64, count: u64) {
    counter.fetch_add(count, Ordering::Relaxed);
}

fn get(counter: &AtomicU64) -> u64 {
    counter.load(Ordering::Relaxed)
}
