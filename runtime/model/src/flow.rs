//! What the stages hand on: [`Item`] and [`Block`] from `interp`, [`Segment`] from `path`.

use crate::axis::{AxisSet, AxisVector};
use crate::span::Origin;

/// What the interpreter answers when asked for the next thing.
#[derive(Debug, Clone, PartialEq)]
pub enum Item {
    /// A block for the path stage.
    Block(Block),
    /// An auxiliary function for the sequence program.
    Output(Output),
    /// M00 or M01: acts when motion has come to it (D14).
    Stop(ProgramStop),
    /// The interpreter cannot go on before all motion given so far is at rest; ask again then.
    NeedsStandstill(Origin),
    /// Something worth an event, while the program goes on.
    Warning(Origin, String),
    /// The program has ended: M02, M30, or M99 in a main program.
    End(Origin),
}

/// An auxiliary function as programmed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Output {
    /// Where it stands.
    pub origin: Origin,
    /// M number, 0 to 191.
    pub m: u16,
    /// VA to VH in order; `None` where not programmed.
    pub params: [Option<f64>; 8],
}

impl Output {
    /// True when at least one of VA to VH is programmed; such an output is always `after_motion` (D30).
    pub fn has_params(&self) -> bool {
        self.params.iter().any(Option::is_some)
    }
}

/// M00 or M01.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProgramStop {
    /// Where it stands.
    pub origin: Origin,
    /// True for M01: stops only with the optional stop input on, read when motion has come to it (D14).
    pub optional: bool,
}

/// One block for the path stage. What is modal and matters for motion stands in it.
#[derive(Debug, Clone, PartialEq)]
pub struct Block {
    /// Where it stands.
    pub origin: Origin,
    /// What it does.
    pub action: Action,
    /// Feedrate and ramp times in force.
    pub feed: Feed,
    /// G61, or G64.
    pub path_control: PathControl,
    /// G09 before the axis words: motion comes to an exact stop before this block (D27).
    pub exact_stop_before: bool,
    /// G09 after the axis words: motion comes to an exact stop at the end of this block (D27).
    pub exact_stop_after: bool,
}

/// What a block does.
#[derive(Debug, Clone, PartialEq)]
pub enum Action {
    /// Modal words only. In G64 with G501 it ends a blended chain.
    None,
    /// G00.
    Rapid(AxisWords),
    /// G01.
    Linear(AxisWords),
    /// G04.
    Dwell {
        /// Time at rest, s.
        dwell_s: f64,
    },
    /// The transform for the blocks from here on; moves nothing.
    Transform(Box<Transform>),
}

/// Axis words of a block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisWords {
    /// Programmed values in mm or degrees; zero where not named.
    pub values: AxisVector,
    /// The axes that the block names; the others stay.
    pub named: AxisSet,
    /// How the values count.
    pub distance: Distance,
}

/// G90 or G91.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Distance {
    /// G90: a position in the coordinates in force.
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

/// Feedrate and ramp times of a cutting block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Feed {
    /// F: mm/min over X, Y, Z (deg/min for a block of rotary axes only). 0: never programmed.
    pub feedrate_mm_min: f64,
    /// Acceleration time ta, ms.
    pub ta_ms: f64,
    /// Deceleration time td, ms.
    pub td_ms: f64,
    /// Jerk time ts, ms.
    pub ts_ms: f64,
}

/// From the programmed point to the machine position (D20). Only the work offset exists so far; each further
/// transform becomes a field here and a step in the path stage.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Transform {
    /// G54 to G59, added to the programmed point.
    pub work_offset: AxisVector,
}

/// A piece of the way in machine coordinates, for the motion stage.
#[derive(Debug, Clone, PartialEq)]
pub struct Segment {
    /// Where it comes from.
    pub origin: Origin,
    /// What moves, and how.
    pub motion: SegmentMotion,
    /// How it ends.
    pub end: SegmentEnd,
}

/// How a segment moves.
#[derive(Debug, Clone, PartialEq)]
pub enum SegmentMotion {
    /// Along a path with a programmed feedrate and ramps.
    Feed {
        /// The geometry.
        path: Path,
        /// Speed along it and ramp times. The feedrate is that of the path's length.
        feed: Feed,
    },
    /// G00: each motor alone, in its shortest time.
    Rapid {
        /// Start, machine coordinates.
        from: AxisVector,
        /// Target, machine coordinates.
        to: AxisVector,
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
#[derive(Debug, Clone, PartialEq)]
pub enum Path {
    /// A straight line.
    Line {
        /// Start.
        from: AxisVector,
        /// End.
        to: AxisVector,
        /// What F counts: mm over X, Y, Z, or degrees when only rotary axes move.
        length: f64,
    },
}

impl Path {
    /// Start point.
    pub fn start(&self) -> AxisVector {
        match self {
            Path::Line { from, .. } => *from,
        }
    }

    /// End point.
    pub fn end(&self) -> AxisVector {
        match self {
            Path::Line { to, .. } => *to,
        }
    }

    /// Length that F counts: mm, or degrees for a block of rotary axes only.
    pub fn length(&self) -> f64 {
        match self {
            Path::Line { length, .. } => *length,
        }
    }

    /// The point at `distance` from the start, 0 to the path's length; both ends are exact.
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
