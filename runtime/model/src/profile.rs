//! Position of one segment as a function of time: the motion stage produces it, the servo cycle evaluates it.

use crate::axis::{AXES_MAX, AxisVector};
pub use crate::cubic::CubicMotion;
use crate::flow::{Path, TapLeg};
pub use crate::motor_move::{JERK_RESERVE, MotorLimits, MotorMove};
pub use crate::motor_stop::MotorStop;
pub use crate::pace::{PACE_PIECES_MAX, Pace, PacePiece, PathPlace, SlewRoom, Stretch};
use crate::ramp::UnitRamp;
use crate::span::Origin;
pub use crate::speed_growth::SpeedGrowth;

/// Number of golden sections of a range, to a millionth of it.
const SECTIONS: u32 = 30;

/// One planned motion. Its times count from its own start at an override of 100 percent.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// Number of the segment in the run, from 1, strictly increasing.
    pub segment: u64,
    /// Epoch of the servo queue for which the profile was planned. A flush of the queue raises the epoch, and
    /// the servo drops profiles of older epochs.
    pub epoch: u32,
    /// Block from which the profile comes.
    pub origin: Origin,
    /// Position as a function of time.
    pub law: Law,
    /// Time from start to end at an override of 100 percent, s.
    pub duration_s: f64,
    /// True if the profile ends at rest with an in-position check.
    pub exact_stop: bool,
}

/// The override that scales the time of a profile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TimeBase {
    /// Feed override, 0 to 200 percent.
    Feed,
    /// Rapid override, 0 to 100 percent.
    Rapid,
    /// No override: a dwell and a thread take the programmed time. Feed hold stops a dwell, except in a
    /// thread.
    Fixed,
}

/// Position as a function of time. No variant contains a box, because the servo cycle would free the box, and
/// the servo cycle must not call the allocator.
#[allow(
    clippy::large_enum_variant,
    reason = "a box would be freed by the servo cycle"
)]
#[derive(Debug, Clone, PartialEq)]
pub enum Law {
    /// A block at feedrate as planned: from rest to rest, or blended with the blocks before and after it.
    Ramped {
        /// Geometry, speed and ramps of the block.
        block: RampedMotion,
        /// Position of the block in its chain.
        place: ChainPlace,
    },
    /// A block as in `Ramped`, but in plan time, which advances at a pace that respects the limits of the
    /// motors (M1d).
    Paced {
        /// Motion of the block at its programmed speed. If several profiles pass one block, the pace ends
        /// before the end of the block.
        block: PacedMotion,
        /// Plan time as a function of time.
        pace: Pace,
    },
    /// A motion in which each motor moves alone, by its own law.
    Motors {
        /// Start, machine coordinates.
        from: AxisVector,
        /// Target, machine coordinates.
        to: AxisVector,
        /// One law for each axis, over the distance from start to target.
        moves: [MotorMove; AXES_MAX],
        /// The part of the motion that this profile passes, forward or backward.
        stretch: Stretch,
    },
    /// A motion as in `Motors`, until the skip input of a motor switches on. The servo cycle then returns
    /// this motor to the captured position.
    Skip {
        /// Start, machine coordinates.
        from: AxisVector,
        /// Target, machine coordinates.
        to: AxisVector,
        /// One law for each axis, over the distance from start to target.
        moves: [MotorMove; AXES_MAX],
    },
    /// A move in a thread from rest to rest, with ramps as in `Ramped`. The spindle turns in proportion to
    /// the distance (M1h).
    Tap {
        /// Start, machine coordinates.
        from: AxisVector,
        /// End, machine coordinates.
        to: AxisVector,
        /// Speed between the ramps, as the share of the whole distance covered per second.
        rate: f64,
        /// Ramp from rest to `rate`.
        start: UnitRamp,
        /// Ramp from `rate` to rest.
        stop: UnitRamp,
        /// Revolutions of the spindle from start to end, clockwise positive; 0 if the spindle is not locked
        /// to the move.
        revolutions: f64,
        /// Direction of the move: into the hole, or out of it.
        leg: TapLeg,
    },
    /// A wait at rest.
    Rest {
        /// Position during the wait, machine coordinates.
        at: AxisVector,
        /// The part of the waiting time that this profile waits; empty in backward motion.
        stretch: Stretch,
    },
}

