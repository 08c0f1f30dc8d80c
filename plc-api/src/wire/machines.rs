//! The machines that the HMI shows on one page, as this runtime knows them.

use serde::Serialize;

use crate::types::CoordinateSystemNumber;
use crate::types::machine::AlarmRecord;
use crate::types::output::PendingOutput;
use crate::types::start::StartConditions;
use crate::types::state::State;

/// Topics of a machine from which others are shown, below its root.
pub const TOPICS: [&str; 7] = [
    "presence",
    "heartbeat",
    "alarm/active",
    "cs/+/state",
    "cs/+/m_code/pending",
    "cs/+/start_conditions",
    "cs/+/time_left",
];

/// Machines beside this one.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "MachineList"))]
pub struct Machines {
    /// Addresses of the configuration, `[hmi] machines`, in their order.
    pub addresses: Vec<String>,
    /// The external broker that this runtime shares with others.
    pub broker: SharedBroker,
    /// Machines that are or were at the shared broker, ascending by name; at most 256.
    pub machines: Vec<MachineSeen>,
}

/// The broker at which other machines are heard.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum SharedBroker {
    /// The embedded one, which has this machine alone.
    #[default]
    None,
    /// It is being connected to.
    Connecting,
    /// What is heard there is here.
    Connected,
}

/// A machine as its messages tell.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MachineSeen {
    /// Its name.
    pub machine: String,
    /// Whether it is there.
    pub link: MachineLink,
    /// Age of its newest heartbeat, ms; `null`: none has arrived.
    pub age_ms: Option<u64>,
    /// Address of its HMI, where it says one.
    pub url: Option<String>,
    /// How many alarms are active.
    pub alarm_count: u32,
    /// The newest of them, at most 4.
    pub alarms: Vec<AlarmRecord>,
    /// What its coordinate systems do, ascending by number; at most 8.
    pub coordinate_systems: Vec<CoordinateSystemSeen>,
}

/// Whether a machine is there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum MachineLink {
    /// It is.
    Online,
    /// It has not said in time that it is there: what is told of it is old.
    Silent,
    /// It has said that it goes, or its connection was lost.
    Offline,
}

/// A coordinate system of another machine.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CoordinateSystemSeen {
    /// Its number.
    pub number: CoordinateSystemNumber,
    /// Its state.
    pub state: Option<State>,
    /// The output that it waits for.
    pub waiting_on: Option<PendingOutput>,
    /// Time to the end of the program that runs, s.
    pub left_s: Option<f64>,
    /// Share of the program that is done, 0 to 1.
    pub progress: Option<f64>,
    /// What prevents a start of its loaded program; null: it has not said so.
    pub start_conditions: Option<StartConditions>,
}
