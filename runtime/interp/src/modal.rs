//! Modal state: what stays in force from block to block.

use tandem_model::flow::{Compensation, Distance, Feed, MultiBlock, PathControl, Transform};
use tandem_model::plane::Plane;
use tandem_model::settings::{CoordinateSystemSettings, Unit};

use crate::codes::g20_g21_unit::G20;
use crate::codes::g74_g84_tapping::G80;
use crate::codes::{Code, ModalGroup};
use crate::dialects::Dialect;

/// Millimetres of an inch.
const INCH_MM: f64 = 25.4;

/// The words of a fixed cycle that stay until G80 (D42), in mm and s; `None` where not programmed.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CycleWords {
    /// Initial level: Z where the cycle began.
    pub initial: Option<f64>,
    /// Z point.
    pub z: Option<f64>,
    /// R point.
    pub r: Option<f64>,
    /// Dwell at the Z point, s.
    pub dwell_s: Option<f64>,
    /// Number of repetitions.
    pub repetitions: Option<u16>,
}

/// Modal state of a coordinate system.
#[derive(Debug, Clone, PartialEq)]
pub struct Modal {
    codes: [Option<&'static Code>; ModalGroup::COUNT],
    /// F as it is written, mm/min, above the maximum feedrate too; 0: never programmed.
    pub feedrate_mm_min: f64,
    /// F as blocks of rotary axes alone read it, deg/min: a number of degrees, whatever the unit of lengths.
    pub feedrate_deg_min: f64,
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
    /// G40, G41 or G42 with the tool's radius and the plane.
    pub compensation: Compensation,
    /// Cutter compensation has been switched and no motion has led in or out since.
    pub lead_pending: bool,
    /// What a fixed cycle keeps.
    pub cycle: CycleWords,
}

impl Modal {
    /// The state at start-up: the manual's initial codes, and feedrate and times of the settings.
    pub(crate) fn start_up(dialect: &Dialect, settings: &CoordinateSystemSettings) -> Self {
        Self {
            feedrate_mm_min: settings.default_feedrate_mm_min,
            ta_ms: settings.default_ta_ms,
            td_ms: settings.default_td_ms,
            ts_ms: settings.default_ts_ms,
            feedrate_deg_min: settings.default_feedrate_mm_min,
            ..Self::of_text(dialect, settings.unit)
        }
    }

    /// What the text of a main program shows at its head.
    pub(crate) fn of_text(dialect: &Dialect, unit: Unit) -> Self {
        let mut modal = Self {
            codes: [None; ModalGroup::COUNT],
            feedrate_mm_min: 0.0,
            feedrate_deg_min: 0.0,
            spindle_speed_r_min: 0.0,
            ta_ms: 0.0,
            td_ms: 0.0,
            ts_ms: 0.0,
            distance: Distance::default(),
            path_control: PathControl::default(),
            transform: Transform::default(),
            compensation: Compensation::default(),
            lead_pending: false,
            cycle: CycleWords::default(),
        };
        let of_unit = dialect.g_codes.find(G20.tenths).filter(|_| unit == Unit::Inch);
        for code in dialect.start_up.iter().copied().chain(of_unit) {
            modal.remember(code);
        }
        modal
    }

    /// Puts a code into force in its group.
    pub(crate) fn remember(&mut self, code: &'static Code) {
        self.codes[code.group as usize] = Some(code);
    }

    /// Ends a fixed cycle.
    pub(crate) fn end_cycle(&mut self) {
        self.remember(&G80);
        self.cycle = CycleWords::default();
    }

    /// Lets go which codes are in force: the text alone does not show it from here on.
    pub(crate) fn forget(&mut self) {
        self.codes = [None; ModalGroup::COUNT];
        self.lead_pending = false;
    }

    /// True when one of these codes is in force.
    pub(crate) fn is(&self, group: ModalGroup, codes: &[&str]) -> bool {
        self.code(group).is_some_and(|code| codes.contains(&code.code))
    }

    /// What takes axis words: the fixed cycle in force, or the motion.
    pub(crate) fn taker(&self) -> Option<&'static Code> {
        let cycle = self
            .code(ModalGroup::FixedCycle)
            .filter(|code| code.motion.is_some());
        cycle.or(self.code(ModalGroup::Motion))
    }

    /// The plane in force.
    pub fn plane(&self) -> Plane {
        if self.is(ModalGroup::Plane, &["G18"]) {
            Plane::Zx
        } else if self.is(ModalGroup::Plane, &["G19"]) {
            Plane::Yz
        } else {
            Plane::Xy
        }
    }

    /// Millimetres of a programmed length of 1 (D25).
    pub fn unit(&self) -> f64 {
        if self.is(ModalGroup::Unit, &["G20"]) {
            INCH_MM
        } else {
            1.0
        }
    }

    /// G500 or G501.
    pub fn multi_block(&self) -> MultiBlock {
        if self.is(ModalGroup::MultiBlock, &["G500"]) {
            MultiBlock::On
        } else {
            MultiBlock::Off
        }
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

    /// True in cutter compensation, where the program cannot be stopped between blocks (manual, G41 and G42).
    pub fn compensates(&self) -> bool {
        self.is(ModalGroup::ToolRadius, &["G41", "G42"])
    }

    /// True from G74 or G84 to the end of the fixed cycle.
    pub fn in_fixed_cycle(&self) -> bool {
        self.code(ModalGroup::FixedCycle)
            .is_some_and(|code| code.motion.is_some())
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
