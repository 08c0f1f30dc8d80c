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
    /// None: a dwell lasts as long as programmed, a thread is cut as programmed. Feed hold stops a dwell outside of a
    /// thread.
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
    /// One speed along a path, a ramp at each end: from rest to rest, or blended with its neighbours. A blended
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
        /// Where its chain is with it.
        place: ChainPlace,
    },
    /// As `Ramped`, in plan time, which advances at a pace that respects the motors' limits (M1d).
    Paced {
        /// The geometry.
        path: Path,
        /// Speed between the ramps, path units per second of plan time.
        speed: f64,
        /// From rest to speed.
        start: UnitRamp,
        /// From speed to rest, or over to the speed of the next block.
        stop: UnitRamp,
        /// How far the start ramp has come at plan time 0, s.
        begun_s: f64,
        /// The block that begins along the stop ramp; `None`: this one ends at rest.
        next: Option<Lead>,
        /// Plan time at the end of the block, s; its pace may end before it when several profiles follow each other.
        plan_s: f64,
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
        /// The part of the motion that is passed, either way.
        stretch: Stretch,
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
    /// A way in a thread from rest to rest, as `Ramped`; the spindle turns in proportion to it (M1h).
    Tap {
        /// Start, machine coordinates.
        from: AxisVector,
        /// End, machine coordinates.
        to: AxisVector,
        /// Share of the way covered between the ramps, per second.
        rate: f64,
        /// From rest to speed.
        start: UnitRamp,
        /// From speed to rest.
        stop: UnitRamp,
        /// Revolutions of the spindle over the way, clockwise positive; 0: it is not locked to it.
        revolutions: f64,
        /// Into the hole, or out of it.
        leg: TapLeg,
    },
    /// Rest.
    Rest {
        /// Where, machine coordinates.
        at: AxisVector,
        /// The part of its time that is waited; backward none.
        stretch: Stretch,
    },
}

/// Position `t_s` seconds after the start of motors that move alone; exact at the ends of each.
fn alone([from, to]: [&AxisVector; 2], moves: &[MotorMove; AXES_MAX], t_s: f64) -> AxisVector {
    AxisVector(std::array::from_fn(|i| {
        if t_s >= moves[i].duration_s() {
            to.0[i]
        } else {
            from.0[i] + moves[i].distance(t_s)
        }
    }))
}

/// How far a chain of blocks between two stops has come with one of them (M1b).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChainPlace {
    /// Number of the segment that the chain begins with.
    pub first_segment: u64,
    /// Time from the begin of the chain to the end of the profile at 100 percent, s.
    pub ends_s: f64,
}

/// The begin of the next block within the profile of the one before it (M1b).
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

/// A block along its path with a ramp at each end, in its own time.
struct Ramps<'a> {
    path: &'a Path,
    speed: f64,
    start: UnitRamp,
    stop: UnitRamp,
    begun_s: f64,
    next: Option<&'a Lead>,
    duration_s: f64,
}

impl Ramps<'_> {
    fn position(&self, t_s: f64) -> AxisVector {
        if t_s >= self.duration_s {
            return self.end();
        }
        let stopped_s = self
            .stop
            .distance(t_s - (self.duration_s - self.stop.duration_s()));
        let gone = self.speed * (self.start.distance(t_s + self.begun_s) - stopped_s);
        let own = self.path.point_at(gone);
        match self.next {
            Some(next) => own.plus(next.offset(stopped_s)),
            None => own,
        }
    }

    fn end(&self) -> AxisVector {
        match self.next {
            Some(next) => self.path.end().plus(next.offset(self.stop.duration_s() / 2.0)),
            None => self.path.end(),
        }
    }
}

impl Profile {
    /// Where the block ends as programmed, machine coordinates; backward, where it begins.
    pub fn target(&self) -> AxisVector {
        match &self.law {
            Law::Paced { path, pace, .. } if pace.is_backward() => path.start(),
            Law::Motors { from, stretch, .. } if stretch.is_backward() => *from,
            Law::Ramped { path, .. } | Law::Paced { path, .. } => path.end(),
            Law::Motors { to, .. } | Law::Skip { to, .. } | Law::Tap { to, .. } => *to,
            Law::Rest { at, .. } => *at,
        }
    }

