//! States that can be read: the same messages as on MQTT, with the revision as `ETag`; and what a server makes of them.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use serde::Serialize;
use serde_json::Value;

use super::route::{Content, Route};
use crate::types::CoordinateSystemNumber;
use crate::types::machine::BrokerInUse;
use crate::types::machine::CoordinateSystemInfo;
use crate::types::topic::{CsTopic, Topic};

/// One state with its route.
#[derive(Debug)]
pub struct StateRow {
    topic: Topic,
    /// Where it is read.
    pub route: Route,
}

impl StateRow {
    /// The topic of the state; `cs` where it is a coordinate system's.
    pub fn topic(&self, cs: CoordinateSystemNumber) -> Topic {
        match &self.topic {
            Topic::CoordinateSystem(_, topic) => Topic::cs(cs, *topic),
            machine => machine.clone(),
        }
    }

    /// Name of the input whose state it is.
    pub fn input(&self) -> Option<&'static str> {
        self.route.pattern.strip_prefix("/cs/{cs}/inputs/")
    }
}

/// Every state that has a route.
pub static STATES: LazyLock<Vec<StateRow>> = LazyLock::new(|| {
    let machine = [
        (Topic::Birth, "/machine"),
        (Topic::Heartbeat, "/heartbeat"),
        (Topic::AlarmActive, "/alarms"),
    ];
    let of_cs = CsTopic::STATES.into_iter();
    let of_cs = of_cs.filter_map(|(topic, _)| Some((Topic::cs(0, topic), topic.route()?)));
    let rows = machine.into_iter().chain(of_cs).map(|(topic, pattern)| StateRow {
        route: Route::get(pattern, topic.summary()).answered(200, Content::Json(topic.form())),
        topic,
    });
    rows.collect()
});

/// All coordinate systems with their states.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CoordinateSystems {
    /// Ascending by number.
    pub coordinate_systems: Vec<WithState>,
}

/// A coordinate system with its state.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(inline))]
pub struct WithState {
    /// Which.
    #[serde(flatten)]
    pub info: CoordinateSystemInfo,
    /// The message of its state.
    #[cfg_attr(
        feature = "schema",
        schemars(with = "Option<crate::types::form::Enveloped<'static, crate::types::state::State>>")
    )]
    pub state: Option<Value>,
}

/// The messages of all inputs of a coordinate system, by name.
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

/// Whether the server answers, and has its MQTT broker.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Health {
    /// Of the server.
    pub status: HealthStatus,
    /// The external MQTT broker that it is connected to.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub broker: Option<BrokerInUse>,
}

/// The status of a server that answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum HealthStatus {
    /// Nothing is missing.
    Ok,
    /// No MQTT broker can be reached; HTTP and the machine work.
    Degraded,
}
