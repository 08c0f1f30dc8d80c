//! Limits for changes of the override factor in G500 chains, rapids and G31 (M1d, M1e, M1i).

use tandem_model::profile::{Law, Profile, SlewRoom};

use crate::channel::Channel;
use crate::profile_queue::ProfileConsumer;
use crate::splice::{Joint, Splice};

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
