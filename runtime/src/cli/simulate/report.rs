//! What a simulation found, as text and as JSON.

use std::collections::BTreeMap;
use std::sync::Arc;

use parking_lot::Mutex;
use plc_api::types::CoordinateSystemNumber;
use plc_api::types::message::Payload;
use plc_api::types::topic::{CsTopic, Topic};
use serde_json::{Map, Value, json};
use tandem_model::alarm::AlarmEntry;
use tandem_model::variables::VariableArray;
use tandem_runtime::Runtime;

use super::super::say;
use super::Job;
use super::recorder::{Record, Recorder};

/// What a simulation found: the first coordinate system's part, and those of the others.
pub(in crate::cli) struct Outcome {
    first: Part,
    others: BTreeMap<CoordinateSystemNumber, Part>,
}

/// One coordinate system's part.
struct Part {
    record: Record,
    machine: BTreeMap<String, f64>,
    work: BTreeMap<String, f64>,
    captured: Vec<Value>,
    variables: Value,
}

impl Outcome {
    pub(super) async fn new(
        runtime: &Runtime,
        jobs: &[Job],
        recorder: &Arc<Mutex<Recorder>>,
        ended_by: Option<&AlarmEntry>,
    ) -> Self {
        let mut parts = BTreeMap::new();
        for job in jobs {
            let record = recorder.lock().record(job.cs);
            parts.insert(job.cs, Part::new(runtime, job, record, ended_by).await);
        }
        let first = parts.remove(&jobs[0].cs).unwrap_or_else(Part::empty);
        Self { first, others: parts }
    }

    pub fn is_completed(&self) -> bool {
        self.parts().all(|part| part.record.alarm.is_null())
    }

    /// From the first program's start to its end, s.
    pub fn cycle_time_s(&self) -> f64 {
        self.first.cycle_time_s()
    }

    /// What ended the first program that did not complete, in a sentence; empty when all completed.
    pub fn alarm_text(&self) -> String {
        self.parts().find_map(Part::alarm_text).unwrap_or_default()
    }

    fn parts(&self) -> impl Iterator<Item = &Part> {
        std::iter::once(&self.first).chain(self.others.values())
    }

    pub fn to_json(&self) -> Value {
        let mut object = self.first.to_json();
        if !self.others.is_empty() {
            let others = self
                .others
                .iter()
                .map(|(cs, part)| (cs.to_string(), Value::Object(part.to_json())));
            object.insert("with".into(), Value::Object(others.collect()));
        }
        Value::Object(object)
    }

    pub fn print(&self) {
        self.first.print("");
        for (cs, part) in &self.others {
            say("");
            part.print(&format!("coordinate system {cs}: "));
        }
    }
}

impl Part {
    fn empty() -> Self {
        Self {
            record: Record::default(),
            machine: BTreeMap::new(),
            work: BTreeMap::new(),
            captured: Vec::new(),
            variables: json!({"P": {}, "Q": {}}),
        }
    }

    async fn new(runtime: &Runtime, job: &Job, mut record: Record, ended_by: Option<&AlarmEntry>) -> Self {
        let port = runtime.port();
        let read = async |topic| port.read(&Topic::cs(job.cs, topic)).await;
        let mut part = Self::empty();
        if let Some(message) = read(CsTopic::Position).await
            && let Payload::Position(position) = &message.payload
        {
            part.machine.clone_from(&position.machine);
            part.work.clone_from(&position.work);
        }
        if let Some(message) = read(CsTopic::Captured).await
            && let Payload::Captured(captured) = &message.payload
        {
            let each = captured
                .motors
                .iter()
                .zip(&captured.positions)
                .zip(&captured.captured);
            part.captured = each
                .map(|((motor, position), captured)| {
                    json!({"motor": motor, "position": position, "captured": captured})
                })
                .collect();
        }
        if let Some(variables) = runtime.variables(job.cs) {
            let (p, q) = (
                non_zero(&variables.global),
                non_zero(&variables.coordinate_system),
            );
            part.variables = json!({"P": p, "Q": q});
        }
        if record.end_s == 0.0 {
            record.end_s = port.now_s();
        }
        if let Some(entry) = ended_by
            && record.alarm.is_null()
        {
            let place = read(CsTopic::Program).await;
            let place = place.as_ref().and_then(|message| match &message.payload {
                Payload::Program(place) => Some((place.number, place.line)),
                _ => None,
            });
            let (program, line) = place.unwrap_or_default();
            let text = format!("{}. {}", entry.title, entry.remedy);
            record.alarm =
                json!({"number": entry.number, "text": text, "program": program, "line": line, "column": 1});
        }
        part.record = record;
        part
    }