/// A block along its path at one speed with a ramp at each end. A blended block begins after the ramp from
/// the previous block, and ends with the ramp to the next block.
#[derive(Debug, Clone, PartialEq)]
pub struct RampedMotion {
    /// Geometry of the block.
    pub path: Path,
    /// Speed between the ramps, path units per second.
    pub speed: f64,
    /// Ramp from rest to `speed`.
    pub start: UnitRamp,
    /// Ramp from `speed` to rest, or to the speed of the next block.
    pub stop: UnitRamp,
    /// Progress of the start ramp at plan time 0, s. It is 0 for a start from rest, and the whole ramp time
    /// if the block began within the profile of the previous block.
    pub begun_s: f64,
    /// The next block, which begins along the stop ramp. `None` if this block ends at rest.
    pub next: Option<Lead>,
    /// Plan time at the end of the block, s.
    pub plan_s: f64,
}

/// Motion of a block with G500 at its programmed speed.
#[allow(
    clippy::large_enum_variant,
    reason = "a box would be freed by the servo cycle"
)]
#[derive(Debug, Clone, PartialEq)]
pub enum PacedMotion {
    /// A block of M1b: its path, with the ramps to the blocks before and after it.
    Ramped(RampedMotion),
    /// A part of a block whose path was smoothed.
    Smoothed(CubicMotion),
}

impl PacedMotion {
    /// Returns the machine position at a plan time.
    pub fn position(&self, plan_s: f64) -> AxisVector {
        match self {
            Self::Ramped(block) => block.position(plan_s),
            Self::Smoothed(part) => part.position(plan_s),
        }
    }

    /// Returns the block of a programmed path; `None` on a smoothed path.
    pub fn as_ramped(&self) -> Option<&RampedMotion> {
        match self {
            Self::Ramped(block) => Some(block),
            Self::Smoothed(_) => None,
        }
    }

    /// Returns the programmed start and end of the block, machine coordinates.
    pub fn programmed(&self) -> [AxisVector; 2] {
        match self {
            Self::Ramped(block) => [block.path.start(), block.path.end()],
            Self::Smoothed(part) => part.programmed,
        }
    }
}

/// The start of the next block within the profile of the one before it (M1b).
#[derive(Debug, Clone, PartialEq)]
pub struct Lead {
    /// Geometry of the next block.
    pub path: Path,
    /// Speed of the next block after the ramp, path units per second.
    pub speed: f64,
}

/// Position of a profile in a chain of blocks between two stops (M1b).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChainPlace {
    /// Number of the first segment of the chain.
    pub first_segment: u64,
    /// Time from the start of the chain to the end of the profile at an override of 100 percent, s.
    pub ends_s: f64,
}

impl Law {
    /// Returns the override that scales the time of the profile.
    pub fn time_base(&self) -> TimeBase {
        match self {
            Law::Ramped { .. } | Law::Paced { .. } => TimeBase::Feed,
            Law::Motors { .. } | Law::Skip { .. } => TimeBase::Rapid,
            Law::Tap { .. } | Law::Rest { .. } => TimeBase::Fixed,
        }
    }
}

/// Returns velocity and acceleration at a distance along a path, for this speed and acceleration along the path.
fn along(path: &Path, distance: f64, [speed, acceleration]: [f64; 2]) -> [AxisVector; 2] {
    let [first, second] = match path {
        Path::Line { from, to, length } => [to.minus(*from).scaled(1.0 / length), AxisVector::ZERO],
        Path::Arc(arc) => arc.derivatives_at(distance),
    };
    [
        first.scaled(speed),
        first.scaled(acceleration).plus(second.scaled(speed * speed)),
    ]
}

/// Returns the argument at which a function with one minimum in a range has its minimum, by golden sections.
fn minimum([mut from, mut to]: [f64; 2], of: impl Fn(f64) -> f64) -> f64 {
    let share = (3.0 - 5.0_f64.sqrt()) / 2.0;
    let mut inner = [from + share * (to - from), to - share * (to - from)];
    let mut values = inner.map(&of);
    for _ in 0..SECTIONS {
        if values[0] < values[1] {
            to = inner[1];
            inner = [from + share * (to - from), inner[0]];
            values = [of(inner[0]), values[0]];
        } else {
            from = inner[0];
            inner = [inner[1], to - share * (to - from)];
            values = [values[1], of(inner[1])];
        }
    }
    f64::midpoint(from, to)
}

