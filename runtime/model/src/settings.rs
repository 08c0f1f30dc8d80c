//! Settings of the motors and coordinate systems, as the stages use them.

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
    /// The motor of each axis. `None` if the coordinate system does not have the axis.
    pub motors: [Option<MotorSettings>; AXES_MAX],
    /// Motor of the spindle. `None` if the coordinate system has no spindle.
    pub spindle: Option<MotorSettings>,
    /// Unit of programmed lengths at start-up.
    pub unit: Unit,
    /// Maximum feedrate, mm/min, in G20 inch/min (D25). A higher F is clipped with a warning.
    pub max_feedrate_mm_min: f64,
    /// Feedrate until the program writes F, mm/min, in G20 inch/min (D25). If 0, a program must write F.
    pub default_feedrate_mm_min: f64,
    /// Acceleration time ta until the program sets it, ms.
    pub default_ta_ms: f64,
    /// Deceleration time td until the program sets it, ms.
    pub default_td_ms: f64,
    /// Jerk time ts until the program sets it, ms.
    pub default_ts_ms: f64,
    /// Feedrate of blocks that move only rotary axes, deg/min. If 0, F applies.
    pub rotary_feedrate_deg_min: f64,
    /// Time in which the override changes from 0 to 100 percent, ms.
    pub override_slew_ms: f64,
    /// Time in which feed hold stops the motion from 100 percent, ms.
    pub hold_slew_ms: f64,
    /// Servo period, s.
    pub servo_period_s: f64,
    /// Number of consecutive blocks without motion or output after which alarm 21 is raised: the program
    /// makes no progress.
    pub blocks_without_motion_max: u32,
    /// Options of path and motion, each with a default.
    pub motion: MotionOptions,
    /// Path rules of the dialect in which the programs are written.
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
    /// State of G500 or G501 until a program selects one.
    pub multi_block: MultiBlock,
}

impl PathRules {
    /// Path rules of dialect nj.
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
    /// Each motor moves alone, in its shortest time.
    EachMotor,
    /// All motors move on a straight line, as fast as all of them can together.
    Straight,
}

/// Meaning of F on rotary axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RotaryFeed {
    /// F is in deg/min. If a linear axis moves too, F does not apply to rotary axes.
    Degrees,
    /// F is the speed of the tool along a circle about the A axis. The centre is Y0 Z0 of the work
    /// coordinates; the radius is that at the start of the block (manual dgshape, 1-4 and 2-5).
    Surface,
}

/// Rules of cutter compensation that differ between dialects.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CompensationRules {
    /// Lead-in and lead-out are at least as long as the tool's radius. Rapids are not allowed in
    /// compensation, and overcuts are detected.
    Checked,
    /// Lead-in and lead-out have any length and may be rapids. Rapids are allowed in compensation, and
    /// overcuts are not detected (manual dgshape, G40 to G42).
    Unchecked,
}

/// Options that a dialect leaves to the machine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NcOptions {
    /// Numbers without a decimal point that are read in the unit itself.
    pub calculator: Calculator,
    /// Degrees per increment, for an angle without a decimal point.
    pub angle_increment_deg: f64,
    /// Minimum feedrate, mm/min; 0 for none. In a dialect with a minimum, it replaces any smaller F.
    pub min_feedrate_mm_min: f64,
    /// Minimum spindle speed, r/min. It replaces any smaller S.
    pub min_spindle_speed_r_min: f64,
    /// Maximum spindle speed, r/min. It replaces any larger S; 0 selects the maximum of the spindle's motor.
    pub max_spindle_speed_r_min: f64,
    /// Height above the previous depth at which a peck of a fixed cycle begins to cut, mm.
    pub peck_clearance_mm: f64,
    /// Path of lead-in and lead-out of cutter compensation on the outside of a corner.
    pub compensation_start: CompensationStart,
    /// External offset EXOFS, which shifts all work coordinate systems.
    pub external_offset: AxisVector,
    /// M codes with settings of their own.
    pub m_codes: MCodeSet,
}

impl NcOptions {
    /// Returns the wanted speed, limited to the minimum and maximum spindle speed of these options, r/min.
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

/// Numbers without a decimal point that are read in the unit itself (calculator format). All other numbers
/// without a point count increments (manual dgshape, 1-5).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Calculator {
    /// No numbers.
    #[default]
    None,
    /// All numbers.
    All,
    /// Numbers of F.
    F,
    /// Numbers of I, J, K, R, X, Y, Z and A.
    Dimensions,
}

