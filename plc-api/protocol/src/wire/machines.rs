//! The machines that the HMI shows on one page, according to the messages that this runtime receives.

use serde::Serialize;

use crate::types::CoordinateSystemNumber;
use crate::types::machine::AlarmRecord;
use crate::types::output::PendingOutput;
use crate::types::start::StartConditions;
use crate::types::state::State;

/// Topics of another machine that the page shows, below the root of that machine.
pub const TOPICS: [&str; 7] = [
    "presence",
    "heartbeat",
    "alarm/active",
    "cs/+/state",
    "cs/+/m_code/pending",
    "cs/+/start_conditions",
    "cs/+/time_left",
];

/// The other machines that the HMI shows.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "MachineList"))]
pub struct Machines {
    /// Addresses in `[hmi] machines` of the configuration, in the order of the configuration.
    pub addresses: Vec<String>,
    /// The external broker that this runtime shares with other machines.
    pub broker: SharedBroker,
    /// Machines that are or were connected to the shared broker, ascending by name; at most 256.
    pub machines: Vec<MachineSeen>,
}

/// State of the broker that connects the machines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum SharedBroker {
    /// The runtime uses the embedded broker, to which only this machine is connected.
    #[default]
    None,
    /// The connection is being established.
    Connecting,
    /// The connection is established, and `machines` contains the received data.
    Connected,
}

/// A machine according to its messages.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MachineSeen {
    /// Name of the machine.
    pub machine: String,
    /// Whether the machine is online.
    pub link: MachineLink,
    /// Age of the newest heartbeat of the machine, ms; `null` if no heartbeat has been received.
    pub age_ms: Option<u64>,
    /// Address of the HMI of the machine, if the machine publishes this address.
    pub url: Option<String>,
    /// Number of active alarms of the machine.
    pub alarm_count: u32,
    /// The newest active alarms, at most 4.
    pub alarms: Vec<AlarmRecord>,
    /// States of the coordinate systems, ascending by number; at most 8.
    pub coordinate_systems: Vec<CoordinateSystemSeen>,
}

/// Whether a machine is online.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum MachineLink {
    /// The machine is online.
    Online,
    /// No presence was received within `expires_ms`; the data shown are stale.
    Silent,
    /// The machine has announced that it leaves, or its connection was lost.
    Offline,
}

/// A coordinate system of another machine.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CoordinateSystemSeen {
    /// Number of the coordinate system.
    pub number: CoordinateSystemNumber,
    /// State of the coordinate system.
    pub state: Option<State>,
    /// The output for which the program waits.
    pub waiting_on: Option<PendingOutput>,
    /// Time to the end of the program in progress, s.
    pub left_s: Option<f64>,
    /// Completed share of the program, 0 to 1.
    pub progress: Option<f64>,
    /// Obstacles of a start of the loaded program; null if the machine has not published them.
    pub start_conditions: Option<StartConditions>,
}
