//! Results of a simulation as text and as JSON.

use std::collections::BTreeMap;

use plc_api::CoordinateSystem;
use plc_protocol::types::CoordinateSystemNumber;
use serde::Serialize;
use serde_json::{Map, Value, json};
use tandem_model::alarm::AlarmEntry;
use tandem_model::variables::VariableArray;
use tandem_runtime::Runtime;

use super::super::print_line;
use super::recorder::Record;

/// Result of a simulation: the result of the first coordinate system, and the results of the others.
#[derive(Serialize)]
pub(in crate::cli) struct Outcome {
    #[serde(flatten)]
    first: SystemResult,
    #[serde(rename = "with", skip_serializing_if = "BTreeMap::is_empty")]
    others: BTreeMap<CoordinateSystemNumber, SystemResult>,
}

/// Result of one coordinate system.
#[derive(Serialize)]
struct SystemResult {
    outcome: &'static str,
    cycle_time_s: f64,
    #[serde(flatten)]
    record: Record,
    machine: BTreeMap<String, f64>,
    work: BTreeMap<String, f64>,
    captured: Vec<Value>,
    variables: Value,
}

impl Outcome {
    /// Creates the result from the records of each coordinate system and the final state of the runtime.
    pub(super) async fn new(
        runtime: &Runtime,
        mut records: BTreeMap<CoordinateSystemNumber, Record>,
        systems: &[CoordinateSystem],
        ended_by: Option<&AlarmEntry>,
    ) -> Self {
        let mut parts = Vec::new();
        for system in systems {
            let record = records.remove(&system.number()).unwrap_or_default();
            let part = SystemResult::new(runtime, system, record, ended_by).await;
            parts.push((system.number(), part));
        }
        let (_, first) = parts.remove(0);
        let others = parts.into_iter().collect();
        Self { first, others }
    }

    pub fn is_completed(&self) -> bool {
        self.parts().all(|part| part.record.alarm.is_null())
    }

    /// Returns the time from the start of the first program to the end of that program, s.
    pub fn cycle_time_s(&self) -> f64 {
        self.first.cycle_time_s
    }

    /// Returns the reason why the first incomplete program ended, as a sentence; empty if all programs were
    /// completed.
    pub fn alarm_text(&self) -> String {
        self.parts()
            .find_map(SystemResult::alarm_text)
            .unwrap_or_default()
    }

    fn parts(&self) -> impl Iterator<Item = &SystemResult> {
        std::iter::once(&self.first).chain(self.others.values())
    }

    pub fn print(&self) {
        self.first.print("");
        for (cs, part) in &self.others {
            print_line("");
            part.print(&format!("coordinate system {cs}: "));
        }
    }
}

impl SystemResult {
    async fn new(
        runtime: &Runtime,
        system: &CoordinateSystem,
        mut record: Record,
        ended_by: Option<&AlarmEntry>,
    ) -> Self {
        let position = system.position().await.unwrap_or_default();
        let of = system.captured().await.unwrap_or_default();
        let captured = (of.motors.iter().zip(&of.positions).zip(&of.captured))
            .map(|((motor, position), captured)| {
                json!({"motor": motor, "position": position, "captured": captured})
            })
            .collect();
        let variables = runtime.variables(system.number());
        let of_cs = variables.map(|of| (non_zero(&of.global), non_zero(&of.coordinate_system)));
        let (p, q) = of_cs.unwrap_or_default();
        if record.end_s == 0.0 {
            record.end_s = runtime.port().now_s();
        }
        if let Some(entry) = ended_by.filter(|_| record.alarm.is_null()) {
            let place = system.program().await.unwrap_or_default();
            record.alarm = json!({
                "number": entry.number, "text": format!("{}. {}", entry.title, entry.remedy),
                "program": place.number, "line": place.line, "column": 1,
            });
        }
        let is_completed = record.alarm.is_null();
        Self {
            outcome: if is_completed { "completed" } else { "alarm" },
            cycle_time_s: record.end_s - record.start_s,
            record,
            machine: position.machine,
            work: position.work,
            captured,
            variables: json!({"P": p, "Q": q}),
        }
    }

    fn alarm_text(&self) -> Option<String> {
        let alarm = &self.record.alarm;
        let text = alarm.get("text")?.as_str().unwrap_or_default();
        Some(format!(
            "alarm {} in program {} line {} column {}: {text}",
            alarm["number"], alarm["program"], alarm["line"], alarm["column"]
        ))
    }

    fn print(&self, heading: &str) {
        print_line(format!(
            "{heading}{} after {:.3} s, {} blocks",
            self.outcome, self.cycle_time_s, self.record.blocks
        ));
        for (name, position) in [("machine", &self.machine), ("work", &self.work)] {
            let axes: Vec<_> = position
                .iter()
                .map(|(letter, value)| format!("{letter} {:.4}", without_rounding(*value)))
                .collect();
            print_line(format!("  {name:8} {}", axes.join("  ")));
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
            print_line(format!(
                "  M{m:02}{} in line {line}: output at {at_s:.3} s, {reset}",
                params.concat()
            ));
        }
        for stop in &self.record.stops {
            let at_s = stop["at_s"].as_f64().unwrap_or_default();
            print_line(format!(
                "  M{:02} in line {}: program stop at {at_s:.3} s",
                stop["m"].as_u64().unwrap_or_default(),
                stop["line"]
            ));
        }
        for warning in &self.record.warnings {
            print_line(format!(
                "  warning in line {}: {}",
                warning["line"],
                warning["text"].as_str().unwrap_or_default()
            ));
        }
        if let Some(text) = self.alarm_text() {
            print_line(format!("  {text}"));
        }
        self.record.measured.print();
    }
}

/// Returns the variables that are not zero, by number. Values such as NaN become strings.
fn non_zero(variables: &VariableArray) -> Map<String, Value> {
    (0..variables.len())
        .filter_map(|index| Some((index, variables.get(index)?)))
        .filter(|(_, value)| *value != 0.0)
        .map(|(index, value)| {
            let number = value.is_finite().then_some(value);
            (
                index.to_string(),
                number.map_or_else(|| json!(value.to_string()), |number| json!(number)),
            )
        })
        .collect()
}

/// Rounds a value to the printed digits, and removes the sign of a zero.
fn without_rounding(value: f64) -> f64 {
    (value * 1e4).round() / 1e4 + 0.0
}