/// Returns the position `t_s` seconds after the start of motors that each move alone. Start and end position
/// of each motor are exact.
fn alone([from, to]: [&AxisVector; 2], moves: &[MotorMove; AXES_MAX], t_s: f64) -> AxisVector {
    AxisVector(std::array::from_fn(|i| {
        if t_s >= moves[i].duration_s() {
            to.0[i]
        } else {
            from.0[i] + moves[i].distance(t_s)
        }
    }))
}

impl RampedMotion {
    /// Returns the machine position at a plan time; the end position is exact.
    pub fn position(&self, plan_s: f64) -> AxisVector {
        if plan_s >= self.plan_s {
            return self.end_position();
        }
        let (gone, stopped_s) = self.covered_distances(plan_s);
        self.beyond(self.path.point_at(gone), stopped_s)
    }

    /// Returns two values at a plan time: the distance along the block's own path, and P of its stop ramp. P
    /// times the speed of the next block is the distance along the path of the next block.
    #[inline]
    pub fn covered_distances(&self, plan_s: f64) -> (f64, f64) {
        let stopped_s = self
            .stop
            .distance(plan_s - (self.plan_s - self.stop.duration_s()));
        let gone = self.speed * (self.start.distance(plan_s + self.begun_s) - stopped_s);
        (gone, stopped_s)
    }

    /// Returns the distance, over X, Y and Z, of the path from the programmed corner at the end of the block, at the
    /// nearest point of the path, mm. Returns `None` if the distance is at most `above`, or if the block ends at rest.
    pub fn corner_distance(&self, above: f64) -> Option<f64> {
        self.next.as_ref()?;
        let corner = self.path.end();
        let off = |plan_s: f64| self.position(plan_s).minus(corner).orthogonal_length();
        let [from_s, to_s] = [self.plan_s - self.stop.duration_s(), self.plan_s];
        // With equal speeds the nearest point is at the middle of the ramp, otherwise nearby.
        let at_middle = off(f64::midpoint(from_s, to_s));
        if at_middle <= above {
            return None;
        }
        let nearest = off(minimum([from_s, to_s], off)).min(at_middle);
        Some(nearest).filter(|nearest| *nearest > above)
    }

    /// Returns velocity and acceleration at a plan time, by the formulas of the phases that contain `within_s`.
    pub fn motion_at(&self, plan_s: f64, within_s: f64) -> [AxisVector; 2] {
        let stop_s = self.plan_s - self.stop.duration_s();
        let [started, _] = self.start.slopes(plan_s + self.begun_s, within_s + self.begun_s);
        let [stopped, _] = self.stop.slopes(plan_s - stop_s, within_s - stop_s);
        let (own, ramped_s) = self.covered_distances(plan_s);
        let stopping = self.stop.speed(plan_s - stop_s);
        let own_speed = self.speed * (self.start.speed(plan_s + self.begun_s) - stopping);
        let own = along(&self.path, own, [own_speed, self.speed * (started - stopped)]);
        let Some(Lead { path, speed }) = &self.next else {
            return own;
        };
        let next = along(path, speed * ramped_s, [speed * stopping, speed * stopped]);
        [own[0].plus(next[0]), own[1].plus(next[1])]
    }

    /// Returns the machine position at the end: the end of the block's path, moved by the distance that the
    /// next block has covered by then.
    pub fn end_position(&self) -> AxisVector {
        self.beyond(self.path.end(), self.stop.duration_s() / 2.0)
    }

    /// Returns the point `own` of the block's path, moved by the distance that the next block has covered.
    /// `ramped_s` is P of the common ramp.
    fn beyond(&self, own: AxisVector, ramped_s: f64) -> AxisVector {
        match &self.next {
            Some(Lead { path, speed }) => own.plus(path.point_at(speed * ramped_s).minus(path.start())),
            None => own,
        }
    }
}

impl Profile {
    /// Returns the programmed end of the block, machine coordinates. For backward motion, returns the
    /// programmed start.
    pub fn target(&self) -> AxisVector {
        match &self.law {
            Law::Paced { block, pace } => block.programmed()[usize::from(!pace.is_backward())],
            Law::Motors { from, stretch, .. } if stretch.is_backward() => *from,
            Law::Ramped { block, .. } => block.path.end(),
            Law::Motors { to, .. } | Law::Skip { to, .. } | Law::Tap { to, .. } => *to,
            Law::Rest { at, .. } => *at,
        }
    }

