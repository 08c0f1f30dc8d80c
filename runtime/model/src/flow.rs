//! The data that stages pass on: [`Item`] and [`Block`] come from `interp`, [`Segment`] comes from `path`.

use crate::arc::ArcPath;
use crate::axis::{Axis, AxisSet, AxisVector};
use crate::plane::{Plane, Turn};
use crate::span::Origin;
pub use crate::transform::{Mirror, Rotation, Scaling, Transform};
use crate::unit::Unit;

/// The next item of the interpreter.
#[derive(Debug, Clone, PartialEq)]
pub enum Item {
    /// A block for the path stage.
    Block(Block),
    /// An auxiliary function for the sequence program.
    Output(Output),
    /// M00 or M01: acts when the motion reaches it (D14).
    Stop(ProgramStop),
    /// The interpreter cannot continue before all motion so far is at rest; call it again then.
    NeedsStandstill(Origin),
    /// Something worth an event; the program continues.
    Warning(Origin, String),
    /// The program has ended: M02, M30, or M99 in a main program.
    End(Origin),
}

/// An auxiliary function as programmed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Output {
    /// Its place in the program.
    pub origin: Origin,
    /// M number, 0 to 191.
    pub m: u16,
    /// VA to VH in order; `None` if not programmed.
    pub params: [Option<f64>; 8],
}

impl Output {
    /// Returns true if at least one of VA to VH is programmed; such an output is always `after_motion` (D30).
    pub fn has_params(&self) -> bool {
        self.params.iter().any(Option::is_some)
    }
}

/// M00 or M01.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProgramStop {
    /// Its place in the program.
    pub origin: Origin,
    /// True for M01: stops only with the optional stop input on, read when the motion reaches it (D14).
    pub optional: bool,
}

/// One block for the path stage. It carries the modal state that matters for motion.
#[derive(Debug, Clone, PartialEq)]
pub struct Block {
    /// Its place in the program.
    pub origin: Origin,
    /// Action of the block.
    pub action: Action,
    /// Feedrate as written, and current ramp times.
    pub feed: ProgrammedFeed,
    /// The current unit, in which the maximum and the default feedrate are expressed (D25).
    pub unit: Unit,
    /// F for a block that moves rotary axes only, deg/min: as it is written, in inches too (D25). 0: never programmed.
    pub feedrate_deg_min: f64,
    /// G61, or G64.
    pub path_control: PathControl,
    /// G09 before the axis words, or in a block that does not move: motion comes to an exact stop before this block (D27).
    pub exact_stop_before: bool,
    /// G09 after the axis words: motion comes to an exact stop at the end of this block (D27).
    pub exact_stop_after: bool,
    /// G500 or G501.
    pub multi_block: MultiBlock,
    /// G40, G41 or G42, with the plane that it works in.
    pub compensation: Compensation,
}

/// Action of a block.
// Its kind is a word of its own: the odd bytes of a smaller one are moved in overlapping pieces, and each move of a block waited
// for the one before.
#[repr(u64)]
#[derive(Debug, Clone, PartialEq)]
pub enum Action {
    /// Modal words only. In G64 it ends a blended chain; with G500 only with G09.
    None,
    /// G00.
    Rapid(AxisWords),
    /// G01.
    Linear(AxisWords),
    /// G02 or G03.
    Arc(Box<Arc>),
    /// G31: each motor alone at its skip velocity, until its skip input switches on.
    Skip(AxisWords),
    /// G28 or G30: to the middle point, then to a reference point, named axes only (none named: D24).
    Reference {
        /// The middle point.
        middle: AxisWords,
        /// 1 to 4.
        point: u8,
        /// Also with an active tool length offset.
        with_tool_length: bool,
    },
    /// G39: cutter compensation rounds the corner between the motions before and after it, if the next one continues in
    /// this direction; no motion of its own.
    Corner(AxisWords),
    /// G74 or G84 begins: rejected before anything moves when a hole is out of reach or its thread cannot be cut; no
    /// motion of its own.
    ThreadAhead(Box<ThreadAhead>),
    /// A move of G74 or G84 in the thread, into the hole or out of it, with a spindle locked to it.
    Tap(Box<Tap>),
    /// G04.
    Dwell {
        /// Time at rest, s.
        dwell_s: f64,
    },
    /// The transform for the blocks from here on; moves nothing. It ends a chain as [`Action::None`] does, and whenever
    /// the tool length changes.
    Transform(Box<Transform>),
}

