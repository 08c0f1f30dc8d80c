//! Profiles of a block at the rate that look-ahead has found for the block.

use std::collections::VecDeque;

use tandem_model::profile::{PACE_PIECES_MAX, Pace, PacePiece, Profile};

use super::held_block::HeldBlock;
use super::step::RateStep;

/// Outputs a block with these steps, in the necessary number of profiles.
pub(super) fn profiles(held: &HeldBlock, steps: &[RateStep], free_to: u64, out: &mut VecDeque<Profile>) {
    let block = &held.block;
    let is_backward = held.passage.is_backward;
    let sign = if is_backward { -1.0 } else { 1.0 };
    let plan_time = |way_s: f64| {
        if is_backward {
            block.ramped.plan_s - way_s
        } else {
            way_s
        }
    };
    let parts = steps.chunks(PACE_PIECES_MAX);
    let last = parts.len().saturating_sub(1);
    for (n, part) in parts.enumerate() {
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
                growth: if is_backward {
                    step.growth.reversed()
                } else {
                    step.growth
                },
                room: step.room,
            }
        });
        let pace = Pace::new(pieces, ends_s, held.feed_override, free_to);
        out.push_back(block.paced(pace, duration_s, held.is_last && n == last));
    }
}
