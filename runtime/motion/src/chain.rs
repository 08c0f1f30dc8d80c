//! A chain of blended blocks between two stops (M1b, G64 with G501).
//!
//! Each joint has one ramp, centred on the time `t_i = t_(i-1) + L_i/v_i` at which the block would end
//! without ramps. The ramp decelerates one block and accelerates the next block at the same time. A ramp
//! never extends beyond the middle of either block. Therefore at most two blocks move at any time, and the
//! profile of a block depends on the next block only.

use std::collections::VecDeque;

use tandem_model::profile::{ChainPlace, Lead, RampedMotion};
use tandem_model::ramp::UnitRamp;
use tandem_model::settings::ShortBlock;

use crate::block::{BlockMotion, ChainBlock, PlannedBlock};

/// The blocks of the chain whose plan is not complete.
#[derive(Debug, Clone, Default)]
pub(crate) struct Chain {
    links: VecDeque<Link>,
    /// Position in the chain of the last output block. `None` before the first output block.
    place: Option<ChainPlace>,
}

/// A block within its chain.
#[derive(Debug, Clone)]
struct Link {
    block: ChainBlock,
    /// Speed, path units per second. It is final when the stop ramp is known; with [`ShortBlock::Shrink`]
    /// from the beginning.
    speed: f64,
    is_first: bool,
    /// The start ramp. For the first block it is as programmed until the second block is known.
    start: UnitRamp,
    /// Ramp to the next block, or to rest. `None` if it is not known yet.
    stop: Option<UnitRamp>,
}

impl Chain {
    pub(crate) fn clear(&mut self) {
        self.links.clear();
        self.place = None;
    }

    /// Adds a block, and outputs the blocks whose plan is final.
    pub(crate) fn push(&mut self, rule: ShortBlock, block: ChainBlock, out: impl FnMut(PlannedBlock)) {
        let mut link = Link {
            speed: block.alone.limit,
            is_first: self.links.is_empty(),
            start: block.alone.start,
            stop: None,
            block,
        };
        if let Some(before) = self.links.back_mut() {
            if rule == ShortBlock::Shrink {
                if before.is_first {
                    before.start = before.block.alone.start_from_rest(before.block_s());
                }
                link.start = link.start.at_most(before.block_s().min(link.block_s()));
            }
            before.end_with(link.start, rule);
        }
        self.links.push_back(link);
        self.release_final(rule, out);
    }

    /// Ends the chain at rest and outputs all remaining blocks.
    pub(crate) fn finish(&mut self, rule: ShortBlock, mut out: impl FnMut(PlannedBlock)) {
        if let Some(last) = self.links.back_mut()
            && !last.is_first
        {
            let ramp = match rule {
                ShortBlock::Shrink => last.block.alone.stop_to_rest(last.block_s()),
                // The ramps stay as programmed, because they determine the speed, and the speed determines
                // the path.
                ShortBlock::Extend => last.block.alone.stop,
            };
            last.end_with(ramp, rule);
        }
        self.release_final(rule, &mut out);
        if let Some(last) = self.links.pop_front() {
            out(self.planned(last));
        }
        self.clear();
    }

    fn release_final(&mut self, rule: ShortBlock, mut out: impl FnMut(PlannedBlock)) {
        while let Some(next) = self.links.get(1) {
            if rule == ShortBlock::Extend && next.stop.is_none() {
                return;
            }
            if let Some(first) = self.links.pop_front() {
                out(self.planned(first));
            }
        }
    }

    /// Plans a link that blends into the first of the remaining links. If the link is the only one of its
    /// chain, it is planned from rest to rest.
    fn planned(&mut self, link: Link) -> PlannedBlock {
        let length = link.block.path.length();
        let (speed, [start, stop], begun_s, plan_s) = match link.stop {
            None => {
                let (speed, ramps, duration_s) = link.block.alone.rest_to_rest(length);
                (speed, ramps, 0.0, duration_s)
            }
            Some(stop) => {
                let (begun_s, ramp_in_s) = if link.is_first {
                    (0.0, link.start.duration_s() / 2.0)
                } else {
                    (link.start.duration_s(), -link.start.duration_s() / 2.0)
                };
                let plan_s = link.block_s() + ramp_in_s + stop.duration_s() / 2.0;
                (link.speed, [link.start, stop], begun_s, plan_s)
            }
        };
        let before = self.place.unwrap_or(ChainPlace {
            first_segment: link.block.segment,
            ends_s: 0.0,
        });
        let place = ChainPlace {
            ends_s: before.ends_s + plan_s,
            ..before
        };
        self.place = Some(place);
        PlannedBlock {
            segment: link.block.segment,
            epoch: link.block.epoch,
            origin: link.block.origin,
            motion: BlockMotion::Ramped {
                block: RampedMotion {
                    path: link.block.path,
                    speed,
                    start,
                    stop,
                    begun_s,
                    next: self.links.front().map(|next| Lead {
                        path: next.block.path.clone(),
                        speed: next.speed,
                    }),
                    plan_s,
                },
                place,
            },
        }
    }
}

impl Link {
    /// Returns the time of the whole block at its speed, s.
    fn block_s(&self) -> f64 {
        self.block.path.length() / self.speed
    }

    fn end_with(&mut self, stop: UnitRamp, rule: ShortBlock) {
        if rule == ShortBlock::Extend {
            // Half of each ramp must fit into the block: the block takes at least the time of both halves.
            let ramps_s = f64::midpoint(self.start.duration_s(), stop.duration_s());
            self.speed = self.speed.min(self.block.path.length() / ramps_s);
        }
        self.stop = Some(stop);
    }
}
