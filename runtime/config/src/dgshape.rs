//! `[coordinate_system.dgshape]`: settings that the manual of dialect dgshape leaves to the machine.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tandem_model::settings::{Calculator, CompensationStart};

use super::words::{CalculatorWord, CompensationStartWord};
use super::{POSITION_MAX, RATE_MAX, RATE_MIN};

/// `[coordinate_system.dgshape]`
#[derive(Debug, Clone, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DgshapeConfig {
    /// Numbers without a decimal point whose unit is mm, inch, degree, mm/min or second. All other numbers
    /// without a decimal point count increments: 0.001 mm, 0.0001 inch, `angle_increment`, 0.001 mm/min, ms.
    #[serde(with = "CalculatorWord")]
    pub calculator: Calculator,
    /// Increment of an angle without a decimal point, in degrees.
    #[schemars(range(min = RATE_MIN, max = 360.0), extend("x-unit" = "deg"))]
    pub angle_increment: f64,
    /// Lowest feedrate; a lower F is raised to this value. With 0, an F that is not above 0 is an error.
    #[schemars(range(min = 0.0, max = 1e9), extend("x-unit" = "mm/min"))]
    pub min_feedrate: f64,
    /// Lowest spindle speed, also selected by S00; a lower S is raised to this value. No override makes a turning
    /// spindle slower.
    #[schemars(range(min = 0.0, max = RATE_MAX), extend("x-unit" = "r/min"))]
    pub min_spindle_speed: f64,
    /// Highest spindle speed, also selected by S99; a higher S is reduced to this value. No override makes the spindle
    /// faster. 0: `max_velocity` of its motor.
    #[schemars(range(min = 0.0, max = RATE_MAX), extend("x-unit" = "r/min"))]
    pub max_spindle_speed: f64,
    /// Distance above the last depth at which G83 begins to cut again.
    #[schemars(range(min = 0.0, max = POSITION_MAX), extend("x-unit" = "mm"))]
    pub peck_clearance: f64,
    /// Path into and out of tool-diameter offset on the outside of a corner: type A or B.
    #[serde(with = "CompensationStartWord")]
    pub compensation_start: CompensationStart,
    /// EXOFS: axis letter to the distance by which all work coordinate systems are shifted.
    pub external_offset: BTreeMap<String, f64>,
}

impl Default for DgshapeConfig {
    fn default() -> Self {
        Self {
            calculator: Calculator::None,
            angle_increment: 0.001,
            min_feedrate: 0.001,
            min_spindle_speed: 0.0,
            max_spindle_speed: 0.0,
            peck_clearance: 0.5,
            compensation_start: CompensationStart::A,
            external_offset: BTreeMap::new(),
        }
    }
}
