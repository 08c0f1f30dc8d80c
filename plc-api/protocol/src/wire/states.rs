//! States that clients can read by REST: the same messages as on MQTT, with the revision as `ETag`, and
//! states that only a server has.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use serde::Serialize;
use serde_json::Value;

use super::path_parameter::{CS, IO_NAME, PathParameter};
use super::route::{Content, Route};
use super::row::number;
use super::subject::Subject;
use crate::supervisor::TaskFault;
use crate::types::io::{IoPoint, IoSide};
use crate::types::machine::BrokerInUse;
use crate::types::machine::CoordinateSystemInfo;
use crate::types::topic::{CsTopic, Topic};

/// One state with its route.
#[derive(Debug)]
pub struct StateRow {
    of: StateOf,
    /// Route on which the state is read.
    pub route: Route,
}

/// The part of the machine that has the state.
#[derive(Debug)]
enum StateOf {
    Machine(Topic),
    CoordinateSystem(CsTopic),
    Io(IoSide),
}

impl StateRow {
    fn new(of: StateOf, subject: Subject, pattern: &'static str) -> Self {
        let params: &'static [PathParameter] = match of {
            StateOf::Machine(_) => &[],
            StateOf::CoordinateSystem(_) => &[CS],
            StateOf::Io(_) => &[IO_NAME],
        };
        let mut row = Self {
            of,
            route: Route::get(subject, pattern, params, ""),
        };
        let topic = row.topic(&[]);
        row.route.summary = topic.summary();
        row.route.answer = (200, Content::Json(topic.form()));
        row
    }

    /// Returns the topic of the state; `params` are the values of the names in the path of its route.
    pub fn topic(&self, params: &[(&str, &str)]) -> Topic {
        let level = |name: &str| {
            let mut named = params.iter().filter(|(known, _)| *known == name);
            named.next().map_or("", |(_, level)| *level)
        };
        match &self.of {
            StateOf::Machine(topic) => topic.clone(),
            StateOf::CoordinateSystem(topic) => Topic::cs(number(level("cs")).unwrap_or_default(), *topic),
            StateOf::Io(side) => Topic::Io(IoPoint {
                side: *side,
                name: level("name").to_owned(),
            }),
        }
    }

    /// Returns the name of the input if the state is that of an input, otherwise `None`.
    pub fn input(&self) -> Option<&'static str> {
        self.route.pattern.strip_prefix("/cs/{cs}/inputs/")
    }
}

/// All states that have a route.
pub static STATES: LazyLock<Vec<StateRow>> = LazyLock::new(|| {
    let machine = [
        (Topic::Birth, Subject::Machine, "/machine"),
        (Topic::Heartbeat, Subject::Machine, "/heartbeat"),
        (Topic::AlarmActive, Subject::Alarms, "/alarms"),
        (Topic::Variables, Subject::Values, "/variables"),
        (Topic::StoredData, Subject::Machine, "/stored_data"),
    ];
    let of_io = [
        (IoSide::In, "/io/{side=in}/{name}"),
        (IoSide::Out, "/io/{side=out}/{name}"),
    ];
    let of_cs = CsTopic::STATES.into_iter();
    let of_cs = of_cs.filter_map(|(topic, _)| {
        let pattern = topic.route()?;
        Some(StateRow::new(
            StateOf::CoordinateSystem(topic),
            subject_of(topic),
            pattern,
        ))
    });
    machine
        .map(|(topic, subject, pattern)| StateRow::new(StateOf::Machine(topic), subject, pattern))
        .into_iter()
        .chain(of_io.map(|(side, pattern)| StateRow::new(StateOf::Io(side), Subject::Inputs, pattern)))
        .chain(of_cs)
        .collect()
});

/// Returns the subject of the route that reads this state of a coordinate system.
fn subject_of(topic: CsTopic) -> Subject {
    match topic {
        CsTopic::Pending => Subject::MCodes,
        CsTopic::OptionalSkip
        | CsTopic::OptionalStop
        | CsTopic::SingleBlock
        | CsTopic::DryRun
        | CsTopic::Interlock
        | CsTopic::StartLock => Subject::Inputs,
        CsTopic::Lease => Subject::Commands,
        CsTopic::Variables | CsTopic::WorkOffsets => Subject::Values,
        _ => Subject::States,
    }
}

/// All coordinate systems with their states.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "CoordinateSystemList"))]
pub struct CoordinateSystems {
    /// Coordinate systems with their states, ascending by number.
    pub coordinate_systems: Vec<WithState>,
}

/// A coordinate system with its state.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(inline))]
pub struct WithState {
    /// Description of the coordinate system.
    #[serde(flatten)]
    pub info: CoordinateSystemInfo,
    /// The last message of the state, as on MQTT.
    #[cfg_attr(
        feature = "schema",
        schemars(with = "Option<crate::types::form::MessageEnvelope<'static, crate::types::state::State>>")
    )]
    pub state: Option<Value>,
}

/// The last messages of all inputs of a coordinate system, by name.
#[derive(Debug, Serialize)]
pub struct Inputs(pub BTreeMap<&'static str, Value>);

#[cfg(feature = "schema")]
impl schemars::JsonSchema for Inputs {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Inputs".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        let inputs = STATES.iter().filter_map(|row| match row.route.answer {
            (_, Content::Json(form)) => {
                let message = format!("#/components/schemas/{}", (form.name)());
                Some((row.input()?, serde_json::json!({ "$ref": message })))
            }
            _ => None,
        });
        let inputs: BTreeMap<_, _> = inputs.collect();
        schemars::json_schema!({"type": "object", "properties": inputs, "required": []})
    }
}

/// All inputs and outputs of the plant, each with the last message of its state.
#[derive(Debug, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AllIo {
    /// Inputs by name.
    #[serde(rename = "in")]
    #[cfg_attr(
        feature = "schema",
        schemars(
            with = "BTreeMap<String, crate::types::form::MessageEnvelope<'static, crate::types::io::IoState>>"
        )
    )]
    pub inputs: BTreeMap<String, Value>,
    /// Outputs by name.
    #[serde(rename = "out")]
    #[cfg_attr(
        feature = "schema",
        schemars(
            with = "BTreeMap<String, crate::types::form::MessageEnvelope<'static, crate::types::io::IoState>>"
        )
    )]
    pub outputs: BTreeMap<String, Value>,
}

/// Health of the server, its MQTT broker, and all tasks of the runtime.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Health {
    /// Status of the server.
    pub status: HealthStatus,
    /// The external MQTT broker to which the server is connected; absent without a connection.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub broker: Option<BrokerInUse>,
    /// True if hold, stop and abort need no login (`[hmi] stop_without_login`).
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub stop_without_login: bool,
    /// Tasks and threads of the runtime that have failed since its start.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub faults: Vec<TaskFault>,
}

/// The status of a server that answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum HealthStatus {
    /// The server, its broker and all tasks work.
    Ok,
    /// No MQTT broker can be reached, or a task has failed; HTTP and the machine work.
    Degraded,
    /// A fault has stopped the machine or a coordinate system until the runtime is restarted.
    Failed,
}
