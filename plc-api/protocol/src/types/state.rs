//! State of a coordinate system as HMIs and sequence programs receive it.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::Timestamp;
use super::explained::explained;
use super::output::Progress;
use super::question::Question;

pub use super::execution::{Execution, Reason};
pub use super::lock::{Lock, LockSet, LockSource};

explained! {
    "transition to another state"
    /// Transition to another state.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    #[non_exhaustive]
    pub enum Transition {
        /// A start was accepted.
        Starting = "STARTING",
            "The state becomes ACTIVE automatically.";
        /// Decelerating on the path to a feed hold.
        Holding = "HOLDING",
            "The state becomes FEED_HOLD when the axes are at rest; in a thread, when the tool has left the thread.";
        /// Decelerating to a stop.
        Stopping = "STOPPING",
            "The state becomes STOPPED when the axes are at rest.";
        /// Leaving a pause.
        Resuming = "RESUMING",
            "The state becomes ACTIVE automatically.";
        /// A reset is in progress.
        Resetting = "RESETTING",
            "The state becomes READY when the axes are at rest and the open outputs are cancelled.";
    }
}

/// Kind of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum RunKind {
    /// The loaded program.
    Program,
    /// Manual data input.
    Mdi,
    /// Axes move to their reference points.
    Home,
    /// An operator moves one axis.
    Jog,
}

/// Payload of `state`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct State {
    /// The state word.
    pub execution: Execution,
    /// Transition to another state, or null.
    pub transition: Option<Transition>,
    /// Reason of the state, or null.
    pub reason: Option<Reason>,
    /// `wait_state` setting of the M code for which the program waits.
    pub wait_state: Option<String>,
    /// The output for which the program waits.
    pub waiting_on: Option<WaitingOn>,
    /// The loaded main program.
    pub program: Option<u16>,
    /// Hash of the loaded program: during a run the hash of the running text, otherwise the hash of the text
    /// that a start would run. SHA-256 of the bytes of the file, 64 hexadecimal digits; null without a
    /// program.
    #[serde(default)]
    pub hash: Option<String>,
    /// Number that the text contains, in dialects whose text contains a number (`O12345678`); this is not the
    /// number `program`.
    #[serde(default)]
    pub o_number: Option<u32>,
    /// Id of the run; null before the first start.
    pub run_id: Option<String>,
    /// Kind of the run, also while it is paused; null if no run is active.
    #[serde(default)]
    pub run_kind: Option<RunKind>,
    /// Single block input.
    pub single_block: bool,
    /// Dry run input.
    pub dry_run: bool,
    /// Optional stop input.
    pub optional_stop: bool,
    /// Optional skip inputs that are on, ascending.
    pub optional_skip: Vec<u8>,
    /// Active alarms of this coordinate system.
    pub alarm_count: u32,
    /// Id of the last accepted command.
    pub last_command_id: Option<String>,
}

/// The output for which a program waits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct WaitingOn {
    /// M number.
    pub m: u16,
    /// Sequence number.
    pub seq: u64,
    /// Time when the wait began.
    pub since: Timestamp,
    /// Last progress report of the handler.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub progress: Option<Progress>,
    /// Question of the handler to the operator, while the question has no answer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub question: Option<Box<Question>>,
}

/// Payload of `program`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ProgramLocation {
    /// Number of the program that runs now, main or subprogram; 0 for manual data input.
    pub number: Option<u16>,
    /// 0 in the main program, 1 to 8 in subprograms.
    pub nest_level: u8,
    /// Calls that lead to the running program, main program first.
    pub stack: Vec<CallSite>,
    /// Line of the block whose motion runs, from 1.
    pub line: u32,
    /// Text of that line.
    pub block: String,
    /// Line that the interpreter has reached in its pre-read.
    pub interpreted_line: u32,
}

/// A call in the program stack.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CallSite {
    /// Program number.
    pub program: u16,
    /// Line of the call.
    pub line: u32,
}

