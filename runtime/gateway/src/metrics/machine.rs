//! Metrics of the machine's states: coordinate systems, pending M codes, runs, alarms, handlers.

use std::collections::BTreeMap;
use std::fmt;
use std::time::SystemTime;

use plc_protocol::execution::wire_name;
use plc_protocol::hub::Filter;
use plc_protocol::types::machine::ActiveAlarms;
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::output::Pending;
use plc_protocol::types::run::Run;
use plc_protocol::types::state::State;
use plc_protocol::types::topic::Topic;
use plc_protocol::types::{CoordinateSystemNumber, Timestamp};

use super::scrape::FamilyEncoder;
use crate::machine::Machine;

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

    /// Encodes the metrics of all states.
    pub(super) fn encode(&self, families: &mut FamilyEncoder) -> fmt::Result {
        self.encode_systems(families)?;
        self.encode_open_m_codes(families)?;
        self.encode_runs(families)?;
        let mut alarms = BTreeMap::<_, u32>::new();
        for alarm in &self.alarms.alarms {
            let cs = alarm.cs.map_or_else(String::new, |cs| cs.to_string());
            *alarms
                .entry((cs, alarm.number, wire_name(&alarm.severity)))
                .or_default() += 1;
        }
        families.gauges(
            "tandem_alarms_active",
            "Active alarms and warnings by number; cs is empty for those of the whole machine.",
            alarms.into_iter().map(|((cs, number, severity), count)| {
                let labels = [("cs", cs), ("number", number.to_string()), ("severity", severity)];
                (labels, count)
            }),
        )?;
        families.gauges(
            "tandem_handler_online",
            "1 while a handler of M codes is online, 0 while it is offline.",
            (self.handlers.iter()).map(|(id, online)| ([("handler", id.as_str())], u32::from(*online))),
        )
    }

    fn encode_systems(&self, families: &mut FamilyEncoder) -> fmt::Result {
        families.gauges(
            "tandem_execution",
            "1 for the state word of each coordinate system.",
            self.systems.iter().map(|(cs, state)| {
                let labels = [("cs", cs.to_string()), ("execution", wire_name(&state.execution))];
                (labels, 1_u32)
            }),
        )?;
        families.gauges(
            "tandem_reason",
            "1 for the reason why a coordinate system is held, stopped or waits, if there is a reason.",
            self.systems.iter().filter_map(|(cs, state)| {
                let reason = state.reason.as_ref()?;
                Some(([("cs", cs.to_string()), ("reason", wire_name(reason))], 1_u32))
            }),
        )
    }

    fn encode_open_m_codes(&self, families: &mut FamilyEncoder) -> fmt::Result {
        let age_s = |since: &Timestamp| {
            let since = since.to_system_time()?;
            Some(self.now?.duration_since(since).unwrap_or_default().as_secs_f64())
        };
        families.gauges(
            "tandem_m_code_open_seconds",
            "Time for which a pending M code has been in its state.",
            self.pending.iter().flat_map(|(cs, pending)| {
                pending.outputs.iter().map(move |open| {
                    // an M code has at most one pending output
                    let labels = [
                        ("cs", cs.to_string()),
                        ("m", open.output.m.to_string()),
                        ("state", wire_name(&open.state)),
                    ];
                    (labels, age_s(&open.since).unwrap_or_default())
                })
            }),
        )
    }

    /// Omitted if the machine has no run.
    fn encode_runs(&self, families: &mut FamilyEncoder) -> fmt::Result {
        if self.runs.is_empty() {
            return Ok(());
        }
        let values = |parts: fn(&Run) -> u32| {
            self.runs.iter().map(move |(cs, run)| {
                let labels = [("cs", cs.to_string()), ("program", run.program.to_string())];
                (labels, parts(run))
            })
        };
        families.gauges(
            "tandem_run_parts",
            "Ordered parts of the newest run.",
            values(|run| run.parts),
        )?;
        families.gauges(
            "tandem_run_parts_done",
            "Completed parts of the newest run.",
            values(|run| run.parts_done),
        )
    }
}

#[cfg(test)]
mod tests {
    use prometheus_client::encoding::prometheus_text;
    use prometheus_client::registry::Registry;

    use super::super::scrape::Scrape;
    use super::*;

    #[test]
    fn a_name_in_a_label_ends_no_line_and_no_label() {
        let states = States {
            handlers: BTreeMap::from([("a\"b\\c\nd".to_owned(), true)]),
            ..States::default()
        };
        let mut registry = Registry::default();
        registry.register_collector(Box::new(Scrape {
            broker: None,
            states,
            servo: None,
        }));
        let mut text = String::new();
        prometheus_text::encode(&mut text, &registry).unwrap();
        let line = r#"tandem_handler_online{handler="a\"b\\c\nd"} 1"#;
        assert!(text.lines().any(|one| one == line), "{text}");
    }
}
