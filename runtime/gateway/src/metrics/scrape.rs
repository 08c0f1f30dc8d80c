//! Metrics that are determined when they are read: states of the machine, the servo thread, and the process.

use std::fmt;
use std::time::Duration;

use plc_protocol::server::{Durations, ServoTiming};
use prometheus_client::collector::Collector;
use prometheus_client::encoding::{
    DescriptorEncoder, EncodeCounterValue, EncodeGaugeValue, EncodeLabelSet, EncodeMetric, NoLabelSet,
};
use prometheus_client::metrics::MetricType;
use prometheus_client::metrics::counter::ConstCounter;

use super::States;
use crate::process::Usage;

/// The values of one answer to `GET /metrics`.
#[derive(Debug)]
pub(super) struct Scrape {
    /// Address of the external broker, and the age of the connection.
    pub(super) broker: Option<(String, Duration)>,
    pub(super) states: States,
    /// `None` in simulated time.
    pub(super) servo: Option<ServoTiming>,
}

impl Collector for Scrape {
    fn encode(&self, encoder: DescriptorEncoder) -> fmt::Result {
        let mut families = FamilyEncoder(encoder);
        if let Some((address, age)) = &self.broker {
            families.gauges(
                "tandem_mqtt_connection_age_seconds",
                "Age of the connection to this external MQTT broker.",
                [([("broker", address.as_str())], age.as_secs_f64())],
            )?;
        }
        self.states.encode(&mut families)?;
        if let Some(servo) = &self.servo {
            encode_servo(&mut families, servo)?;
        }
        encode_process(&mut families)
    }
}

/// Encoder of metric families. Help texts are complete sentences: nothing is appended to them.
pub(super) struct FamilyEncoder<'a>(DescriptorEncoder<'a>);

impl FamilyEncoder<'_> {
    /// Encodes a gauge with a value for each set of labels. The help is also written if there is no value.
    pub(super) fn gauges<L: EncodeLabelSet, V: EncodeGaugeValue>(
        &mut self,
        name: &str,
        help: &str,
        values: impl IntoIterator<Item = (L, V)>,
    ) -> fmt::Result {
        let mut family = self.0.encode_descriptor(name, help, None, MetricType::Gauge)?;
        for (labels, value) in values {
            family.encode_family(&labels)?.encode_gauge(&value)?;
        }
        Ok(())
    }

    fn gauge(&mut self, name: &str, help: &str, value: &impl EncodeGaugeValue) -> fmt::Result {
        self.0
            .encode_descriptor(name, help, None, MetricType::Gauge)?
            .encode_gauge(value)
    }

    /// Encodes a counter. The encoder adds `_total` to its name.
    fn counter(&mut self, name: &str, help: &str, value: impl EncodeCounterValue) -> fmt::Result {
        ConstCounter::new(value).encode(self.0.encode_descriptor(name, help, None, MetricType::Counter)?)
    }

    /// Encodes a histogram `{name}_seconds`, and its maximum.
    fn durations(&mut self, name: &str, help: &str, durations: &Durations) -> fmt::Result {
        let count = durations.buckets.iter().map(|(_, in_bucket)| in_bucket).sum();
        self.0
            .encode_descriptor(
                &format!("{name}_seconds"),
                &format!("{help}."),
                None,
                MetricType::Histogram,
            )?
            .encode_histogram::<NoLabelSet>(durations.sum_s, count, &durations.buckets, None)?;
        let most = format!("{help}, maximum since the start.");
        self.gauge(&format!("{name}_max_seconds"), &most, &durations.max_s)
    }
}

fn encode_servo(families: &mut FamilyEncoder, servo: &ServoTiming) -> fmt::Result {
    families.gauge("tandem_servo_period_seconds", "Servo period.", &servo.period_s)?;
    let overruns =
        "Servo cycles that were not finished when the next one was due, including the cycles left out.";
    families.counter("tandem_servo_overruns", overruns, servo.overruns)?;
    let missed = "Servo cycles that were left out because the servo was late.";
    families.counter("tandem_servo_missed_cycles", missed, servo.missed)?;
    let late = "Exchanges with the drives that ended late.";
    families.counter("tandem_servo_late_exchanges", late, servo.late_exchanges)?;
    let lost = "Frames to the drives that were lost.";
    families.counter("tandem_servo_lost_frames", lost, servo.lost_frames)?;
    let late = "Delay of the start of a servo cycle";
    families.durations("tandem_servo_wakeup_lateness", late, &servo.lateness)?;
    let computing = "Duration of a servo cycle";
    families.durations("tandem_servo_cycle", computing, &servo.computing)
}

/// Encodes the process metrics under their standard names. Omitted if the system does not provide them.
fn encode_process(families: &mut FamilyEncoder) -> fmt::Result {
    let usage = Usage::now();
    if let Some(cpu_s) = usage.cpu_s {
        families.counter(
            "process_cpu_seconds",
            "Processor time used by the process on all cores.",
            cpu_s,
        )?;
    }
    if let Some(bytes) = usage.resident_bytes {
        families.gauge("process_resident_memory_bytes", "Memory of the process.", &bytes)?;
    }
    Ok(())
}
