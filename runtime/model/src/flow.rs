//! Data between stages: the crate `interp` produces [`Item`] and [`Block`], the crate `path` produces
//! [`Segment`].

use crate::arc::ArcPath;
use crate::axis::{Axis, AxisSet, AxisVector};
use crate::plane::{Plane, Turn};
use crate::span::Origin;
pub use crate::transform::{Mirror, Rotation, Scaling, Transform};
use crate::unit::Unit;

/// One result of the interpreter; the items follow in program order.
#[derive(Debug, Clone, PartialEq)]
pub enum Item {
    /// A block for the path stage.
    Block(Block),
    /// An auxiliary function for the sequence program.
    Output(Output),
    /// M00 or M01. It takes effect when the motion reaches it (D14).
    Stop(ProgramStop),
    /// The interpreter needs a standstill. The caller waits until all previous motion is at rest, and then
    /// calls the interpreter again.
    NeedsStandstill(Origin),
    /// A warning, which is published as an event; the program continues.
    Warning(Origin, String),
    /// The program has ended: M02, M30, or M99 in a main program.
    End(Origin),
}

/// An auxiliary function, as programmed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Output {
    /// Position of the output in the program.
    pub origin: Origin,
    /// M number, 0 to 191.
    pub m: u16,
    /// Parameters VA to VH in order; `None` if not programmed.
    pub params: [Option<f64>; 8],
}

impl Output {
    /// Returns true if at least one of VA to VH is programmed. Such an output is always `after_motion` (D30).
    pub fn has_params(&self) -> bool {
        self.params.iter().any(Option::is_some)
    }
}

/// Program stop M00 or M01.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProgramStop {
    /// Position of the stop in the program.
    pub origin: Origin,
    /// True for M01, which stops only if the optional stop input is on when the motion reaches it (D14).
    pub optional: bool,
}

/// One block for the path stage, with the modal state that affects motion.
#[derive(Debug, Clone, PartialEq)]
pub struct Block {
    /// Position of the block in the program.
    pub origin: Origin,
    /// Action of the block.
    pub action: Action,
    /// Feedrate as written, and the current ramp times.
    pub feed: ProgrammedFeed,
    /// Current unit. The maximum and the default feedrate are in this unit (D25).
    pub unit: Unit,
    /// F for a block that moves only rotary axes, deg/min, as written, even in G20 (D25). 0 if no F was
    /// programmed.
    pub feedrate_deg_min: f64,
    /// G61 or G64.
    pub path_control: PathControl,
    /// True if G09 is before the axis words, or in a block that does not move. Motion then comes to an exact
    /// stop before this block (D27).
    pub exact_stop_before: bool,
    /// True if G09 is after the axis words. Motion then comes to an exact stop at the end of this block
    /// (D27).
    pub exact_stop_after: bool,
    /// G500 or G501.
    pub multi_block: MultiBlock,
    /// G40, G41 or G42, with the plane of the compensation.
    pub compensation: Compensation,
}

/// Action of a block.
// The discriminant has 64 bits. A smaller one would leave odd bytes, which are moved in overlapping pieces,
// and each move of a block would wait for the previous move.
#[repr(u64)]
#[derive(Debug, Clone, PartialEq)]
pub enum Action {
    /// No motion, only modal words. With G501, in G64, the block ends a blended chain; with G500 only
    /// together with G09.
    None,
    /// Rapid motion, G00.
    Rapid(AxisWords),
    /// Linear motion, G01.
    Linear(AxisWords),
    /// Circular motion, G02 or G03.
    Arc(Box<Arc>),
    /// Skip, G31: each motor moves alone at its skip velocity, until its skip input switches on.
    Skip(AxisWords),
    /// G28 or G30: motion of the named axes to the middle point, then to a reference point. D24 applies if no
    /// axis is named.
    Reference {
        /// The middle point.
        middle: AxisWords,
        /// Number of the reference point, 1 to 4.
        point: u8,
        /// True if the motion is allowed with an active tool length offset.
        with_tool_length: bool,
    },
    /// G39, without motion of its own: cutter compensation rounds the corner between the previous and the
    /// next motion, if the next motion continues in this direction.
    Corner(AxisWords),
    /// Start of G74 or G84, without motion of its own. If a hole is out of reach or its thread cannot be cut,
    /// the block is rejected before anything moves.
    ThreadAhead(Box<ThreadAhead>),
    /// A move of G74 or G84 in the thread, into the hole or out of it. The spindle is locked to the move.
    Tap(Box<Tap>),
    /// Dwell, G04.
    Dwell {
        /// Time at rest, s.
        dwell_s: f64,
    },
    /// The transform for all following blocks, without motion. It ends a chain as [`Action::None`] does, and
    /// always if the tool length changes.
    Transform(Box<Transform>),
}

