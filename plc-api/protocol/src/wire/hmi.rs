//! Additions of a machine builder to the HMI: in the configuration, and in the answer of the server.

use serde::{Deserialize, Serialize};

use crate::types::CoordinateSystemNumber;
use crate::types::execution::Execution;

/// Default of `jog_step_max`, mm or degrees.
pub const JOG_STEP_MAX_DEFAULT: f64 = 10.0;

/// Additions of a machine builder to the HMI, and the limits of its jog buttons.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Hmi {
    /// The longest jog that needs no refresh, mm or degrees.
    pub jog_step_max: f64,
    /// Buttons in the order in which they are shown.
    pub buttons: Vec<HmiButton>,
    /// Cards in the order in which they are shown.
    pub cards: Vec<HmiCard>,
}

impl Default for Hmi {
    fn default() -> Self {
        Self {
            jog_step_max: JOG_STEP_MAX_DEFAULT,
            buttons: Vec::new(),
            cards: Vec::new(),
        }
    }
}

/// A button of the panel Machine: it runs an M code or a line of NC text, sets a variable, or switches an
/// input.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct HmiButton {
    /// Text on the button, 1 to 40 characters.
    pub text: String,
    /// A picture before the text: name of a file in the folder `dir`, such as `lamp.svg`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub icon: Option<String>,
    /// The coordinate system of the button; if absent, the coordinate system that the operator has selected.
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = 255)))]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cs: Option<CoordinateSystemNumber>,
    /// M code that the button runs immediately, as a line of MDI.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = 191)))]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub m_code: Option<u16>,
    /// Line of NC text that the button runs immediately, such as `M60 VA2` or `G28 Z0`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mdi: Option<String>,
    /// Variable that the button sets to `value`, such as `P100` or `Q5`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variable: Option<String>,
    /// Value of the variable.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub value: Option<f64>,
    /// Input that the button switches on and off: `optional_stop`, `single_block`, `dry_run`, or
    /// `optional_skip/1` to `optional_skip/31`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub input: Option<String>,
    /// Question that the operator must confirm before the action, 1 to 200 characters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub confirm: Option<String>,
    /// States in which the button can be pressed; empty for all states in which the machine accepts the
    /// action.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub states: Vec<Execution>,
}

/// A card of the panel Machine: it shows the open output of an M code, a variable, an input, or the drawing
/// of a module in the folder `dir`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct HmiCard {
    /// Title of the card, 1 to 40 characters.
    pub text: String,
    /// A picture before the title: name of a file in the folder `dir`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub icon: Option<String>,
    /// The coordinate system of the card; if absent, the coordinate system that the operator has selected.
    #[cfg_attr(feature = "schema", schemars(range(min = 1, max = 255)))]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cs: Option<CoordinateSystemNumber>,
    /// M code that the card shows: whether an output of the M code is open, and the report of its handler.
    #[cfg_attr(feature = "schema", schemars(range(min = 0, max = 191)))]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub m_code: Option<u16>,
    /// Variable that the card shows, such as `P100` or `Q5`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variable: Option<String>,
    /// Unit that the card shows after the variable, at most 12 characters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// Input that the card shows: `optional_stop`, `single_block`, `dry_run`, `interlock`, `start_lock`, or
    /// `optional_skip/1` to `optional_skip/31`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub input: Option<String>,
    /// ES module in the folder `dir`, such as `oil.js`, whose default export draws the card.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub module: Option<String>,
}