/// Path of lead-in and lead-out of cutter compensation on the outside of a corner (manual dgshape, G40 to
/// G42).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum CompensationStart {
    /// Straight line to the point perpendicular to the corner.
    #[default]
    A,
    /// Path through the intersection of the offset paths.
    B,
}

/// A set of M codes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MCodeSet([u64; 3]);

impl MCodeSet {
    /// Returns true if the set contains the M code.
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

/// Default value of [`MotionOptions::arc_radius_tolerance_mm`].
pub const ARC_RADIUS_TOLERANCE_MM: f64 = 0.01;

/// Options of path and motion, each with a default.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionOptions {
    /// Largest distance of the path from the programmed path with G500, mm, and degrees for a rotary axis (M1d.8). If
    /// 0, the path is that of G501.
    pub path_tolerance_mm: f64,
    /// Tolerance by which the radius R of an arc may be smaller than half the chord, mm (D26).
    pub arc_radius_tolerance_mm: f64,
    /// Tolerance for the difference of the radii at start and end of an arc, mm. If 0, any difference makes a
    /// spiral.
    pub spiral_tolerance_mm: f64,
    /// Feedrate of dry run, mm/min or deg/min. If 0, the maximum feedrate applies.
    pub dry_run_feedrate_mm_min: f64,
    /// Path to which F refers in cutter compensation.
    pub compensation_feed: CompensationFeed,
    /// Reaction to an overcut in cutter compensation.
    pub overcut: Overcut,
    /// Quantity that is reduced if the blocks of a blended chain are too short for their ramps (M1b).
    pub short_block: ShortBlock,
    /// Distance of the path from a programmed corner above which a check warns, mm. If 0, it does not warn.
    pub corner_warning_mm: f64,
    /// Effect of a feed override below 100 percent with G500 (M1i.1).
    pub low_override: LowOverride,
    /// Simulated skip input of each axis's motor (G31). `None` is an input that never switches on.
    pub simulated_skip: [Option<SimulatedSkip>; AXES_MAX],
    /// Round object that a simulated probe touches with X and Y.
    pub simulated_round: Option<SimulatedRound>,
}

/// Condition under which a simulated skip input is on: the motor's actual machine position, mm or degrees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SimulatedSkip {
    /// The input is on below this position.
    Below(f64),
    /// The input is on above this position.
    Above(f64),
}

/// A round wall about a vertical axis (Z). A simulated probe touches it with X and Y, below its upper edge.
/// Machine positions, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulatedRound {
    /// X and Y of the centre.
    pub centre: [f64; 2],
    /// Radius of the circle on which the centre of the probe's ball lies at contact.
    pub radius: f64,
    /// True for a bore, which the probe touches from inside; false for a boss, which it touches from outside.
    pub is_bore: bool,
    /// Z position of the wall's upper edge. The wall exists only below it.
    pub below: f64,
}

impl SimulatedRound {
    /// Returns the position of an axis (0 for X, 1 for Y) at contact with the wall. Returns `None` if the
    /// probe at this position of X, Y and Z does not touch the wall.
    pub fn touched(&self, axis: usize, [x, y, z]: [f64; 3]) -> Option<f64> {
        let away = [x - self.centre[0], y - self.centre[1]];
        let is_touched = z < self.below && (away[0].hypot(away[1]) > self.radius) == self.is_bore;
        let across = away.get(1_usize.checked_sub(axis)?)?;
        let half = (self.radius.powi(2) - across.powi(2)).max(0.0).sqrt();
        is_touched.then(|| self.centre[axis] + half.copysign(away[axis]))
    }
}

impl SimulatedSkip {
    /// Returns the position at which the input switches.
    pub fn threshold(self) -> f64 {
        match self {
            SimulatedSkip::Below(threshold) | SimulatedSkip::Above(threshold) => threshold,
        }
    }

    /// Returns true if the input is on at this position of the motor.
    pub fn is_on(self, position: f64) -> bool {
        match self {
            SimulatedSkip::Below(threshold) => position < threshold,
            SimulatedSkip::Above(threshold) => position > threshold,
        }
    }
}

