//! The configuration: `tandem.toml` as a user writes it.
//!
//! The doc comments, ranges and units of the keys are the reference that `tandem explain` and the book show.
//! A key that does not exist is an error that names the key and the nearest existing one. [`Config::resolve`]
//! converts the values into the settings of the stages.

mod alarm;
mod broker;
pub mod declared;
mod demo;
mod dgshape;
mod error;
pub mod explain;
mod handlers;
mod hmi;
mod identification;
mod input;
mod io;
mod limits;
mod machine;
mod programs;
mod reference;
mod resolve;
mod text;
mod variables;
mod words;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use plc_protocol::types::m_code::ParamDeclaration;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{Deserializer, Error as _};
use serde::{Deserialize, Serialize};
use tandem_gateway::MtconnectVersion;
use tandem_interp::{Dialect, dialects};
use tandem_model::settings::{CompensationFeed, LowOverride, MotorKind, Overcut, ShortBlock, Unit};

pub use alarm::AlarmConfig;
pub use broker::{Broker, ExternalBroker};
pub use dgshape::DgshapeConfig;
pub use error::ConfigError;
pub use handlers::HandlersConfig;
pub use hmi::HmiConfig;
pub use identification::IdentificationConfig;
pub use input::{InputConfig, LockConfig, LockSourceConfig};
pub use io::{IoConfig, IoPointConfig};
use limits::{POSITION_MAX, RATE_MAX, RATE_MIN, TIME_MAX_MS};
pub use machine::{ConfiguredSystem, MCodeSettings, Machine, ProgramSource, Stock, UnhandledReaction};
pub use programs::ProgramsConfig;
pub use reference::{ConfigKey, ConfigWord};
pub use variables::{PublishedConfig, VariablesConfig};
use words::{CompensationFeedWord, LowOverrideWord, MotorKindWord, OvercutWord, ShortBlockWord, UnitWord};
pub use words::{EncoderKind, OnBusLoss, RoundKind};

/// A whole configuration.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// `[machine]`
    #[serde(default)]
    pub machine: MachineConfig,
    /// `[identification]`
    #[serde(default)]
    pub identification: IdentificationConfig,
    /// `[[motor]]`
    #[serde(default)]
    pub motor: Vec<MotorConfig>,
    /// `[[coordinate_system]]`
    #[serde(default)]
    pub coordinate_system: Vec<CoordinateSystemConfig>,
    /// `[[tool]]`
    #[serde(default)]
    pub tool: Vec<ToolConfig>,
    /// `[m_code.N]`
    #[serde(default)]
    pub m_code: BTreeMap<String, MCodeConfig>,
    /// `[alarm.N]`
    #[serde(default)]
    pub alarm: BTreeMap<String, AlarmConfig>,
    /// `[input]`
    #[serde(default)]
    pub input: InputConfig,
    /// `[io]`
    #[serde(default)]
    pub io: IoConfig,
    /// `[handlers]`
    #[serde(default)]
    pub handlers: HandlersConfig,
    /// `[variables]`
    #[serde(default)]
    pub variables: VariablesConfig,
    /// `[[simulated_skip]]`
    #[serde(default)]
    pub simulated_skip: Vec<SimulatedSkipConfig>,
    /// `[[simulated_round]]`
    #[serde(default)]
    pub simulated_round: Vec<SimulatedRoundConfig>,
    /// `[mqtt]`
    #[serde(default)]
    pub mqtt: MqttConfig,
    /// `[http]`
    #[serde(default)]
    pub http: HttpConfig,
    /// `[hmi]`
    #[serde(default)]
    pub hmi: HmiConfig,
    /// `[tls]`
    pub tls: Option<TlsConfig>,
    /// `[mtconnect]`
    pub mtconnect: Option<MtconnectConfig>,
    /// `[programs]`
    #[serde(default)]
    pub programs: ProgramsConfig,
    /// Folder to which relative paths refer.
    #[serde(skip)]
    pub base_dir: PathBuf,
    /// Texts of programs that are part of the executable, by their path in the configuration.
    #[serde(skip)]
    pub embedded_programs: BTreeMap<&'static str, &'static str>,
    /// True for the built-in demo machine, which has its own sequence program.
    #[serde(skip)]
    pub is_demo: bool,
    #[serde(skip)]
    places: text::KeyPositions,
}