/// A circular, spiral, helical or conical move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arc {
    /// End of the arc. Axes outside the plane move linearly in the angle.
    pub target: AxisWords,
    /// Plane of the circle.
    pub plane: Plane,
    /// G02 or G03.
    pub turn: Turn,
    /// Definition of the circle.
    pub shape: ArcShape,
}

/// Definition of a circle: centre or radius.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ArcShape {
    /// I, J, K: the centre relative to the start point, mm (D26).
    Centre([f64; 3]),
    /// R, mm: positive for an arc up to a half circle, negative for a larger one, 0 for a straight line.
    Radius(f64),
}

/// A move of a tapping cycle in the thread. The spindle revolutions are the Z travel times S / F (M1h).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tap {
    /// End of the move: the Z point, or the R point on the way out.
    pub target: AxisWords,
    /// Direction of the move: into the hole, or out of it.
    pub leg: TapLeg,
    /// Direction of spindle rotation on this move.
    pub turn: Turn,
    /// S, r/min. `None` if the coordinate system has no spindle; the sequence program then turns the spindle.
    pub spindle_speed_r_min: Option<f64>,
}

/// Data of a tapping cycle's block, for each hole: the rapids to its position and to the R point, the thread,
/// and the return.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThreadAhead {
    /// Position of the hole, or its distance from the previous hole, without Z.
    pub position: AxisWords,
    /// Number of holes, 1 or more.
    pub repetitions: u16,
    /// The R point, from which the thread begins.
    pub r_point: AxisWords,
    /// The move into the hole.
    pub tap: Tap,
    /// Level to which the tool returns after each hole. `None` selects the R point.
    pub initial: Option<AxisWords>,
}

/// Direction of a move in a thread.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TapLeg {
    /// Into the hole, from the R point to the Z point.
    In,
    /// Out of the hole, to the R point.
    Out,
}

/// Axis words of a block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisWords {
    /// Programmed values in mm or degrees; zero for an axis that the block does not name.
    pub values: AxisVector,
    /// The axes that the block names; all other axes stay.
    pub named: AxisSet,
    /// Distance mode of the values, G90 or G91.
    pub distance: Distance,
    /// Coordinates of the values.
    pub frame: Frame,
}

/// Coordinates of axis words.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Frame {
    /// The current work coordinates.
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

/// G61 or G64: behaviour at the end of a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PathControl {
    /// G61: each block ends at rest and in position.
    ExactStop,
    /// G64, the start-up default: blocks may blend.
    #[default]
    ContinuousPath,
}

/// G500 or G501: whether ramps may span several blocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum MultiBlock {
    /// G501, the start-up default: ramps are within each block.
    #[default]
    Off,
    /// G500: motion accelerates and decelerates over several blocks, within the limits of the motors.
    On,
}