/// Path to which F refers in cutter compensation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum CompensationFeed {
    /// The path of the centre of the tool.
    #[default]
    Centre,
    /// The programmed path, which the edge of the tool cuts.
    Edge,
}

/// Reaction to an overcut in cutter compensation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Overcut {
    /// Alarm before the first affected block moves.
    #[default]
    Detect,
    /// Omission of the blocks between which the tool does not fit. If this does not help, an alarm.
    Prevent,
}

/// Quantity that is reduced if the blocks of a blended chain are too short for their ramps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ShortBlock {
    /// The ramps; the feedrate is kept.
    #[default]
    Shrink,
    /// The feedrate; the ramps are kept.
    Extend,
}

/// Effect of a feed override below 100 percent with G500.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LowOverride {
    /// F is multiplied and the motion is planned again. The limits of the motors stay.
    #[default]
    Replan,
    /// The time of the plan is scaled. Accelerations fall with the square of the override.
    TimeBase,
}

impl Default for MotionOptions {
    fn default() -> Self {
        Self {
            path_tolerance_mm: 0.0,
            arc_radius_tolerance_mm: ARC_RADIUS_TOLERANCE_MM,
            spiral_tolerance_mm: 0.0,
            dry_run_feedrate_mm_min: 0.0,
            compensation_feed: CompensationFeed::Centre,
            overcut: Overcut::Detect,
            short_block: ShortBlock::Shrink,
            corner_warning_mm: 0.0,
            low_override: LowOverride::Replan,
            simulated_skip: [None; AXES_MAX],
            simulated_round: None,
        }
    }
}

impl Default for CoordinateSystemSettings {
    /// Returns coordinate system 1 without motors, with the default values of a configuration.
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

/// Settings of one motor. Units: mm for linear motors, degrees for rotary motors, r/min for spindles.
#[derive(Debug, Clone, PartialEq)]
pub struct MotorSettings {
    /// Number of the CNC motor.
    pub number: u16,
    /// Kind of the motor's load.
    pub kind: MotorKind,
    /// Maximum velocity, units per second (spindle: r/min).
    pub max_velocity: f64,
    /// Maximum acceleration, units per second squared (spindle: r/min per second).
    pub max_acceleration: f64,
    /// Maximum jerk, units per second cubed. `None` disables the limit. It applies to G00, G28, G30 and G31 (M1e), and to feed
    /// motion with G500 (M1d). With G501, the jerk follows from `ta`, `td` and `ts`.
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
    /// Lowest and highest machine position. A motion that would leave this range raises an alarm before it
    /// starts.
    pub soft_limits: Option<[f64; 2]>,
    /// Machine positions of the first to fourth reference point.
    pub reference_points: [f64; 4],
    /// Time constant of the simulated drive's following error, ms; 0 for no following error.
    pub lag_ms: f64,
    /// Machine position of the simulated drive at switch-on.
    pub start_at: f64,
    /// True if the simulated drive knows its position at switch-on.
    pub is_homed_at_start: bool,
    /// Speed of spindle orientation, r/min.
    pub orientation_velocity: f64,
    /// Position of spindle orientation, degrees.
    pub orientation_position: f64,
    /// Deviation from the commanded spindle speed up to which the spindle is at speed, percent of the
    /// commanded speed.
    pub at_speed_percent: f64,
}

impl MotorSettings {
    /// Creates a motor with these limits, without jerk limit, soft limits and following error. Other values
    /// are the defaults of a configuration: rapid at the limits, G31 at a tenth of the velocity, in position
    /// within 0.01 in 2 s, orientation at 100 r/min to 0 degrees.
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

/// Kind of a motor's load, with its unit.
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

/// Data of the tool that G41 to G44 use (D17).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Tool {
    /// Length, mm: G43 adds it to Z, G44 subtracts it.
    pub length: f64,
    /// Radius, mm: the offset with G41 and G42.
    pub radius: f64,
}

impl Tool {
    /// A tool with lost data.
    pub const LOST: Tool = Tool {
        length: LOST,
        radius: LOST,
    };

    /// Returns true if the length or the radius is lost.
    pub fn is_lost(&self) -> bool {
        is_lost(self.length) || is_lost(self.radius)
    }
}