/// `[machine]`
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MachineConfig {
    /// MQTT topic level: lower-case letters, digits and hyphens, 1 to 32.
    pub name: String,
    /// Servo period.
    #[schemars(range(min = 125, max = 10_000), extend("x-unit" = "us"))]
    pub servo_period_us: u64,
    /// Delay of a servo cycle, while motors move, from which the motion is held (`FEED_HOLD`, reason
    /// `SERVO_LATE`).
    #[schemars(range(min = 25, max = 60_000), extend("x-unit" = "ms"))]
    pub servo_late_ms: u64,
    /// Age at which a presence of the runtime expires. The presence is published again every third of this time; a
    /// client that has not received it for this long considers the machine offline.
    #[schemars(range(min = 300, max = 3_600_000), extend("x-unit" = "ms"))]
    pub presence_expires_ms: u64,
    /// Folder for programs and all other persistent data.
    pub data_dir: PathBuf,
    /// File that describes the M codes of the sequence programs and their parameters. While no handler is
    /// online, `tandem check`, `tandem explain` and editors read this file. `SequenceProgram::served` writes
    /// the file, or `curl` of `/api/v1/machine`. A running machine asks its handlers instead.
    pub served: Option<PathBuf>,
}

impl Default for MachineConfig {
    fn default() -> Self {
        Self {
            name: "mill-1".into(),
            servo_period_us: 1000,
            servo_late_ms: 100,
            presence_expires_ms: 30_000,
            data_dir: "tandem-data".into(),
            served: None,
        }
    }
}

