//! Metrics of the machine's states (coordinate systems, pending M codes, runs, alarms, handlers) and of the process.

use std::collections::BTreeMap;
use std::time::SystemTime;

use plc_api::execution::wire_name;
use plc_api::hub::Filter;
use plc_api::types::CoordinateSystemNumber;
use plc_api::types::machine::ActiveAlarms;
use plc_api::types::message::{Message, Payload};
use plc_api::types::output::Pending;
use plc_api::types::run::Run;
use plc_api::types::state::State;
use plc_api::types::topic::Topic;

use super::Text;
use crate::machine::Machine;
use crate::process::Usage;

/// The states of a machine, grouped by metric.
#[derive(Debug, Default)]
pub(crate) struct States {
    now: Option<SystemTime>,
    systems: BTreeMap<CoordinateSystemNumber, State>,
    pending: BTreeMap<CoordinateSystemNumber, Pending>,
    runs: BTreeMap<CoordinateSystemNumber, Run>,
    alarms: ActiveAlarms,
    handlers: BTreeMap<String, bool>,
}

impl States {
    /// Returns the current states: a subscription begins with them.
    pub(crate) fn from_machine(machine: &Machine) -> Self {
        let mut states = Self {
            now: Some(machine.time()),
            ..Self::default()
        };
        let mut all = machine.subscribe(Filter::All);
        while let Some(message) = all.try_next() {
            states.apply_message(&message);
        }
        states
    }

    fn apply_message(&mut self, message: &Message) {
        match (&message.topic, &message.payload) {
            (Topic::CoordinateSystem(cs, _), Payload::State(state)) => {
                self.systems.insert(*cs, state.clone());
            }
            (Topic::CoordinateSystem(cs, _), Payload::Pending(pending)) => {
                self.pending.insert(*cs, pending.clone());
            }
            (Topic::CoordinateSystem(cs, _), Payload::Run(run)) => {
                self.runs.extend(run.run.clone().map(|run| (*cs, run)));
            }
            (_, Payload::AlarmActive(alarms)) => self.alarms = alarms.clone(),
            (Topic::HandlerPresence(id), Payload::HandlerPresence(presence)) => {
                self.handlers.insert(id.clone(), presence.online);
            }
            _ => {}
        }
    }
}

impl Text {
    pub(super) fn states(&mut self, states: &States) {
        self.systems(states);
        self.open_m_codes(states);
        self.runs(states);
        let mut alarms = BTreeMap::<_, u32>::new();
        for alarm in &states.alarms.alarms {
            let cs = alarm.cs.map_or_else(String::new, |cs| cs.to_string());
            *alarms
                .entry((cs, alarm.number, wire_name(&alarm.severity)))
                .or_default() += 1;
        }
        let name = "tandem_alarms_active";
        self.head(
            name,
            "Active alarms and warnings by number; cs is empty for those of the whole machine.",
        );
        for ((cs, number, severity), count) in alarms {
            self.value(
                &format!("{name}{{cs=\"{cs}\",number=\"{number}\",severity=\"{severity}\"}}"),
                count,
            );
        }
        let name = "tandem_handler_online";
        self.head(
            name,
            "1 while a handler of M codes is online, 0 while it is offline.",
        );
        for (id, online) in &states.handlers {
            self.value(
                &format!("{name}{{handler=\"{}\"}}", escaped(id)),
                u8::from(*online),
            );
        }
    }

    fn systems(&mut self, states: &States) {
        let name = "tandem_execution";
        self.head(name, "1 for the state word of each coordinate system.");
        for (cs, state) in &states.systems {
            let execution = wire_name(&state.execution);
            self.value(&format!("{name}{{cs=\"{cs}\",execution=\"{execution}\"}}"), 1);
        }
        let name = "tandem_reason";
        self.head(
            name,
            "1 for the reason why a coordinate system is held, stopped or waits, if there is a reason.",
        );
        for (cs, state) in &states.systems {
            if let Some(reason) = &state.reason {
                self.value(
                    &format!("{name}{{cs=\"{cs}\",reason=\"{}\"}}", wire_name(reason)),
                    1,
                );
            }
        }
    }

    fn open_m_codes(&mut self, states: &States) {
        let name = "tandem_m_code_open_seconds";
        self.head(name, "Time for which a pending M code has been in its state.");
        let age_s = |since: &plc_api::types::Timestamp| {
            let since = since.to_system_time()?;
            Some(
                states
                    .now?
                    .duration_since(since)
                    .unwrap_or_default()
                    .as_secs_f64(),
            )
        };
        for (cs, pending) in &states.pending {
            for open in &pending.outputs {
                let (m, state) = (open.output.m, wire_name(&open.state));
                let age_s = age_s(&open.since).unwrap_or_default();
                // an M code has at most one pending output
                self.value(
                    &format!("{name}{{cs=\"{cs}\",m=\"{m}\",state=\"{state}\"}}"),
                    age_s,
                );
            }
        }
    }

    fn runs(&mut self, states: &States) {
        let of_run = |run: &Run| {
            [
                ("tandem_run_parts", run.parts),
                ("tandem_run_parts_done", run.parts_done),
            ]
        };
        let help = [
            "Ordered parts of the newest run.",
            "Completed parts of the newest run.",
        ];
        for (place, help) in help.into_iter().enumerate() {
            for (first, (cs, run)) in states.runs.iter().enumerate() {
                let (name, parts) = of_run(run)[place];
                if first == 0 {
                    self.head(name, help);
                }
                self.value(
                    &format!("{name}{{cs=\"{cs}\",program=\"{}\"}}", run.program),
                    parts,
                );
            }
        }
    }

    /// Writes the process metrics under their standard names. Omitted if the system does not provide them.
    pub(super) fn process(&mut self) {
        let usage = Usage::now();
        if let Some(cpu_s) = usage.cpu_s {
            self.number(
                "process_cpu_seconds_total",
                "Processor time used by the process on all cores.",
                cpu_s,
            );
        }
        if let Some(bytes) = usage.resident_bytes {
            self.number("process_resident_memory_bytes", "Memory of the process.", bytes);
        }
    }
}

/// Escapes the value of a label.
pub(super) fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\")
        .replace('"', "\\\"")
        .replace('\n', "\\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_in_a_label_ends_no_line_and_no_label() {
        assert_eq!(escaped("a\"b\\c\nd"), "a\\\"b\\\\c\\nd");
    }
}
