//! Modal state: the values that remain valid from block to block.

use std::collections::BTreeMap;

use tandem_model::AxisVector;
use tandem_model::flow::{Compensation, Distance, MultiBlock, PathControl, ProgrammedFeed, Transform};
use tandem_model::plane::Plane;
use tandem_model::settings::{CoordinateSystemSettings, Unit};

use crate::codes::{Code, ModalGroup};
use crate::dialect::Dialect;
use crate::fixed_cycles::FixedCycle;
use crate::meaning::{InForce, ModalValue};

/// The words of a fixed cycle that stay until G80 (D42), in mm and s; `None` if not programmed.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CycleWords {
    /// Initial level: Z where the cycle began.
    pub initial: Option<f64>,
    /// Level of the Z point.
    pub z: Option<CycleLevel>,
    /// Level of the R point.
    pub r: Option<CycleLevel>,
    /// Dwell at the Z point, s.
    pub dwell_s: Option<f64>,
    /// Number of repetitions of each block.
    pub repetitions: Option<u16>,
    /// Depth of each cut in a cycle with several cuts, mm.
    pub peck: Option<f64>,
}

/// A level of a fixed cycle with the distance mode of its block: a later G90 or G91 does not move the level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CycleLevel {
    /// The value of the word, mm.
    pub value: f64,
    /// Selects whether `value` is a position or a distance from another level.
    pub distance: Distance,
}

impl CycleLevel {
    /// Returns the level, mm. An incremental level is measured from `origin`.
    pub fn above(self, origin: f64) -> f64 {
        match self.distance {
            Distance::Absolute => self.value,
            Distance::Incremental => origin + self.value,
        }
    }
}

/// Data that G10, G28 and G92 of dialect dgshape keep until the next program begins; mm or degrees.
#[derive(Debug, Clone, PartialEq)]
pub struct RetainedData {
    /// External offset (EXOFS). `None` selects the offset of the settings.
    pub external_offset: Option<AxisVector>,
    /// Work offsets of the six coordinate systems. `None` selects the offset of the table.
    pub work_offsets: [Option<AxisVector>; 6],
    /// Index of the selected work coordinate system.
    pub selected: usize,
    /// Shift of all work coordinate systems by G92, mm or degrees.
    pub shift: AxisVector,
    /// Tool-diameter offsets (as radius, mm) by number.
    pub radii: BTreeMap<u16, f64>,
    /// The middle point of G28, X, Y and Z; `None` for an axis that no G28 has named.
    pub middle: [Option<Middle>; 3],
}

/// Data before any code has set them.
pub(crate) static NOTHING_KEPT: RetainedData = RetainedData {
    external_offset: None,
    work_offsets: [None; 6],
    selected: 0,
    shift: AxisVector::ZERO,
    radii: BTreeMap::new(),
    middle: [None; 3],
};

/// Middle point of G28 on one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Middle {
    /// A programmed position, mm.
    At(f64),
    /// The position of the axis: G28 named the axis by a distance (G91).
    Here,
}

/// Modal state of a coordinate system.
#[derive(Debug, Clone, PartialEq)]
pub struct Modal {
    codes: [Option<&'static Code>; ModalGroup::COUNT],
    /// The values that the active codes have set.
    pub in_force: InForce,
    /// Feedrate F, mm/min, possibly above the maximum feedrate; 0 if neither F nor a default exists.
    pub feedrate_mm_min: f64,
    /// F for blocks that move rotary axes only, deg/min, independent of the unit of lengths.
    pub feedrate_deg_min: f64,
    /// True after the first F. Before it, the default feedrate applies, in the unit of lengths (D25).
    pub is_feed_programmed: bool,
    /// Spindle speed S, r/min.
    pub spindle_speed_r_min: f64,
    /// Acceleration time ta, ms.
    pub ta_ms: f64,
    /// Deceleration time td, ms.
    pub td_ms: f64,
    /// S-curve time ts, ms.
    pub ts_ms: f64,
    /// Transform from the programmed point to the machine position.
    pub transform: Transform,
    /// Cutter compensation by G40, G41 or G42, with the tool's radius and the plane.
    pub compensation: Compensation,
    /// True if cutter compensation was switched on or off, and the motion that leads in or out is still
    /// pending.
    pub lead_pending: bool,
    /// Words that a fixed cycle keeps from block to block.
    pub cycle: CycleWords,
    /// True if a block has used the unit of lengths, which must not change from then on.
    pub unit_settled: bool,
}

impl Modal {
    /// Returns the modal state at start-up: the manual's initial codes, and the feedrate and ramp times of
    /// the settings.
    pub(crate) fn start_up(dialect: &Dialect, settings: &CoordinateSystemSettings) -> Self {
        let of_text = Self::start_up_from_text(dialect, settings.unit);
        Self {
            feedrate_mm_min: settings.default_feedrate_mm_min * of_text.unit(),
            ta_ms: settings.default_ta_ms,
            td_ms: settings.default_td_ms,
            ts_ms: settings.default_ts_ms,
            feedrate_deg_min: settings.default_feedrate_mm_min,
            ..of_text
        }
    }