/// `[[motor]]`
#[derive(Debug, Clone, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MotorConfig {
    /// CNC motor number.
    pub number: u16,
    /// Axis or spindle that the motor moves.
    #[serde(with = "MotorKindWord")]
    pub kind: MotorKind,
    /// Highest speed (spindle: r/min).
    #[schemars(range(min = RATE_MIN, max = RATE_MAX), extend("x-unit" = "units/s"))]
    pub max_velocity: f64,
    /// Highest acceleration (spindle: r/min per s).
    #[schemars(range(min = RATE_MIN, max = RATE_MAX), extend("x-unit" = "units/s^2"))]
    pub max_acceleration: f64,
    /// Highest jerk of G00, G28, G30, G31 and, with G500, of feed motion. With G501, it follows from ta, td and ts.
    #[schemars(range(min = RATE_MIN, max = RATE_MAX), extend("x-unit" = "units/s^3"))]
    pub max_jerk: Option<f64>,
    /// Speed of G00; default `max_velocity`.
    #[schemars(range(min = RATE_MIN, max = RATE_MAX), extend("x-unit" = "units/s"))]
    pub rapid_velocity: Option<f64>,
    /// Acceleration of G00; default `max_acceleration`.
    #[schemars(range(min = RATE_MIN, max = RATE_MAX), extend("x-unit" = "units/s^2"))]
    pub rapid_acceleration: Option<f64>,
    /// Speed of G31; default a tenth of `max_velocity`.
    #[schemars(range(min = RATE_MIN, max = RATE_MAX), extend("x-unit" = "units/s"))]
    pub skip_velocity: Option<f64>,
    /// Position window for exact stop.
    #[serde(default = "hundredth")]
    #[schemars(range(min = RATE_MIN, max = POSITION_MAX), extend("x-unit" = "units"))]
    pub in_position: f64,
    /// Lowest and highest machine position; without this key, the motor has no soft limits.
    #[serde(default, deserialize_with = "soft_limits")]
    #[schemars(inner(range(min = -POSITION_MAX, max = POSITION_MAX)), extend("x-unit" = "units"))]
    pub soft_limits: Option<[f64; 2]>,
    /// First to fourth reference point as machine positions; all four are required.
    #[serde(default, deserialize_with = "reference_points")]
    #[schemars(inner(range(min = -POSITION_MAX, max = POSITION_MAX)), extend("x-unit" = "units"))]
    pub reference_points: [f64; 4],
    /// Time limit for reaching the in-position window.
    #[serde(default = "number::<2000>")]
    #[schemars(range(min = RATE_MIN, max = TIME_MAX_MS), extend("x-unit" = "ms"))]
    pub in_position_timeout_ms: f64,
    /// Following error of the simulated drive as a time constant.
    #[serde(default)]
    #[schemars(range(min = 0.0, max = 10_000.0), extend("x-unit" = "ms"))]
    pub lag_ms: f64,
    /// Encoder of the simulated drive. Both kinds keep the position over restarts.
    #[serde(default)]
    pub encoder: EncoderKind,
    /// Machine position of the simulated drive at the first start, within `soft_limits`; default 0, or the limit
    /// nearest to it.
    #[schemars(range(min = -POSITION_MAX, max = POSITION_MAX), extend("x-unit" = "units"))]
    pub start_at: Option<f64>,
    /// Spindle: speed during orientation.
    #[serde(default = "number::<100>")]
    #[schemars(range(min = RATE_MIN, max = RATE_MAX), extend("x-unit" = "r/min"))]
    pub orientation_velocity: f64,
    /// Spindle: angle of orientation.
    #[serde(default)]
    #[schemars(range(min = -POSITION_MAX, max = POSITION_MAX), extend("x-unit" = "deg"))]
    pub orientation_position: f64,
    /// Spindle: the stock sequence program resets M03 and M04 when the speed differs from the commanded speed by at
    /// most this percentage. The program resets M05 when the spindle is at rest.
    #[serde(default = "number::<10>")]
    #[schemars(range(min = 0.1, max = 100.0), extend("x-unit" = "%"))]
    pub at_speed_percent: f64,
}

/// Reads exactly `N` numbers. Reason: without this check, an array would ignore further numbers.
fn exactly<'de, const N: usize, D: Deserializer<'de>>(
    deserializer: D,
    what: &str,
) -> Result<[f64; N], D::Error> {
    let given = Vec::<f64>::deserialize(deserializer)?;
    let count = given.len();
    let wrong = |_| D::Error::custom(format!("{count} values: write {what}"));
    given.try_into().map_err(wrong)
}

fn soft_limits<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<[f64; 2]>, D::Error> {
    exactly(deserializer, "soft_limits = [lowest, highest]").map(Some)
}

fn reference_points<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f64; 4], D::Error> {
    exactly(
        deserializer,
        "the 1st to 4th of reference_points, such as [0.0, 0.0, 0.0, 0.0]",
    )
}

/// Returns a default value that is an integer.
fn number<const VALUE: u32>() -> f64 {
    f64::from(VALUE)
}

fn count<const VALUE: usize>() -> usize {
    VALUE
}

fn hundredth() -> f64 {
    0.01
}

