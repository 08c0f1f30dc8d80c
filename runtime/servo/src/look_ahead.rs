//! Limits for changes of the override factor (M1d, M1e, M1i): by the accelerations that the motors have left.

use tandem_model::profile::{Law, Profile, RampedMotion, SlewRoom};
use tandem_model::{AXES_MAX, Axis};

use crate::channel::Channel;
use crate::profile_queue::ProfileConsumer;
use crate::splice::{Joint, Splice};

/// Share of the half of a cycle by which the formula of a block is selected inwards of an end of the cycle, so that
/// rounding does not select the phase next to it.
const INWARDS: f64 = 1e-3;

impl Channel {
    /// Returns the largest change of the override factor per second towards the target in the coming cycle.
    /// The limit is that of the motors over all profiles that the cycle may touch. These include queued
    /// profiles and the profiles of a new plan.
    pub(crate) fn room_to(&mut self, target: f64) -> f64 {
        let rate = self.time.rate();
        let Some(profile) = self.current.as_ref() else {
            return f64::INFINITY;
        };
        if rate.total_cmp(&target).is_eq() {
            return f64::INFINITY;
        }
        let now_s = self.time.now_s();
        let ends_s = now_s + rate.max(target) * self.period_s;
        let splice = self.splice.as_ref();
        let joint = splice.and_then(|splice| joint_within(splice, profile, &mut self.profiles, ends_s));
        // The room of the running plan also counts beyond a joint, because the running plan continues if the
        // new plan is too slow there.
        let mut room = match &profile.law {
            Law::Paced { pace, .. } => pace.room(now_s, ends_s),
            _ => self.skip.room(profile, self.motors.deceleration(), now_s, ends_s),
        };
        if !profile.exact_stop {
            room = room.worst(room_of(&mut self.profiles, ends_s - profile.duration_s));
        }
        let slope = |room: SlewRoom, rate: f64| {
            if target < self.time.rate() {
                room.fall(rate)
            } else {
                room.rise(rate, self.period_s)
            }
        };
        let slope_here = slope(room, rate);
        match (joint, &mut self.splice) {
            (Some(Joint { at_s, ratio }), Some(splice)) => {
                let beyond = room_of(&mut splice.profiles, (ends_s - at_s) * ratio);
                slope_here.min(slope(beyond, rate * ratio) / ratio)
            }
            _ => slope_here,
        }
    }

    /// Returns the largest change of the override factor per second towards the target in the coming cycle of a chain
    /// with G501, over the blocks that the cycle may touch.
    pub(crate) fn room_on_ramps(&mut self, target: f64) -> f64 {
        let slew = Slew {
            factor: self.time.rate(),
            target,
            period_s: self.period_s,
            limits: self.motors.deceleration(),
        };
        let Some(profile) = self.current.as_ref() else {
            return f64::INFINITY;
        };
        let now_s = self.time.now_s();
        let ends_s = now_s + slew.factor.max(target) * self.period_s;
        let within = |profile: &Profile, from_s: f64, to_s: f64| match &profile.law {
            Law::Ramped { block, .. } => slew.room(block, [from_s, to_s.min(profile.duration_s)]),
            _ => f64::INFINITY,
        };
        let here = within(profile, now_s, ends_s);
        let beyond_s = ends_s - profile.duration_s;
        match self.profiles.peek() {
            Ok(next) if beyond_s > 0.0 && !profile.exact_stop => here.min(within(next, 0.0, beyond_s)),
            _ => here,
        }
    }
}

/// A change of the override factor in a chain with G501. G501 does not respect the limits of acceleration itself, so
/// the limit of a motor is at least the acceleration that the block causes there; that of X, Y and Z is at least the
/// largest of the three.
struct Slew {
    factor: f64,
    target: f64,
    period_s: f64,
    limits: [f64; AXES_MAX],
}

impl Slew {
    /// Returns the largest change per second at which no motor exceeds its limit between two plan times of a block.
    fn room(&self, block: &RampedMotion, [from_s, to_s]: [f64; 2]) -> f64 {
        // A ramp may begin or end between the two times.
        let middle_s = f64::midpoint(from_s, to_s);
        let at = |at_s: f64| {
            let within_s = at_s + (middle_s - at_s) * INWARDS;
            let [velocity, acceleration] = block.motion_at(at_s, within_s);
            let largest =
                (Axis::ORTHOGONAL.into_iter()).fold(0.0_f64, |most, axis| most.max(acceleration[axis].abs()));
            let room = |axis: Axis| {
                let own = if axis.is_orthogonal() {
                    largest
                } else {
                    acceleration[axis].abs()
                };
                self.room_of_motor(axis, velocity[axis], acceleration[axis], own)
            };
            Axis::ALL.into_iter().map(room).fold(f64::INFINITY, f64::min)
        };
        at(from_s).min(at(middle_s)).min(at(to_s)).max(0.0)
    }

    fn room_of_motor(&self, axis: Axis, velocity: f64, acceleration: f64, own: f64) -> f64 {
        let (square, limit) = (self.factor * self.factor, self.limits[axis.index()]);
        if velocity == 0.0 || limit <= 0.0 {
            return f64::INFINITY;
        }
        let falls = self.target < self.factor;
        // The acceleration at factor 1 in the direction of the change
        let used = acceleration * velocity.signum() * if falls { -1.0 } else { 1.0 };
        let left = limit.max(own * square) - used * square;
        // While the factor changes by s T, its square changes by at most 2 s T times the larger factor. This matters
        // if the acceleration then adds more to that of the change, or takes less from it.
        let worse = if falls { -used } else { used };
        let changing = 2.0 * worse.max(0.0) * self.period_s * self.factor.max(self.target);
        left / (velocity.abs() + changing)
    }
}

/// Returns the joint at which the motion switches to a new plan, in the time of the running profile. The
/// joint may be in the running profile or in a queued profile. Returns `None` if it is later than `ends_s`.
fn joint_within(
    splice: &Splice,
    running: &Profile,
    waiting: &mut ProfileConsumer,
    ends_s: f64,
) -> Option<Joint> {
    if let Some(joint) = splice.joint(running) {
        return Some(joint).filter(|joint| joint.at_s <= ends_s);
    }
    let mut begins_s = running.duration_s;
    let mut goes_on = !running.exact_stop;
    let chunk = waiting.waiting()?;
    let (first, second) = chunk.as_slices();
    for next in first.iter().chain(second) {
        if begins_s > ends_s || !goes_on {
            return None;
        }
        if let Some(Joint { at_s, ratio }) = splice.joint(next) {
            let at_s = begins_s + at_s;
            return Some(Joint { at_s, ratio }).filter(|joint| joint.at_s <= ends_s);
        }
        begins_s += next.duration_s;
        goes_on = !next.exact_stop;
    }
    None
}

/// Returns the room that the motors leave over `time_s`, from the start of the first queued profile on.
fn room_of(waiting: &mut ProfileConsumer, time_s: f64) -> SlewRoom {
    let mut left_s = time_s;
    let mut room = SlewRoom::default();
    if left_s <= 0.0 {
        return room;
    }
    let Some(chunk) = waiting.waiting() else {
        return room;
    };
    let (first, second) = chunk.as_slices();
    for next in first.iter().chain(second) {
        if let Law::Paced { pace, .. } = &next.law {
            room = room.worst(pace.room(0.0, left_s));
        }
        left_s -= next.duration_s;
        if left_s <= 0.0 || next.exact_stop {
            break;
        }
    }
    room
}
