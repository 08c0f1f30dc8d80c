//! What a machine is: presence, birth, alarms.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::alarm_text::AlarmWords;
use super::io::IoDeclarations;
use super::m_code::DeclaredParams;
pub use super::m_code::{Served, ServedMCode};
use super::output::Timing;
use super::{CoordinateSystemNumber, Timestamp};

/// Payload of `presence`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Presence {
    /// False: the runtime has gone, or its connection was lost.
    pub online: bool,
    /// When it started.
    pub started_at: Timestamp,
    /// Its version.
    pub version: String,
    /// The external MQTT broker that it is connected to; absent with the embedded one, and while it has no connection.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub broker: Option<BrokerInUse>,
    /// It is published again at a third of this time, ms; a client that has been connected and has not heard it for as long may
    /// take the runtime for gone. Absent: it is not published again.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expires_ms: Option<u64>,
    /// Address of its HMI as others reach it, where the configuration says it (`[http] public_url`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub url: Option<String>,
}

/// An external MQTT broker to which the runtime is connected.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BrokerInUse {
    /// Its address, such as `mqtt://10.0.0.7:1883`.
    pub address: String,
    /// Since when the connection is there.
    pub since: Timestamp,
}

/// Payload of `birth`: what the machine is. Only `serves` changes while the runtime runs.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Birth {
    /// Machine name.
    pub machine: String,
    /// What its nameplate says.
    #[serde(default)]
    pub identification: Identification,
    /// Servo period, microseconds.
    pub servo_period_us: u64,
    /// Coordinate systems, ascending.
    pub coordinate_systems: Vec<CoordinateSystemInfo>,
    /// Motors, ascending.
    pub motors: Vec<MotorInfo>,
    /// M codes that have settings, by number.
    pub m_codes: BTreeMap<u16, MCodeInfo>,
    /// M codes that are served now, ascending; at most 1000.
    #[serde(default)]
    pub serves: Vec<ServedMCode>,
    /// Inputs and outputs of the plant.
    #[serde(default)]
    pub io: IoDeclarations,
    /// Limits of the interface.
    pub limits: Limits,
}

/// What the nameplate of a machine says: the table `[identification]` of its configuration. What is not written there is absent.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Identification {
    /// Who built it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub manufacturer: Option<String>,
    /// What its builder calls machines of its kind.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// What its builder tells it from others by.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial_number: Option<String>,
    /// Names it among all machines in the world.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub product_instance_uri: Option<String>,
    /// Where it stands.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub location: Option<String>,
    /// When it was built.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub year_of_construction: Option<u16>,
}

/// One coordinate system.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CoordinateSystemInfo {
    /// Its number.
    pub number: CoordinateSystemNumber,
    /// Motor number by axis letter.
    pub axes: BTreeMap<String, u16>,
    /// Motor number of the spindle.
    pub spindle: Option<u16>,
    /// NC dialect.
    pub dialect: String,
    /// `mm` or `inch` at start; positions are always mm.
    pub units: String,
}

/// One motor.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MotorInfo {
    /// CNC motor number.
    pub number: u16,
    /// `linear` (mm), `rotary` (deg) or `spindle` (r/min).
    pub kind: String,
    /// Lowest and highest machine position.
    pub soft_limits: Option<[f64; 2]>,
    /// Units per second (spindle: r/min).
    pub max_velocity: f64,
}

/// Settings of one M code.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MCodeInfo {
    /// When it is output.
    pub timing: Timing,
    /// Time limit of its reset, ms.
    pub timeout_ms: Option<u64>,
    /// What the state shows while it is waited for.
    pub wait_state: Option<String>,
    /// Its name in the configuration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Its parameters in the configuration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub params: Option<DeclaredParams>,
}

/// Limits of the interface.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Limits {
    /// Outputs that may be open in one coordinate system; more hold back the interpreter.
    pub open_outputs_max: u32,
    /// Bytes of one program.
    pub program_bytes_max: u64,
}

/// How much an alarm weighs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum AlarmSeverity {
    /// Worth knowing; nothing stops.
    Warning,
    /// Stops its coordinate system.
    #[default]
    Alarm,
}

/// One alarm: payload of `alarm/event`, and an entry of `alarm/active`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AlarmRecord {
    /// Names this occurrence.
    pub id: u64,
    /// Warning or alarm.
    pub severity: AlarmSeverity,
    /// 1 to 9999: the runtime's table; 10000 + code: a handler's.
    pub number: u16,
    /// What happened.
    pub text: String,
    /// What to do, where the alarm table, the configuration or the handler says it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub remedy: Option<String>,
    /// What happened and what to do in other languages, by their tags, such as `de`, where the configuration or the handler says it.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub languages: BTreeMap<String, AlarmWords>,
    /// The coordinate system that it stopped; null: all.
    pub cs: Option<CoordinateSystemNumber>,
    /// Program number.
    pub program: Option<u16>,
    /// Line of the source file.
    pub line: Option<u32>,
    /// Column of the source line.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub column: Option<u32>,
    /// When it was raised.
    pub raised_at: Timestamp,
    /// When it was cleared.
    pub cleared_at: Option<Timestamp>,
    /// Who acknowledged it.
    pub acknowledged_by: Option<String>,
}

/// Payload of `alarm/raise`: an alarm of a sequence program that belongs to no output, such as low air pressure.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct AlarmRaise {
    /// The coordinate system that it stops; null: all.
    pub cs: Option<CoordinateSystemNumber>,
    /// 0 to 9999; its number is 10000 + this.
    pub code: u16,
    /// What happened, 1 to 1000 characters.
    pub text: String,
}

/// Payload of `alarm/active`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ActiveAlarms {
    /// Ascending by id.
    pub alarms: Vec<AlarmRecord>,
}
