//! Position over time of one segment: the motion stage produces it, the servo cycle evaluates it.

use crate::axis::{AXES_MAX, AxisVector};
use crate::flow::{Path, TapLeg};
pub use crate::motor_move::{MotorLimits, MotorMove};
pub use crate::pace::{PACE_PIECES_MAX, Pace, PacePiece, PathPlace, SlewRoom, Stretch};
use crate::ramp::UnitRamp;
use crate::span::Origin;
pub use crate::speed_growth::SpeedGrowth;

/// One planned motion. Times count from its own start, before feed override scales them.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// Number of the segment in its run, from 1, strictly increasing.
    pub segment: u64,
    /// Run of the servo queue that it belongs to; a flush raises it, and older profiles are dropped.
    pub epoch: u32,
    /// Its origin.
    pub origin: Origin,
    /// Position as a function of time.
    pub law: Law,
    /// Time from start to end at 100 percent, s.
    pub duration_s: f64,
    /// True if it ends at rest with an in-position check.
    pub exact_stop: bool,
}

/// Which override scales the time of a profile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TimeBase {
    /// Feed override, 0 to 200 percent.
    Feed,
    /// Rapid override, 0 to 100 percent.
    Rapid,
    /// No override: a dwell lasts as long as programmed, a thread is cut as programmed. Feed hold stops a dwell outside
    /// of a thread.
    Fixed,
}

/// Position as a function of time. Nothing in it is boxed: the servo cycle would free it, and must not call the
/// allocator.
#[allow(
    clippy::large_enum_variant,
    reason = "a box would be freed by the servo cycle"
)]
#[derive(Debug, Clone, PartialEq)]
pub enum Law {
    /// A block at feedrate as planned: from rest to rest, or blended with its neighbours.
    Ramped {
        /// The block.
        block: RampedMotion,
        /// Its place in its chain.
        place: ChainPlace,
    },
    /// As `Ramped`, in plan time, which advances at a pace that respects the motors' limits (M1d).
    Paced {
        /// The block; the pace may end before it when several profiles follow each other.
        block: RampedMotion,
        /// Plan time as a function of time.
        pace: Pace,
    },
    /// Each motor alone: start position and its own law.
    Motors {
        /// Start, machine coordinates.
        from: AxisVector,
        /// Target, machine coordinates.
        to: AxisVector,
        /// One law for each axis.
        moves: [MotorMove; AXES_MAX],
        /// The part of the motion that is passed, forward or backward.
        stretch: Stretch,
    },
    /// As `Motors`, until a motor's skip input switches on: the servo cycle then returns that motor to the captured
    /// position.
    Skip {
        /// Start, machine coordinates.
        from: AxisVector,
        /// Target, machine coordinates.
        to: AxisVector,
        /// One law for each axis, to the target.
        moves: [MotorMove; AXES_MAX],
    },
    /// A move in a thread from rest to rest, as `Ramped`; the spindle turns in proportion to it (M1h).
    Tap {
        /// Start, machine coordinates.
        from: AxisVector,
        /// End, machine coordinates.
        to: AxisVector,
        /// Share of the distance covered between the ramps, per second.
        rate: f64,
        /// Ramp from rest to `rate`.
        start: UnitRamp,
        /// Ramp from `rate` to rest.
        stop: UnitRamp,
        /// Revolutions of the spindle from start to end, clockwise positive; 0: it is not locked to the move.
        revolutions: f64,
        /// Into the hole, or out of it.
        leg: TapLeg,
    },
    /// Rest.
    Rest {
        /// Where, machine coordinates.
        at: AxisVector,
        /// The part of its time that is waited; none when passed backward.
        stretch: Stretch,
    },
}

/// A block along its path at one speed with a ramp at each end. A blended block begins where the ramp from the block
/// before is over, and ends with the ramp to the next one.
#[derive(Debug, Clone, PartialEq)]
pub struct RampedMotion {
    /// The geometry.
    pub path: Path,
    /// Speed between the ramps, path units per second.
    pub speed: f64,
    /// From rest to speed.
    pub start: UnitRamp,
    /// From speed to rest, or to the speed of the next block.
    pub stop: UnitRamp,
    /// Progress of the start ramp at plan time 0, s: 0 from rest; all of it when the block began within the profile
    /// before.
    pub begun_s: f64,
    /// The block that begins along the stop ramp. `None` if this one ends at rest.
    pub next: Option<Lead>,
    /// Plan time at its end, s.
    pub plan_s: f64,
}

/// The start of the next block within the profile of the one before it (M1b).
#[derive(Debug, Clone, PartialEq)]
pub struct Lead {
    /// The next block's geometry.
    pub path: Path,
    /// Its speed after the ramp, path units per second.
    pub speed: f64,
}

