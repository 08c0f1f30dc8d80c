//! Profiles of a block at the rate that look-ahead has found for the block.

use std::collections::VecDeque;

use tandem_model::profile::{PACE_PIECES_MAX, Pace, PacePiece, PacedMotion, Profile};

use super::held_block::HeldBlock;
use super::step::RateStep;
use super::way::Way;

/// Outputs a block with these steps, in the necessary number of profiles.
pub(super) fn profiles(held: &HeldBlock, steps: &[RateStep], free_to: u64, out: &mut VecDeque<Profile>) {
    let first = out.len();
    match Way::new(&held.block.motion, held.passage) {
        Way::Blended(way) => output(
            held,
            || PacedMotion::Ramped(way.block.clone()),
            steps,
            free_to,
            out,
        ),
        Way::Smoothed(way) => {
            let mut steps = steps.iter().copied().peekable();
            let mut within = Vec::new();
            for (stretch, range_s) in way.stretches() {
                let [_, to_s] = range_s;
                within.clear();
                while let Some(step) = steps.peek_mut() {
                    if let Some(first) = step.split(to_s) {
                        within.push(first);
                        break;
                    }
                    if f64::midpoint(step.from_s, step.to_s) >= to_s {
                        break;
                    }
                    within.extend(steps.next());
                }
                let motion = || PacedMotion::Smoothed(way.motion(stretch, range_s));
                output(held, motion, &within, free_to, out);
            }
        }
    }
    if let Some(last) = out.range_mut(first..).next_back() {
        last.exact_stop = held.is_last;
    }
}

/// Outputs the profiles of steps along one motion.
fn output(
    held: &HeldBlock,
    motion: impl Fn() -> PacedMotion,
    steps: &[RateStep],
    free_to: u64,
    out: &mut VecDeque<Profile>,
) {
    let block = &held.block;
    let is_backward = held.passage.is_backward;
    let sign = if is_backward { -1.0 } else { 1.0 };
    let plan_time = |way_s: f64| {
        if is_backward {
            block.plan_s() - way_s
        } else {
            way_s
        }
    };
    for part in steps.chunks(PACE_PIECES_MAX) {
        let mut duration_s = 0.0;
        let ends_s = part.last().map_or(0.0, |step| plan_time(step.to_s));
        let pieces = part.iter().map(|step| {
            let begins_s = duration_s;
            duration_s += step.duration_s();
            PacePiece {
                begins_s,
                plan_s: plan_time(step.from_s),
                rate: sign * step.start.sqrt(),
                rate_change: sign * step.rate_change,
                rate_jerk: sign * step.rate_jerk,
                rate_slope: step.rate_slope,
                growth: if is_backward {
                    step.growth.reversed()
                } else {
                    step.growth
                },
                room: step.room,
            }
        });
        let pace = Pace::new(pieces, ends_s, held.feed_override, free_to);
        out.push_back(block.paced(motion(), pace, duration_s, false));
    }
}
