//! G31 in the servo cycle (M1e, D40): a motor whose skip input switches on brakes, and returns to the captured
//! position. Also the room that the motors of G00 and G31 leave for overrides.

use tandem_model::profile::{Law, MotorLimits, MotorMove, MotorStop, Profile, SlewRoom};
use tandem_model::{AXES_MAX, Axis, AxisSet, AxisVector};

/// The motors that have turned back in the running profile.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct SkipRun {
    turned: [Option<SkipReturn>; AXES_MAX],
}

/// The motion of a motor after its trigger: the motor decelerates to rest, then moves to the captured
/// position. Times are profile times, s, so overrides and feed hold act as on any other motion.
#[derive(Debug, Clone, Copy)]
struct SkipReturn {
    at_s: f64,
    from: f64,
    stop: MotorStop,
    captured: f64,
    back: MotorMove,
}

impl SkipReturn {
    fn back_s(&self) -> f64 {
        self.at_s + self.stop.duration_s()
    }

    fn end_s(&self) -> f64 {
        self.back_s() + self.back.duration_s()
    }

    /// Returns the room as [`MotorMove::room`] does.
    fn room(&self, max_acceleration: f64, from_s: f64, to_s: f64) -> SlewRoom {
        let back_s = self.back_s();
        let back = self.back.room(max_acceleration, from_s - back_s, to_s - back_s);
        if from_s < back_s && to_s > self.at_s {
            back.worst(self.stop.room(max_acceleration))
        } else {
            back
        }
    }

    fn position(&self, t_s: f64) -> f64 {
        if t_s >= self.end_s() {
            self.captured
        } else {
            let stopping = self.from + self.stop.distance(t_s - self.at_s);
            stopping + self.back.distance(t_s - self.back_s())
        }
    }
}

impl SkipRun {
    /// Returns the duration of the profile, s, including the return of motors that have turned back.
    pub(crate) fn duration_s(&self, profile: &Profile) -> f64 {
        let Law::Skip { moves, .. } = &profile.law else {
            return profile.duration_s;
        };
        self.turned
            .iter()
            .zip(moves)
            .map(|(turned, to_target)| turned.map_or(to_target.duration_s(), |turned| turned.end_s()))
            .fold(0.0, f64::max)
    }

    /// Returns the positions of all motors, mm or degrees.
    pub(crate) fn position(&self, profile: &Profile, t_s: f64) -> AxisVector {
        let position = profile.position(t_s);
        if !matches!(profile.law, Law::Skip { .. }) {
            return position;
        }
        self.replace_turned(position, |turned| turned.position(t_s))
    }

    /// Returns the room that the motors of G00 and G31 leave for overrides and feed hold between two times of
    /// the profile.
    pub(crate) fn room(
        &self,
        profile: &Profile,
        max_acceleration: [f64; AXES_MAX],
        from_s: f64,
        to_s: f64,
    ) -> SlewRoom {
        let (moves, is_backward) = match &profile.law {
            Law::Motors { moves, stretch, .. } => (moves, stretch.is_backward()),
            Law::Skip { moves, .. } => (moves, false),
            _ => return SlewRoom::default(),
        };
        let [begin_s, end_s] = [from_s, to_s].map(|t_s| profile.plan_time(t_s));
        let of_motors = self.turned.iter().zip(moves).zip(max_acceleration);
        of_motors
            .map(|((turned, to_target), most)| match turned {
                Some(turned) => turned.room(most, from_s, to_s),
                None if is_backward => to_target.room(most, end_s, begin_s).reversed(),
                None => to_target.room(most, begin_s, end_s),
            })
            .fold(SlewRoom::default(), SlewRoom::worst)
    }

    /// Returns the positions at which all motors end.
    pub(crate) fn end_position(&self, profile: &Profile) -> AxisVector {
        self.replace_turned(profile.end_position(), |turned| turned.captured)
    }

    /// Returns the axes whose motors have captured a position.
    pub(crate) fn captured(&self) -> AxisSet {
        Axis::ALL
            .into_iter()
            .filter(|axis| self.turned[axis.index()].is_some())
            .collect()
    }

    /// Returns true if this motor has a distance to move and has not turned back.
    pub(crate) fn seeks(&self, profile: &Profile, axis: Axis) -> bool {
        let i = axis.index();
        matches!(&profile.law, Law::Skip { moves, .. } if moves[i].duration_s() > 0.0)
            && self.turned[i].is_none()
    }

    /// Turns a motor back to `captured`, because its input has switched on at the profile time `t_s`.
    pub(crate) fn turn_back(
        &mut self,
        profile: &Profile,
        axis: Axis,
        t_s: f64,
        captured: f64,
        limits: MotorLimits,
    ) {
        let Law::Skip { moves, .. } = &profile.law else {
            return;
        };
        let seeking = &moves[axis.index()];
        let stop = MotorStop::fastest(seeking.velocity_at(t_s), seeking.acceleration_at(t_s), limits);
        let from = profile.position(t_s)[axis];
        let rest = from + stop.distance(stop.duration_s());
        let turned = SkipReturn {
            at_s: t_s,
            from,
            stop,
            captured,
            back: MotorMove::shortest(captured - rest, limits),
        };
        self.turned[axis.index()] = Some(turned);
    }

    fn replace_turned(&self, position: AxisVector, of_turned: impl Fn(&SkipReturn) -> f64) -> AxisVector {
        let mut position = position;
        for (value, turned) in position.0.iter_mut().zip(&self.turned) {
            if let Some(turned) = turned {
                *value = of_turned(turned);
            }
        }
        position
    }
}