/// Progress of a chain of blocks between two stops (M1b).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChainPlace {
    /// Number of the segment that the chain begins with.
    pub first_segment: u64,
    /// Time from the start of the chain to the end of the profile at 100 percent, s.
    pub ends_s: f64,
}

impl Law {
    /// Returns the override that scales its time.
    pub fn time_base(&self) -> TimeBase {
        match self {
            Law::Ramped { .. } | Law::Paced { .. } => TimeBase::Feed,
            Law::Motors { .. } | Law::Skip { .. } => TimeBase::Rapid,
            Law::Tap { .. } | Law::Rest { .. } => TimeBase::Fixed,
        }
    }
}

/// Returns the position `t_s` seconds after the start of motors that move alone; exact at the ends of each.
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
    /// Returns the machine position at a plan time; exact at the end.
    pub fn position(&self, plan_s: f64) -> AxisVector {
        if plan_s >= self.plan_s {
            return self.end_position();
        }
        let (gone, stopped_s) = self.covered_distances(plan_s);
        self.beyond(self.path.point_at(gone), stopped_s)
    }

    /// Returns the distance along its own path at a plan time, and P of the ramp at its end: with the speed
    /// of the next block, the distance along that one's path.
    #[inline]
    pub fn covered_distances(&self, plan_s: f64) -> (f64, f64) {
        let stopped_s = self
            .stop
            .distance(plan_s - (self.plan_s - self.stop.duration_s()));
        let gone = self.speed * (self.start.distance(plan_s + self.begun_s) - stopped_s);
        (gone, stopped_s)
    }

    /// Returns the machine position at its end: that of its path, and what the next block has covered by
    /// then.
    pub fn end_position(&self) -> AxisVector {
        self.beyond(self.path.end(), self.stop.duration_s() / 2.0)
    }

    /// Returns a point of its own path, moved by what the next block has covered, `ramped_s` being P of the
    /// common ramp.
    fn beyond(&self, own: AxisVector, ramped_s: f64) -> AxisVector {
        match &self.next {
            Some(Lead { path, speed }) => own.plus(path.point_at(speed * ramped_s).minus(path.start())),
            None => own,
        }
    }
}

impl Profile {
    /// Returns the programmed end of the block, machine coordinates; backward, its start.
    pub fn target(&self) -> AxisVector {
        match &self.law {
            Law::Paced { block, pace } if pace.is_backward() => block.path.start(),
            Law::Motors { from, stretch, .. } if stretch.is_backward() => *from,
            Law::Ramped { block, .. } | Law::Paced { block, .. } => block.path.end(),
            Law::Motors { to, .. } | Law::Skip { to, .. } | Law::Tap { to, .. } => *to,
            Law::Rest { at, .. } => *at,
        }
    }

    /// Returns the last position of the profile, machine coordinates: its target, and what the next block has
    /// covered by then.
    pub fn end_position(&self) -> AxisVector {
        match &self.law {
            Law::Ramped { block, .. } => block.end_position(),
            Law::Paced { block, pace } => block.position(pace.ends_s),
            _ => self.target(),
        }
    }

    /// Returns the commanded machine position `t_s` seconds after the start; exact at both ends. For a time
    /// before the start, the position at the start.
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

    /// Returns the plan time within the block `t_s` seconds after the start, s: what [`PathPlace`] counts.
    pub fn plan_time(&self, t_s: f64) -> f64 {
        match &self.law {
            Law::Paced { pace, .. } => pace.plan_time(t_s),
            Law::Motors { stretch, .. } | Law::Rest { stretch, .. } => stretch.plan_time(t_s),
            _ => t_s,
        }
    }

    /// Returns true if it begins at rest, or at a pace of its own; else the time base begins at 0, as after a
    /// feed hold.
    pub fn begins_at_its_rate(&self) -> bool {
        match &self.law {
            Law::Motors { moves, stretch, .. } => {
                moves.iter().all(|motor| motor.velocity_at(stretch.from_s) == 0.0)
            }
            _ => true,
        }
    }

    /// Returns the same motion over another stretch of its plan time, if it is a rapid or rest; any other
    /// unchanged.
    #[must_use]
    pub fn over(&self, passed: Stretch) -> Self {
        let mut profile = self.clone();
        if let Law::Motors { stretch, .. } | Law::Rest { stretch, .. } = &mut profile.law {
            *stretch = passed;
            profile.duration_s = passed.duration_s();
        }
        profile
    }

    /// Returns the revolutions that the spindle has turned `t_s` seconds after the start, clockwise positive.
    /// `None` if the spindle is not locked to this profile. At any time in proportion to the distance, exact
    /// at both ends.
    pub fn spindle_revolutions(&self, t_s: f64) -> Option<f64> {
        match self.law {
            Law::Tap { revolutions, .. } if revolutions != 0.0 => Some(revolutions * self.tap_share(t_s)),
            _ => None,
        }
    }

    /// Returns the share of a move in a thread, 0 to 1; 0 for another law.
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