/// `[[coordinate_system]]`
#[derive(Debug, Clone, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CoordinateSystemConfig {
    /// Number of the coordinate system.
    #[schemars(range(min = 1))]
    pub number: u8,
    /// NC dialect of its programs.
    #[serde(
        default = "dialects::default_dialect",
        deserialize_with = "dialect",
        skip_serializing
    )]
    #[schemars(schema_with = "dialect_schema")]
    pub dialect: &'static Dialect,
    /// Axis letter to motor number.
    pub axes: BTreeMap<String, u16>,
    /// Motor number of the spindle; without this key, the coordinate system has no spindle.
    pub spindle: Option<u16>,
    /// Highest feedrate, in G20 in inch/min (manual, G20 and G21). The limits of the motors apply as well.
    #[serde(default = "number::<10_000>")]
    #[schemars(range(min = RATE_MIN, max = 1e9), extend("x-unit" = "units/min"))]
    pub max_feedrate: f64,
    /// Feedrate until a program sets F, in G20 in inch/min; 0: F must be programmed.
    #[serde(default)]
    #[schemars(range(min = 0.0, max = 1e9), extend("x-unit" = "units/min"))]
    pub default_feedrate: f64,
    /// Acceleration time until a program sets ta. Dialect dgshape has no ta; its ramps follow the limits of the motors.
    #[serde(default = "number::<100>")]
    #[schemars(range(min = 0.0, max = 250_000.0), extend("x-unit" = "ms"))]
    pub default_ta_ms: f64,
    /// Deceleration time until a program sets td.
    #[serde(default = "number::<100>")]
    #[schemars(range(min = 0.0, max = 250_000.0), extend("x-unit" = "ms"))]
    pub default_td_ms: f64,
    /// Jerk time until a program sets ts.
    #[serde(default = "number::<50>")]
    #[schemars(range(min = 0.0, max = 125_000.0), extend("x-unit" = "ms"))]
    pub default_ts_ms: f64,
    /// Unit of lengths when a program starts.
    #[serde(default, with = "UnitWord")]
    pub units: Unit,
    /// Program number to file, for the programs that are loaded into the store at the start.
    #[serde(default)]
    pub programs: BTreeMap<String, String>,
    /// Feedrate of blocks that move rotary axes only; 0: F applies.
    #[serde(default)]
    #[schemars(range(min = 0.0, max = 1e9), extend("x-unit" = "deg/min"))]
    pub rotary_feedrate: f64,
    /// Feedrate of dry run; 0: `max_feedrate`.
    #[serde(default)]
    #[schemars(range(min = 0.0, max = 1e9), extend("x-unit" = "units/min"))]
    pub dry_run_feedrate: f64,
    /// Reaction to a block that is too short for its ramps (M1b.4).
    #[serde(default, with = "ShortBlockWord")]
    pub short_block: ShortBlock,
    /// Largest distance of the path from the programmed one with G500 (M1d.8), rotary axes in degrees; 0: as with G501.
    #[serde(default)]
    #[schemars(range(min = 0.0, max = 10.0), extend("x-unit" = "mm"))]
    pub path_tolerance: f64,
    /// Distance of the path from a programmed corner above which `tandem check` warns (W0020); 0: no warning.
    #[serde(default)]
    #[schemars(range(min = 0.0, max = 1e6), extend("x-unit" = "mm"))]
    pub corner_warning: f64,
    /// Greatest amount by which the radius R of an arc may be too small.
    #[serde(default = "hundredth")]
    #[schemars(range(min = 0.0, max = 1e6), extend("x-unit" = "mm"))]
    pub arc_radius_tolerance: f64,
    /// Greatest difference between the radii at both ends of an arc; 0: every difference makes a spiral.
    #[serde(default)]
    #[schemars(range(min = 0.0, max = 1e6), extend("x-unit" = "mm"))]
    pub spiral_tolerance: f64,
    /// Path on which F applies in cutter compensation.
    #[serde(default, with = "CompensationFeedWord")]
    pub compensation_feed: CompensationFeed,
    /// Reaction if the tool would cut into another block.
    #[serde(default, with = "OvercutWord")]
    pub overcut: Overcut,
    /// Effect of a feed override below 100 percent with G500 (M1i.1).
    #[serde(default, with = "LowOverrideWord", rename = "override")]
    pub low_override: LowOverride,
    /// Time in which the override changes by 100 percent; with G500 and `replan`, the limits of the motors apply.
    #[serde(default = "number::<1000>")]
    #[schemars(range(min = 1.0, max = 60_000.0), extend("x-unit" = "ms"))]
    pub override_slew_ms: f64,
    /// Time in which a feed hold reduces the speed from 100 percent to rest.
    #[serde(default = "number::<200>")]
    #[schemars(range(min = 1.0, max = 60_000.0), extend("x-unit" = "ms"))]
    pub hold_slew_ms: f64,
    /// Number of blocks that are read ahead of the motion.
    #[serde(default = "count::<10_000>")]
    #[schemars(range(min = 16, max = 1_000_000))]
    pub pre_read_blocks: usize,
    /// Blocks in a row without motion, wait or output after which a program makes no progress (alarm 21). Blocks of a
    /// loop that reads P or Q are not counted, because such a loop waits for another program or a client to write them.
    #[serde(default = "count::<1_000_000>")]
    #[schemars(range(min = 1000, max = 1_000_000_000))]
    pub blocks_without_motion_max: usize,
    /// Largest number of outputs that are pending at the same time.
    #[serde(default = "count::<64>")]
    #[schemars(range(min = 1, max = 1024))]
    pub open_outputs_max: usize,
    /// `G54` to `G59`: axis letter to offset.
    #[serde(default)]
    pub work_offset: BTreeMap<String, BTreeMap<String, f64>>,
    /// `[coordinate_system.dgshape]`: settings that dialect dgshape leaves to the machine.
    #[serde(skip_serializing)]
    pub dgshape: Option<DgshapeConfig>,
}