    /// Returns the initial modal state of a main program, as its text shows it.
    pub(crate) fn start_up_from_text(dialect: &Dialect, unit: Unit) -> Self {
        let mut modal = Self {
            codes: [None; ModalGroup::COUNT],
            in_force: InForce::START,
            feedrate_mm_min: 0.0,
            feedrate_deg_min: 0.0,
            is_feed_programmed: false,
            spindle_speed_r_min: 0.0,
            ta_ms: 0.0,
            td_ms: 0.0,
            ts_ms: 0.0,
            transform: Transform::default(),
            compensation: Compensation::default(),
            lead_pending: false,
            cycle: CycleWords::default(),
            unit_settled: false,
        };
        modal.in_force.unit = Some(unit);
        modal.in_force.multi_block = Some(dialect.path.multi_block);
        let of_unit = dialect.that_sets(ModalValue::Unit(unit));
        for code in dialect.start_up.iter().copied().chain(of_unit) {
            modal.remember(code);
        }
        modal
    }

    /// Makes a code the active code of its modal group.
    pub(crate) fn remember(&mut self, code: &'static Code) {
        self.codes[code.group as usize] = Some(code);
        if let Some(value) = code.sets {
            self.in_force.set(value);
        }
    }

    /// Ends a fixed cycle and discards its words.
    pub(crate) fn end_cycle(&mut self, dialect: &Dialect) {
        if let Some(cancel) = dialect.cycle_cancel {
            self.remember(cancel);
        }
        self.cycle = CycleWords::default();
    }

    /// Discards the active codes and their values, because the text does not show them from here on.
    pub(crate) fn forget(&mut self) {
        self.codes = [None; ModalGroup::COUNT];
        self.in_force = InForce::default();
        self.lead_pending = false;
    }

    /// Discards the values that are different in `other`. Returns `true` if a known value is discarded.
    pub(crate) fn join(&mut self, other: &Self) -> bool {
        let before = self.clone();
        for (code, other) in self.codes.iter_mut().zip(&other.codes) {
            *code = code.filter(|code| Some(*code) == *other);
        }
        self.in_force.join(&other.in_force);
        self.lead_pending &= other.lead_pending;
        self.unit_settled &= other.unit_settled;
        *self != before
    }

    /// Returns the code that takes axis words: the active fixed cycle, otherwise the active motion.
    pub(crate) fn taker(&self) -> Option<&'static Code> {
        let cycle = self
            .code(ModalGroup::FixedCycle)
            .filter(|code| code.motion.is_some());
        cycle.or(self.code(ModalGroup::Motion))
    }

    /// Returns the current plane of arcs, cutter compensation and rotation.
    pub fn plane(&self) -> Plane {
        self.in_force.plane.unwrap_or_default()
    }

    /// Returns the length of one programmed unit, mm (D25).
    pub fn unit(&self) -> f64 {
        self.in_force.unit.unwrap_or_default().mm()
    }

    /// Returns the name of the unit of lengths, `mm` or `inch`.
    pub fn unit_text(&self) -> &'static str {
        match self.in_force.unit {
            Some(Unit::Inch) => "inch",
            Some(Unit::Millimetre) | None => "mm",
        }
    }

    /// Returns whether axis words are positions or distances.
    pub fn distance(&self) -> Distance {
        self.in_force.distance.unwrap_or_default()
    }

    /// Returns whether blocks may blend.
    pub fn path_control(&self) -> PathControl {
        self.in_force.path_control.unwrap_or_default()
    }

    /// Returns whether acceleration ramps span blocks.
    pub fn multi_block(&self) -> MultiBlock {
        self.in_force.multi_block.unwrap_or_default()
    }

    /// Returns the active code of a modal group.
    pub fn code(&self, group: ModalGroup) -> Option<&'static Code> {
        self.codes[group as usize]
    }

    /// Returns the number of each modal group (`"01"`) and its active code (`"G01"`), ascending by group. Group 14 is
    /// missing while no work coordinate system is selected.
    pub fn groups(&self) -> impl Iterator<Item = (&'static str, &'static str)> {
        ModalGroup::ALL
            .iter()
            .filter_map(|group| self.code(*group).map(|code| (group.number(), code.code)))
    }

    /// Returns the selected work coordinate system, `"G54"` to `"G59"`; `None` in the start-up state.
    pub fn work_offset(&self) -> Option<&'static str> {
        self.code(ModalGroup::WorkCoordinates).map(|code| code.code)
    }

    /// Returns true if cutter compensation is on. The program can then not be stopped between blocks (manual,
    /// G41 and G42).
    pub fn compensates(&self) -> bool {
        self.in_force.compensates()
    }

    /// Returns the active fixed cycle. A cycle is active from the code that begins it to its end.
    pub fn fixed_cycle(&self) -> Option<&'static FixedCycle> {
        self.in_force.cycle.flatten()
    }

    /// Returns the current feedrate and ramp times.
    pub fn feed(&self) -> ProgrammedFeed {
        ProgrammedFeed {
            feedrate_mm_min: self.feedrate_mm_min,
            ta_ms: self.ta_ms,
            td_ms: self.td_ms,
            ts_ms: self.ts_ms,
        }
    }
}
