//! The machine as the stages see it: its motors and coordinate systems.

use crate::axis::{AXES_MAX, Axis, AxisSet, AxisVector};
use crate::flow::MultiBlock;
use crate::limits::STEPS_WITHOUT_ITEM_MAX;
use crate::lost::{LOST, is_lost};
pub use crate::unit::Unit;

/// Settings of one coordinate system, resolved from the configuration.
#[derive(Debug, Clone, PartialEq)]
pub struct CoordinateSystemSettings {
    /// Number of the coordinate system, from 1.
    pub number: u8,
    /// The motor of each axis; `None` for an axis that it does not have.
    pub motors: [Option<MotorSettings>; AXES_MAX],
    /// The spindle's motor.
    pub spindle: Option<MotorSettings>,
    /// The unit at start-up.
    pub unit: Unit,
    /// F above it is clipped with a warning, mm/min; in G20 inch/min (D25).
    pub max_feedrate_mm_min: f64,
    /// F before one is programmed, mm/min, in G20 inch/min (D25); 0: F must be programmed.
    pub default_feedrate_mm_min: f64,
    /// ta before one is programmed, ms.
    pub default_ta_ms: f64,
    /// td before one is programmed, ms.
    pub default_td_ms: f64,
    /// ts before one is programmed, ms.
    pub default_ts_ms: f64,
    /// Feedrate of blocks that move only rotary axes, deg/min; 0: F.
    pub rotary_feedrate_deg_min: f64,
    /// Time for the override to go from 0 to 100 percent, ms.
    pub override_slew_ms: f64,
    /// Time for feed hold to come from 100 percent to rest, ms.
    pub hold_slew_ms: f64,
    /// Servo period, s.
    pub servo_period_s: f64,
    /// Blocks without motion or output after which a program makes no progress (alarm 21).
    pub blocks_without_motion_max: u32,
    /// Rules of path and motion with a default.
    pub motion: MotionOptions,
    /// Path rules of the programs' dialect.
    pub path: PathRules,
    /// Options that a dialect leaves to the machine.
    pub nc: NcOptions,
}

/// Path rules of a dialect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PathRules {
    /// Path of a rapid.
    pub rapid: RapidPath,
    /// Meaning of F on rotary axes.
    pub rotary_feed: RotaryFeed,
    /// Lead-in and checks of cutter compensation.
    pub compensation: CompensationRules,
    /// Whether ramps span blocks before a code selects it.
    pub multi_block: MultiBlock,
}

impl PathRules {
    /// Those of dialect nj.
    pub const NJ: Self = Self {
        rapid: RapidPath::EachMotor,
        rotary_feed: RotaryFeed::Degrees,
        compensation: CompensationRules::Checked,
        multi_block: MultiBlock::Off,
    };
}

/// Path of a rapid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RapidPath {
    /// Each motor alone, in its shortest time.
    EachMotor,
    /// Straight, as fast as the motors can together.
    Straight,
}

/// Meaning of F on rotary axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RotaryFeed {
    /// Degrees, and nothing where a linear axis moves, too.
    Degrees,
    /// The path of the tool on a circle about the A axis, whose centre is Y0 Z0 of the work coordinates, with the
    /// radius where the block begins (manual dgshape, 1-4 and 2-5).
    Surface,
}

/// The rules of cutter compensation that dialects have different.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CompensationRules {
    /// Led in and out over the tool's radius at least; rapids do not move in it, and overcuts are looked for.
    Checked,
    /// Led in and out over any length, also by rapids, which move in it; overcuts are not looked for (manual dgshape,
    /// G40 to G42).
    Unchecked,
}