fn dialect<'de, D: Deserializer<'de>>(deserializer: D) -> Result<&'static Dialect, D::Error> {
    let name = String::deserialize(deserializer)?;
    dialects::find(&name).map_err(|why| D::Error::custom(format!("dialect: {why}")))
}

fn dialect_schema(_: &mut SchemaGenerator) -> Schema {
    let names: Vec<&str> = dialects::names().collect();
    json_schema!({ "type": "string", "enum": names, "default": dialects::DEFAULT_NAME })
}

/// `[[tool]]`
#[derive(Debug, Clone, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ToolConfig {
    /// Tool number.
    #[schemars(range(min = 1))]
    pub id: u16,
    /// Radius.
    #[serde(default)]
    #[schemars(range(min = 0.0, max = POSITION_MAX), extend("x-unit" = "mm"))]
    pub radius: f64,
    /// Length.
    #[serde(default)]
    #[schemars(range(min = -POSITION_MAX, max = POSITION_MAX), extend("x-unit" = "mm"))]
    pub length: f64,
}

/// `[m_code.N]`
#[derive(Debug, Clone, Default, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MCodeConfig {
    /// Name of the M code's function, such as `clamp`, for alarms, `birth` and panels; 1 to 40 characters. A
    /// handler can also declare this name.
    pub name: Option<String>,
    /// Parameters of the M code, `VA` to `VH`, each a table; `{}` means no parameters. A program with other parameters,
    /// or with numbers outside their ranges, is not loaded. Without this key, only the declarations of handlers apply.
    pub params: Option<BTreeMap<String, ParamDeclaration>>,
    /// Time at which the output is issued, relative to earlier motion; default `after_motion`, in dialect
    /// dgshape `with_motion`.
    pub timing: Option<plc_protocol::types::output::Timing>,
    /// Reaction if no handler is registered; default `alarm`.
    pub unhandled: Option<UnhandledReaction>,
    /// Time limit from the output to the reset; when it expires, an alarm is raised.
    #[schemars(range(min = 1, max = TIME_MAX_MS), extend("x-unit" = "ms"))]
    pub timeout_ms: Option<u64>,
    /// Action for an output that was claimed when its handler was lost: `ask` leaves it to an operator,
    /// `verify` and `redo` deliver it to a handler again. A handler may also declare an action; the strictest
    /// applies (`ask`, then `verify`, then `redo`). The default is `ask`.
    pub redelivery: Option<plc_protocol::types::output::Redelivery>,
    /// State that is shown while the program waits for the M code.
    pub wait_state: Option<String>,
    /// Action of the stock sequence program if no handler is registered. `select_tool` also declares that VA
    /// is the tool that the M code brings into the spindle. Paths and times planned ahead rely on this
    /// declaration, also if a handler changes the tool.
    pub stock: Option<Stock>,
    /// Group for a start from a line: the last M code of each group before that line is issued again. M codes of a
    /// group replace each other, such as those of the coolant. Default `spindle` for M03, M04, M05 and M19, `tool`
    /// where `stock` is `select_tool`, otherwise none; M codes without a group are not issued again.
    pub restore_group: Option<String>,
    /// Order of the outputs of a start from a line, lowest first; outputs with equal values keep the order of
    /// the program. Default 10 in group `tool`, 30 in group `spindle`, otherwise 20.
    #[schemars(range(min = 0, max = 1000))]
    pub restore_order: Option<u16>,
    /// Time that the stock sequence program takes.
    #[schemars(range(min = 0.0, max = TIME_MAX_MS), extend("x-unit" = "ms"))]
    pub simulated_ms: f64,
}

