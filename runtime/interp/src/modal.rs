//! Modal state: what stays in force from block to block.

use tandem_model::settings::CoordinateSystemSettings;

/// Modal state of a coordinate system.
#[derive(Debug, Clone, PartialEq)]
pub struct Modal {
    /// F, mm/min; 0: never programmed.
    pub feedrate_mm_min: f64,
    /// S, r/min.
    pub spindle_speed_r_min: f64,
    /// ta, ms.
    pub ta_ms: f64,
    /// td, ms.
    pub td_ms: f64,
    /// ts, ms.
    pub ts_ms: f64,
}

impl Modal {
    pub(crate) fn start_up(settings: &CoordinateSystemSettings) -> Self {
        Self {
            feedrate_mm_min: settings.default_feedrate_mm_min,
            spindle_speed_r_min: 0.0,
            ta_ms: settings.default_ta_ms,
            td_ms: settings.default_td_ms,
            ts_ms: settings.default_ts_ms,
        }
    }

    /// Number of each modal group (`"01"`) and the code in force in it (`"G01"`), ascending by group.
    /// Group 14 is missing while no work coordinate system is selected.
    pub fn groups(&self) -> impl Iterator<Item = (&'static str, &'static str)> {
        [].into_iter()
    }

    /// `"G54"` to `"G59"`; `None`: no work coordinate system is selected (the start-up state).
    pub fn work_offset(&self) -> Option<&'static str> {
        None
    }
}