/// A circular, spiral, helical or conical move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arc {
    /// Where it ends; axes outside the plane move linearly in the angle.
    pub target: AxisWords,
    /// Plane of the circle.
    pub plane: Plane,
    /// G02 or G03.
    pub turn: Turn,
    /// How the circle is given.
    pub shape: ArcShape,
}

/// How a circle is given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ArcShape {
    /// I, J, K: the centre, from the start point, mm (D26).
    Centre([f64; 3]),
    /// R, mm: positive for an arc up to a half circle, negative for a larger one, 0 for a straight line.
    Radius(f64),
}

/// A move of a tapping cycle in the thread: revolutions are Z travel times S / F (M1h).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tap {
    /// Where it ends: the Z point, or the R point on the way out.
    pub target: AxisWords,
    /// Into the hole, or out of it.
    pub leg: TapLeg,
    /// Direction of the spindle on this move.
    pub turn: Turn,
    /// S, r/min. `None` if the coordinate system has no spindle; then the sequence program turns it.
    pub spindle_speed_r_min: Option<f64>,
}

/// The moves of a block of a tapping cycle, for each hole: the rapids to its position and to the R point, the thread,
/// and the return.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThreadAhead {
    /// Position of the hole, or its distance from the last one; Z is not named.
    pub position: AxisWords,
    /// Number of holes, 1 or more.
    pub repetitions: u16,
    /// The R point, from where the thread begins.
    pub r_point: AxisWords,
    /// The pass into the hole.
    pub tap: Tap,
    /// The level that each hole returns to at the end. `None` selects the R point.
    pub initial: Option<AxisWords>,
}

/// Which move in a thread.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TapLeg {
    /// From the R point to the Z point.
    In,
    /// Back to the R point.
    Out,
}

/// Axis words of a block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisWords {
    /// Programmed values in mm or degrees; zero where not named.
    pub values: AxisVector,
    /// The axes that the block names; the others stay.
    pub named: AxisSet,
    /// Distance mode of the values.
    pub distance: Distance,
    /// Which coordinates they are in.
    pub frame: Frame,
}

/// Coordinates of axis words.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Frame {
    /// The current coordinates.
    #[default]
    Work,
    /// G53: machine coordinates.
    Machine,
}

/// G90 or G91.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Distance {
    /// G90: a position in the current coordinates.
    #[default]
    Absolute,
    /// G91: a distance from the last commanded position.
    Incremental,
}

/// G61 or G64.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PathControl {
    /// G61: each block ends at rest and in position.
    ExactStop,
    /// G64, the start-up default: blocks may blend.
    #[default]
    ContinuousPath,
}

/// G500 or G501.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum MultiBlock {
    /// G501, the start-up default: ramps within each block.
    #[default]
    Off,
    /// G500: acceleration over several blocks within the motors' limits.
    On,
}

/// Active cutter compensation.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Compensation {
    /// G40.
    #[default]
    Off,
    /// G41: the tool is on the left of the path.
    Left {
        /// Tool radius, mm (D17).
        radius: f64,
        /// Plane of the offset.
        plane: Plane,
    },
    /// G42: the tool is on the right of the path.
    Right {
        /// Tool radius, mm (D17).
        radius: f64,
        /// Plane of the offset.
        plane: Plane,
    },
}

/// Feedrate and ramp times as programmed.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ProgrammedFeed {
    /// F: mm/min over X, Y, Z. 0: never programmed.
    pub feedrate_mm_min: f64,
    /// Acceleration time ta, ms.
    pub ta_ms: f64,
    /// Deceleration time td, ms.
    pub td_ms: f64,
    /// Jerk time ts, ms.
    pub ts_ms: f64,
}

/// Feedrate and ramp times of a cutting segment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SegmentFeed {
    /// mm/min over X, Y, Z (deg/min for a segment of rotary axes only).
    pub feedrate_mm_min: f64,
    /// Acceleration time ta, ms.
    pub ta_ms: f64,
    /// Deceleration time td, ms.
    pub td_ms: f64,
    /// Jerk time ts, ms.
    pub ts_ms: f64,
    /// Millimetres of a programmed length of 1: the maximum and the default feedrate count in it (D25).
    pub unit_mm: f64,
}

impl Default for SegmentFeed {
    fn default() -> Self {
        Self {
            feedrate_mm_min: 0.0,
            ta_ms: 0.0,
            td_ms: 0.0,
            ts_ms: 0.0,
            unit_mm: 1.0,
        }
    }
}