/// `[[simulated_skip]]`
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SimulatedSkipConfig {
    /// Motor number.
    pub motor: u16,
    /// The signal is on below this machine position.
    #[schemars(range(min = -POSITION_MAX, max = POSITION_MAX), extend("x-unit" = "units"))]
    pub below: Option<f64>,
    /// The signal is on above this machine position.
    #[schemars(range(min = -POSITION_MAX, max = POSITION_MAX), extend("x-unit" = "units"))]
    pub above: Option<f64>,
}

/// `[[simulated_round]]`
#[derive(Debug, Clone, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SimulatedRoundConfig {
    /// Coordinate system whose X and Y axes touch the object in G31; at most one object for each coordinate
    /// system.
    pub coordinate_system: u8,
    /// Kind of the object.
    pub kind: RoundKind,
    /// Machine position of the object's centre in X.
    #[schemars(range(min = -POSITION_MAX, max = POSITION_MAX), extend("x-unit" = "mm"))]
    pub x: f64,
    /// Machine position of the object's centre in Y.
    #[schemars(range(min = -POSITION_MAX, max = POSITION_MAX), extend("x-unit" = "mm"))]
    pub y: f64,
    /// Diameter of the object.
    #[schemars(range(min = 0.0, max = POSITION_MAX), extend("x-unit" = "mm"))]
    pub diameter: f64,
    /// Diameter of the ball of the probe, less than that of a bore.
    #[schemars(range(min = 0.0, max = POSITION_MAX), extend("x-unit" = "mm"))]
    pub ball: f64,
    /// Machine position of Z below which the wall exists; default: at every position.
    #[schemars(range(min = -POSITION_MAX, max = POSITION_MAX), extend("x-unit" = "mm"))]
    pub below: Option<f64>,
}

/// `[mqtt]`
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MqttConfig {
    /// `embedded`, or the address of an external broker: `mqtt://host:1883`, `mqtts://host:8883`; or a list of the
    /// addresses of its nodes. The first node that answers is used until its connection is lost.
    #[schemars(with = "broker::Text")]
    pub broker: Broker,
    /// Address of the embedded broker; default `127.0.0.1:1883`.
    pub listen: Option<String>,
    /// The embedded broker also accepts WebSocket, at `/mqtt` of the HTTP address; needs `token_file`.
    pub websocket: bool,
    /// With an external broker, requests on topics without the name of the sender (`cs/1/command/start` instead of
    /// `client/panel/cs/1/command/start`) are accepted. Every client that may publish on these topics can write any
    /// sender into the payload, and so act as another client.
    pub accept_unverified_senders: bool,
    /// User at an external broker.
    pub username: Option<String>,
    /// File with the password at an external broker.
    pub password_file: Option<PathBuf>,
    /// File with the certificate authority for TLS to an external broker.
    pub ca_file: Option<PathBuf>,
    /// File with the client certificate for TLS to an external broker.
    pub client_cert_file: Option<PathBuf>,
    /// File with the key of the client certificate.
    pub client_key_file: Option<PathBuf>,
    /// Topic levels before `tandem/`.
    pub prefix: String,
    /// Behaviour of a program that waits for a reset while the connection to the broker is lost.
    pub on_bus_loss: OnBusLoss,
}

