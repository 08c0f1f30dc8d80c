//! A chain of blended blocks between two stops (M1b, G64 with G501).
//!
//! There is one ramp at each joint, centred on the time `t_i = t_(i-1) + L_i/v_i` at which the block would end without
//! ramps. It decelerates one block and accelerates the next at the same time. A ramp never extends beyond the middle of
//! either block, so at most two blocks move at any time, and the profile of a block depends on the next block only.

use std::collections::VecDeque;

use tandem_model::Origin;
use tandem_model::flow::Path;
use tandem_model::profile::{ChainPlace, Lead};
use tandem_model::ramp::UnitRamp;
use tandem_model::settings::ShortBlock;

use crate::block::RampedBlock;
use crate::ramped::{Alone, RestToRest};

/// The blocks of the chain that are not planned to their end.
#[derive(Debug, Clone, Default)]
pub(crate) struct Chain {
    blocks: VecDeque<Link>,
    /// Of the block put out last; `None`: the first one is still to come.
    place: Option<ChainPlace>,
}

/// A block of a chain.
#[derive(Debug, Clone)]
struct Link {
    segment: u64,
    origin: Origin,
    path: Path,
    length: f64,
    /// Path units per second; final once the stop ramp is known, with [`ShortBlock::Shrink`] from the beginning.
    speed: f64,
    is_first: bool,
    /// As programmed for the first block until the second is there.
    start: UnitRamp,
    /// To the next block, or to rest; `None`: not known yet.
    stop: Option<UnitRamp>,
    /// The block alone, from rest to rest.
    alone: Alone,
}

impl Chain {
    pub(crate) fn clear(&mut self) {
        self.blocks.clear();
        self.place = None;
    }

    /// Adds a block, and puts out what is final.
    pub(crate) fn push(
        &mut self,
        rule: ShortBlock,
        block: Block<'_>,
        epoch: u32,
        out: impl FnMut(RampedBlock),
    ) {
        let Block {
            segment,
            origin,
            path,
            alone,
        } = block;
        let mut link = Link {
            segment,
            origin,
            path: path.clone(),
            length: path.length(),
            speed: alone.limit,
            is_first: self.blocks.is_empty(),
            start: alone.start,
            stop: None,
            alone,
        };
        if let Some(before) = self.blocks.back_mut() {
            if rule == ShortBlock::Shrink {
                if before.is_first {
                    before.start = before.alone.start_from_rest(before.block_s());
                }
                link.start = link.start.at_most(before.block_s().min(link.block_s()));
            }
            before.end_with(link.start, rule);
        }
        self.blocks.push_back(link);
        self.put_out(rule, epoch, out);
    }

    /// Ends the chain at rest and puts out all of it.
    pub(crate) fn finish(&mut self, rule: ShortBlock, epoch: u32, mut out: impl FnMut(RampedBlock)) {
        if let Some(last) = self.blocks.back_mut()
            && !last.is_first
        {
            let ramp = match rule {
                ShortBlock::Shrink => last.alone.stop_to_rest(last.block_s()),
                // The ramps decide on the speed, and that on the path: they are as programmed.
                ShortBlock::Extend => last.alone.stop,
            };
            last.end_with(ramp, rule);
        }
        self.put_out(rule, epoch, &mut out);
        if let Some(last) = self.blocks.pop_front() {
            out(self.planned(&last, epoch));
        }
        self.clear();
    }

    fn put_out(&mut self, rule: ShortBlock, epoch: u32, mut out: impl FnMut(RampedBlock)) {
        while let Some(next) = self.blocks.get(1) {
            if rule == ShortBlock::Extend && next.stop.is_none() {
                return;
            }
            if let Some(first) = self.blocks.pop_front() {
                out(self.planned(&first, epoch));
            }
        }
    }

    /// As planned, going over to the first of the blocks that are left, with its place in the chain.
    fn planned(&mut self, link: &Link, epoch: u32) -> RampedBlock {
        let before = self.place.unwrap_or(ChainPlace {
            first_segment: link.segment,
            ends_s: 0.0,
        });
        let block = link.planned(self.blocks.front(), before, epoch);
        self.place = Some(block.place);
        block
    }
}

/// What a chain takes of a segment.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Block<'a> {
    pub(crate) segment: u64,
    pub(crate) origin: Origin,
    pub(crate) path: &'a Path,
    pub(crate) alone: Alone,
}

impl Link {
    /// Time of the block at its speed, s.
    fn block_s(&self) -> f64 {
        self.length / self.speed
    }

    fn end_with(&mut self, stop: UnitRamp, rule: ShortBlock) {
        if rule == ShortBlock::Extend {
            // Both half ramps must have room: the block takes at least their time.
            let ramps_s = f64::midpoint(self.start.duration_s(), stop.duration_s());
            self.speed = self.speed.min(self.length / ramps_s);
        }
        self.stop = Some(stop);
    }

    /// As planned, going over to the next one, where the block before has come to; alone in its chain, it is the block
    /// from rest to rest.
    fn planned(&self, next: Option<&Link>, before: ChainPlace, epoch: u32) -> RampedBlock {
        let (speed, start, stop, begun_s, plan_s) = match self.stop {
            None => {
                let RestToRest {
                    speed,
                    start,
                    stop,
                    duration_s,
                } = self.alone.rest_to_rest(self.length);
                (speed, start, stop, 0.0, duration_s)
            }
            Some(stop) => {
                let (begun_s, ramp_in_s) = if self.is_first {
                    (0.0, self.start.duration_s() / 2.0)
                } else {
                    (self.start.duration_s(), -self.start.duration_s() / 2.0)
                };
                let plan_s = self.length / self.speed + ramp_in_s + stop.duration_s() / 2.0;
                (self.speed, self.start, stop, begun_s, plan_s)
            }
        };
        RampedBlock {
            segment: self.segment,
            epoch,
            origin: self.origin,
            path: self.path.clone(),
            speed,
            start,
            stop,
            begun_s,
            next: next.map(|next| Lead {
                path: next.path.clone(),
                speed: next.speed,
            }),
            plan_s,
            place: ChainPlace {
                ends_s: before.ends_s + plan_s,
                ..before
            },
        }
    }
}