    /// Last position of the profile, machine coordinates: its target, and what the next block has gone by then.
    pub fn end(&self) -> AxisVector {
        match (&self.law, self.ramps()) {
            (Law::Paced { pace, .. }, Some(ramps)) => ramps.position(pace.ends_s),
            (_, Some(ramps)) => ramps.end(),
            _ => self.target(),
        }
    }

    /// Commanded machine position `t_s` seconds after the start; exact at both ends. A time before the start counts as
    /// the start.
    pub fn position(&self, t_s: f64) -> AxisVector {
        if t_s >= self.duration_s {
            return self.end();
        }
        match (&self.law, self.ramps()) {
            (Law::Paced { pace, .. }, Some(ramps)) => ramps.position(pace.plan_time(t_s)),
            (_, Some(ramps)) => ramps.position(t_s),
            (
                Law::Motors {
                    from,
                    to,
                    moves,
                    stretch,
                },
                _,
            ) => alone([from, to], moves, stretch.plan_time(t_s)),
            (Law::Skip { from, to, moves }, _) => alone([from, to], moves, t_s),
            (Law::Tap { from, to, .. }, _) => from.plus(to.minus(*from).scaled(self.tap_share(t_s))),
            _ => self.target(),
        }
    }

    /// Plan time within the block `t_s` seconds after the start, s: what [`PathPlace`] counts.
    pub fn plan_time(&self, t_s: f64) -> f64 {
        match &self.law {
            Law::Paced { pace, .. } => pace.plan_time(t_s),
            Law::Motors { stretch, .. } | Law::Rest { stretch, .. } => stretch.plan_time(t_s),
            _ => t_s,
        }
    }

    /// True when it begins at rest, or at a pace of its own; else the time base begins at 0, as after a feed hold.
    pub fn begins_at_its_rate(&self) -> bool {
        match &self.law {
            Law::Motors { moves, stretch, .. } => {
                moves.iter().all(|motor| motor.velocity_at(stretch.from_s) == 0.0)
            }
            _ => true,
        }
    }

    /// The same motion over another stretch of its plan time, when it is one of motors alone or rest; any other as it is.
    #[must_use]
    pub fn over(&self, passed: Stretch) -> Self {
        let mut profile = self.clone();
        if let Law::Motors { stretch, .. } | Law::Rest { stretch, .. } = &mut profile.law {
            *stretch = passed;
            profile.duration_s = passed.duration_s();
        }
        profile
    }

    /// Revolutions that the spindle has turned `t_s` seconds after the start, clockwise positive; `None`: the spindle
    /// is not locked to this profile. At any time in proportion to the way, exact at both ends.
    pub fn spindle_revolutions(&self, t_s: f64) -> Option<f64> {
        match self.law {
            Law::Tap { revolutions, .. } if revolutions != 0.0 => Some(revolutions * self.tap_share(t_s)),
            _ => None,
        }
    }

    /// Share of a way in a thread, 0 to 1; 0 for another law.
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

    /// The block along a path; `None` for any other law.
    fn ramps(&self) -> Option<Ramps<'_>> {
        let (path, speed, start, stop, begun_s, next, duration_s) = match &self.law {
            Law::Ramped {
                path,
                speed,
                start,
                stop,
                begun_s,
                next,
                ..
            } => (path, speed, start, stop, begun_s, next, self.duration_s),
            Law::Paced {
                path,
                speed,
                start,
                stop,
                begun_s,
                next,
                plan_s,
                ..
            } => (path, speed, start, stop, begun_s, next, *plan_s),
            _ => return None,
        };
        Some(Ramps {
            path,
            speed: *speed,
            start: *start,
            stop: *stop,
            begun_s: *begun_s,
            next: next.as_ref(),
            duration_s,
        })
    }
}
