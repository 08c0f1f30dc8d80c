//! The words that configuration keys accept.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tandem_model::settings::{
    Calculator, CompensationFeed, CompensationStart, MotorKind, Overcut, ShortBlock, Unit,
};

/// What a program that waits for a reset does while the MQTT broker is lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OnBusLoss {
    /// It goes on as soon as it is reset.
    #[default]
    Continue,
    /// It is held.
    HoldAtWait,
}

/// Whether a simulated drive knows its position when it is switched on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum EncoderKind {
    /// It does: an absolute encoder.
    #[default]
    Absolute,
    /// It does not: it must be homed.
    Incremental,
}

/// What a simulated probe touches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum RoundKind {
    /// Touched from within.
    Bore,
    /// Touched from outside.
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
    /// G21.
    #[serde(rename = "mm")]
    Millimetre,
    /// G20.
    #[serde(rename = "inch")]
    Inch,
}

#[derive(Deserialize, Serialize, JsonSchema)]
#[serde(remote = "ShortBlock", rename_all = "lowercase")]
pub(super) enum ShortBlockWord {
    /// The ramps: the feedrate is kept.
    Shrink,
    /// The feedrate: the ramps are kept.
    Extend,
}

#[derive(Deserialize, Serialize, JsonSchema)]
#[serde(remote = "Calculator")]
pub(super) enum CalculatorWord {
    /// None: all count increments.
    #[serde(rename = "none")]
    None,
    /// All of them.
    #[serde(rename = "all")]
    All,
    /// F.
    #[serde(rename = "f")]
    F,
    /// I, J, K, R, X, Y, Z and A.
    #[serde(rename = "ijkrxyza")]
    Dimensions,
}

#[derive(Deserialize, Serialize, JsonSchema)]
#[serde(remote = "CompensationStart", rename_all = "lowercase")]
pub(super) enum CompensationStartWord {
    /// Straight to the point beside the corner.
    A,
    /// By way of the point where the offset ways meet.
    B,
}

#[derive(Deserialize, Serialize, JsonSchema)]
#[serde(remote = "CompensationFeed", rename_all = "lowercase")]
pub(super) enum CompensationFeedWord {
    /// At the tool's centre.
    Centre,
    /// At the tool's edge, on the programmed arc.
    Edge,
}

#[derive(Deserialize, Serialize, JsonSchema)]
#[serde(remote = "Overcut", rename_all = "lowercase")]
pub(super) enum OvercutWord {
    /// An alarm before the first block that it concerns moves.
    Detect,
    /// The blocks that the tool does not fit between are left out; an alarm where that does not help.
    Prevent,
}