    /// Returns the last position of the profile, machine coordinates: its target, moved by the distance that
    /// the next block has covered by then.
    pub fn end_position(&self) -> AxisVector {
        match &self.law {
            Law::Ramped { block, .. } => block.end_position(),
            Law::Paced { block, pace } => block.position(pace.ends_s),
            _ => self.target(),
        }
    }

    /// Returns the commanded machine position `t_s` seconds after the start; both ends are exact. Returns the
    /// start position for a time before the start.
    pub fn position(&self, t_s: f64) -> AxisVector {
        if t_s >= self.duration_s {
            return self.end_position();
        }
        match &self.law {
            Law::Ramped { block, .. } => block.position(t_s),
            Law::Paced { block, pace } => block.position(pace.plan_time(t_s)),
            Law::Motors {
                from,
                to,
                moves,
                stretch,
            } => alone([from, to], moves, stretch.plan_time(t_s)),
            Law::Skip { from, to, moves } => alone([from, to], moves, t_s),
            Law::Tap { from, to, .. } => from.plus(to.minus(*from).scaled(self.tap_share(t_s))),
            Law::Rest { at, .. } => *at,
        }
    }

    /// Returns the plan time within the block `t_s` seconds after the start, s, as in [`PathPlace`].
    pub fn plan_time(&self, t_s: f64) -> f64 {
        match &self.law {
            Law::Paced { pace, .. } => pace.plan_time(t_s),
            Law::Motors { stretch, .. } | Law::Rest { stretch, .. } => stretch.plan_time(t_s),
            _ => t_s,
        }
    }

    /// Returns true if the profile begins at rest, or has a pace. If false, the time base must begin at 0, as
    /// after a feed hold.
    pub fn begins_at_its_rate(&self) -> bool {
        match &self.law {
            Law::Motors { moves, stretch, .. } => {
                moves.iter().all(|motor| motor.velocity_at(stretch.from_s) == 0.0)
            }
            _ => true,
        }
    }

    /// Returns the same motion over another stretch of its plan time, if the profile is a rapid or rest.
    /// Returns any other profile unchanged.
    #[must_use]
    pub fn over(&self, passed: Stretch) -> Self {
        let mut profile = self.clone();
        if let Law::Motors { stretch, .. } | Law::Rest { stretch, .. } = &mut profile.law {
            *stretch = passed;
            profile.duration_s = passed.duration_s();
        }
        profile
    }

    /// Returns the distance, over X, Y and Z, of the path from the programmed corner at the end of the block, at the
    /// nearest point of the path, mm. Returns `None` if the distance is at most `above`, or if the profile does not
    /// reach the end of a block that continues into the next one.
    pub fn corner_distance(&self, above: f64) -> Option<f64> {
        let ramped = match &self.law {
            Law::Ramped { block, .. } => block,
            Law::Paced {
                block: PacedMotion::Ramped(block),
                pace,
            } if pace.ends_s >= block.plan_s => block,
            Law::Paced {
                block: PacedMotion::Smoothed(part),
                ..
            } if part.to_s >= part.plan_s => {
                return Some(part.corner_distance()).filter(|off| *off > above);
            }
            _ => return None,
        };
        ramped.corner_distance(above)
    }

    /// Returns the revolutions that the spindle has turned `t_s` seconds after the start, clockwise positive,
    /// in proportion to the distance and exact at both ends. Returns `None` if the spindle is not locked to
    /// this profile.
    pub fn spindle_revolutions(&self, t_s: f64) -> Option<f64> {
        match self.law {
            Law::Tap { revolutions, .. } if revolutions != 0.0 => Some(revolutions * self.tap_share(t_s)),
            _ => None,
        }
    }

    /// Returns the share of a thread move that is covered, 0 to 1. Returns 0 for any other law.
    fn tap_share(&self, t_s: f64) -> f64 {
        let Law::Tap {
            rate, start, stop, ..
        } = &self.law
        else {
            return 0.0;
        };
        if t_s >= self.duration_s {
            return 1.0;
        }
        let stop_begins_s = self.duration_s - stop.duration_s();
        rate * (start.distance(t_s) - stop.distance(t_s - stop_begins_s))
    }
}