/// Active cutter compensation, G40, G41 or G42.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Compensation {
    /// No compensation, G40.
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
    /// F, mm/min over X, Y, Z. 0 if no F was programmed.
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
    /// Feedrate, mm/min over X, Y, Z (deg/min for a segment of rotary axes only).
    pub feedrate_mm_min: f64,
    /// Acceleration time ta, ms.
    pub ta_ms: f64,
    /// Deceleration time td, ms.
    pub td_ms: f64,
    /// Jerk time ts, ms.
    pub ts_ms: f64,
    /// Millimetres per programmed unit of length: the maximum and the default feedrate are in this unit
    /// (D25).
    pub unit_mm: f64,
    /// True if `path_tolerance` does not apply: in cutter compensation, the path stays as programmed.
    pub keeps_path: bool,
}

impl Default for SegmentFeed {
    fn default() -> Self {
        Self {
            feedrate_mm_min: 0.0,
            ta_ms: 0.0,
            td_ms: 0.0,
            ts_ms: 0.0,
            unit_mm: 1.0,
            keeps_path: false,
        }
    }
}

/// A piece of the path in machine coordinates, for the motion stage.
#[derive(Debug, Clone, PartialEq)]
pub struct Segment {
    /// Position in the program of the segment's block.
    pub origin: Origin,
    /// Kind of the motion.
    pub motion: SegmentMotion,
    /// End of the segment: at rest, or blended.
    pub end: SegmentEnd,
    /// With G500, a cutting segment respects the motors' maximum acceleration, and back trace can pass it.
    pub multi_block: MultiBlock,
    /// Number of the motion that was passed to the path stage. Pieces that cutter compensation adds have the
    /// number of their block. 0 if the segment belongs to no motion.
    pub serial: u64,
}

/// Motion of a segment.
#[derive(Debug, Clone, PartialEq)]
pub enum SegmentMotion {
    /// Motion along a path with a programmed feedrate and ramps.
    Feed {
        /// Geometry of the path.
        path: Path,
        /// Feedrate along the path, which refers to the path's length, and ramp times.
        feed: SegmentFeed,
    },
    /// G00: each motor moves alone, in its shortest time.
    Rapid {
        /// Start, machine coordinates.
        from: AxisVector,
        /// Target, machine coordinates.
        to: AxisVector,
    },
    /// G31: each motor moves alone at its skip velocity. A motor whose skip input switches on returns to the
    /// captured position.
    Skip {
        /// Start, machine coordinates.
        from: AxisVector,
        /// Target, machine coordinates.
        to: AxisVector,
    },
    /// A move in a thread, from rest to rest. No override acts on the move, and feed hold waits until the
    /// tool is out of the hole.
    Tap {
        /// Start, machine coordinates.
        from: AxisVector,
        /// End, machine coordinates; its Z differs from that of the start.
        to: AxisVector,
        /// F as written, which may exceed the maximum feedrate, and ramp times.
        feed: SegmentFeed,
        /// Revolutions of the spindle from start to end, clockwise positive; 0 if no spindle is locked to the
        /// move.
        revolutions: f64,
        /// Direction of the move: into the hole, or out of it.
        leg: TapLeg,
    },
    /// Dwell, G04.
    Dwell {
        /// Position during the dwell, machine coordinates.
        at: AxisVector,
        /// Time at rest, s.
        dwell_s: f64,
    },
}

/// Geometry in machine coordinates.
// The discriminant has 64 bits: a discriminant of one byte would be copied with seven bytes of padding, which
// takes longer.
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

    /// Returns the length to which F refers: mm, or degrees if only rotary axes move.
    pub fn length(&self) -> f64 {
        match self {
            Path::Line { length, .. } => *length,
            Path::Arc(arc) => arc.length(),
        }
    }

    /// Returns an upper bound of an axis's change per unit of path length; 0 for an axis that rests.
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

    /// Returns the point at `distance` from the start, 0 to the length of the path; both ends are exact.
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

/// End of a segment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SegmentEnd {
    /// The segment ends at rest and in position.
    ExactStop,
    /// The next segment may blend with this segment.
    Continuous,
}