/// A piece of the path in machine coordinates, for the motion stage.
#[derive(Debug, Clone, PartialEq)]
pub struct Segment {
    /// Its origin.
    pub origin: Origin,
    /// Kind of the motion.
    pub motion: SegmentMotion,
    /// How it ends.
    pub end: SegmentEnd,
    /// With G500 a cutting block respects the motors' maximum acceleration, and back trace can pass it.
    pub multi_block: MultiBlock,
    /// Number of the motion given to the path stage; pieces added by cutter compensation have the number of their
    /// block. 0 if it belongs to no motion.
    pub serial: u64,
}

/// How a segment moves.
#[derive(Debug, Clone, PartialEq)]
pub enum SegmentMotion {
    /// Along a path with a programmed feedrate and ramps.
    Feed {
        /// The geometry.
        path: Path,
        /// Speed along it and ramp times. The feedrate is that of the path's length.
        feed: SegmentFeed,
    },
    /// G00: each motor alone, in its shortest time.
    Rapid {
        /// Start, machine coordinates.
        from: AxisVector,
        /// Target, machine coordinates.
        to: AxisVector,
    },
    /// G31: each motor alone at its skip velocity; one whose skip input switches on returns to the captured position.
    Skip {
        /// Start, machine coordinates.
        from: AxisVector,
        /// Target, machine coordinates.
        to: AxisVector,
    },
    /// A move in a thread, from rest to rest: no override acts on it, and feed hold waits until the tool is out.
    Tap {
        /// Start, machine coordinates.
        from: AxisVector,
        /// End, machine coordinates; Z differs.
        to: AxisVector,
        /// F as it is written, perhaps above the maximum feedrate, and ramp times.
        feed: SegmentFeed,
        /// Revolutions of the spindle from start to end, clockwise positive; 0: no spindle is locked to the move.
        revolutions: f64,
        /// Into the hole, or out of it.
        leg: TapLeg,
    },
    /// G04.
    Dwell {
        /// Where the machine rests, machine coordinates.
        at: AxisVector,
        /// Time at rest, s.
        dwell_s: f64,
    },
}

/// Geometry in machine coordinates.
// a kind of one byte would be moved together with the odd bytes next to it, which takes longer
#[repr(u64)]
#[derive(Debug, Clone, PartialEq)]
pub enum Path {
    /// A straight line.
    Line {
        /// Start.
        from: AxisVector,
        /// End.
        to: AxisVector,
        /// Length to which F refers: mm over X, Y, Z, or degrees when only rotary axes move.
        length: f64,
    },
    /// A circle, spiral, helix or cone.
    Arc(ArcPath),
}

impl Path {
    /// Returns the start point.
    pub fn start(&self) -> AxisVector {
        match self {
            Path::Line { from, .. } => *from,
            Path::Arc(arc) => arc.start(),
        }
    }

    /// Returns the end point.
    pub fn end(&self) -> AxisVector {
        match self {
            Path::Line { to, .. } => *to,
            Path::Arc(arc) => arc.end(),
        }
    }

    /// Returns the length to which F refers: mm, or degrees for a block of rotary axes only.
    pub fn length(&self) -> f64 {
        match self {
            Path::Line { length, .. } => *length,
            Path::Arc(arc) => arc.length(),
        }
    }

    /// Returns the bound of the change of an axis per unit of the path's length; 0 for an axis that rests.
    #[inline]
    pub fn steepest(&self, axis: Axis) -> f64 {
        match self {
            Path::Line { from, to, length } => {
                let way = (to[axis] - from[axis]).abs();
                if way == 0.0 { 0.0 } else { way / length }
            }
            Path::Arc(arc) => arc.steepest(axis),
        }
    }

    /// Returns the point at `distance` from the start, 0 to the path's length; both ends are exact.
    pub fn point_at(&self, distance: f64) -> AxisVector {
        match self {
            Path::Line { from, to, length } => {
                if distance <= 0.0 {
                    *from
                } else if distance >= *length {
                    *to
                } else {
                    from.plus(to.minus(*from).scaled(distance / length))
                }
            }
            Path::Arc(arc) => arc.point_at(distance),
        }
    }
}

/// How a segment ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SegmentEnd {
    /// At rest and in position.
    ExactStop,
    /// The next segment may blend with it.
    Continuous,
}