/// Options that a dialect leaves to the machine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NcOptions {
    /// Which numbers without a decimal point are read as by a calculator.
    pub calculator: Calculator,
    /// Degrees of 1 in an angle without a decimal point.
    pub angle_increment_deg: f64,
    /// In a dialect that has a least feedrate, smaller F are replaced by this, mm/min; 0 for none.
    pub min_feedrate_mm_min: f64,
    /// Smaller S are replaced by this, r/min.
    pub min_spindle_speed_r_min: f64,
    /// Larger S are replaced by this, r/min; 0 selects the maximum of the spindle's motor.
    pub max_spindle_speed_r_min: f64,
    /// How far above the last depth a peck of a fixed cycle begins to cut, mm.
    pub peck_clearance_mm: f64,
    /// The path of lead-in and lead-out of cutter compensation on the outside of a corner.
    pub compensation_start: CompensationStart,
    /// EXOFS: shift of all work coordinate systems.
    pub external_offset: AxisVector,
    /// M codes with settings.
    pub m_codes: MCodeSet,
}

impl NcOptions {
    /// Returns a speed within those of the spindle that are set here, r/min.
    pub fn spindle_speed_within(&self, wanted_r_min: f64) -> f64 {
        let fastest = match self.max_spindle_speed_r_min {
            max if max > 0.0 => max,
            _ => f64::INFINITY,
        };
        wanted_r_min.max(self.min_spindle_speed_r_min).min(fastest)
    }
}

impl Default for NcOptions {
    fn default() -> Self {
        Self {
            calculator: Calculator::None,
            angle_increment_deg: 0.001,
            min_feedrate_mm_min: 0.001,
            min_spindle_speed_r_min: 0.0,
            max_spindle_speed_r_min: 0.0,
            peck_clearance_mm: 0.5,
            compensation_start: CompensationStart::A,
            external_offset: AxisVector::ZERO,
            m_codes: MCodeSet::default(),
        }
    }
}

/// Numbers without a decimal point that are read as by a calculator, in the unit itself; all others count increments
/// (manual dgshape, 1-5).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Calculator {
    /// None.
    #[default]
    None,
    /// All.
    All,
    /// Those of F.
    F,
    /// Those of I, J, K, R, X, Y, Z and A.
    Dimensions,
}

/// The path of lead-in and lead-out of cutter compensation on the outside of a corner (manual dgshape, G40 to G42).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum CompensationStart {
    /// Straight to the point next to the corner.
    #[default]
    A,
    /// Through the point where the offset paths meet.
    B,
}

/// A set of M codes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MCodeSet([u64; 3]);

impl MCodeSet {
    /// Returns true for an M code of the set.
    pub fn contains(&self, m: u16) -> bool {
        let word = self.0.get(usize::from(m / 64));
        word.is_some_and(|word| word & (1 << (m % 64)) != 0)
    }
}

impl FromIterator<u16> for MCodeSet {
    fn from_iter<I: IntoIterator<Item = u16>>(codes: I) -> Self {
        let mut set = Self::default();
        for m in codes {
            if let Some(word) = set.0.get_mut(usize::from(m / 64)) {
                *word |= 1 << (m % 64);
            }
        }
        set
    }
}

/// Default of [`MotionOptions::arc_radius_tolerance_mm`].
pub const ARC_RADIUS_TOLERANCE_MM: f64 = 0.01;

/// Rules of path and motion with a default.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionOptions {
    /// R form of an arc: how much the radius may fall short of half the chord, mm (D26).
    pub arc_radius_tolerance_mm: f64,
    /// How much the radii at start and end of an arc may differ, mm; 0: any difference makes a spiral.
    pub spiral_tolerance_mm: f64,
    /// Feedrate of dry run, mm/min or deg/min; 0: the maximum feedrate.
    pub dry_run_feedrate_mm_min: f64,
    /// Path to which F refers with cutter compensation.
    pub compensation_feed: CompensationFeed,
    /// The reaction to an overcut with cutter compensation.
    pub overcut: Overcut,
    /// Quantity that is reduced in a chain of blended blocks that are too short for their ramps (M1b).
    pub short_block: ShortBlock,
    /// The simulated skip input of each axis's motor (G31). With `None` the input never switches on.
    pub simulated_skip: [Option<SimulatedSkip>; AXES_MAX],
    /// Object that a simulated probe touches with X and Y.
    pub simulated_round: Option<SimulatedRound>,
}

