//! Description of a machine: presence, birth, alarms.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::alarm_text::AlarmWords;
use super::io::IoDeclarations;
use super::m_code::DeclaredParams;
pub use super::m_code::{ServedMCode, ServedMCodesFile};
use super::output::Timing;
use super::{CoordinateSystemNumber, Timestamp};

/// Payload of `presence`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Presence {
    /// False if the runtime has ended or its connection was lost.
    pub online: bool,
    /// Time when the runtime started.
    pub started_at: Timestamp,
    /// Version of the runtime.
    pub version: String,
    /// External MQTT broker to which the runtime is connected; absent with the embedded broker, and without a
    /// connection.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub broker: Option<BrokerInUse>,
    /// Validity of this presence, ms; the runtime publishes it again at a third of this time. A connected
    /// client that has received no presence for this time may treat the runtime as offline. Absent if the
    /// presence is not repeated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expires_ms: Option<u64>,
    /// Address of the HMI as other computers reach it, if the configuration sets it (`[http] public_url`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub url: Option<String>,
}

/// An external MQTT broker to which the runtime is connected.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BrokerInUse {
    /// Address of the broker, such as `mqtt://10.0.0.7:1883`.
    pub address: String,
    /// Time when the connection was established.
    pub since: Timestamp,
}

/// Payload of `birth`: description of the machine. Only `serves` changes while the runtime runs.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Birth {
    /// Machine name.
    pub machine: String,
    /// Data of the nameplate.
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

/// Data of a machine's nameplate: the table `[identification]` of its configuration. Entries that are not
/// configured are absent.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Identification {
    /// Name of the manufacturer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub manufacturer: Option<String>,
    /// Manufacturer's name for machines of this type.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// Serial number that the manufacturer assigned.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial_number: Option<String>,
    /// Globally unique identifier of the machine.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub product_instance_uri: Option<String>,
    /// Location of the machine.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub location: Option<String>,
    /// Year in which the machine was built.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub year_of_construction: Option<u16>,
}

/// One coordinate system.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CoordinateSystemInfo {
    /// Number of the coordinate system.
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
    /// Lowest and highest machine position, mm or degrees; null for a motor without soft limits.
    pub soft_limits: Option<[f64; 2]>,
    /// Highest velocity, mm/s or degrees/s (spindle: r/min).
    pub max_velocity: f64,
}

/// Settings of one M code.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MCodeInfo {
    /// Time at which the M code is issued.
    pub timing: Timing,
    /// Time limit of the reset, ms.
    pub timeout_ms: Option<u64>,
    /// Text that `state` shows while the program waits for the M code.
    pub wait_state: Option<String>,
    /// Name of the M code in the configuration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Parameters of the M code in the configuration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub params: Option<DeclaredParams>,
}

/// Limits of the interface.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Limits {
    /// Largest number of open outputs in one coordinate system; at this limit the interpreter waits.
    pub open_outputs_max: u32,
    /// Largest size of one program, bytes.
    pub program_bytes_max: u64,
}

/// Severity of an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum AlarmSeverity {
    /// Information for the operator; nothing is stopped.
    Warning,
    /// Stops the coordinate system of the alarm, or the whole machine.
    #[default]
    Alarm,
}

/// One alarm: payload of `alarm/event`, and an entry of `alarm/active`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AlarmRecord {
    /// Id of this occurrence of the alarm.
    pub id: u64,
    /// Warning or alarm.
    pub severity: AlarmSeverity,
    /// Number of the alarm: 1 to 9999 for an alarm of the runtime's table; 10000 + code for a handler's
    /// alarm.
    pub number: u16,
    /// Description of the event.
    pub text: String,
    /// Remedy, if the alarm table, the configuration or the handler provides one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub remedy: Option<String>,
    /// Text and remedy in other languages, by language tag such as `de`, if the configuration or the handler
    /// provides them.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub languages: BTreeMap<String, AlarmWords>,
    /// The coordinate system that the alarm stopped; null for all.
    pub cs: Option<CoordinateSystemNumber>,
    /// Program number.
    pub program: Option<u16>,
    /// Line of the source file.
    pub line: Option<u32>,
    /// Column of the source line.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub column: Option<u32>,
    /// Time at which the alarm was raised.
    pub raised_at: Timestamp,
    /// Time at which the alarm was cleared; null while it is active.
    pub cleared_at: Option<Timestamp>,
    /// Name of the operator who acknowledged the alarm; null if it is not acknowledged.
    pub acknowledged_by: Option<String>,
}

/// Payload of `alarm/raise`: an alarm of a sequence program that belongs to no output, such as low air
/// pressure.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct AlarmRaise {
    /// The coordinate system that the alarm stops; null for all.
    pub cs: Option<CoordinateSystemNumber>,
    /// Code, 0 to 9999; the alarm number is 10000 + this code.
    pub code: u16,
    /// Description of the event, 1 to 1000 characters.
    pub text: String,
}

/// Payload of `alarm/active`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ActiveAlarms {
    /// Active alarms, ascending by id.
    pub alarms: Vec<AlarmRecord>,
}