/// Payload of `position`. Lengths are mm and angles degrees, regardless of G20 and G21.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Position {
    /// Commanded machine position by axis letter.
    pub machine: BTreeMap<String, f64>,
    /// Commanded position in work coordinates, by axis letter.
    pub work: BTreeMap<String, f64>,
    /// Actual machine position, by axis letter.
    pub actual: BTreeMap<String, f64>,
    /// Whether each axis is homed: its position refers to the zero of the machine, by an absolute encoder or
    /// because its drive has been homed. An axis that is not homed does not move (alarm 208), and its
    /// positions are meaningless. Empty if the machine does not report this.
    #[serde(default)]
    pub homed: BTreeMap<String, bool>,
    /// Commanded minus actual position, by axis letter.
    pub following_error: BTreeMap<String, f64>,
    /// Remaining distance of the running block, by axis letter.
    pub distance_to_go: BTreeMap<String, f64>,
    /// Speed on the path, mm/min.
    pub feedrate: f64,
    /// Actual spindle speed, r/min; negative counter-clockwise.
    pub spindle_rpm: f64,
}

/// Payload of `modal`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Modal {
    /// G code in force by modal group number (`"01"` to `"23"`).
    pub g: BTreeMap<String, String>,
    /// Feedrate, mm/min.
    pub f: f64,
    /// Spindle speed, r/min.
    pub s: f64,
    /// Acceleration time, ms.
    pub ta: f64,
    /// Deceleration time, ms.
    pub td: f64,
    /// Jerk time, ms. In JSON it is `ts_ms`, since `ts` is the time of every message.
    #[serde(rename = "ts_ms")]
    pub ts: f64,
    /// Selected tool; 0 for none; null if the tool is unknown because the stored value is damaged.
    pub tool: Option<u16>,
    /// `G54` to `G59`, or null.
    pub work_offset: Option<String>,
    /// Codes in force at the beginning of the next manual data input that differ from those at start-up, such
    /// as G91 or G20; empty for the start-up state. Codes of motion (group 01) and of the return level (group
    /// 10) are left out.
    #[serde(default)]
    pub mdi: Vec<String>,
}

/// Payload of `captured`: the positions that the last G31 captured.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CapturedPositions {
    /// Id of the run that executed the G31.
    pub run_id: Option<String>,
    /// Line of the G31, from 1.
    pub line: u32,
    /// Motor numbers, ascending.
    pub motors: Vec<u16>,
    /// Captured machine positions, mm or degrees.
    pub positions: Vec<f64>,
    /// For each motor: false if the skip input was not received; the position is then where the motor stopped
    /// (D41).
    pub captured: Vec<bool>,
}

/// Payload of `input/optional_skip/state`.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct OptionalSkip {
    /// Numbers of the block skip inputs that are on, ascending.
    pub requested: Vec<u8>,
    /// Numbers of the block skips that the interpreter applies now.
    pub effective: Vec<u8>,
    /// First line that was interpreted with `effective`; earlier lines were read ahead with the previous
    /// numbers.
    pub effective_from_line: u32,
}

/// Payload of an input with one value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Switch {
    /// On or off.
    pub value: bool,
}

/// Payload of `override/state`, percent.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Overrides {
    /// Feed override, 0 to 200.
    pub feed: f64,
    /// Rapid override, 0 to 100.
    pub rapid: f64,
    /// Spindle override, 0 to 200.
    pub spindle: f64,
}

impl Default for Overrides {
    fn default() -> Self {
        Self {
            feed: 100.0,
            rapid: 100.0,
            spindle: 100.0,
        }
    }
}

/// Rotation of a spindle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum SpindleDirection {
    /// Clockwise (M03).
    Cw,
    /// Counter-clockwise (M04).
    Ccw,
    /// At rest (M05).
    #[default]
    Stop,
    /// At the orientation position (M19).
    Orient,
}

/// Payload of `spindle/state`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Spindle {
    /// Commanded direction.
    pub direction: SpindleDirection,
    /// Commanded speed, r/min.
    pub rpm: f64,
    /// Actual speed, r/min.
    pub actual_rpm: f64,
    /// True if the spindle is at the orientation position after `orient`.
    pub oriented: bool,
}

/// Payload of `tool/state`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Tool {
    /// Number of the tool in the spindle; 0 for none.
    pub id: u16,
}
