//! Modal state: what stays in force from block to block.

use tandem_model::flow::{Distance, Feed, PathControl, Transform};
use tandem_model::settings::CoordinateSystemSettings;

use crate::codes::{Code, ModalGroup};
use crate::dialects::Dialect;

/// Modal state of a coordinate system.
#[derive(Debug, Clone, PartialEq)]
pub struct Modal {
    codes: [Option<&'static Code>; ModalGroup::COUNT],
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
    /// G90 or G91.
    pub distance: Distance,
    /// G61 or G64.
    pub path_control: PathControl,
    /// From the programmed point to the machine position.
    pub transform: Transform,
}

impl Modal {
    /// The state at start-up: the manual's initial codes, and feedrate and times of the settings.
    pub(crate) fn start_up(dialect: &Dialect, settings: &CoordinateSystemSettings) -> Self {
        let mut modal = Self {
            codes: [None; ModalGroup::COUNT],
            feedrate_mm_min: settings.default_feedrate_mm_min,
            spindle_speed_r_min: 0.0,
            ta_ms: settings.default_ta_ms,
            td_ms: settings.default_td_ms,
            ts_ms: settings.default_ts_ms,
            distance: Distance::default(),
            path_control: PathControl::default(),
            transform: Transform::default(),
        };
        for code in dialect.start_up {
            modal.remember(code);
        }
        modal
    }

    /// Puts a code into force in its group.
    pub(crate) fn remember(&mut self, code: &'static Code) {
        self.codes[code.group as usize] = Some(code);
    }

    /// The code in force in a group.
    pub fn code(&self, group: ModalGroup) -> Option<&'static Code> {
        self.codes[group as usize]
    }

    /// Number of each modal group (`"01"`) and the code in force in it (`"G01"`), ascending by group.
    /// Group 14 is missing while no work coordinate system is selected.
    pub fn groups(&self) -> impl Iterator<Item = (&'static str, &'static str)> {
        ModalGroup::ALL
            .iter()
            .filter_map(|group| self.code(*group).map(|code| (group.number(), code.code)))
    }

    /// `"G54"` to `"G59"`; `None`: no work coordinate system is selected (the start-up state).
    pub fn work_offset(&self) -> Option<&'static str> {
        self.code(ModalGroup::WorkCoordinates).map(|code| code.code)
    }

    /// Feedrate and ramp times in force.
    pub fn feed(&self) -> Feed {
        Feed {
            feedrate_mm_min: self.feedrate_mm_min,
            ta_ms: self.ta_ms,
            td_ms: self.td_ms,
            ts_ms: self.ts_ms,
        }
    }
}