/// `[tls]`: TLS of HTTP, WebSocket and the embedded broker. `tandem cert new` makes both files.
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TlsConfig {
    /// Certificate of the machine in PEM, followed by any intermediate certificates; read again when the file changes.
    pub cert_file: PathBuf,
    /// Private key of the certificate in PEM, with mode 0600.
    pub key_file: PathBuf,
}

/// `[mtconnect]`: MTConnect (read only) below `/mtconnect` of the HTTP address. Without this table, MTConnect
/// is off.
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct MtconnectConfig {
    /// Version of the standard that the MTConnect documents follow.
    pub version: MtconnectVersion,
    /// Input of `[io.in.NAME]` that is on while the emergency stop is not pressed; without it, `EMERGENCY_STOP` is
    /// unavailable.
    pub emergency_stop: Option<String>,
    /// Address of an SHDR adapter for an MTConnect agent of another manufacturer. SHDR has no users, so only loopback
    /// addresses are allowed.
    pub shdr_listen: Option<String>,
}

/// `[http]`
#[derive(Debug, Clone, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct HttpConfig {
    /// Address of REST, WebSocket and HMI.
    pub listen: String,
    /// File with the tokens of the users; needed for every address except loopback addresses.
    pub token_file: Option<PathBuf>,
    /// A login ends after this time without activity, in seconds, and after 12 h in any case; 0: only after 12 h. Using
    /// the HMI and each request that changes data or commands the machine are activity; renewals and heartbeats are none.
    pub login_idle_s: u32,
    /// Origins of other web pages that may use REST and WebSocket with a token, such as `https://hmi.example.com`;
    /// needs `token_file`.
    pub allow_origins: Vec<String>,
    /// Address under which other computers reach this HMI, such as `http://mill-1:8080`. The machine publishes it over
    /// MQTT; pages that show several machines link to it.
    pub public_url: Option<String>,
}

impl Default for HttpConfig {
    fn default() -> Self {
        Self {
            listen: "127.0.0.1:8080".into(),
            token_file: None,
            login_idle_s: 3600,
            allow_origins: Vec::new(),
            public_url: None,
        }
    }
}

impl Config {
    /// Reads a configuration file.
    ///
    /// # Errors
    /// Returns an error if the file cannot be read, or if [`Config::from_toml`] rejects its text.
    pub fn read(path: &Path) -> Result<Config, ConfigError> {
        let text = std::fs::read_to_string(path).map_err(|error| ConfigError::Unreadable {
            path: path.to_owned(),
            error,
        })?;
        let base_dir = path.parent().unwrap_or(Path::new("")).to_owned();
        Self::from_toml(&text, base_dir).map_err(|error| error.in_file(path))
    }

    /// Reads a configuration text; relative paths in the text start from `base_dir`.
    ///
    /// # Errors
    /// Returns an error if the text is not TOML, a key is unknown or missing, or a value has the wrong type.
    /// The error then also lists the findings of [`Config::resolve`] that do not follow from these errors.
    pub fn from_toml(text: &str, base_dir: impl Into<PathBuf>) -> Result<Config, ConfigError> {
        let base_dir = base_dir.into();
        text::read(text).map(|config| Config { base_dir, ..config })
    }
}
