//! The words that configuration keys accept.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tandem_model::settings::{
    Calculator, CompensationFeed, CompensationStart, LowOverride, MotorKind, Overcut, ShortBlock, Unit,
};

/// Behaviour of a program that waits for a reset while the connection to the MQTT broker is lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OnBusLoss {
    /// The program continues as soon as the output is reset.
    #[default]
    Continue,
    /// The program is held.
    HoldAtWait,
}

/// Kind of the encoder of a simulated drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum EncoderKind {
    /// Absolute encoder: the position is known after switching on.
    #[default]
    Absolute,
    /// Incremental encoder: the axis must be homed after switching on.
    Incremental,
}

/// Object that a simulated probe touches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum RoundKind {
    /// Bore, touched from inside.
    Bore,
    /// Boss, touched from outside.
    Boss,
}

#[derive(Deserialize, Serialize, JsonSchema)]
#[serde(remote = "MotorKind", rename_all = "lowercase")]
pub(super) enum MotorKindWord {
    /// A linear axis; its units are mm.
    Linear,
    /// A rotary axis; its units are degrees.
    Rotary,
    /// A spindle.
    Spindle,
}

#[derive(Deserialize, Serialize, JsonSchema)]
#[serde(remote = "Unit")]
pub(super) enum UnitWord {
    /// Millimetres, as after G21.
    #[serde(rename = "mm")]
    Millimetre,
    /// Inches, as after G20.
    #[serde(rename = "inch")]
    Inch,
}

#[derive(Deserialize, Serialize, JsonSchema)]
#[serde(remote = "ShortBlock", rename_all = "lowercase")]
pub(super) enum ShortBlockWord {
    /// Shortens the ramps and keeps the feedrate.
    Shrink,
    /// Reduces the feedrate and keeps the ramps.
    Extend,
}

#[derive(Deserialize, Serialize, JsonSchema)]
#[serde(remote = "LowOverride", rename_all = "snake_case")]
pub(super) enum LowOverrideWord {
    /// Multiplies F and plans the motion again; the limits of the motors stay.
    Replan,
    /// Scales the time of the plan; accelerations fall with the square of the override.
    TimeBase,
}

#[derive(Deserialize, Serialize, JsonSchema)]
#[serde(remote = "Calculator")]
pub(super) enum CalculatorWord {
    /// No numbers: all numbers count increments.
    #[serde(rename = "none")]
    None,
    /// All numbers.
    #[serde(rename = "all")]
    All,
    /// Numbers of F only.
    #[serde(rename = "f")]
    F,
    /// Numbers of I, J, K, R, X, Y, Z and A only.
    #[serde(rename = "ijkrxyza")]
    Dimensions,
}

#[derive(Deserialize, Serialize, JsonSchema)]
#[serde(remote = "CompensationStart", rename_all = "lowercase")]
pub(super) enum CompensationStartWord {
    /// The tool moves straight to the offset point at the corner.
    A,
    /// The tool moves through the intersection of the offset paths.
    B,
}

#[derive(Deserialize, Serialize, JsonSchema)]
#[serde(remote = "CompensationFeed", rename_all = "lowercase")]
pub(super) enum CompensationFeedWord {
    /// F applies on the path of the tool's centre.
    Centre,
    /// F applies on the path of the tool's edge, that is, on the programmed arc.
    Edge,
}

#[derive(Deserialize, Serialize, JsonSchema)]
#[serde(remote = "Overcut", rename_all = "lowercase")]
pub(super) enum OvercutWord {
    /// Raises an alarm before the first affected block moves.
    Detect,
    /// Omits the blocks between which the tool does not fit. If this does not help, raises an alarm.
    Prevent,
}