/// When a simulated skip input is on, by the motor's actual machine position, mm or degrees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SimulatedSkip {
    /// Below this position.
    Below(f64),
    /// Above this position.
    Above(f64),
}

/// A round wall about Z that a simulated probe touches with X and Y, below its upper edge: machine positions, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulatedRound {
    /// X and Y of the centre.
    pub centre: [f64; 2],
    /// Radius of the circle on which the centre of the probe's ball touches.
    pub radius: f64,
    /// True for a bore, which is touched from within; false for a boss, which is touched from outside.
    pub is_bore: bool,
    /// The wall is where Z is below this.
    pub below: f64,
}

impl SimulatedRound {
    /// Returns where an axis reaches the wall that the probe at this position of X, Y and Z touches; `axis`: 0 for X, 1
    /// for Y.
    pub fn touched(&self, axis: usize, [x, y, z]: [f64; 3]) -> Option<f64> {
        let away = [x - self.centre[0], y - self.centre[1]];
        let is_touched = z < self.below && (away[0].hypot(away[1]) > self.radius) == self.is_bore;
        let across = away.get(1_usize.checked_sub(axis)?)?;
        let half = (self.radius.powi(2) - across.powi(2)).max(0.0).sqrt();
        is_touched.then(|| self.centre[axis] + half.copysign(away[axis]))
    }
}

impl SimulatedSkip {
    /// Returns the position at which it turns on.
    pub fn threshold(self) -> f64 {
        match self {
            SimulatedSkip::Below(threshold) | SimulatedSkip::Above(threshold) => threshold,
        }
    }

    /// Returns true if the input is on at this position.
    pub fn is_on(self, position: f64) -> bool {
        match self {
            SimulatedSkip::Below(threshold) => position < threshold,
            SimulatedSkip::Above(threshold) => position > threshold,
        }
    }
}

/// Path to which F refers with cutter compensation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum CompensationFeed {
    /// The path of the tool's centre.
    #[default]
    Centre,
    /// On the programmed arc, where the tool's edge cuts.
    Edge,
}

/// The reaction to an overcut with cutter compensation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Overcut {
    /// An alarm before the first block that it concerns moves.
    #[default]
    Detect,
    /// The blocks that the tool does not fit between are left out; an alarm where that does not help.
    Prevent,
}

/// Quantity that is reduced in a chain of blended blocks that are too short for their ramps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ShortBlock {
    /// The ramps: the feedrate is kept.
    #[default]
    Shrink,
    /// The feedrate: the ramps are kept.
    Extend,
}

impl Default for MotionOptions {
    fn default() -> Self {
        Self {
            arc_radius_tolerance_mm: ARC_RADIUS_TOLERANCE_MM,
            spiral_tolerance_mm: 0.0,
            dry_run_feedrate_mm_min: 0.0,
            compensation_feed: CompensationFeed::Centre,
            overcut: Overcut::Detect,
            short_block: ShortBlock::Shrink,
            simulated_skip: [None; AXES_MAX],
            simulated_round: None,
        }
    }
}

impl Default for CoordinateSystemSettings {
    /// Returns coordinate system 1 without motors, with the defaults of a configuration.
    fn default() -> Self {
        Self {
            number: 1,
            motors: [const { None }; AXES_MAX],
            spindle: None,
            unit: Unit::Millimetre,
            max_feedrate_mm_min: 10_000.0,
            default_feedrate_mm_min: 0.0,
            default_ta_ms: 100.0,
            default_td_ms: 100.0,
            default_ts_ms: 50.0,
            rotary_feedrate_deg_min: 0.0,
            override_slew_ms: 1000.0,
            hold_slew_ms: 200.0,
            servo_period_s: 0.001,
            blocks_without_motion_max: STEPS_WITHOUT_ITEM_MAX,
            motion: MotionOptions::default(),
            path: PathRules::NJ,
            nc: NcOptions::default(),
        }
    }
}

