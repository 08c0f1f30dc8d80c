//! Position over time of one segment: what the motion stage gives and the servo cycle evaluates.

use crate::axis::{AXES_MAX, AxisVector};
use crate::flow::Path;
pub use crate::motor_move::{MotorLimits, MotorMove};
use crate::ramp::UnitRamp;
use crate::span::Origin;

/// One planned motion. Times count from its own start, before feed override scales them.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// Number of the segment in its run, from 1, strictly increasing.
    pub segment: u64,
    /// Run of the servo queue that it belongs to; a flush raises it, and what is older is thrown away.
    pub epoch: u32,
    /// Where it comes from.
    pub origin: Origin,
    /// Position as a function of time.
    pub law: Law,
    /// Time from start to end at 100 percent, s.
    pub duration_s: f64,
    /// Which override scales its time.
    pub time_base: TimeBase,
    /// True when it ends at rest with an in-position check.
    pub exact_stop: bool,
}

/// Which override scales the time of a profile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TimeBase {
    /// Feed override, 0 to 200 percent.
    Feed,
    /// Rapid override, 0 to 100 percent.
    Rapid,
    /// None: a dwell lasts as long as programmed. Feed hold still stops it.
    Fixed,
}

/// Position as a function of time. Nothing in it is boxed: the servo cycle would free it, and must not call the
/// allocator.
#[derive(Debug, Clone, PartialEq)]
pub enum Law {
    /// One speed along a path, a ramp at each end: from rest to rest, or blended with the blocks beside it. A blended
    /// block's profile begins where the ramp from the block before is over, and ends with the ramp to the next one.
    Ramped {
        /// The geometry.
        path: Path,
        /// Speed between the ramps, path units per second.
        speed: f64,
        /// From rest to speed.
        start: UnitRamp,
        /// From speed to rest, or over to the speed of the next block.
        stop: UnitRamp,
        /// How far the start ramp has come when the profile begins, s: 0 from rest; all of it when the block began
        /// within the profile before.
        begun_s: f64,
        /// The block that begins along the stop ramp; `None`: this one ends at rest.
        next: Option<Lead>,
    },
    /// Each motor alone: start position and its own law.
    Motors {
        /// Start, machine coordinates.
        from: AxisVector,
        /// Target, machine coordinates.
        to: AxisVector,
        /// One law for each axis.
        moves: [MotorMove; AXES_MAX],
    },
    /// As `Motors`, until a motor's skip input comes: then the servo cycle takes that motor back to where it came.
    Skip {
        /// Start, machine coordinates.
        from: AxisVector,
        /// Target, machine coordinates.
        to: AxisVector,
        /// One law for each axis, to the target.
        moves: [MotorMove; AXES_MAX],
    },
    /// Rest.
    Rest {
        /// Where, machine coordinates.
        at: AxisVector,
    },
}

/// The begin of the next block within the profile of the one before it (motion-semantics 1b).
#[derive(Debug, Clone, PartialEq)]
pub struct Lead {
    /// The next block's geometry.
    pub path: Path,
    /// Its speed after the ramp, path units per second.
    pub speed: f64,
}

impl Lead {
    /// How far the machine is from the joint because of the next block, `ramped_s` being P of the common ramp.
    fn offset(&self, ramped_s: f64) -> AxisVector {
        self.path.point_at(self.speed * ramped_s).minus(self.path.start())
    }
}

impl Profile {
    /// Where the block ends as programmed, machine coordinates.
    pub fn target(&self) -> AxisVector {
        match &self.law {
            Law::Ramped { path, .. } => path.end(),
            Law::Motors { to, .. } | Law::Skip { to, .. } => *to,
            Law::Rest { at } => *at,
        }
    }

    /// Last position of the profile, machine coordinates: its target, and what the next block has gone by then.
    pub fn end(&self) -> AxisVector {
        match &self.law {
            Law::Ramped {
                path,
                stop,
                next: Some(next),
                ..
            } => path.end().plus(next.offset(stop.duration_s() / 2.0)),
            _ => self.target(),
        }
    }

    /// Commanded machine position `t_s` seconds after the start; exact at both ends. A time before the start counts as
    /// the start.
    pub fn position(&self, t_s: f64) -> AxisVector {
        if t_s >= self.duration_s {
            return self.end();
        }
        match &self.law {
            Law::Ramped {
                path,
                speed,
                start,
                stop,
                begun_s,
                next,
            } => {
                let stop_begins_s = self.duration_s - stop.duration_s();
                let stopped_s = stop.distance(t_s - stop_begins_s);
                let own = path.point_at(speed * (start.distance(t_s + begun_s) - stopped_s));
                match next {
                    Some(next) => own.plus(next.offset(stopped_s)),
                    None => own,
                }
            }
            Law::Motors { from, to, moves } | Law::Skip { from, to, moves } => {
                AxisVector(std::array::from_fn(|i| {
                    if t_s >= moves[i].duration_s() {
                        to.0[i]
                    } else {
                        from.0[i] + moves[i].distance(t_s)
                    }
                }))
            }
            Law::Rest { at } => *at,
        }
    }
}
