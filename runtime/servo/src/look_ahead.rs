//! Profiles of look-ahead (G500) in the servo cycle (motion-semantics 1d, 1i): how fast the override factor may change, and
//! how far the motion may go with what is known.

use rtrb::Consumer;
use tandem_model::profile::{Law, Pace, Profile, SlewRoom};

use crate::path_time::PathTime;

/// Largest change of the override factor per second in the coming cycle, towards the target: what the motors leave over
/// all that the cycle may touch, the profiles behind the running one included.
pub(crate) fn slew(
    profile: &Profile,
    waiting: &mut Consumer<Profile>,
    time: &PathTime,
    target: f64,
    period_s: f64,
) -> f64 {
    let rate = time.rate();
    if rate.total_cmp(&target).is_eq() {
        return f64::INFINITY;
    }
    let now_s = time.now_s();
    let ends_s = now_s + rate.max(target) * period_s;
    let mut room = match &profile.law {
        Law::Paced { pace, .. } => pace.room(now_s, ends_s),
        _ => SlewRoom::default(),
    };
    let mut beyond_s = ends_s - profile.duration_s;
    if beyond_s > 0.0 && !profile.exact_stop {
        let known = waiting.slots();
        if let Ok(chunk) = waiting.read_chunk(known) {
            let (first, second) = chunk.as_slices();
            for next in first.iter().chain(second) {
                if let Law::Paced { pace, .. } = &next.law {
                    room = room.worst(pace.room(0.0, beyond_s));
                }
                beyond_s -= next.duration_s;
                if beyond_s <= 0.0 || next.exact_stop {
                    break;
                }
            }
        }
    }
    if target < rate {
        room.fall(rate)
    } else {
        room.rise(rate, period_s)
    }
}

/// True when the motion can still come to rest within what is known once it has passed a segment: then it may go on in
/// it as planned.
pub(crate) fn is_free(waiting: &mut Consumer<Profile>, running: Option<&Pace>, segment: u64) -> bool {
    let known = waiting.slots();
    if known == 0 {
        return running.is_some_and(|pace| segment <= pace.free_to);
    }
    let Ok(chunk) = waiting.read_chunk(known) else {
        return false;
    };
    let (first, second) = chunk.as_slices();
    second
        .last()
        .or(first.last())
        .is_some_and(|newest| match &newest.law {
            Law::Paced { pace, .. } => segment <= pace.free_to,
            // What is not of a G500 chain comes behind the end of one.
            _ => true,
        })
}