impl CoordinateSystemSettings {
    /// Returns the axes that the coordinate system has.
    pub fn axes(&self) -> AxisSet {
        Axis::ALL
            .into_iter()
            .filter(|axis| self.motors[axis.index()].is_some())
            .collect()
    }
}

/// Settings of one motor. Units: mm for linear, degrees for rotary motors, r/min for spindles.
#[derive(Debug, Clone, PartialEq)]
pub struct MotorSettings {
    /// CNC motor number.
    pub number: u16,
    /// Kind of its load.
    pub kind: MotorKind,
    /// Units per second (spindle: r/min).
    pub max_velocity: f64,
    /// Units per second squared (spindle: r/min per second).
    pub max_acceleration: f64,
    /// Units per second cubed, of G00, G28, G30 and G31 (M1e) and, with G500, of lines, arcs and the ramps between them
    /// (M1d). `None` disables the limit. Other feed motion has the jerk that ta, td and ts give it, and steps within
    /// `max_acceleration` where look-ahead changes the rate.
    pub max_jerk: Option<f64>,
    /// Speed of G00, units per second.
    pub rapid_velocity: f64,
    /// Acceleration of G00, units per second squared.
    pub rapid_acceleration: f64,
    /// Speed of G31, units per second.
    pub skip_velocity: f64,
    /// Largest following error at which the motor is in position, units.
    pub in_position: f64,
    /// Time after which a motor that is not in position raises an alarm, ms.
    pub in_position_timeout_ms: f64,
    /// Lowest and highest machine position; leaving them is an alarm before the motion starts.
    pub soft_limits: Option<[f64; 2]>,
    /// First to fourth reference point, machine position.
    pub reference_points: [f64; 4],
    /// Time constant of the simulated drive's following error, ms; 0: ideal.
    pub lag_ms: f64,
    /// Machine position of the simulated drive when it is switched on.
    pub start_at: f64,
    /// The simulated drive knows its position when it is switched on.
    pub is_homed_at_start: bool,
    /// Spindle: speed of orientation, r/min.
    pub orientation_velocity: f64,
    /// Spindle: position of orientation, degrees.
    pub orientation_position: f64,
    /// Spindle: difference from the commanded speed within which that speed is reached, percent of it.
    pub at_speed_percent: f64,
}

impl MotorSettings {
    /// Creates a motor of these limits without jerk limit, soft limits and lag, and otherwise with the
    /// defaults of a configuration: rapid at the limits, G31 at a tenth of the velocity, in position within
    /// 0.01 in 2 s, oriented at 100 r/min to 0 degrees.
    pub fn new(number: u16, kind: MotorKind, max_velocity: f64, max_acceleration: f64) -> Self {
        Self {
            number,
            kind,
            max_velocity,
            max_acceleration,
            max_jerk: None,
            rapid_velocity: max_velocity,
            rapid_acceleration: max_acceleration,
            skip_velocity: max_velocity / 10.0,
            in_position: 0.01,
            in_position_timeout_ms: 2000.0,
            soft_limits: None,
            reference_points: [0.0; 4],
            lag_ms: 0.0,
            start_at: 0.0,
            is_homed_at_start: true,
            orientation_velocity: 100.0,
            orientation_position: 0.0,
            at_speed_percent: 10.0,
        }
    }
}

/// Load of a motor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MotorKind {
    /// A linear axis, mm.
    Linear,
    /// A rotary axis, degrees.
    Rotary,
    /// A spindle, r/min.
    Spindle,
}

/// Work offsets G54 to G59 of one coordinate system.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WorkOffsets(pub [AxisVector; 6]);

/// The tool that G41 to G44 use (D17).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Tool {
    /// Length, mm: G43 adds it to Z, G44 subtracts it.
    pub length: f64,
    /// Radius, mm: the offset of G41 and G42.
    pub radius: f64,
}

impl Tool {
    /// A tool whose data is lost.
    pub const LOST: Tool = Tool {
        length: LOST,
        radius: LOST,
    };

    /// Returns true if its data is lost.
    pub fn is_lost(&self) -> bool {
        is_lost(self.length) || is_lost(self.radius)
    }
}