    fn cycle_time_s(&self) -> f64 {
        self.record.end_s - self.record.start_s
    }

    fn alarm_text(&self) -> Option<String> {
        let alarm = &self.record.alarm;
        let text = alarm.get("text")?.as_str().unwrap_or_default();
        Some(format!(
            "alarm {} in program {} line {} column {}: {text}",
            alarm["number"], alarm["program"], alarm["line"], alarm["column"]
        ))
    }

    fn outcome(&self) -> &'static str {
        if self.record.alarm.is_null() {
            "completed"
        } else {
            "alarm"
        }
    }

    fn to_json(&self) -> Map<String, Value> {
        let object = json!({
            "outcome": self.outcome(),
            "cycle_time_s": self.cycle_time_s(),
            "blocks": self.record.blocks,
            "machine": self.machine,
            "work": self.work,
            "m_codes": self.record.m_codes,
            "stops": self.record.stops,
            "captured": self.captured,
            "variables": self.variables,
            "warnings": self.record.warnings,
            "alarm": self.record.alarm,
        });
        match object {
            Value::Object(object) => object,
            _ => Map::new(),
        }
    }

    fn print(&self, heading: &str) {
        let seconds = self.cycle_time_s();
        say(&format!(
            "{heading}{} after {seconds:.3} s, {} blocks",
            self.outcome(),
            self.record.blocks
        ));
        for (name, position) in [("machine", &self.machine), ("work", &self.work)] {
            let axes: Vec<_> = position
                .iter()
                .map(|(letter, value)| format!("{letter} {:.4}", without_rounding(*value)))
                .collect();
            say(&format!("  {name:8} {}", axes.join("  ")));
        }
        for output in &self.record.m_codes {
            let params: Vec<_> = (output["params"].as_object().into_iter().flatten())
                .map(|(letter, value)| format!(" V{letter}{}", value.as_f64().unwrap_or_default()))
                .collect();
            let m = output["m"].as_u64().unwrap_or_default();
            let reset = match output["reset_s"].as_f64() {
                Some(reset_s) => format!("reset at {reset_s:.3} s"),
                None => "not reset".to_owned(),
            };
            let at_s = output["output_s"].as_f64().unwrap_or_default();
            let line = &output["line"];
            say(&format!(
                "  M{m:02}{} in line {line}: output at {at_s:.3} s, {reset}",
                params.concat()
            ));
        }
        for stop in &self.record.stops {
            let at_s = stop["at_s"].as_f64().unwrap_or_default();
            say(&format!(
                "  M{:02} in line {}: program stop at {at_s:.3} s",
                stop["m"].as_u64().unwrap_or_default(),
                stop["line"]
            ));
        }
        for warning in &self.record.warnings {
            say(&format!(
                "  warning in line {}: {}",
                warning["line"],
                warning["text"].as_str().unwrap_or_default()
            ));
        }
        if let Some(text) = self.alarm_text() {
            say(&format!("  {text}"));
        }
    }
}

/// Variables that are not zero, by number; what is no number is a string.
fn non_zero(variables: &VariableArray) -> Map<String, Value> {
    let value = |value: f64| {
        if value.is_finite() {
            json!(value)
        } else {
            json!(value.to_string())
        }
    };
    (0..variables.len())
        .filter_map(|index| Some((index, variables.get(index)?)))
        .filter(|(_, v)| *v != 0.0)
        .map(|(index, v)| (index.to_string(), value(v)))
        .collect()
}

/// To the digits that are printed: what is rounding around 0 has no sign.
fn without_rounding(value: f64) -> f64 {
    (value * 1e4).round() / 1e4 + 0.0
}
